"""Find the effect that a model misses: where it disagrees with the data, what is missing, and held-out validation of it."""

from bayesid.diagnosis.diagnose import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
