"""The ground truth of a flight: distances, angular sizes, image speed, and the first contact."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights.camera import Camera, Pose, angles_of
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, State
from dlgmd_cli.scenes.flights.solids import Body, Face, IntArray, Surfaces, World
from dlgmd_cli.scenes.flights.visibility import is_outside

# A solid with fewer faces is not closed.
_LEAST_CLOSED = 4
# Longest and shortest time step in the search for contact.
_LONGEST_S, _SHORTEST_S = 0.02, 0.002
# Upper bound on the gain in speed of the drone and the bodies during a step.
_MARGIN_M_S = 0.5
_N_HALVINGS = 40
# Tolerance of contact: a rebounding drone is within reach for an instant only.
_ROUNDING_M = 1e-6
# Below this sine of the angle between two directions, its rate is taken as 0.
_SAME_DIRECTION = 1e-12
# Cells of the grid of viewing rays, which spans the image.
_N_COLUMNS, _N_ROWS = 64, 36
# Tolerance for a ray that hits the edge between two faces.
_ROUNDING = 1e-9
_LEAST = 1e-12
# Relative tolerance in depth when deciding whether a point is hidden.
_HIDES = 1e-6
# Points on the outline of a ball.
_N_AROUND = 8
# Rounding tolerance for times.
_SAME_S = 1e-9


@dataclass(frozen=True)
class FlightTruth:
    """The ground truth of one frame.

    Attributes
    ----------
    x_m, y_m, z_m, roll_deg, pitch_deg, yaw_deg : float
        Position and attitude of the camera, see `State`; within ±180 if it is mounted tilted.
    distance_m : float
        Distance from the camera to the nearest point of the target; 0 inside.
    time_to_contact_s : float
        Time until contact; NaN after it, and in a flight without contact.
    angular_size_deg, angular_velocity_deg_s : float
        Greatest angle between two points of the target, inside the image or not, 180 at most; and
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


class Nearest:
    """Exact distances from a point to convex bodies, and to walls as infinite planes."""

    def __init__(self, bodies: Sequence[Body], walls: Sequence[Face] = ()) -> None:
        self.surfaces = Surfaces(bodies)
        corners = self.surfaces.corners_m
        self._edges = np.roll(corners, -1, axis=1) - corners
        squares = (self._edges**2).sum(axis=-1)
        # Where a corner is repeated, its edge is a point.
        self._squares = np.where(squares > 0.0, squares, 1.0)
        self._inwards = np.cross(self.surfaces.normals[:, None], self._edges)
        self._solids, self._starts = np.unique(self.surfaces.face_body, return_index=True)
        n_faces = np.diff([*self._starts, len(corners)])
        self._closed = n_faces >= _LEAST_CLOSED
        self._low = np.minimum.reduceat(corners.min(axis=1), self._starts)
        self._high = np.maximum.reduceat(corners.max(axis=1), self._starts)
        self._wall_normals = np.array([wall.normal for wall in walls]).reshape(-1, 3)
        self._wall_levels = np.array([wall.normal @ wall.corners_m[0] for wall in walls])

    def distances(self, position_m: FloatArray, time_s: float) -> FloatArray:
        """Distances from a point, (3,), to each body, and then to each wall, in m.

        They are 0 inside a body, and negative behind a wall.
        """
        # Instead of moving the bodies, move the point the other way.
        points = position_m - self.surfaces.offsets(time_s)
        distances = np.full(len(points), np.inf)
        distances[self._solids] = self._to_solids(points)
        distances[self.surfaces.capsule_body] = self._to_capsules(points)
        return np.concatenate([distances, self._wall_normals @ position_m - self._wall_levels])

    def _to_solids(self, points: FloatArray) -> FloatArray:
        """Distances to the solids from points, one for each body."""
        surfaces = self.surfaces
        to_corners = points[surfaces.face_body][:, None] - surfaces.corners_m
        heights = (to_corners[:, 0] * surfaces.normals).sum(axis=-1)
        above = (to_corners * self._inwards).sum(axis=-1).min(axis=1) >= 0.0
        along = (to_corners * self._edges).sum(axis=-1) / self._squares
        to_edges = to_corners - np.clip(along, 0.0, 1.0)[..., None] * self._edges
        beside = np.sqrt((to_edges**2).sum(axis=-1).min(axis=1))
        to_faces = np.where(above, np.abs(heights), beside)
        nearest = np.minimum.reduceat(to_faces, self._starts)
        highest = np.maximum.reduceat(heights, self._starts)
        of_solids = points[self._solids]
        boxed = ((of_solids >= self._low) & (of_solids <= self._high)).all(axis=-1)
        inside = self._closed & (highest <= 0.0) & boxed
        return np.where(inside, 0.0, nearest)

    def _to_capsules(self, points: FloatArray) -> FloatArray:
        """Distances to the capsules from points, one for each body."""
        first, axis = self.surfaces.ends_m[:, 0], np.diff(self.surfaces.ends_m, axis=1)[:, 0]
        squares = (axis**2).sum(axis=-1)
        to_first = points[self.surfaces.capsule_body] - first
        along = (to_first * axis).sum(axis=-1) / np.where(squares > 0.0, squares, 1.0)
        to_axis = to_first - np.clip(along, 0.0, 1.0)[:, None] * axis
        return np.maximum(np.sqrt((to_axis**2).sum(axis=-1)) - self.surfaces.radii_m, 0.0)


def surroundings(world: World) -> Nearest:
    """Distances to everything in a world."""
    return Nearest(world.bodies, world.room.faces)


def first_contact(path: Path, world: World) -> float | None:
    """Time, in s, when something first comes within `REACH_M` of the camera, or None.

    Whatever is that close at the start, such as the floor under the drone, counts only after it
    has been farther away.
    """
    return contact_after(path, surroundings(world), 0.0, _LONGEST_S)


def contact_after(
    path: Path, nearest: Nearest, start_s: float, longest_s: float = math.inf
) -> float | None:
    """The first contact from a time on, as `first_contact` has it.

    `longest_s` is the longest time step; it has to be short if the drone or a body speeds up.
    """

    def distances(time_s: float) -> FloatArray:
        return nearest.distances(path.state(time_s).position_m, time_s)

    blows = [stretch.start_s for stretch in path.stretches[1:]]
    time, was = start_s, distances(start_s)
    clear = was > REACH_M
    while time < path.duration_s and len(was):
        velocities = nearest.surfaces.velocities(time)
        fastest = float(np.sqrt((velocities**2).sum(axis=-1)).max(initial=0.0))
        speed = float(np.linalg.norm(path.state(time).velocity_m_s)) + fastest + _MARGIN_M_S
        gap = float((was[clear] - REACH_M).min(initial=math.inf))
        step = min(max(gap / speed, _SHORTEST_S), longest_s)
        later = min(time + step, path.duration_s, *(blow for blow in blows if blow > time))
        now = distances(later)
        touched = clear & (now <= REACH_M + _ROUNDING_M)
        if touched.any():
            for _ in range(_N_HALVINGS):
                middle = 0.5 * (time + later)
                is_met = (distances(middle)[touched] <= REACH_M).any()
                time, later = (time, middle) if is_met else (middle, later)
            return later
        clear |= now > REACH_M
        time, was = later, now
    return None


class ImageSpeed:
    """The greatest image speed over sample points.

    The points are the nodes of a grid over the image, and the visible corners of the target and
    points on the outlines of its round parts.
    """

    def __init__(self, world: World, camera: Camera, target: str | None = None) -> None:
        self.surfaces = Surfaces([*world.bodies, world.room])
        self._camera = camera
        half_width, half_height = camera.middle_xy / camera.focal_px
        x, y = np.meshgrid(
            np.linspace(-half_width, half_width, _N_COLUMNS + 1),
            np.linspace(-half_height, half_height, _N_ROWS + 1),
        )
        self.grid = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
        points, radii, body = _marks(Surfaces(world.bodies))
        of_target = np.array([world.bodies[i].name == target for i in body], bool)
        self._marks, self._radii, self._mark_body = (
            points[of_target],
            radii[of_target],
            body[of_target],
        )

    def fastest(self, state: State, time_s: float) -> float:
        """The greatest image speed, in px/s, for a camera in this state at a time."""
        pose, offsets = self._camera.mounted(state.pose), self.surfaces.offsets(time_s)
        marks, mark_body = self._marked(pose, offsets)
        rays = np.concatenate([self.grid, marks / marks[:, 2:]])
        closeness, body = self.cast(rays, pose, offsets)
        n_lines = len(self.grid)
        mark_closeness = 1.0 / marks[:, 2]
        shown = closeness[n_lines:] <= mark_closeness * (1.0 + _HIDES)
        closeness[n_lines:], body[n_lines:] = np.where(shown, mark_closeness, 0.0), mark_body
        axes = pose.camera_from_world.T
        speeds = (self.surfaces.velocities(time_s) - state.velocity_m_s) @ axes
        spin = state.angular_velocity_rad_s @ axes
        # Rates of change of x / z and y / z, in 1/s.
        moves = speeds[body] * closeness[:, None] - np.cross(spin, rays)
        flow = moves[:, :2] - rays[:, :2] * moves[:, 2:]
        seen = closeness > 0.0
        fastest = np.sqrt((flow[seen] ** 2).sum(axis=-1)).max(initial=0.0)
        return float(self._camera.focal_px * fastest)

    def cast(
        self, rays: FloatArray, pose: Pose, offsets_m: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Find the nearest body along rays, (n, 3), in camera axes with forward component 1.

        The bodies have moved by (n_bodies, 3) m. Returns 1 / depth, (n,) in 1/m, and the indices of
        the bodies in `surfaces`, where the last one is the room. Both are 0 for rays without a hit.
        """
        surfaces, axes = self.surfaces, pose.camera_from_world.T
        closeness, body = np.zeros(len(rays)), np.zeros(len(rays), np.intp)
        eyes = pose.position_m - offsets_m
        corners = (surfaces.corners_m - eyes[surfaces.face_body][:, None]) @ axes
        normals = surfaces.normals @ axes
        heights = (corners[:, 0] * normals).sum(axis=-1)
        chosen = np.flatnonzero((heights < 0.0) & ~is_outside(self._camera, corners))
        corners, planes = corners[chosen], normals[chosen] / heights[chosen, None]
        # Planes through the camera and each side; positive outside the face.
        sides = np.cross(corners, np.roll(corners, -1, axis=1))
        sides /= np.maximum(np.sqrt((sides**2).sum(axis=-1, keepdims=True)), _LEAST)
        columns = np.ascontiguousarray(rays.T)
        hits = [
            (np.where((side @ columns).max(axis=0) <= _ROUNDING, plane @ columns, 0.0), owner)
            for side, plane, owner in zip(sides, planes, surfaces.face_body[chosen], strict=True)
        ]
        for each, owner in zip(surfaces.capsules, surfaces.capsule_body, strict=True):
            seen = self._camera.view(each.ends_m + offsets_m[owner], pose)
            if (seen[:, 2] >= -each.radius_m).any():
                hits.append((_capsule(rays, seen, each.radius_m), owner))
        for near, owner in hits:
            body[near > closeness] = owner
            np.maximum(closeness, near, out=closeness)
        return closeness, body

    def _marked(self, pose: Pose, offsets_m: FloatArray) -> tuple[FloatArray, IntArray]:
        """The target's points inside the image, in camera axes, and their bodies."""
        at = self._camera.view(self._marks + offsets_m[self._mark_body], pose)
        outlines = [_outline(*mark) for mark in zip(at, self._radii, strict=True)]
        points = np.concatenate([np.empty((0, 3)), *outlines])
        owners = np.repeat(self._mark_body, [len(outline) for outline in outlines])
        ahead = points[:, 2] > 0.0
        points, owners = points[ahead], owners[ahead]
        reach = self._camera.middle_xy / self._camera.focal_px
        framed = (np.abs(points[:, :2] / points[:, 2:]) <= reach).all(axis=-1)
        return points[framed], owners[framed]


def _outline(middle: FloatArray, radius: float) -> FloatArray:
    """Points on the outline of a ball seen from the origin, and its nearest point, (n, 3)."""
    if radius == 0.0:
        return middle[None]
    distance = float(np.sqrt(middle @ middle))
    if distance <= radius:
        return np.empty((0, 3))
    towards = middle / distance
    aside = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    aside /= np.sqrt(aside @ aside)
    angles = np.arange(_N_AROUND) * (2.0 * np.pi / _N_AROUND)
    ring = np.cos(angles)[:, None] * aside + np.sin(angles)[:, None] * np.cross(towards, aside)
    share = radius / distance
    rim = (distance - radius * share) * towards + radius * np.sqrt(1.0 - share**2) * ring
    return np.concatenate([rim, (middle - radius * towards)[None]])


def _capsule(rays: FloatArray, ends: FloatArray, radius: float) -> FloatArray:
    """1 / depth at which rays enter a capsule; 0 for those that miss it."""
    balls = [_entry((rays**2).sum(axis=-1), rays @ end, end @ end - radius**2) for end in ends]
    near = np.maximum(*balls)
    axis = ends[1] - ends[0]
    length = float(np.sqrt(axis @ axis))
    if length == 0.0:
        return near
    axis = axis / length
    sideways = rays - (rays @ axis)[:, None] * axis
    middle = ends[0] - (ends[0] @ axis) * axis
    squares, along = (sideways**2).sum(axis=-1), sideways @ middle
    tube = _entry(squares, along, middle @ middle - radius**2)
    height = np.divide(rays @ axis, tube, out=np.full(len(tube), -1.0), where=tube > 0.0)
    height -= ends[0] @ axis
    return np.maximum(near, np.where((height >= 0.0) & (height <= length), tube, 0.0))


def _entry(squares: FloatArray, along: FloatArray, power: float) -> FloatArray:
    """1 / s for the smaller solution s of a s² - 2 b s + c = 0 if it is positive, else 0."""
    inner = along**2 - squares * power
    meets = (inner >= 0.0) & (along > 0.0) & (power > 0.0)
    root = np.sqrt(np.where(meets, inner, 0.0))
    # The smaller solution is c / (b + sqrt(b² - a c)).
    return np.where(meets, (along + root) / (power if power > 0.0 else 1.0), 0.0)


def _marks(surfaces: Surfaces) -> tuple[FloatArray, FloatArray, IntArray]:
    """Corners, with radius 0, and the end balls of capsules: their centres, radii and bodies."""
    of_corner = np.repeat(surfaces.face_body, surfaces.corners_m.shape[1])[:, None]
    # Corners that faces share count once.
    corners = np.unique(np.hstack([of_corner, surfaces.corners_m.reshape(-1, 3)]), axis=0)
    points = np.concatenate([corners[:, 1:], surfaces.ends_m.reshape(-1, 3)])
    radii = np.concatenate([np.zeros(len(corners)), np.repeat(surfaces.radii_m, 2)])
    body = np.concatenate([corners[:, 0], np.repeat(surfaces.capsule_body, 2)]).astype(np.intp)
    return points, radii, body


class Target:
    """The target of a stage; raises ParameterError if no body has its name."""

    def __init__(self, stage: Stage) -> None:
        if not stage.targets:
            raise ParameterError("the flight's target", f"nothing is named '{stage.target}'")
        self._nearest = Nearest(stage.targets)
        self._points, self._radii, self._body = _marks(self._nearest.surfaces)

    def seen_from(self, state: State, time_s: float) -> tuple[float, float, float]:
        """Distance in m, angular size in degrees, and its rate in degrees/s; see `FlightTruth`.

        The greatest angle is between two corners, or two end balls of capsules. For balls, half of
        the angle that each ball spans is added to the angle between the directions to their
        centres. The angle is 180 and its rate 0 inside a body, or if the bodies are all round.
        """
        surfaces = self._nearest.surfaces
        distance = float(self._nearest.distances(state.position_m, time_s).min())
        towards = self._points + surfaces.offsets(time_s)[self._body] - state.position_m
        lengths = np.sqrt((towards**2).sum(axis=-1))
        if distance == 0.0 or (lengths <= self._radii).any():
            return distance, 180.0, 0.0
        units = towards / lengths[:, None]
        halves = np.arcsin(self._radii / lengths)
        spans = np.arccos(np.clip(units @ units.T, -1.0, 1.0)) + halves[:, None] + halves
        pair = np.array(np.unravel_index(int(spans.argmax()), spans.shape))
        ends, half, length = units[pair], halves[pair], lengths[pair]
        speeds = surfaces.velocities(time_s)[self._body[pair]] - state.velocity_m_s
        cosine = float(ends[0] @ ends[1])
        sine = float(np.linalg.norm(np.cross(ends[0], ends[1])))
        angle = math.atan2(sine, cosine) + float(half.sum())
        if angle >= math.pi:
            return distance, 180.0, 0.0
        rate = 0.0
        if sine >= _SAME_DIRECTION:
            aside = speeds / length[:, None]
            turns = aside - (aside * ends).sum(axis=-1)[:, None] * ends
            rate = 0.0 - float(turns[0] @ ends[1] + ends[0] @ turns[1]) / sine
        outwards = (speeds * ends).sum(axis=-1)
        rate -= float((outwards * np.tan(half) / length).sum())
        return distance, math.degrees(angle), math.degrees(rate)


def truth_rows(stage: Stage, camera: Camera, fps: float, n_frames: int) -> Iterator[FlightTruth]:
    """The ground truth of frames 0, 1, … at index / fps; raises as `Target` does."""
    target = Target(stage)
    contact_s = math.nan if stage.contact_s is None else stage.contact_s
    speeds = ImageSpeed(stage.world, camera, stage.target)
    for index in range(n_frames):
        time = index / fps
        state = stage.path.state(time)
        distance, angle, rate = target.seen_from(state, time)
        left_s = max(contact_s - time, 0.0) if time <= contact_s + _SAME_S else math.nan
        x, y, z = state.position_m.tolist()
        angles = state.roll_deg, state.pitch_deg, state.yaw_deg
        if camera.tilt_deg:
            angles = angles_of(camera.mounted(state.pose).rotation)
        seen = distance, left_s, angle, rate, speeds.fastest(state, time) / fps
        yield FlightTruth(index, time, x, y, z, *angles, *seen, stage.path.phase(time))
