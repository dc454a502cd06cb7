"""How soon a drone reaches what is in its way, point by point.

The window ahead averages an object with the background beside it. With the direction of flight and
the turns of the camera, each point has a time to contact of its own, and a place in the way or
beside. A drone's motion tells both; else they are found in the image.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.growth import (
    MIN_POINTS,
    PATCH_WH,
    Points,
    returns,
    tracked,
    tracked_near,
    visible,
)
from dlgmd_cli.models.windows import Camera, Direction

# The way reaches so far (m) to each side of the drone and above it, and below it: a hull of 0.3 m,
# with room for errors. Below, ground follows.
BESIDE_M, BELOW_M = 0.45, 0.3
# A slower drone has no way, in m/s.
LEAST_M_S = 0.5
# Points are tracked as far from the direction as they can be in the way at this rate (1/s), where
# the motion is known and where it is not, but at most this far. Neighbours are STEP_PX apart, or so
# much further that MOST_OUT reach the edge.
FASTEST, FASTEST_FOUND, FARTHEST_DEG, STEP_PX, MOST_OUT = 1.2, 1.0, 24.0, 3.0, 16
# Other points, so many along the sides of the image, tell how the camera turned, and more of them
# where the drone flies.
N_TURN, N_FOUND = 7, (14, 8)
# A point has moved if its patch fits less well, by this share, where it would be if it were far
# away: a repeated pattern fits at several places. Differences of NOISE_LEVELS are noise.
BETTER, NOISE_LEVELS = 0.6, 0.3
# Standard deviation of a tracked place (px).
PLACE_PX = 0.1
# A drone whose motion is unknown is taken to fly so fast (m/s).
USUAL_M_S = 2.0
# Standard deviations of the turn between two images, and of the direction of flight (rad): by the
# drone's motion, and before they are found in the image.
KNOWN, UNKNOWN_RAD = (0.005, math.radians(3.0)), (0.09, math.radians(10.0))
# Steps of the fit, and the standard deviations beyond which a point counts less.
N_STEPS, OUTSIDE = 4, 3.0
# The direction that is found moves by at most this (rad) in a step.
MOST_STEP_RAD = 0.06
# A rate counts less its standard error, if this is at most MOST_ERROR (1/s), and if the point is
# not nearer to the direction (rad), where it hardly moves. A point moves away from the direction:
# across by at most MOST_ACROSS standard deviations and this share of its way.
MOST_ERROR, LEAST_RAD, MOST_ACROSS, SHARE_ACROSS = 1.0, 0.03, 5.0, 0.3
# So many of 3 x 3 neighbouring points reach the rate.
SUPPORT = 6
# What `fastest` gives if nothing is in the way, and if too few points can be tracked to say so.
NOTHING, UNKNOWN = (0.0, (math.nan, math.nan)), (math.nan, (math.nan, math.nan))

_Numbers = npt.NDArray[np.float64]


class Motion(NamedTuple):
    """How a drone flies when an image is taken.

    Attributes
    ----------
    direction : (float, float)
        To the right and upwards from the camera's axis, in degrees.
    speed_m_s : float
        NaN if unknown.
    roll_deg, pitch_deg, yaw_deg : float
        The drone's attitude: positive with the right side down, the nose up, and to the right. NaN
        if unknown.
    """

    direction: Direction
    speed_m_s: float = math.nan
    roll_deg: float = math.nan
    pitch_deg: float = math.nan
    yaw_deg: float = math.nan

    @property
    def is_whole(self) -> bool:
        """Whether speed and attitude are known."""
        return not math.isnan(self.speed_m_s + self.roll_deg + self.pitch_deg + self.yaw_deg)

    @property
    def has_way(self) -> bool:
        """Whether they are known, and the drone flies."""
        return self.is_whole and self.speed_m_s >= LEAST_M_S

    def axes(self, tilt_deg: float) -> _Numbers:
        """The axes of a tilted camera: to its right, down and forward, as rows (3, 3).

        Along north, east and down.
        """
        drone = ((0, 0, self.yaw_deg), (0, self.pitch_deg, 0), (self.roll_deg, 0, 0))
        turns = [cv2.Rodrigues(np.radians(turn))[0] for turn in (*drone, (0, tilt_deg, 0))]
        forward, right, down = np.linalg.multi_dot(turns).T
        return np.stack((right, down, forward))


class Course(NamedTuple):
    """How a camera flies from an image to a later one.

    Attributes
    ----------
    direction : (float, float)
        To the right and upwards from the axis, in degrees, at the earlier image.
    speed_m_s : float
    turn : ndarray, shape (3, 3)
        From what a far point's direction is at the earlier image to what it is at the later one.
    prior : ndarray, shape (5, 5)
        Inverse covariance (1/rad²) of the turns about the three axes and of the direction.
    n_turn : int
        Columns and rows of points over the whole image that tell more of both.
    fastest : float
        The rate (1/s) at which all points in the way are tracked.
    """

    direction: Direction
    speed_m_s: float
    turn: _Numbers
    prior: _Numbers
    n_turn: int
    fastest: float


def known(motions: tuple[Motion, Motion], camera: Camera) -> Course:
    """The course of a drone that tells its speed and attitude at two images."""
    then, now = motions
    turn = now.axes(camera.tilt_deg) @ then.axes(camera.tilt_deg).T
    return Course(then.direction, then.speed_m_s, turn, _prior(*KNOWN), N_TURN, FASTEST)


def found(before: Grey, now: Grey, camera: Camera, shown: Flags | None = None) -> Course | None:
    """The course by the moves of points over the whole image, at a usual speed.

    None if too few points can be tracked, or the image does not show where the camera flies.
    """
    points = visible(_spread(now.shape, *N_FOUND), now.shape, shown)
    there, is_tracked, _ = tracked(before, now, points)
    if np.count_nonzero(is_tracked) < 2 * MIN_POINTS:
        return None
    focal, axis = camera.focal(now.shape[1]), np.array(camera.axis(now.shape))
    points, there = ((places[is_tracked] - axis) / focal for places in (points, there))
    foe = ahead = np.tan(np.radians(camera.ahead)) * (1.0, -1.0)
    turns, prior = np.zeros(3), _prior(*UNKNOWN_RAD)
    for _ in range(N_STEPS):
        left = there - _by_turns(points, there) @ turns
        more, precision = _fitted(points, left, foe, PLACE_PX / focal, prior, ahead - foe)
        turns, foe = turns + more[:3], foe + np.clip(more[3:], -MOST_STEP_RAD, MOST_STEP_RAD)
    right_deg, up_deg = np.degrees(np.arctan(foe * (1.0, -1.0))).tolist()
    if camera.window(now.shape, (right_deg, up_deg)) is None:
        return None
    turn = np.asarray(cv2.Rodrigues(-turns)[0], np.float64)
    return Course((right_deg, up_deg), USUAL_M_S, turn, precision, 0, FASTEST_FOUND)


def fastest(
    before: Grey,
    now: Grey,
    course: Course,
    camera: Camera,
    age_s: float,
    shown: Flags | None = None,
) -> tuple[float, tuple[float, float]]:
    """The fastest rate that `SUPPORT` neighbouring points in the drone's way reach.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
        An earlier and a later image.
    course : Course
        From the earlier to the later one.
    camera : Camera
    age_s : float
        The time from the earlier to the later image.
    shown : ndarray, shape (H, W), bool, optional
        Where points may be.

    Returns
    -------
    rate : float
        1 / (time to contact) at the later image, in 1/s, less its standard error; 0 if nothing is
        in the way, NaN if too few points can be tracked.
    place : (float, float)
        Of the points in the earlier image, x and y from -1 to 1; NaN without a rate above 0.

    Notes
    -----
    The later image is turned back, so that far points stay where they are. With the place
    z = (x, y) of a point, the direction f, r = |z - f| and the move d, all on the plane at the
    distance 1, the point reaches the camera at the rate q / t, with q = d·(z - f) / r² and the time
    t between the images. Remaining turns ω and an error of the direction are found from the moves
    across z - f, which do not depend on depth: weighted least squares with the course's errors as
    priors. Their covariance is in the standard error of each q. A point is in the way of a drone
    with the speed v if the distance r v / q is at most `BESIDE_M`.
    """
    way = _Way(course, camera, now.shape)
    turn = way.view @ course.turn @ np.linalg.inv(way.view)
    turned = cv2.warpPerspective(
        now, turn, now.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    at_rest = cv2.boxFilter(cv2.absdiff(before, turned), cv2.CV_32F, PATCH_WH)
    points = np.concatenate((way.points, _spread(now.shape, course.n_turn, course.n_turn)))
    usable = _usable(points, now.shape, shown)
    usable &= _usable(cv2.perspectiveTransform(points[np.newaxis], turn)[0], now.shape)
    if np.count_nonzero(usable) < 2 * MIN_POINTS:
        return UNKNOWN
    there, reached, differs = tracked_near(before, turned, points[usable])
    kept = np.flatnonzero(usable)[reached]
    if len(kept) < 2 * MIN_POINTS:
        return UNKNOWN
    points, there = points[kept], there[reached]
    column, row = np.rint(points).astype(np.intp).T
    moved = differs[reached] + NOISE_LEVELS < BETTER * (at_rest[row, column] + NOISE_LEVELS)
    moved &= kept < len(way.points)
    sight = _sight(way.on_plane(points), way.on_plane(there), way.foe, way.focal, course.prior)
    rate = (sight.growth - sight.error) / age_s
    moved &= sight.moves_away & (sight.error <= MOST_ERROR * age_s) & way.holds(points, sight, rate)
    moved[moved] = returns(before, turned, points[moved], there[moved])
    return way.reached(points[moved], rate[moved])


class _Way:
    """The points around the direction of flight, and which of them are in the drone's way.

    Attributes
    ----------
    view : ndarray, shape (3, 3)
        From directions to px.
    foe : ndarray, shape (2,)
        The direction of flight on the plane at the distance 1.
    points : ndarray, shape (n, 2)
    """

    def __init__(self, course: Course, camera: Camera, shape: tuple[int, ...]) -> None:
        self.focal, self._shape = camera.focal(shape[1]), shape
        self._axis = np.array(camera.axis(shape))
        self.view = np.diag((self.focal, self.focal, 1.0))
        self.view[:2, 2] = self._axis
        self.foe = np.tan(np.radians(course.direction)) * (1.0, -1.0)
        self._per_m = 1.0 / course.speed_m_s
        reach = min(BESIDE_M * self._per_m * course.fastest, math.tan(math.radians(FARTHEST_DEG)))
        self._step = STEP_PX * math.ceil(reach * self.focal / STEP_PX / MOST_OUT)
        self._n_out = math.ceil(reach * self.focal / self._step)
        side = np.arange(-self._n_out, self._n_out + 1)
        cells = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        cells = cells[np.hypot(*cells.T) <= self._n_out]
        self._middle = self._axis + self.focal * self.foe
        self.points: Points = np.float32(self._middle + self._step * cells)

    def on_plane(self, points: Points) -> _Numbers:
        """Places in px, on the plane at the distance 1."""
        return (points - self._axis) / self.focal

    def holds(self, points: Points, sight: "_Sight", rate: _Numbers) -> Flags:
        """Which points are in the way at these rates."""
        away = self.on_plane(points) - sight.foe
        away[:, 1] *= np.where(away[:, 1] > 0.0, BESIDE_M / BELOW_M, 1.0)
        return np.asarray(np.hypot(*away.T) <= BESIDE_M * self._per_m * rate)

    def reached(self, points: Points, rate: _Numbers) -> tuple[float, tuple[float, float]]:
        """The rate of the fastest group of neighbours, and its place."""
        cells = np.rint((points - self._middle) / self._step).astype(np.intp) + self._n_out
        if len(cells) < SUPPORT:
            return NOTHING
        rates = np.zeros((2 * self._n_out + 3,) * 2)
        rates[cells[:, 1] + 1, cells[:, 0] + 1] = rate
        blocks = np.lib.stride_tricks.sliding_window_view(rates, (3, 3))
        reached = np.partition(blocks.reshape(*blocks.shape[:2], 9), -SUPPORT)[..., -SUPPORT]
        row, column = np.unravel_index(np.argmax(reached), reached.shape)
        if not reached[row, column] > 0.0:
            return NOTHING
        x, y = (self._middle + self._step * (np.array((column, row)) - self._n_out)).tolist()
        height, width = self._shape
        place = (2.0 * x + 1.0) / width - 1.0, (2.0 * y + 1.0) / height - 1.0
        return float(reached[row, column]), place


def _prior(turn_rad: float, direction_rad: float) -> _Numbers:
    """The inverse covariance of three turns and a direction with these standard deviations."""
    deviations = np.array([turn_rad] * 3 + [direction_rad] * 2)
    return np.diag(deviations**-2.0)


def _spread(shape: tuple[int, ...], n_across: int, n_down: int) -> Points:
    """Columns and rows of points over the whole image."""
    height, width = shape
    across = np.linspace(8.0, width - 9.0, n_across)
    down = np.linspace(8.0, height - 9.0, n_down)
    return np.float32(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))


def _usable(points: Points, shape: tuple[int, ...], shown: Flags | None = None) -> Flags:
    """Which points have most of their patch in an image (H, W), and are where it is `shown`."""
    height, width = shape
    edge = PATCH_WH[0] // 2
    usable: Flags = np.all((points >= edge) & (points < (width - edge, height - edge)), axis=1)
    if shown is not None:
        column, row = np.rint(points[usable]).astype(np.intp).T
        usable[usable] = shown[row, column]
    return usable


class _Sight(NamedTuple):
    """The found direction on the plane at the distance 1, (2,), and what n points do, (n,).

    That is their growth q, its standard error, and whether they move away from the direction.
    """

    foe: _Numbers
    growth: _Numbers
    error: _Numbers
    moves_away: Flags


def _sight(
    points: _Numbers, there: _Numbers, foe: _Numbers, focal: float, prior: _Numbers
) -> _Sight:
    """The growth of each point, from its place on the plane at the distance 1 in two images."""
    deviation = PLACE_PX / focal
    more, precision = _fitted(points, there, foe, deviation, prior)
    covariance = np.linalg.inv(precision)
    by_turns = _by_turns(points, there)
    move = there - points - by_turns @ more[:3]
    foe = foe + more[3:]
    along, across, distance = _away(points, foe)
    growth = _dot(move, along) / distance
    by = (
        np.concatenate(
            (np.einsum("nij,ni->nj", by_turns, along), -np.abs(growth)[:, np.newaxis] * along),
            axis=1,
        )
        / distance[:, np.newaxis]
    )
    error = np.sqrt((deviation / distance) ** 2 + np.einsum("ni,ij,nj->n", by, covariance, by))
    most = MOST_ACROSS * deviation + SHARE_ACROSS * np.abs(growth) * distance
    moves_away = (distance > LEAST_RAD) & (np.abs(_dot(move, across)) < most)
    return _Sight(foe, growth, error, moves_away)


def _fitted(
    points: _Numbers,
    there: _Numbers,
    foe: _Numbers,
    deviation: float,
    prior: _Numbers,
    expected: _Numbers | float = 0.0,
) -> tuple[_Numbers, _Numbers]:
    """Three turns and two corrections of the direction, (5,), and their inverse covariance.

    Parameters
    ----------
    points, there : ndarray, shape (n, 2)
        Places on the plane at the distance 1 in two images.
    foe : ndarray, shape (2,)
        The direction there.
    deviation : float
        Standard deviation of a place.
    prior : ndarray, shape (5, 5)
        The inverse covariance before: of turns that are 0 at best, and of the corrections.
    expected : ndarray, shape (2,)
        The corrections at best.
    """
    move = there - points
    along, across, distance = _away(points, foe)
    moved_across = _dot(move, across)
    growth = np.clip(_dot(move, along) / distance, 0.0, 0.3)
    factors = np.concatenate(
        (
            np.einsum("nij,ni->nj", _by_turns(points, there), across),
            -growth[:, np.newaxis] * across,
        ),
        axis=1,
    )
    pull = prior[:, 3:] @ np.broadcast_to(expected, 2)
    weight = np.ones(len(points))
    for _ in range(N_STEPS):
        weighted = factors * (weight / deviation**2)[:, np.newaxis]
        precision = weighted.T @ factors + prior
        fit = np.linalg.solve(precision, weighted.T @ moved_across + pull)
        squares = ((moved_across - factors @ fit) / deviation) ** 2
        # Without NumPy's `median`, which takes as long as the rest of a step.
        scale = max(1.0, 2.2 * float(np.partition(squares, len(squares) // 2)[len(squares) // 2]))
        weight = 1.0 / (1.0 + squares / (OUTSIDE**2 * scale))
    return fit, precision / scale


def _by_turns(points: _Numbers, there: _Numbers) -> _Numbers:
    """The moves by small turns about the axes to the right, down and forward, (n, 2, 3)."""
    x, y = ((points + there) / 2.0).T
    right = np.stack((x * y, -1.0 - x * x, y), -1)
    return np.stack((right, np.stack((1.0 + y * y, -x * y, -x), -1)), axis=1)


def _away(points: _Numbers, foe: _Numbers) -> tuple[_Numbers, _Numbers, _Numbers]:
    """Unit vectors away from a place and across them, (n, 2), and the distances from it, (n,)."""
    away = points - foe
    distance = np.maximum(np.hypot(*away.T), 1e-6)
    along = away / distance[:, np.newaxis]
    return along, np.stack((-along[:, 1], along[:, 0]), axis=-1), distance


def _dot(a: _Numbers, b: _Numbers) -> _Numbers:
    product: _Numbers = np.einsum("ni,ni->n", a, b)
    return product
