"""How soon a drone whose motion is known reaches what is in its way, point by point.

The window ahead averages an object with the background beside it. With the drone's attitude,
direction and speed, each point has a time to contact of its own, and a place in the way or beside.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.growth import MIN_POINTS, PATCH_WH, Points, grid, returns, tracked_near
from dlgmd_cli.models.windows import Camera, Direction

# The way reaches so far (m) to each side of the drone and above it, and below it: a hull of 0.3 m,
# with room for errors. Below, ground follows.
BESIDE_M, BELOW_M = 0.45, 0.3
# A slower drone has no way, in m/s.
LEAST_M_S = 0.5
# Points are tracked as far from the direction as they can be in the way at this rate (1/s), but at
# most this far. Neighbours are STEP_PX apart, or so much further that MOST_OUT reach the edge.
FASTEST, FARTHEST_DEG, STEP_PX, MOST_OUT = 1.2, 24.0, 3.0, 16
# Other points, so many along each side of the image, help to tell how the camera turned.
N_TURN = 7
# A point has moved if its patch fits less well, by this share, where it would be if it were far
# away: a repeated pattern fits at several places. Differences of NOISE_LEVELS are noise.
BETTER, NOISE_LEVELS = 0.6, 0.3
# Standard deviations of a tracked place (px), of the direction of flight, and of the turn between
# two images by the attitude (rad).
PLACE_PX, DIRECTION_RAD, TURN_RAD = 0.1, math.radians(3.0), 0.005
# Steps of the fit, and the standard deviations beyond which a point counts less.
N_STEPS, OUTSIDE = 4, 3.0
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
    """How a drone flies when an image is taken; what is not known is NaN.

    Attributes
    ----------
    direction : (float, float)
        To the right and upwards from the camera's axis, in degrees.
    speed_m_s : float
    roll_deg, pitch_deg, yaw_deg : float
        The drone's attitude: positive with the right side down, the nose up, and to the right.
    """

    direction: Direction = (math.nan, math.nan)
    speed_m_s: float = math.nan
    roll_deg: float = math.nan
    pitch_deg: float = math.nan
    yaw_deg: float = math.nan

    @property
    def has_attitude(self) -> bool:
        """Whether the attitude is known."""
        return not math.isnan(self.roll_deg + self.pitch_deg + self.yaw_deg)

    @property
    def is_moving(self) -> bool:
        """Whether the speed is known, and enough for a direction."""
        return self.speed_m_s >= LEAST_M_S

    @property
    def has_way(self) -> bool:
        """Whether all is known, and the drone moves."""
        return self.is_moving and self.has_attitude and not math.isnan(sum(self.direction))

    def axes(self, tilt_deg: float) -> _Numbers:
        """The axes of a tilted camera: to its right, down and forward, as rows (3, 3).

        Along north, east and down.
        """
        drone = ((0, 0, self.yaw_deg), (0, self.pitch_deg, 0), (self.roll_deg, 0, 0))
        turns = [cv2.Rodrigues(np.radians(turn))[0] for turn in (*drone, (0, tilt_deg, 0))]
        forward, right, down = np.linalg.multi_dot(turns).T
        return np.stack((right, down, forward))


def fastest(
    before: Grey,
    now: Grey,
    motions: tuple[Motion, Motion],
    camera: Camera,
    age_s: float,
    shown: Flags | None = None,
) -> tuple[float, tuple[float, float]]:
    """The fastest rate that `SUPPORT` neighbouring points in the drone's way reach.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
        An earlier and a later image.
    motions : (Motion, Motion)
        The drone's motion when they were taken; both with speed and attitude.
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
    The later image is turned back, see `turned`, so that far points stay where they are. With
    the place z = (x, y) of a point, the direction f, r = |z - f| and the move d, all on the plane
    at the distance 1, the point reaches the camera at the rate q / t, with q = d·(z - f) / r² and
    the time t between the images. Remaining turns ω and an error of the direction are found from
    the moves across z - f, which do not depend on depth: weighted least squares with `TURN_RAD`
    and `DIRECTION_RAD` as priors. Their covariance is in the standard error of each q. A point is
    in the way of a drone with the speed v if the distance r v / q is at most `BESIDE_M`.
    """
    way = Way(motions, camera, now.shape)
    found = way.seen(before, now, age_s, shown)
    return UNKNOWN if found is None else way.fastest(*found)


def turned(before: Motion, now: Motion, camera: Camera, shape: tuple[int, ...]) -> _Numbers | None:
    """Where far points of an image go as the drone turns until a later one: a homography, (3, 3).

    From places in px of the earlier image to those in the later one; both have the `shape` (H, W).
    None if the attitude at one of them is unknown.
    """
    if not (before.has_attitude and now.has_attitude):
        return None
    turn = now.axes(camera.tilt_deg) @ before.axes(camera.tilt_deg).T
    view = np.diag((camera.focal(shape[1]),) * 2 + (1.0,))
    view[:2, 2] = camera.axis(shape)
    found: _Numbers = view @ turn @ np.linalg.inv(view)
    return found


class Way:
    """Points around the direction of flight, and which of them are in the drone's way.

    `motions` are the drone's when two images of the `shape` (H, W) are taken; the points are a grid
    of neighbours around the direction in the earlier one, and some over the whole image.
    """

    def __init__(
        self, motions: tuple[Motion, Motion], camera: Camera, shape: tuple[int, ...]
    ) -> None:
        motion = motions[0]
        self._turn = turned(*motions, camera, shape)
        self._shape, self._focal = shape, camera.focal(shape[1])
        self._axis = np.array(camera.axis(shape))
        # The direction of flight on the plane at the distance 1.
        self._foe = np.tan(np.radians(motion.direction)) * (1.0, -1.0)
        self._per_m = 1.0 / motion.speed_m_s
        reach = min(BESIDE_M * self._per_m * FASTEST, math.tan(math.radians(FARTHEST_DEG)))
        self._step = STEP_PX * math.ceil(reach * self._focal / STEP_PX / MOST_OUT)
        self._n_out = math.ceil(reach * self._focal / self._step)
        side = np.arange(-self._n_out, self._n_out + 1)
        cells = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        cells = cells[np.hypot(*cells.T) <= self._n_out]
        self._middle = self._axis + self._focal * self._foe
        self._points: Points = np.float32(self._middle + self._step * cells)

    def seen(
        self, before: Grey, now: Grey, age_s: float, shown: Flags | None = None
    ) -> tuple[Points, _Numbers] | None:
        """The points in the way, in px of the earlier image, (n, 2), and their rates in 1/s, (n,).

        For the arguments, see the function `fastest`. None if too few points can be tracked, or
        if an attitude is unknown.
        """
        turn = self._turn
        if turn is None:
            return None
        back = cv2.warpPerspective(
            now, turn, now.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        )
        at_rest = cv2.boxFilter(cv2.absdiff(before, back), cv2.CV_32F, PATCH_WH)
        points = np.concatenate((self._points, _spread(now.shape)))
        usable = _usable(points, now.shape, shown)
        usable &= _usable(cv2.perspectiveTransform(points[np.newaxis], turn)[0], now.shape)
        if np.count_nonzero(usable) < 2 * MIN_POINTS:
            return None
        there, reached, differs = tracked_near(before, back, points[usable])
        kept = np.flatnonzero(usable)[reached]
        if len(kept) < 2 * MIN_POINTS:
            return None
        points, there = points[kept], there[reached]
        column, row = np.rint(points).astype(np.intp).T
        moved = differs[reached] + NOISE_LEVELS < BETTER * (at_rest[row, column] + NOISE_LEVELS)
        moved &= kept < len(self._points)
        sight = _sight(self._on_plane(points), self._on_plane(there), self._foe, self._focal)
        moved &= sight.moves_away
        moved[moved] = returns(before, back, points[moved], there[moved])
        rates = (sight.growth - sight.error) / age_s
        counts = moved & (sight.error <= MOST_ERROR * age_s)
        counts &= self._is_in_way(points, rates, sight.foe)
        return points[counts], rates[counts]

    def fastest(self, points: Points, rates: _Numbers) -> tuple[float, tuple[float, float]]:
        """The rate that `SUPPORT` neighbours of the points in the way reach, and their place."""
        if len(points) < SUPPORT:
            return NOTHING
        column, row = np.rint((points - self._middle) / self._step).astype(np.intp).T + self._n_out
        grid_rates = np.zeros((2 * self._n_out + 3,) * 2)
        grid_rates[row + 1, column + 1] = rates
        blocks = np.lib.stride_tricks.sliding_window_view(grid_rates, (3, 3))
        reached = np.partition(blocks.reshape(*blocks.shape[:2], 9), -SUPPORT)[..., -SUPPORT]
        row, column = np.unravel_index(np.argmax(reached), reached.shape)
        if not reached[row, column] > 0.0:
            return NOTHING
        x, y = (self._middle + self._step * (np.array((column, row)) - self._n_out)).tolist()
        height, width = self._shape
        place = (2.0 * x + 1.0) / width - 1.0, (2.0 * y + 1.0) / height - 1.0
        return float(reached[row, column]), place

    def _on_plane(self, points: Points) -> _Numbers:
        """Places in px, on the plane at the distance 1."""
        return (points - self._axis) / self._focal

    def _is_in_way(self, points: Points, rates: _Numbers, foe: _Numbers) -> Flags:
        away = self._on_plane(points) - foe
        away[:, 1] *= np.where(away[:, 1] > 0.0, BESIDE_M / BELOW_M, 1.0)
        is_in_way: Flags = np.hypot(*away.T) <= BESIDE_M * self._per_m * rates
        return is_in_way


def _spread(shape: tuple[int, ...]) -> Points:
    """Points over the whole image."""
    height, width = shape
    return grid((8.0, 8.0, width - 9.0, height - 9.0), N_TURN)


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


def _sight(points: _Numbers, there: _Numbers, foe: _Numbers, focal: float) -> _Sight:
    """The growth of each point, from its place on the plane at the distance 1 in two images."""
    move, deviation = there - points, PLACE_PX / focal
    x, y = ((points + there) / 2.0).T
    # The move by small turns about the axes to the right, down and forward, (n, 2, 3).
    by_turns = np.stack(
        (np.stack((x * y, -1.0 - x * x, y), -1), np.stack((1.0 + y * y, -x * y, -x), -1)), axis=1
    )
    along, across, distance = _away(points, foe)
    moved_across = _dot(move, across)
    growth = np.clip(_dot(move, along) / distance, 0.0, 0.3)
    factors = np.concatenate(
        (np.einsum("nij,ni->nj", by_turns, across), -growth[:, np.newaxis] * across), axis=1
    )
    prior = np.diag(np.array([TURN_RAD] * 3 + [DIRECTION_RAD] * 2) ** -2.0)
    weight = np.ones(len(points))
    for _ in range(N_STEPS):
        weighted = factors * (weight / deviation**2)[:, np.newaxis]
        precision = weighted.T @ factors + prior
        found = np.linalg.solve(precision, weighted.T @ moved_across)
        squares = ((moved_across - factors @ found) / deviation) ** 2
        scale = max(1.0, 2.2 * float(np.median(squares)))
        weight = 1.0 / (1.0 + squares / (OUTSIDE**2 * scale))
    covariance = np.linalg.inv(precision) * scale
    move = move - by_turns @ found[:3]
    foe = foe + found[3:]
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


def _away(points: _Numbers, foe: _Numbers) -> tuple[_Numbers, _Numbers, _Numbers]:
    """Unit vectors away from a place and across them, (n, 2), and the distances from it, (n,)."""
    away = points - foe
    distance = np.maximum(np.hypot(*away.T), 1e-6)
    along = away / distance[:, np.newaxis]
    return along, np.stack((-along[:, 1], along[:, 0]), axis=-1), distance


def _dot(a: _Numbers, b: _Numbers) -> _Numbers:
    product: _Numbers = np.einsum("ni,ni->n", a, b)
    return product
