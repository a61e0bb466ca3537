"""Telling rivals apart: which motion splits effects that recordings cannot tell from each other, and how likely it decides."""
