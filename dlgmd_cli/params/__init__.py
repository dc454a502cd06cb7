"""The parameters of every model, checked when they are made."""

from dlgmd_cli.params.base import Parameters, ParametersT, Spec, nearest
from dlgmd_cli.params.dlgmd import FORMULATIONS, MAX_LATENCY_FRAMES, DlgmdParameters
from dlgmd_cli.params.others import EmdLgmdParameters, LgmdParameters

__all__ = [
    "FORMULATIONS",
    "MAX_LATENCY_FRAMES",
    "PARAMETERS",
    "DlgmdParameters",
    "EmdLgmdParameters",
    "LgmdParameters",
    "Parameters",
    "ParametersT",
    "Spec",
    "nearest",
]

# The models that `--model` takes, with the parameters of each.
PARAMETERS: dict[str, type[Parameters]] = {
    kind.model: kind for kind in (DlgmdParameters, LgmdParameters, EmdLgmdParameters)
}
