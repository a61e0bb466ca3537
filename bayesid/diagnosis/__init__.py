"""Find the effect that a model misses: where it disagrees with the data, what is missing, and proof that it was."""

from bayesid.diagnosis.diagnose import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
