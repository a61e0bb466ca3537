"""Mistakes of whoever made the recording: signs, frames, units and orders, found by what they do to a cheap fit."""
