"""Robust estimators: losses that bound what a segment of rows can do."""
