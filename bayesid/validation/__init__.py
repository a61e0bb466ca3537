"""Validation: predictions of held-out motions, cross-checks, and tests of agreement."""
