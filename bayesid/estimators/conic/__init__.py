"""Physically consistent estimation: conic problems over bodies that can exist."""
