"""The D-LGMD of [Zhao2023], fed one frame at a time."""

import math
from collections import deque

import cv2
import numpy as np

from dlgmd_cli.errors import FrameError
from dlgmd_cli.models.base import FloatImage, Layers, Response
from dlgmd_cli.models.filters import empty_image, sum_4x4
from dlgmd_cli.models.kernels import Connections, connect, gaussian
from dlgmd_cli.models.plan import Term, plan
from dlgmd_cli.params import DlgmdParameters

# The released code divides by this whatever the frame: n_cell m of its authors' 800 x 600.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3


class DLGMD:
    """Distributed-presynaptic-connection LGMD, [Zhao2023] Eqs. (1) to (13).

    Parameters
    ----------
    params : DlgmdParameters, optional
        Parameters and formulation; set 9 in the `default` formulation unless given.

    Examples
    --------
    >>> import numpy as np
    >>> model = DLGMD()
    >>> responses = [model.step(np.full((60, 80), t / 10, np.float32)) for t in range(5)]
    >>> [response.is_valid for response in responses]
    [False, False, False, True, True]
    """

    name = "dlgmd"

    def __init__(self, params: DlgmdParameters | None = None) -> None:
        self.params = params if params is not None else DlgmdParameters()
        self._literal = self.params.formulation == "equations"
        self._released = self.params.formulation == "released"
        self.connections = connections_of(self.params)
        bases = [gaussian(self.params.r, s) for s in (self.params.sigma_i, self.params.sigma_e)]
        self._terms: tuple[Term, ...] = plan(self.connections.signed(), bases)
        # FFI(t) looks one frame back, two in the released code, Eq. (12).
        self._ffi_delay = 2 if self._released else 1
        self.reset()

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with a full history: 1 + the largest delay."""
        return 1 + max(self.connections.max_delay_frames, self._ffi_delay)

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self._n_frames = 0
        self._shape: tuple[int, int] | None = None
        self._p_sums: deque[float] = deque(maxlen=self._ffi_delay + 1)

    def step(self, luminance: FloatImage, *, layers: bool = False) -> Response:
        """Take the next frame and answer to it.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32
            Luminance in 0..1. The array may be reused by the caller afterwards.
        layers : bool
            Return copies of P, S and G as well.

        Returns
        -------
        Response
            Sums in units of luminance; NaN before `first_valid_frame` for all but `p_sum`, and
            for `p_sum` at the first frame.

        Raises
        ------
        FrameError
            If the frame is not a float32 image, or not of the same size as the one before.
        """
        self._admit(luminance)
        frame = self._n_frames
        self._n_frames += 1
        if frame == 0:
            np.copyto(self._previous, luminance)
            return _undefined(layers=Layers() if layers else None)
        p = self._p(frame)
        cv2.absdiff(luminance, self._previous, dst=p)
        np.copyto(self._previous, luminance)
        self._p_sums.append(cv2.sumElems(p)[0])
        if frame < self.first_valid_frame:
            return _undefined(self._p_sums[-1], Layers(p.copy()) if layers else None)
        self._summate(frame)
        ffi = self._p_sums[-1 - self._ffi_delay]
        t_de = self._threshold(ffi)
        self._group(t_de)
        return Response(
            p_sum=self._p_sums[-1],
            s_sum=cv2.sumElems(self._s)[0],
            mp=cv2.sumElems(self._g)[0],
            ffi=ffi,
            t_de=t_de,
            layers=Layers(p.copy(), self._s.copy(), self._g.copy()) if layers else None,
        )

    def _admit(self, luminance: FloatImage) -> None:
        """Check a frame, and make room on the first one."""
        if luminance.ndim != 2 or luminance.dtype != np.float32 or luminance.size == 0:
            raise FrameError(
                "frame",
                f"{luminance.dtype} of shape {luminance.shape} is not a float32 image (H, W)",
                "Give luminance in 0..1, for example gray.astype(np.float32) / 255.",
            )
        if self._shape is None:
            self._shape = (luminance.shape[0], luminance.shape[1])
            self._previous = empty_image(self._shape)
            depth = self.connections.max_delay_frames + 1
            self._history = [empty_image(self._shape) for _ in range(depth)]
            self._s, self._g, self._part, self._difference = (
                empty_image(self._shape) for _ in range(4)
            )
        elif luminance.shape != self._shape:
            raise FrameError(
                "frame",
                f"its shape {luminance.shape} is not that of the frames before, {self._shape}",
                "Call reset() between videos.",
            )

    def _p(self, frame: int) -> FloatImage:
        """The buffer of P at frame number `frame`, kept for as long as a delay reaches back."""
        return self._history[frame % len(self._history)]

    def _summate(self, frame: int) -> None:
        """S(t) = max(P(t) ∗ K_E - Σ_d P(t-d) ∗ K_d, 0), Eqs. (2), (3), (6), (7)."""
        if not self._terms:
            self._s[:] = 0.0
        for position, term in enumerate(self._terms):
            image = self._p(frame - term.delay)
            if term.difference:
                cv2.subtract(image, self._p(frame - term.delay - 1), dst=self._difference)
                image = self._difference
            if position == 0:
                term.filter.apply(image, out=self._s)
            else:
                term.filter.apply(image, out=self._part)
                cv2.add(self._s, self._part, dst=self._s)
        cv2.threshold(self._s, 0.0, 0.0, cv2.THRESH_TOZERO, dst=self._s)

    def _threshold(self, ffi: float) -> float:
        """T_de, Eq. (11); the released code divides by a constant, and caps it."""
        if not self.params.ffi_gd:
            return 0.0
        cells = RELEASED_CELLS if self._released else self._s.size * self.params.m
        t_de = ffi * self.params.t0 / cells
        return t_de if self._literal else min(t_de, MAX_T_DE)

    def _group(self, t_de: float) -> None:
        """G = S · Ce where it reaches T_de, saturated at 1, Eqs. (8) to (10)."""
        sum_4x4(self._s, out=self._part)
        cv2.multiply(self._s, self._part, dst=self._g, scale=self.params.k)
        if t_de > 0.0:
            cv2.threshold(self._g, _just_below(t_de), 0.0, cv2.THRESH_TOZERO, dst=self._g)
        if not self._literal:
            cv2.threshold(self._g, 1.0, 0.0, cv2.THRESH_TRUNC, dst=self._g)


def connections_of(params: DlgmdParameters) -> Connections:
    """The kernels that `params` describe."""
    return connect(
        radius_px=params.r,
        sigma_e_px=params.sigma_e,
        sigma_i_px=params.sigma_i,
        strength=params.a,
        alpha=params.alpha,
        beta=params.beta,
        lam=params.lam,
        interpolate=params.formulation == "equations",
    )


def _just_below(threshold: float) -> float:
    """The largest float32 below `threshold`: OpenCV keeps what is greater, Eq. (10) what is ≥."""
    nearest = np.float32(threshold)
    if float(nearest) >= threshold:  # as float64: NumPy would round the threshold first
        nearest = np.nextafter(nearest, np.float32(-math.inf))
    return float(nearest)


def _undefined(p_sum: float = math.nan, layers: Layers | None = None) -> Response:
    return Response(p_sum, math.nan, math.nan, math.nan, math.nan, layers)
