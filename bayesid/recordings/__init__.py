"""Recordings: tables, the experiment folder, and the checks on both."""
