"""What hangs at the flange: mass, centre of mass and inertia of one body, where they are known from, and what shows more."""
