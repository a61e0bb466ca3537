"""Find the effect that a model misses: where it disagrees with the data, what is missing, and held-out validation of it."""
