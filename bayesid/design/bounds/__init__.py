"""What a controller may rely on: simultaneous bounds of parameters, of the mass matrix and its companions, and of torques."""
