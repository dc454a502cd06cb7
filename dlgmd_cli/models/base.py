"""What every model looks like from outside, and where to find one by name."""

import math
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.params import Parameters

if TYPE_CHECKING:
    from dlgmd_cli.models.photoreceptors import View

FloatImage = npt.NDArray[np.float32]
Grey = npt.NDArray[Any]  # uint8 levels of 0..255, or float32 in 0..1


@dataclass(frozen=True)
class Layers:
    """Copies of a model's layers at one frame, each (H, W) float32; None before it is defined.

    `p` is the photoreceptors' output, `s` the summation layer, `g` the grouping layer after its
    threshold and saturation: what the membrane potential sums.
    """

    p: FloatImage | None = None
    s: FloatImage | None = None
    g: FloatImage | None = None


@dataclass(frozen=True)
class Response:
    """A model's answer to one frame; NaN marks what is not defined yet.

    Attributes
    ----------
    p_sum, s_sum : float
        Sums of the photoreceptor and the summation layer, without regard to sign, in the model's
        own units of them.
    mp : float
        Raw membrane potential K, Eq. (13).
    ffi : float
        Feed-forward inhibition, Eq. (12).
    t_de : float
        Threshold of the grouping layer, Eq. (11).
    layers : Layers or None
        The layers, when `step` was asked for them.
    """

    p_sum: float
    s_sum: float
    mp: float
    ffi: float
    t_de: float
    layers: Layers | None = None

    @property
    def is_valid(self) -> bool:
        """Whether the model had a full history, so that `mp` and `s_sum` are defined."""
        return not math.isnan(self.mp)

    @property
    def attenuation_db(self) -> float:
        """Attenuation 10 lg(ΣS/ΣP) in dB: -inf where ΣS = 0, NaN where it is undefined."""
        if not self.p_sum > 0.0 or math.isnan(self.s_sum):
            return math.nan
        return 10.0 * math.log10(self.s_sum / self.p_sum) if self.s_sum > 0.0 else -math.inf


def undefined(p_sum: float = math.nan, layers: Layers | None = None) -> Response:
    """The answer before the history is full."""
    return Response(p_sum, math.nan, math.nan, math.nan, math.nan, layers)


class Model(Protocol):
    """A looming detector that is fed one frame at a time and keeps constant memory."""

    @property
    def name(self) -> str:
        """The name behind `--model`."""
        ...

    @property
    def layer_units(self) -> tuple[str, str, str]:
        """Units of the layers P, S and G, in words."""
        ...

    @property
    def engine_name(self) -> str:
        """What computes the layers; before the first frame, what was asked for."""
        ...

    @property
    def look_back(self) -> int:
        """How many P of the past, with the newest, `respond` needs a view to hold."""
        ...

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with a full history, counting from 0 at `reset`."""
        ...

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        ...

    def step(self, luminance: Grey, *, layers: bool = False) -> Response:
        """Take the next frame, (H, W) float32 in 0..1 or uint8 in 0..255, and answer to it."""
        ...

    def respond(self, view: "View", *, layers: bool = False) -> Response:
        """Answer to the newest frame of a view that others may share; once a frame, in order."""
        ...


# Imported on first use: OpenCV takes a tenth of a second.
MODELS = {
    "dlgmd": ("dlgmd_cli.models.dlgmd", "DLGMD"),
    "lgmd": ("dlgmd_cli.models.lgmd", "LGMD"),
    "emd-lgmd": ("dlgmd_cli.models.emd_lgmd", "EmdLGMD"),
}


def create_model(params: Parameters, **options: Any) -> Model:
    """The model that `params` are parameters of.

    Parameters
    ----------
    params : Parameters
        Of one of the `MODELS`.
    options
        Handed to the model: `engine` and `tell`, see `DLGMD`.

    Raises
    ------
    ParameterError
        If there is none, or no such engine.
    MissingExtraError
        If the engine needs a package that is not installed.
    """
    if params.model not in MODELS:
        raise ParameterError("", f"no model takes {type(params).__name__}")
    module, attribute = MODELS[params.model]
    model: Model = getattr(import_module(module), attribute)(params, **options)
    return model
