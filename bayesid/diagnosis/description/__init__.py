"""The unknown, described: short formulas for what no effect of the library explains."""
