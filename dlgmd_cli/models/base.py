"""The interface of all models, and their photoreceptors."""

import math
import traceback
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, FrameError, ModelError, ParameterError, argument
from dlgmd_cli.frame import Flags as Flags
from dlgmd_cli.frame import FloatImage as FloatImage
from dlgmd_cli.parameters.presets import DlgmdParameters, Parameters, ParametersT, untrusted

Grey = npt.NDArray[Any]  # uint8 levels of 0..255, or float32 in 0..1

CACHE_LINE = 64
# Of single precision.
_ROUNDING = 2.0**-23
AUTO = "auto"
_TYPES = (np.dtype(np.float32), np.dtype(np.uint8))


@dataclass(frozen=True)
class Layers:
    """Copies of a model's layers at one frame, each (H, W) float32; None until defined.

    `p` is the output of the photoreceptors and `s` the summation layer. `g` is the grouping layer
    after threshold and saturation, whose sum is the membrane potential.
    """

    p: FloatImage | None = None
    s: FloatImage | None = None
    g: FloatImage | None = None


@dataclass(frozen=True)
class Response:
    """A model's response to one frame; NaN where not defined yet.

    Attributes
    ----------
    p_sum, s_sum : float
        Sums of the absolute values of the photoreceptor and the summation layer, in the model's
        units.
    mp : float
        Raw membrane potential K, Eq. (13).
    ffi : float
        Feed-forward inhibition, Eq. (12).
    t_de : float
        Threshold of the grouping layer, Eq. (11).
    layers : Layers or None
        The layers, if `step` was called with ``layers=True``.
    g_x, g_y : float
        Centroid of the grouping layer, see `centroid`; NaN where no cell is active.
    more : mapping of str to float
        Further numbers of the model, by the names in `Model.columns`.
    """

    p_sum: float = math.nan
    s_sum: float = math.nan
    mp: float = math.nan
    ffi: float = math.nan
    t_de: float = math.nan
    layers: Layers | None = None
    g_x: float = math.nan
    g_y: float = math.nan
    more: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_valid(self) -> bool:
        """Whether the model had a full history, so that `mp` and `s_sum` are defined."""
        return not math.isnan(self.mp)

    @property
    def attenuation_db(self) -> float:
        """Attenuation 10 lg(ΣS/ΣP) in dB, NaN where it is undefined.

        It is -inf where ΣS is at most ΣP times 2**-23, the rounding of single precision (-69 dB):
        what is left there of E - aI = 0 depends on the order of the additions.
        """
        if not self.p_sum > 0.0 or math.isnan(self.s_sum):
            return math.nan
        share = self.s_sum / self.p_sum
        return 10.0 * math.log10(share) if share > _ROUNDING else -math.inf


class Model:
    """A looming detector that processes one frame at a time in constant memory.

    A custom model derives from this class, names its parameter class, and defines `step`.
    What runs it calls `reset` before the first frame, too.

    Parameters
    ----------
    params : Parameters, optional
        Parameters of the class `params_class`; its defaults unless given.
    engine : str
        See `DLGMD`; the only one is `opencv`, unless a model says otherwise.

    Attributes
    ----------
    params_class : type
        The class of the parameters.
    layer_units : (str, str, str)
        Units of the layers P, S and G, in words.
    columns : tuple of str
        Names of further numbers that each `Response` has in `more`; mp.csv has a column of each.
    params : Parameters
        Parameters of the model.
    engine_name : str
        Engine that computes the layers; before the first frame, the requested one.
    first_valid_frame : int
        Index of the first frame with a full history, counting from 0 at `reset`.
    receptors : Photoreceptors
        The last `first_valid_frame` changes ``|L(t) - L(t-1)|``, once they `take` the frames.
    """

    params_class: ClassVar[type[Parameters]] = Parameters
    layer_units: tuple[str, str, str] = ("–", "–", "–")
    columns: tuple[str, ...] = ()
    params: Any
    engine_name: str
    first_valid_frame: int = 1
    receptors: "Photoreceptors"

    def __init_subclass__(cls) -> None:
        """Make the model known to its parameter class; raises ParameterError."""
        super().__init_subclass__()
        if not cls.__module__.startswith("dlgmd_cli."):
            spec = f"{cls.__module__}:{cls.__qualname__}"
            cls.params_class = cls.params_class.own_of(cls, spec)
        elif vars(cls.params_class).get("module") == cls.__module__:
            cls.params_class.model_class = cls

    def __init__(self, params: Parameters | None = None, engine: str = AUTO) -> None:
        self.params = checked_params(params, self.params_class)
        self.engine_name = "opencv"
        if engine not in (AUTO, "opencv"):
            why = f"the model {self.name} has no engine {engine!r}"
            raise ParameterError(argument("engine"), why, "Leave it out.")
        self.receptors = Photoreceptors(self.first_valid_frame)

    @property
    def name(self) -> str:
        """The model's name, which users write."""
        return str(self.params_class.model)

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.receptors.reset()

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells of all frames from now on, also after `reset`.

        Ignored cells have P = 0 and S = 0 and are not counted, like the surroundings of the frame.

        Parameters
        ----------
        hidden : ndarray, shape (H, W), bool, or None
            True for ignored cells; None for no ignored cells.
        """
        self.receptors.hide(hidden)

    @property
    def n_cells(self) -> int:
        """Number of cells of the newest frame that are not ignored."""
        return self.receptors.n_cells

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255. The caller may reuse the array afterwards.
        time_s : float, optional
            Time of the frame. The present models count frames and ignore it.
        layers : bool
            Also return copies of P, S and G.

        Returns
        -------
        Response
            Before `first_valid_frame`, everything except `p_sum` is NaN; at the first frame,
            `p_sum` too.

        Raises
        ------
        FrameError
            If the frame is not a float32 or uint8 image, or differs in size or type from the
            previous one.
        MissingExtraError
            If the requested engine needs a package that is not installed.
        """
        raise NotImplementedError


def checked_params(params: Any, kind: type[ParametersT]) -> ParametersT:
    """`params`, or the defaults of `kind` for None; raises ParameterError for another class."""
    if params is None:
        return kind()
    if not isinstance(params, kind):
        base: Any = kind.__mro__[1]  # of which `own_of` has made `kind`, perhaps
        if ":" in kind.model and base is not Parameters and isinstance(params, base):
            return kind.from_mapping(params.to_dict())
        is_set = kind is DlgmdParameters
        hint = f"Write {'load_set(9)' if is_set else f'{kind.__name__}()'}, or leave it out."
        raise ParameterError("", f"expected {kind.__name__}, not {shown_params(params)}", hint)
    return params


def shown_params(params: Any) -> str:
    """A short form of a wrong argument, for error messages."""
    return type(params).__name__ if isinstance(params, Parameters) else repr(params)[:40]


def create_model(params: Parameters, **options: Any) -> Model:
    """Create the model that belongs to the class of `params`.

    Parameters
    ----------
    params : Parameters
        Parameters of a model.
    options
        `engine`, see `DLGMD`.

    Raises
    ------
    ParameterError
        If there is no such model or engine.
    MissingExtraError
        If the engine needs a package that is not installed.
    ModelError
        If a custom model fails; its `step` raises this error, too.
    """
    if not isinstance(params, Parameters):
        hint = "Write load_set(9) for one of the paper's sets."
        raise ParameterError("", f"expected parameters, not {shown_params(params)}", hint)
    kind, facts = type(params), vars(type(params))
    if facts.get("module") and facts.get("model_class") is None:
        import_module(kind.module)
    model_class = vars(kind).get("model_class")
    if model_class is None:
        if ":" in kind.model:
            raise untrusted(kind.model)
        raise ParameterError("", f"no model takes {kind.__name__}")
    if model_class.__module__.startswith("dlgmd_cli."):
        model: Model = model_class(params, **options)
        return model
    return _guarded(params, options)


def _guarded(params: Parameters, options: dict[str, Any]) -> Model:
    """A custom model whose failures are a ModelError."""
    name = params.model

    @contextmanager
    def blamed() -> Iterator[None]:
        try:
            yield
        except (DlgmdError, MemoryError):
            raise
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(last.filename).name}, line {last.lineno}"
            why = f"the model fails with {type(error).__name__}: {error} ({where})"
            raise ModelError(name, " ".join(why.split())) from error

    with blamed():
        model: Model = params.model_class(params, **options)
        step, reset, receptors = model.step, model.reset, model.receptors
        reset()  # which may be all that sets the state

    def guarded_reset() -> None:
        with blamed():
            reset()

    def guarded(luminance: Grey, time_s: float | None = None, *, layers: bool = False) -> Response:
        frame, wanted = receptors.frame, {"layers": True} if layers else {}
        with blamed():
            response = step(luminance, time_s, **wanted)
        if not isinstance(response, Response):
            raise ModelError(name, f"its step returns {type(response).__name__}, not a Response")
        if layers and response.layers is None:
            if response.is_valid:
                hint = "Add Response(layers=Layers(…))."
                raise ModelError(name, "its step returns no layers", hint)
            response = replace(response, layers=Layers())
        if receptors.frame == frame:  # so that `n_cells` knows the frame
            receptors.take(luminance)
        return response

    model.step, model.reset = guarded, guarded_reset  # type: ignore[method-assign]
    return model


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> Grey:
    """An uninitialised array that is aligned to a cache line.

    OpenCV's order of summation depends on the alignment. Without it, the last bit of a sum would
    differ from run to run.
    """
    n_bytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.empty(n_bytes + CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % CACHE_LINE
    return memory[start : start + n_bytes].view(dtype).reshape(shape)


def first_moments(image: FloatImage) -> tuple[float, float]:
    """Σ image · column and Σ image · row over the cells of an image, (H, W), in px."""
    height, width = image.shape
    columns = cv2.reduce(image, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    rows = cv2.reduce(image, 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    return float(columns @ np.arange(width)), float(rows @ np.arange(height))


def centroid(
    g_sum: float, moments: tuple[float, float], shape: tuple[int, ...]
) -> tuple[float, float]:
    """Centroid of the activity in the grouping layer: ΣG·x / ΣG and ΣG·y / ΣG.

    Parameters
    ----------
    g_sum : float
        ΣG.
    moments : (float, float)
        See `first_moments`.
    shape : (int, int)
        H and W of the layer.

    Returns
    -------
    g_x, g_y : float
        From -1, the left or upper border of the frame, to 1; NaN if ΣG = 0.
    """
    if not g_sum > 0.0:
        return math.nan, math.nan
    (m_x, m_y), (height, width) = moments, shape
    return (2.0 * m_x / g_sum + 1.0) / width - 1.0, (2.0 * m_y / g_sum + 1.0) / height - 1.0


def centroid_of(g: FloatImage) -> tuple[float, float]:
    """The `centroid` of a non-negative layer, (H, W)."""
    return centroid(cv2.sumElems(g)[0], first_moments(g), g.shape)


class Photoreceptors:
    """``P(t) = |L(t) - L(t-1)|``, [Zhao2023] Eq. (1), of the last few frames.

    Parameters
    ----------
    depth : int
        Number of P to keep; 0 for a model that uses the frames only.

    Attributes
    ----------
    frame : int
        Number of the newest frame, from 0; -1 before the first frame.
    current, previous : ndarray, shape (H, W), uint8 or float32
        The newest frame and, from frame 1 on, the previous one.
    stack : ndarray, shape (depth, H, W), of the frames' type
        Ring buffer of P, in levels of 0..255 or 0..1.
    hidden : ndarray, shape (H, W), bool, or None
        True for ignored cells, see `Model.ignore`.
    """

    current: Grey
    previous: Grey
    stack: Grey
    hidden: Flags | None = None
    _n_hidden = 0

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.frame = -1
        self._newest = 0
        self._p_sums: deque[float] = deque(maxlen=self._depth)

    def hide(self, hidden: Flags | None) -> None:
        """Ignore the cells where `hidden` is True, see `Model.ignore`."""
        self.hidden = None if hidden is None else np.ascontiguousarray(hidden, np.bool_)
        self._n_hidden = 0 if hidden is None else int(np.count_nonzero(hidden))

    @property
    def n_cells(self) -> int:
        """Number of cells of the newest frame that are not hidden."""
        return self.current.size - self._n_hidden

    def clear(self, image: Grey) -> None:
        """Set the hidden cells of an image, (H, W), to 0."""
        if self.hidden is not None:
            image[self.hidden] = 0

    def take(self, luminance: Grey) -> None:
        """Store the next frame and compute its P; raises FrameError as `Model.step` does."""
        self._check(luminance)
        if self.frame < 0:
            shape, dtype = luminance.shape, luminance.dtype
            self.current, self.previous = aligned(shape, dtype), aligned(shape, dtype)
            self.stack = aligned((self._depth, *shape), dtype)
        self.current, self.previous = self.previous, self.current
        np.copyto(self.current, luminance)
        self.clear(self.current)
        self.frame += 1
        if self.frame > 0 and self._depth > 0:
            self._newest = (self._newest + 1) % self._depth
            self._p_sums.appendleft(self._compute_p(self.p(0)) * self.unit)

    def _compute_p(self, out: Grey) -> float:
        """Write P of the newest frame to `out`, in levels; returns Σ|L(t) - L(t-1)|, in levels."""
        cv2.absdiff(self.current, self.previous, dst=out)
        return float(cv2.sumElems(out)[0])

    @property
    def unit(self) -> float:
        """Luminance of one level."""
        return 1.0 / 255.0 if self.current.dtype == np.uint8 else 1.0

    def position(self, delay: int) -> int:
        """Index into `stack` of P(t - delay)."""
        return (self._newest - delay) % self._depth

    def p(self, delay: int) -> Grey:
        """P(t - delay), shape (H, W), in levels; a view."""
        return self.stack[self.position(delay)]

    def layer(self) -> FloatImage:
        """A copy of P(t) in luminance."""
        return self.p(0).astype(np.float32) * np.float32(self.unit)

    def p_sum(self, delay: int) -> float:
        """Σ|L(t - delay) - L(t - delay - 1)| in luminance; NaN if not defined yet."""
        return self._p_sums[delay] if delay < len(self._p_sums) else math.nan

    def _check(self, luminance: Grey) -> None:
        shape, kind = luminance.shape, luminance.dtype
        if luminance.ndim != 2 or kind not in _TYPES or luminance.size == 0:
            why = f"{kind} of shape {shape} is not a float32 or uint8 image (H, W)"
            hint = "Give luminance in 0..1, for example gray.astype(np.float32) / 255."
            raise FrameError("frame", why, hint)
        if self.hidden is not None and self.hidden.shape != shape:
            why = f"the cells to ignore are {self.hidden.shape}, the frame is {shape}"
            raise FrameError("frame", why, "Give both in the same shape.")
        if self.frame >= 0 and (shape, kind) != (self.current.shape, self.current.dtype):
            before = f"{self.current.dtype} of shape {self.current.shape}"
            why = f"{kind} of shape {shape}, but the frames before are {before}"
            raise FrameError("frame", why, "Call reset() between videos.")
