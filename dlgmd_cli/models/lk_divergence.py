"""Divergence of sparse optical flow: a simple looming detector, as a baseline."""

import math
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Grey, Layers, Model, Response
from dlgmd_cli.parameters.presets import DEFAULT_MODEL_FPS, LkDivergenceParameters

# Side of the square in the middle of the frame, as a share of the frame's shorter side.
WINDOW = 0.6
# Corners: largest number, least quality relative to the best corner, and least distance in px.
MAX_CORNERS, QUALITY, DISTANCE_PX = 150, 0.01, 4
# Size of the tracked patch, in px; OpenCV's pyramid has three levels above the frame.
PATCH_WH = 15, 15
# A point tracked forward and backward must come back to within this many px.
MAX_RETURN_PX = 0.5
# Of the fit: fewest points, number of reweighted steps, and least scale of the residuals in px.
MIN_POINTS, N_STEPS, LEAST_SCALE_PX = 8, 5, 0.05
# Time constant of the low-pass, in s.
TAU_S = 0.1


class LkDivergence(Model):
    """Expansion rate of the middle of the frame, from corners tracked by Lucas and Kanade.

    Corners [Shi1994] in a square of 0.6 of the shorter side are tracked from the previous frame by
    pyramidal Lucas-Kanade [Bouguet2001], and back; points that do not come back are dropped. The
    displacements are fitted by u + a x along x and v + b y along y, each by iteratively reweighted
    least squares. The expansion rate is the mean of a and b, per second, smoothed over 0.1 s; for
    a frontal surface, 1 / (time to contact). K is the positive part of the expansion rate times
    the number of cells. Frames without times count as 30 per second.

    Parameters
    ----------
    params : LkDivergenceParameters, optional
        The parameters, which affect only spikes and alarms.
    """

    params_class = LkDivergenceParameters
    layer_units = ("luminance", "px", "1/s")

    def __init__(self, params: LkDivergenceParameters | None = None) -> None:
        super().__init__(params)
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self._time_s: float | None = None
        self._rate = 0.0

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        receptors = self.receptors
        receptors.take(luminance)
        before_s, self._time_s = self._time_s, time_s
        if receptors.frame < self.first_valid_frame:
            return Response(layers=Layers() if layers else None)
        interval_s = 1.0 / DEFAULT_MODEL_FPS
        if time_s is not None and before_s is not None and time_s > before_s:
            interval_s = time_s - before_s
        points, moved = self._tracked()
        growth = 0.0
        if len(points) >= MIN_POINTS:
            growth = sum(_slope(points[:, axis], moved[:, axis]) for axis in (0, 1)) / 2.0
        newest = -math.expm1(-interval_s / TAU_S)
        self._rate += newest * (growth / interval_s - self._rate)
        shown = Layers(receptors.layer()) if layers else None
        mp, s_sum = receptors.n_cells * max(self._rate, 0.0), float(np.abs(moved).sum())
        return Response(receptors.p_sum(0), s_sum, mp, 0.0, 0.0, shown)

    def _tracked(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Places of corners in the previous frame, and their displacements, each (n, 2) in px."""
        before, now = map(_levels, (self.receptors.previous, self.receptors.current))
        height, width = before.shape
        half = WINDOW * min(height, width) / 2.0
        inside = np.zeros(before.shape, np.uint8)
        rows, columns = (slice(round(n / 2 - half), round(n / 2 + half)) for n in (height, width))
        inside[rows, columns] = 1
        self.receptors.clear(inside)
        corners = cv2.goodFeaturesToTrack(before, MAX_CORNERS, QUALITY, DISTANCE_PX, mask=inside)
        if corners is None:
            return np.empty((0, 2), np.float32), np.empty((0, 2), np.float32)
        track = partial(cv2.calcOpticalFlowPyrLK, winSize=PATCH_WH)
        there, reached, _ = track(before, now, corners, None)
        back, returned, _ = track(now, before, there, None)
        error = np.linalg.norm((back - corners)[:, 0], axis=1)
        kept = (reached * returned).ravel().astype(bool) & (error < MAX_RETURN_PX)
        return corners[kept, 0], (there - corners)[kept, 0]


def _slope(at: npt.NDArray[np.float32], moved: npt.NDArray[np.float32]) -> float:
    """Slope of a line fitted to displacements over places, with Cauchy's weights."""
    weight = np.ones(len(at))
    slope = 0.0
    for _ in range(N_STEPS):
        x, y = at - np.average(at, weights=weight), moved - np.average(moved, weights=weight)
        slope = float(weight @ (x * y) / max(float(weight @ (x * x)), 1e-9))
        rest = y - slope * x
        scale = 1.5 * float(np.median(np.abs(rest))) + LEAST_SCALE_PX
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
    return slope


def _levels(grey: Grey) -> Grey:
    """Luminance as uint8, the type that the tracker accepts."""
    return grey if grey.dtype == np.uint8 else np.uint8(np.clip(grey, 0.0, 1.0) * 255.0 + 0.5)
