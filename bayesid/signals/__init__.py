"""Signals: smoothing of joint positions, the filters of the paper, noise models."""
