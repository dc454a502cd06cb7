"""The interface of all models."""

import math
import numbers
import traceback
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from dlgmd_cli.errors import DlgmdError, ModelError, ParameterError
from dlgmd_cli.frame import Flags as Flags
from dlgmd_cli.frame import FloatImage as FloatImage
from dlgmd_cli.models.columns import ATTENUATION, column, columns_of, described
from dlgmd_cli.models.receptors import Grey as Grey
from dlgmd_cli.models.receptors import Photoreceptors as Photoreceptors
from dlgmd_cli.models.receptors import read_only
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.keys import PUBLISHED_MODELS, in_degrees
from dlgmd_cli.parameters.presets import DlgmdParameters, Parameters, ParametersT, untrusted

# Relative rounding of single precision.
_ROUNDING = 2.0**-23
_CENTROID = "centroid of the active cells, from −1 (left, top) to 1; empty if none is active"
# The layers P, S and G of a frame, each (H, W) float32, and further fields of `Response`.
Answer = tuple[FloatImage, FloatImage, FloatImage, Mapping[str, Any]]


@dataclass(frozen=True)
class Layers:
    """Copies of a model's layers at one frame, each (H, W) float32; None until defined.

    `p` is the output of the photoreceptors and `s` the summation layer. `g` is the grouping layer
    after threshold and saturation, whose sum is the membrane potential.
    """

    p: FloatImage | None = None
    s: FloatImage | None = None
    g: FloatImage | None = None


@described
@dataclass(frozen=True)
class Response:
    """A model's response to one frame; numbers are NaN where not defined yet.

    Attributes
    ----------
    layers : Layers or None
        The layers, if `step` was called with ``layers=True``.
    more : mapping of str to float
        Further numbers of the model, by the names in `Model.columns`.
    """

    p_sum: float = column("model's unit", "ΣP, the sum of absolute changes (layer P)", ATTENUATION)
    s_sum: float = column("model's unit", "ΣS, what inhibition leaves of it (layer S)", ATTENUATION)
    mp: float = column("–", "[membrane potential](words.md) (MP), K, Eq. (13)")
    ffi: float = column("model's unit", "feed-forward inhibition, Eq. (12)")
    t_de: float = column("model's unit", "threshold of the layer G, which `ffi` sets, Eq. (11)")
    layers: Layers | None = None
    g_x: float = column("–", _CENTROID)
    g_y: float = column("–", _CENTROID)
    more: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, p: FloatImage, s: FloatImage, g: FloatImage, *, layers: bool, **numbers: Any
    ) -> "Response":
        """The response of a model with these layers P, S and G, each (H, W) float32.

        The sums and the centroid are those of the layers' absolute values; `mp` is Σ|G| unless
        it is given among the other `numbers`. With `layers`, the response has copies of the layers.
        """
        p_sum, s_sum, mp = (cv2.norm(layer, cv2.NORM_L1) for layer in (p, s, g))
        g_x, g_y = centroid(mp, first_moments(np.abs(g)), g.shape)
        shown = Layers(p.copy(), s.copy(), g.copy()) if layers else None
        return replace(cls(p_sum, s_sum, mp, layers=shown, g_x=g_x, g_y=g_y), **numbers)

    @property
    def is_valid(self) -> bool:
        """Whether the model had a full history, so that `mp` and `s_sum` are defined."""
        return not math.isnan(self.mp)

    @property
    def attenuation_db(self) -> float:
        """Attenuation 10 lg(ΣS/ΣP) in dB, NaN where undefined.

        It is -inf where ΣS is at most ΣP times 2**-23, the rounding of single precision (-69 dB):
        there, the residual of E - aI = 0 depends on the order of the additions.
        """
        if not self.p_sum > 0.0 or math.isnan(self.s_sum):
            return math.nan
        share = self.s_sum / self.p_sum
        return 10.0 * math.log10(share) if share > _ROUNDING else -math.inf


class Model:
    """A looming detector that processes one frame at a time in constant memory.

    A custom model derives from this class, names its parameter class, and defines `respond`, or
    `step`. Callers of a model call `reset` before the first frame, too.

    Parameters
    ----------
    params : Parameters, optional
        Parameters of the class `params_class`; its defaults unless given.

    Attributes
    ----------
    params_class : type
        The class of the parameters.
    layer_units : (str, str, str)
        Units of the layers P, S and G, in words.
    columns : tuple of str
        Names of the numbers in `Response.more`; each is a column of mp.csv.
    params : Parameters
        Parameters of the model.
    first_valid_frame : int
        Index of the first frame with a full history, counting from 0 at `reset`.
    receptors : Photoreceptors
        The newest frames, and the last `first_valid_frame` changes ``|L(t) - L(t-1)|``. A `step` of
        one's own gives it each frame to `take`.
    """

    params_class: ClassVar[type[Parameters]] = Parameters
    layer_units: tuple[str, str, str] = ("–", "–", "–")
    columns: tuple[str, ...] = ()
    params: Any
    first_valid_frame: int = 1
    receptors: Photoreceptors

    def __init_subclass__(cls) -> None:
        """Make the model known to its parameter class; raises ParameterError."""
        super().__init_subclass__()
        package, _, module = cls.__module__.rpartition(".")
        if package == PUBLISHED_MODELS:
            cls.params_class = cls.params_class.own_of(cls, module.replace("_", "-"))
        elif not cls.__module__.startswith("dlgmd_cli."):
            spec = f"{cls.__module__}:{cls.__qualname__}"
            cls.params_class = cls.params_class.own_of(cls, spec)
        elif vars(cls.params_class).get("module") == cls.__module__:
            cls.params_class.model_class = cls

    def __init__(self, params: Parameters | None = None) -> None:
        self.params = checked_params(params, self.params_class)
        self.receptors = Photoreceptors(self.first_valid_frame)

    @property
    def name(self) -> str:
        """The model's name, as users write it."""
        return str(self.params.model)

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.receptors.reset()

    def look(self, camera: Camera) -> None:
        """Take the angles of the camera; a model in pixels does not need them."""

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
        """Process the next frame: unless a class has its own `step`, by `respond`.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255. The caller may reuse the array afterwards.
        time_s : float, optional
            Time of the frame in seconds. Models that count frames ignore it.
        layers : bool
            Also return copies of P, S and G.

        Returns
        -------
        Response
            Before `first_valid_frame`, all numbers except `p_sum` are NaN; at the first frame,
            `p_sum` is NaN as well.

        Raises
        ------
        FrameError
            If the frame is not a float32 or uint8 image, or differs in size or type from the
            previous one.
        """
        self.receptors.take(luminance)
        if self.receptors.frame < self.first_valid_frame:
            return Response(self.receptors.p_sum(0))
        p, s, g, numbers = self.respond()
        return Response.of(p, s, g, layers=layers, **numbers)

    def respond(self) -> Answer:
        """The answer to the newest frame of `receptors`, from `first_valid_frame` on.

        Returns
        -------
        p, s, g : ndarray, shape (H, W), float32
            The layers.
        numbers : mapping of str to Any
            The fields of `Response` that do not follow from the layers, such as `mp` and `more`.
        """
        raise NotImplementedError("the class has neither respond() nor step()")


def checked_params(params: Any, kind: type[ParametersT]) -> ParametersT:
    """`params`, or the defaults of `kind` for None; raises ParameterError for another class."""
    if params is None:
        return kind()
    if not isinstance(params, kind):
        parent = kind.__mro__[1]  # `own_of` may have derived `kind` from this class
        is_custom = ":" in kind.model and parent is not Parameters
        if is_custom and isinstance(params, Parameters) and isinstance(params, parent):
            return kind.from_mapping(params.to_dict())
        is_set = kind is DlgmdParameters
        hint = f"Write {'load_set(9)' if is_set else f'{kind.__name__}()'}, or leave it out."
        raise ParameterError("", f"expected {kind.__name__}, not {shown_params(params)}", hint)
    return params


def shown_params(params: Any) -> str:
    """A short form of a wrong argument, for error messages."""
    return type(params).__name__ if isinstance(params, Parameters) else repr(params)[:40]


def create_model(params: Parameters) -> Model:
    """Create the model that belongs to the class of `params`.

    Parameters
    ----------
    params : Parameters
        Parameters of a model.

    Raises
    ------
    ParameterError
        If there is no such model.
    ModelError
        If a custom model fails; `step` of the returned model raises this error, too.
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
        if in_degrees(params):
            model_class = import_module("dlgmd_cli.models.degrees").DegreesDLGMD
        model: Model = model_class(params)
        model.reset()  # a model may set its state only here
        return model
    return CustomModel(params)


def number(value: Any, what: str) -> float:
    """A value as float; raises ModelError if it is not a real number. `what` returns the value."""
    is_scalar = isinstance(value, numbers.Real | np.bool_)
    if not (is_scalar or (isinstance(value, np.ndarray) and value.shape == ())):
        shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
        raise ModelError(what, f"it returns {type(value).__name__}{shape}, not a number")
    return float(value)


class CustomModel(Model):
    """A wrapper around a custom model that raises ModelError if the model fails.

    The error names the class, the method and the frame. An answer that is not valid is an error.

    Parameters
    ----------
    params : Parameters
        The model's parameters, whose class names the model.
    """

    def __init__(self, params: Parameters) -> None:
        self.params, self._frame = params, -1
        with self._blamed("__init__"):
            self.model: Model = params.model_class(params)
        with self._blamed("reset"):
            self.model.reset()  # a model may set its state only here
        with self._blamed("first_valid_frame"):
            self.first_valid_frame = self.model.first_valid_frame
        self.columns, self.layer_units = self.model.columns, self.model.layer_units
        if isinstance(self.columns, str) or not all(isinstance(name, str) for name in self.columns):
            hint = 'Write columns = ("share",), with the comma.'
            raise ModelError(
                self.name, f"its columns = {self.columns!r} is no tuple of names", hint
            )

    def __getattr__(self, name: str) -> Any:
        if name == "model":  # creating the model failed
            raise AttributeError(name)
        return getattr(self.model, name)

    @property
    def n_cells(self) -> int:
        """Number of cells of the newest frame that are not ignored."""
        return self.model.n_cells

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self._frame = -1
        with self._blamed("reset"):
            self.model.reset()

    def look(self, camera: Camera) -> None:
        """Take the angles of the camera, see `Model.look`."""
        with self._blamed("look"):
            self.model.look(camera)

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells, see `Model.ignore`."""
        with self._blamed("ignore"):
            self.model.ignore(hidden)

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`; raises ModelError if the model fails."""
        receptors = self.model.receptors
        frame = receptors.frame
        self._frame += 1
        luminance = read_only(luminance)  # other models get the same frame
        with self._blamed("step"):
            if layers:
                response = self.model.step(luminance, time_s, layers=True)
            else:  # a model's `step` may lack the argument `layers`
                response = self.model.step(luminance, time_s)
            response = self._valid(response, layers=layers)
        if receptors.frame == frame:  # the model took no frame, but `n_cells` needs its size
            receptors.take(luminance)
        return response

    def _valid(self, response: Any, *, layers: bool) -> Response:
        """A response whose numbers are floats; raises ModelError if it is not valid."""
        if not isinstance(response, Response):
            raise ModelError("step()", f"it returns {type(response).__name__}, not a Response")
        if unknown := response.more.keys() - {*self.columns}:
            names = ", ".join(map(repr, sorted(map(str, unknown))))
            hint = f"The class's columns are {', '.join(self.columns) or 'none'}."
            raise ModelError("step()", f"its more has {names}, which is no column", hint)
        if layers and response.layers is None:
            if response.is_valid:
                raise ModelError(
                    "step()", "it returns no layers", "Add Response(layers=Layers(…))."
                )
            response = replace(response, layers=Layers())
        values = {
            one.name: number(getattr(response, one.name), f"step(), {one.name}")
            for one in columns_of(Response)
        }
        if math.isinf(values["mp"]):
            raise ModelError("step(), mp", "it returns infinity")
        more = {name: number(value, f"step(), {name}") for name, value in response.more.items()}
        return Response(**values, layers=response.layers, more=more)

    def _blamed(self, method: str) -> AbstractContextManager[None]:
        at = f", frame {self._frame}" if method == "step" else ""
        return blamed(self.name, f"{method}()", at)


@contextmanager
def blamed(name: str, method: str, at: str = "", noun: str = "model") -> Iterator[None]:
    """Convert an exception of a class of the user's inside the context into a ModelError."""
    try:
        yield
    except ModelError as error:  # raised for a layer or a number
        raise ModelError(f"{name}, {error.what}{at}", error.why, error.hint) from error
    except (DlgmdError, MemoryError):
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}, line {last.lineno}"
        why = f"the {noun} fails with {type(error).__name__}: {error} ({where})"
        raise ModelError(f"{name}, {method}{at}", " ".join(why.split())) from error


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
        From -1 (left, top border of the frame) to 1; NaN if ΣG = 0.
    """
    if not g_sum > 0.0:
        return math.nan, math.nan
    (m_x, m_y), (height, width) = moments, shape
    return (2.0 * m_x / g_sum + 1.0) / width - 1.0, (2.0 * m_y / g_sum + 1.0) / height - 1.0


def centroid_of(g: FloatImage) -> tuple[float, float]:
    """The `centroid` of a non-negative layer, (H, W)."""
    return centroid(cv2.sumElems(g)[0], first_moments(g), g.shape)
