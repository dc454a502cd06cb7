"""What a rendered flight can be told."""

from dataclasses import dataclass

from dlgmd_cli.stimuli.base import ClipOptions, invalid, option

# What rounding may add to a time that fills the frame.
_TOLERANCE_MS = 1e-6


@dataclass(frozen=True)
class FlightOptions(ClipOptions):
    """Options of all flights; those of the camera, beside what every clip has.

    Attributes
    ----------
    exposure_ms : float
        How long the shutter is open, which blurs what moves; 0 for no blur.
    vignette : float
        Share of the light that the lens loses in the corners.
    noise : float
        Read noise: standard deviation, in units of full scale of linear light.
    shot_noise : float
        Standard deviation that a fully bright pixel gets beside it; its square grows with light.
    gamma : float
        Grey levels are linear light to the power of 1 / gamma.
    rolling_shutter_ms : float
        How much later the last row is taken than the first.
    """

    fov_deg: float = option(80.0, "--fov", 1, 170, unit="degrees")
    exposure_ms: float = option(0.0, "--exposure", 0, 1000, unit="ms")
    vignette: float = option(0.3, "--vignette", 0, 1)
    noise: float = option(0.002, "--noise", 0, 1)
    shot_noise: float = option(0.01, "--shot-noise", 0, 1)
    gamma: float = option(2.2, "--gamma", 1, 4)
    rolling_shutter_ms: float = option(0.0, "--rolling-shutter", 0, 1000, unit="ms")

    def __post_init__(self) -> None:
        super().__post_init__()
        period_ms = 1000.0 / self.fps
        for flag, value in (
            ("--exposure", self.exposure_ms),
            ("--rolling-shutter", self.rolling_shutter_ms),
        ):
            if value > period_ms + _TOLERANCE_MS:
                raise invalid(
                    flag,
                    f"{value:g} ms is longer than a frame at {self.fps:g} frames/s",
                    f"Choose {period_ms:.4g} or less, or a lower --fps.",
                )
