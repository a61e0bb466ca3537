"""The robot: its model from a URDF, bodies, limits, and what is known of them beforehand."""
