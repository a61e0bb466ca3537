"""From recordings to the linear model: rows, their noise, and the problem that estimators take."""
