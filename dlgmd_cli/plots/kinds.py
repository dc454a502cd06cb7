"""The kinds of figures over time; without Matplotlib, for the command line."""

# The panels of each kind, from the top down.
KINDS: dict[str, tuple[str, ...]] = {
    "mp": ("level",),
    "attenuation": ("attenuation",),
    "spikes": ("level", "raster"),
    "overview": ("level", "attenuation", "raster"),
}
