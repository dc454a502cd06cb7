"""The ground truth of each frame of a flight, computed from the geometry."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.flights.geometry import AngularExtent, Nearest
from dlgmd_cli.lab.flights.image_speed import ImageSpeed
from dlgmd_cli.lab.flights.path import Stage, State
from dlgmd_cli.lab.flights.renderer.camera import Camera
from dlgmd_cli.lab.flights.renderer.solids import Body

# Rounding tolerance for times.
_SAME_S = 1e-9


@dataclass(frozen=True)
class FlightTruth:
    """The ground truth of one frame.

    Attributes
    ----------
    x_m, y_m, z_m, roll_deg, pitch_deg, yaw_deg : float
        Position and attitude of the camera, see `State`.
    distance_m : float
        Distance from the camera to the nearest point of the target; 0 inside.
    time_to_contact_s : float
        Time until contact; NaN after it, and in a flight without contact.
    angular_size_deg, angular_velocity_deg_s : float
        Greatest angle between two points of the target, inside the picture or not, 180 at most; and
        its rate. Rotation of the camera does not affect either.
    max_image_speed_px : float
        Greatest image speed, in px/frame.
    """

    frame: int
    time_s: float
    x_m: float
    y_m: float
    z_m: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    distance_m: float
    time_to_contact_s: float
    angular_size_deg: float
    angular_velocity_deg_s: float
    max_image_speed_px: float
    phase: str


def truth_rows(stage: Stage, camera: Camera, fps: float, n_frames: int) -> Iterator[FlightTruth]:
    """The ground truth of frames 0, 1, … at index / fps.

    Raises ParameterError if no body has the target's name.
    """
    target = Target(stage)
    speeds = ImageSpeed(stage.world, camera, stage.target)
    for index in range(n_frames):
        time = index / fps
        state = stage.path.state(time)
        distance, angle, rate = target.seen_from(state, time)
        x, y, z = state.position_m.tolist()
        yield FlightTruth(
            index,
            time,
            *(x, y, z),
            *(state.roll_deg, state.pitch_deg, state.yaw_deg),
            distance,
            _time_left(stage, time),
            angle,
            rate,
            speeds.fastest(state, time) / fps,
            stage.path.phase(time),
        )


class Target:
    """The target of a stage; raises as `truth_rows` does."""

    def __init__(self, stage: Stage) -> None:
        name = stage.target
        bodies: list[Body] = [body for body in stage.world.bodies if body.name == name]
        if stage.wall is not None:
            bodies = [stage.wall]
        if not bodies:
            raise ParameterError("the flight's target", f"nothing is named '{name}'")
        self._nearest = Nearest(bodies)
        self._extent = AngularExtent(self._nearest.surfaces)

    def seen_from(self, state: State, time_s: float) -> tuple[float, float, float]:
        """Distance in m, angular size in degrees, and its rate in degrees/s; see `FlightTruth`."""
        distance = float(self._nearest.distances(state.position_m, time_s).min())
        if distance == 0.0:
            return distance, 180.0, 0.0
        surfaces = self._nearest.surfaces
        offsets, velocities = surfaces.offsets(time_s), surfaces.velocities(time_s)
        angle, rate = self._extent.angle(state.position_m, state.velocity_m_s, offsets, velocities)
        return distance, angle, rate


def _time_left(stage: Stage, time_s: float) -> float:
    """Time until contact, in s."""
    if stage.contact_s is None or time_s > stage.contact_s + _SAME_S:
        return math.nan
    return max(stage.contact_s - time_s, 0.0)
