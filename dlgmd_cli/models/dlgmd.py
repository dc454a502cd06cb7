"""The D-LGMD of [Zhao2023]: first its layers, one method each, then the processing of a frame."""

import math
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from dlgmd_cli.errors import ModelError, ParameterError
from dlgmd_cli.models import filters
from dlgmd_cli.models.base import (
    FloatImage,
    Grey,
    Layers,
    Model,
    Response,
    centroid,
    centroid_of,
    checked_params,
    number,
)
from dlgmd_cli.models.filters import Convolution, Grouping, SummationAndGrouping
from dlgmd_cli.models.kernels import (
    BANDS,
    NEAR_FRAMES,
    Connections,
    FloatKernel,
    delayed,
    gaussian,
    latency_map,
)
from dlgmd_cli.models.receptors import (
    BOTH,
    Pathway,
    Photoreceptors,
    aligned,
    checked_layer,
    read_only,
    rectified,
    unit_of,
)
from dlgmd_cli.parameters.keys import PIXELS
from dlgmd_cli.parameters.presets import DlgmdParameters

# Both released codes divide by this constant for any frame size. For the authors' frames, n_cell m
# is 192000 (800 x 600) or 207360 (960 x 540): the intended frame size is not known.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3
# The methods of the summation layer.
SUMMATION = ("excite", "inhibit", "combine")


class DLGMD(Model):
    """Distributed-presynaptic-connection LGMD, [Zhao2023] Eqs. (1) to (13).

    A variant overrides the methods of single layers, from `see` to `potential`. Images are float32
    arrays of shape (H, W), with luminance in 0 to 1; an override returns a new array. S, G
    and K are computed in one go if no layer is overridden, or only `see`, `perceive`, the
    connections or the threshold.

    Parameters
    ----------
    params : DlgmdParameters, optional
        Parameters and formulation; set 9 in the `default` formulation unless given.

    Attributes
    ----------
    polarities : tuple of str
        Input of each pathway: ``"both"`` (the default), ``"on"`` (brightening cells) or ``"off"``
        (darkening cells). S is the sum of the pathways.
    connections : Connections
        The connections that S sums over: `net` of `connect`.

    Examples
    --------
    >>> import numpy as np
    >>> model = DLGMD()
    >>> responses = [model.step(np.full((60, 80), t / 10, np.float32)) for t in range(5)]
    >>> [response.is_valid for response in responses]
    [False, False, False, True, True]
    """

    params_class = DlgmdParameters
    layer_units = ("luminance", "luminance", "luminance²")
    polarities: tuple[str, ...] = (BOTH,)
    units = PIXELS
    params: DlgmdParameters
    _first_valid_frame = 0  # by the connections

    def __init__(self, params: DlgmdParameters | None = None) -> None:
        self.params = checked_params(params, self.params_class)
        if self.params.units != self.units:
            why = f"the class {type(self).__name__} works in {self.units}, not {self.params.units}"
            hint = "In degrees, there are dlgmd and dlgmd-onoff alone, in Python by create_model()."
            raise ParameterError("", why, hint)
        self.receptors = Photoreceptors(0, self.polarities)
        self._prepared_for: tuple[tuple[int, ...], float] | None = None

    # The layers

    def see(self, luminance: FloatImage) -> FloatImage:
        """L(t): the frame's luminance, unchanged; ignored cells are 0."""
        return luminance

    def perceive(self, change: FloatImage) -> FloatImage | tuple[FloatImage, ...]:
        """``P(t) = |L(t) - L(t-1)|``, Eq. (1), from the `change` L(t) - L(t-1).

        An override may return a tuple of several P. Each P is the input of a pathway with its own
        E, I and S; the neuron's S is the sum. `polarities` chooses P without an override.
        """
        first, *others = (rectified(change, polarity) for polarity in self.polarities)
        return (first, *others) if others else first

    def latency(self) -> FloatKernel:
        """τ(x, y) of each connection in frames, (2r + 1, 2r + 1) float64, Eq. (5)."""
        params = self.params
        return latency_map(params.r, params.alpha, params.beta, params.lam)

    def connect(self) -> Connections:
        """The kernel g_E, and a g_I for each delay in frames, Eqs. (2) to (4) and (6).

        The parameter `latency` says how τ is rounded to whole frames, see `delayed`.
        """
        params, latency = self.params, self.latency()
        g_e, g_i = gaussian(params.r, params.sigma_e), gaussian(params.r, params.sigma_i)
        inhibition = delayed(params.a * g_i, latency, params.latency)
        return Connections(latency, g_e, inhibition, (g_i, g_e))

    def net(self, connections: Connections) -> Connections:
        """The connections after subtracting undelayed inhibition from excitation.

        In both of the authors' codes (`bands…` in the parameter `latency`), inhibition without
        delay (τ < 1) reduces excitation: K_E = max(g_E - a g_I, 0). In the code of 2021, and
        therefore in `default`, there is also no excitation where τ > 1. The printed equations do
        neither: `nearest` and `interpolated` leave the connections unchanged.
        """
        if self.params.latency not in BANDS:
            return connections
        late = dict(connections.inhibition)
        excitation = np.maximum(connections.excitation - late.pop(0, 0.0), 0.0)
        if self.params.latency == "bands":
            excitation[connections.latency > NEAR_FRAMES] = 0.0
        return replace(connections, excitation=excitation, inhibition=late)

    def excite(self, p: Pathway) -> FloatImage:
        """E(t) = P(t) ∗ K_E, Eq. (2); ``p(d)`` is P(t - d)."""
        return self._excitation.of(p)

    def inhibit(self, p: Pathway) -> FloatImage:
        """I(t) = Σ_d P(t - d) ∗ K_d, Eq. (3), with the strength a of Eq. (6) in K_d."""
        return self._inhibition.of(p)

    def combine(self, e: FloatImage, i: FloatImage) -> FloatImage:
        """S(t) = max(E(t) - I(t), 0), Eqs. (6) and (7)."""
        s = e - i
        return np.maximum(s, 0.0, out=s)

    def feed_forward(self) -> float:
        """FFI(t) = ΣP(t-1) in luminance, Eq. (12); in the released codes ΣP(t-2)."""
        return self.receptors.p_sum(self.least_delay)

    def threshold(self, ffi: float) -> float:
        """T_de(t) = FFI(t) T_0 / (n_cell m), Eq. (11), in luminance².

        The released codes divide by a constant. They and `default` limit T_de to 0.3; the printed
        equation has no limit.
        """
        params = self.params
        if not params.ffi_gd:
            return 0.0
        cells = RELEASED_CELLS if params.is_released else self.n_cells * params.m
        t_de = ffi * params.t0 / cells
        return min(t_de, MAX_T_DE) if params.saturate else t_de

    def group(self, s: FloatImage, t_de: float) -> FloatImage:
        """G̃(t) in luminance², Eqs. (8) to (10).

        ::

            C_e = k ΣS over 4 x 4 cells
            G = S C_e
            G̃ = G where G ≥ T_de, else 0; at most 1, except in the printed equations
        """
        return filters.grouped(s, self._grouping(t_de))

    def potential(self, g: FloatImage) -> float:
        """K(t) = ΣG̃(t), Eq. (13)."""
        return float(cv2.sumElems(g)[0])

    # The processing of a frame

    @property
    def least_delay(self) -> int:
        """The delay of FFI in frames, over which P must be kept."""
        return 2 if self.params.is_released else 1

    @cached_property
    def connections(self) -> Connections:
        """The connections that S sums over: `net` of `connect`."""
        return self.net(self.connect())

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with a full history: P is defined from frame 1 on.

        This is also the number of P that are kept. It follows from the connections; a variant that
        needs a longer history sets it.
        """
        reach = max(self.connections.max_delay_frames, self.least_delay)
        return self._first_valid_frame or 1 + reach

    @first_valid_frame.setter
    def first_valid_frame(self, frame: int) -> None:
        self._first_valid_frame = frame

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        receptors = self.receptors
        self._take(luminance)
        p_sum = receptors.p_sum(0)
        if receptors.frame < self.first_valid_frame:
            return Response(p_sum, layers=Layers(self.p_layer()) if layers else None)
        ffi = self._checked_number("feed_forward", self.feed_forward())
        t_de = self._checked_number("threshold", self.threshold(ffi))
        compute = self._fused if self._is_fused else self._layered
        summed = compute(t_de, layers=layers)
        written = summed.layers or Layers()
        shown = replace(written, p=self.p_layer()) if layers else None
        return replace(summed, p_sum=p_sum, ffi=ffi, t_de=t_de, layers=shown)

    def p_layer(self) -> FloatImage | None:
        """A copy of P(t) in luminance; None at the first frame."""
        return self.receptors.layer() if self.receptors.frame > 0 else None

    def _take(self, frame: Grey) -> None:
        """Store the next frame and its P; at the first frame, plan the filters."""
        receptors = self.receptors
        if self._overrides("see"):
            luminance = receptors.luminance_of(frame)
            frame = self._checked("see", self.see(luminance), luminance)
        in_luminance = self._overrides("perceive", *SUMMATION)
        if receptors.frame < 0:
            receptors.check(frame)
            self._prepare(frame.shape, 1.0 if in_luminance else unit_of(frame.dtype))
        if not in_luminance:
            receptors.take(frame)
            return
        receptors.look(frame)
        if receptors.frame > 0:
            p = self.perceive(receptors.change())
            receptors.keep(p if isinstance(p, tuple) else (p,))

    def _prepare(self, shape: tuple[int, ...], unit: float) -> None:
        """Plan the filters for frames of `shape` and P in `unit`, or keep the present ones."""
        self.receptors.depth = self.first_valid_frame
        if self._prepared_for == (shape, unit):
            return
        self._prepared_for = shape, unit
        self._buffers = aligned(shape), aligned(shape), aligned(shape)
        connections = self.connections
        if self._overrides(*SUMMATION):
            none = {0: np.zeros_like(connections.excitation)}
            self._excitation, self._inhibition = (
                Convolution(kernels, connections.gaussians, shape)
                for kernels in ({0: connections.excitation}, none | connections.inhibition)
            )
        else:
            self._layers = SummationAndGrouping(connections, shape, unit)

    @property
    def _is_fused(self) -> bool:
        """Whether S, G and K are computed in one go."""
        is_one = len(self.receptors.pathways) == 1
        return is_one and not self._overrides(*SUMMATION, "group", "potential")

    def _fused(self, t_de: float, *, layers: bool) -> Response:
        """S, G and K in one go."""
        receptors = self.receptors
        shape = receptors.current.shape
        s, g = (aligned(shape), aligned(shape)) if layers else (None, None)
        p, grouping = receptors.pathways[0], self._grouping(t_de)
        s_sum, mp, moments = self._layers.respond(p, receptors.hidden, grouping, s, g)
        g_x, g_y = centroid(mp, moments, shape)
        return Response(s_sum=s_sum, mp=mp, g_x=g_x, g_y=g_y, layers=Layers(s=s, g=g))

    def _layered(self, t_de: float, *, layers: bool) -> Response:
        """S, G and K layer by layer; in new images where a caller or an override may keep them."""
        may_keep = layers or self._overrides(*SUMMATION, "group", "potential")
        s_buffer, spare, g = self._buffers
        first, *others = self.receptors.pathways
        s = self._sum_up(first, aligned(s_buffer.shape) if may_keep else s_buffer)
        for p in others:
            cv2.add(s, self._sum_up(p, spare), dst=s)
        if may_keep:
            g = self._checked("group", self.group(read_only(s), t_de), s)
        else:
            filters.sum_4x4(s, out=spare)
            filters.group(s, spare, self._grouping(t_de), g)
        mp = self._checked_number("potential", self.potential(read_only(g)))
        (g_x, g_y), s_sum = centroid_of(g), cv2.norm(s, cv2.NORM_L1)
        return Response(s_sum=s_sum, mp=mp, g_x=g_x, g_y=g_y, layers=Layers(s=s, g=g))

    def _sum_up(self, p: Pathway, out: FloatImage) -> FloatImage:
        """S of one pathway, in `out`; overridden E, I or S give a new image."""
        if not self._overrides(*SUMMATION):
            self._layers.respond(p, self.receptors.hidden, None, out)
            return out
        history = [p(delay) for delay in range(self.first_valid_frame)]
        e = self._checked("excite", self.excite(p), *history)
        i = self._checked("inhibit", self.inhibit(p), *history)
        return self._checked("combine", self.combine(e, i), e, i)

    def _grouping(self, t_de: float) -> Grouping:
        """What the grouping layer needs for G."""
        return Grouping(self.params.gain, t_de, 1.0 if self.params.saturate else math.inf)

    def _overrides(self, *methods: str) -> bool:
        """Whether the class overrides one of these methods."""
        return any(getattr(type(self), name) is not getattr(DLGMD, name) for name in methods)

    def _checked(self, method: str, layer: FloatImage, *given: FloatImage) -> FloatImage:
        """A method's layer with 0 in ignored cells; for an override, a checked copy."""
        if self._overrides(method):
            layer = checked_layer(layer, given, method)
        self.receptors.clear(layer)
        return layer

    def _checked_number(self, method: str, value: float) -> float:
        """A method's number; raises ModelError if an override returns no finite number."""
        if self._overrides(method):
            value = number(value, f"{method}()")
            if not math.isfinite(value):
                why = f"it returns {'NaN' if math.isnan(value) else 'infinity'}"
                raise ModelError(f"{method}()", why)
        return value
