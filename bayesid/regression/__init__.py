"""How recordings become the linear model: rows, their noise, and the problem that estimators take."""
