"""The laboratory: what makes truth (stimuli, rendered flights) and measures against it."""
