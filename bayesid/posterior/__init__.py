"""The posterior over base parameters and the links behind them: density, samplers, diagnostics, results."""
