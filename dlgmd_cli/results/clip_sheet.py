"""What a contact sheet shows of a rendered clip: some of its frames, and what is true of them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Still:
    """One frame of a clip.

    Attributes
    ----------
    frame : int
        Its number, from 0.
    time_s : float
    image : ndarray, shape (H, W), uint8
        As it was rendered, before any video smoothed it.
    phase : str
        What the drone is doing; empty where there is none.
    time_to_contact_s, angular_size_deg : float
        NaN where not defined.
    is_collision : bool
        Whether it is the clip's collision frame.
    """

    frame: int
    time_s: float
    image: npt.NDArray[np.uint8]
    phase: str = ""
    time_to_contact_s: float = math.nan
    angular_size_deg: float = math.nan
    is_collision: bool = False


@dataclass(frozen=True)
class ClipSheet:
    """Some frames of one clip.

    Attributes
    ----------
    name : str
        What the clip is called.
    fps : float
        Frames per second.
    n_frames : int
        How many frames the clip has.
    seed : int
        Where all that is random in it starts.
    stills : tuple of Still
        At least one, in order, all of one shape.
    target : str
        What a flight may collide with; empty where there is no such thing.
    collision_frame : int or None
        None if no frame of the clip is at or after the contact.
    collision_time_s : float or None
        None if the flight has no contact, be it after the clip.
    """

    name: str
    fps: float
    n_frames: int
    seed: int
    stills: tuple[Still, ...]
    target: str = ""
    collision_frame: int | None = None
    collision_time_s: float | None = None
