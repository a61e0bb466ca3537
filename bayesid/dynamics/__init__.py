"""Rigid-body dynamics: channels, regressors, kinematics, base parameters and the links behind them."""
