"""Accuracy of an identification: what errors depend on, effects left out of the model, coverage, sensors to choose from."""
