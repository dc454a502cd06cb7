"""Flights of a drone, rendered by MuJoCo, with the truth of each frame."""
