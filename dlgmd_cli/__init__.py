"""Locust-inspired collision detection on video: the D-LGMD model as a command and a library."""

__version__ = "0.1.0"
