"""A flight through a world: what there is to see, and what the truth is about."""

from dataclasses import dataclass

from dlgmd_cli.flights.path import Path
from dlgmd_cli.flights.renderer.solids import World

# Where the drone's hull is: what is that near to the camera has been hit.
REACH_M = 0.1


@dataclass(frozen=True)
class Stage:
    """A world, and a flight through it.

    Attributes
    ----------
    world : World
    path : Path
    target : str
        Name of the bodies that distances and angles are about; all of that name are one target.
    contact_s : float or None
        When the drone hits something; None if it never does.
    duration_s : float
        How long it is filmed.
    """

    world: World
    path: Path
    target: str
    contact_s: float | None
    duration_s: float
