"""The D-LGMD in degrees and milliseconds: one response for all lenses, frame sizes and rates."""

import math
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from dlgmd_cli.errors import FrameError
from dlgmd_cli.models import filters
from dlgmd_cli.models.base import Flags, FloatImage, Grey, Response
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.kernels import Connections, resized, shares
from dlgmd_cli.models.receptors import aligned
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.keys import DEGREES, FRAME_S, PX_DEG
from dlgmd_cli.parameters.presets import DlgmdParameters

# A step between frames within this share of FRAME_S counts as FRAME_S.
_SAME_STEP = 0.02


class _Image(NamedTuple):
    time_s: float
    luminance: FloatImage


class DegreesDLGMD(DLGMD):
    """The D-LGMD or its ON/OFF version, whose pixels are 0.3 degrees and whose frames 1/30 s.

    A video has other pixels and frames. With s, the pixels of the video in `PX_DEG` at the centre
    of the image, and Ω(x, y), the solid angle of a pixel over the mean of all:

    - L is averaged over s × s pixels if s > 1, as a pixel of the paper's camera does;
    - a connection spreads over s × s pixels, with the same sum, see `kernels.resized`;
    - C_e sums over 4 s × 4 s pixels, and is divided by s², Eq. (9);
    - FFI(t) = Σ P(t-1) Ω, Eq. (12), and K(t) = Σ G̃(t) Ω, Eq. (13): their means over the cells
      are those over the solid angle;
    - t-1 is `FRAME_S` earlier. If no frame came then, K is that of the next longer and the next
      shorter step between frames, interpolated: √K goes with the step, as G is quadratic in S.

    Parameters
    ----------
    params : DlgmdParameters, optional
        Parameters with ``units="degrees"``.
    """

    units = DEGREES

    def __init__(self, params: DlgmdParameters) -> None:
        self.polarities = getattr(type(params).model_class, "polarities", DLGMD.polarities)
        super().__init__(params)
        self._camera, self._shape, self._scale = Camera(), (0, 0), 1.0
        self._images: list[_Image] = []

    def look(self, camera: Camera) -> None:
        """Take the angles of the camera, see `Model.look`."""
        self._camera, self._shape = camera, (0, 0)

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells, see `Model.ignore`."""
        super().ignore(hidden)
        self._shape = (0, 0)

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self._images = []

    @property
    def n_cells(self) -> int:
        """Number of cells of the newest frame that are not ignored."""
        return int(np.count_nonzero(self._weights))

    @cached_property
    def connections(self) -> Connections:
        """The connections in pixels of the video, by which `_fit` scales those of the set."""
        return resized(self.net(self.connect()), self._scale)

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`; numbers are NaN until the history is full.

        Between two steps, the layers, the centroid and the feed-forward inhibition are those of
        the step that is nearer to `FRAME_S`.
        """
        if time_s is None:
            why = "it has no time, which a model in milliseconds needs"
            raise FrameError("frame", why, "Give step() its time in seconds.")
        self.receptors.check(luminance)
        self._fit(luminance.shape)
        self._keep(_Image(time_s, self._averaged(self.receptors.luminance_of(luminance))))
        by_share = sorted(self._steps().items(), key=lambda item: item[1])
        if not by_share:
            return Response()
        p_sum = s_sum = root = 0.0
        response = Response()
        for n, share in by_share:
            response = self._response(n, layers=layers)
            p_sum += share * response.p_sum
            s_sum += share * response.s_sum
            root += share * math.sqrt(response.mp)
        return replace(response, p_sum=p_sum, s_sum=s_sum, mp=root**2)

    def feed_forward(self) -> float:
        """FFI(t) = ΣP(t-1) Ω in luminance, Eq. (12)."""
        return float(np.vdot(self.receptors.p(self.least_delay), self._weights))

    def group(self, s: FloatImage, t_de: float) -> FloatImage:
        """G̃(t), Eqs. (8) to (10), with C_e over 4 s × 4 s pixels."""
        around, g = aligned(s.shape), aligned(s.shape)
        window, border = self._window, cv2.BORDER_CONSTANT
        cv2.sepFilter2D(s, -1, window, window, dst=around, borderType=border)
        filters.group(s, around, self._grouping(t_de), g)
        return g

    def potential(self, g: FloatImage) -> float:
        """K(t) = ΣG̃(t) Ω, Eq. (13)."""
        return float(np.vdot(g, self._weights))

    def _fit(self, shape: tuple[int, ...]) -> None:
        """Scale the connections and windows for frames of a shape, (H, W)."""
        if shape == self._shape:
            return
        (height, width), focal = shape, self._camera.focal(shape[1])
        self._shape, self._scale = (height, width), focal * math.radians(PX_DEG)
        self.__dict__.pop("connections", None)
        self._prepared_for = None
        # The window of Eq. (9) reaches 1.5 px before a cell's centre, and 2.5 px beyond it.
        side = math.ceil(2.5 * self._scale + 0.5)
        edges = np.arange(-side, side + 2) - 0.5
        inside = np.clip(edges, -1.5 * self._scale, 2.5 * self._scale)
        self._window = np.diff(inside) / self._scale
        axis_x, axis_y = self._camera.axis(shape)
        x, y = (np.arange(width) - axis_x) / focal, (np.arange(height) - axis_y) / focal
        solid = (1.0 + x**2 + y[:, np.newaxis] ** 2) ** -1.5
        if self.receptors.hidden is not None:
            solid[self.receptors.hidden] = 0.0
        self._weights = np.float32(solid * ((solid > 0.0).sum() / solid.sum()))

    def _averaged(self, luminance: FloatImage) -> FloatImage:
        """The luminance averaged over a pixel of the paper's camera, if that is the larger one."""
        if self._scale <= 1.0:
            return luminance
        box = shares(1, self._scale)[:, 0] / self._scale
        averaged = cv2.sepFilter2D(luminance, -1, box, box, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(averaged, np.float32)

    def _keep(self, image: _Image) -> None:
        """Store an image; what is missing before it is interpolated, and old images are dropped."""
        images = self._images
        if images and image.time_s > images[-1].time_s:
            last, gap_s = images[-1], image.time_s - images[-1].time_s
            n = math.floor(gap_s / FRAME_S + 0.5)
            change = image.luminance - last.luminance
            for i in range(1, n):
                luminance = last.luminance + np.float32(i / n) * change
                images.append(_Image(last.time_s + gap_s * i / n, luminance))
        images.append(image)
        # Twice the history, since a step may be nearly twice `FRAME_S`.
        oldest_s = image.time_s - 2.0 * self.first_valid_frame * FRAME_S - FRAME_S
        while images[0].time_s < oldest_s:
            del images[0]

    def _steps(self) -> dict[int, float]:
        """Step between frames, a whole number -> its share in the response; empty if too early."""
        n, shorter_s, longer_s = 0, 0.0, self._step_s(1)
        while longer_s <= (1.0 + _SAME_STEP) * FRAME_S:
            n, shorter_s, longer_s = n + 1, longer_s, self._step_s(n + 2)
        if n and shorter_s >= (1.0 - _SAME_STEP) * FRAME_S:
            return {n: 1.0}
        if math.isinf(longer_s):
            return {}
        share = (FRAME_S - shorter_s) / (longer_s - shorter_s)
        return {n + 1: share, **({n: 1.0 - share} if n else {})}

    def _step_s(self, n: int) -> float:
        """The mean step in seconds from each n-th frame to the next; infinite if too early."""
        back = n * self.first_valid_frame
        if back >= len(self._images):
            return math.inf
        return (self._images[-1].time_s - self._images[-1 - back].time_s) / self.first_valid_frame

    def _response(self, n: int, *, layers: bool) -> Response:
        """The response to each n-th frame up to the newest."""
        self.receptors.reset()
        response = Response()
        for place in range(self.first_valid_frame, -1, -1):
            image = self._images[-1 - n * place]
            response = super().step(image.luminance, layers=layers and place == 0)
        return response
