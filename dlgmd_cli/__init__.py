"""Locust-inspired collision detection on video: the D-LGMD model as a command and a library."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = ["DLGMD", "DlgmdError", "DlgmdParameters", "load_set", "open_source"]

if TYPE_CHECKING:
    from dlgmd_cli.errors import DlgmdError
    from dlgmd_cli.models.dlgmd import DLGMD
    from dlgmd_cli.params import DlgmdParameters
    from dlgmd_cli.presets import load_set
    from dlgmd_cli.sources.open import open_source

_HOMES = {
    "DLGMD": "dlgmd_cli.models.dlgmd",
    "DlgmdError": "dlgmd_cli.errors",
    "DlgmdParameters": "dlgmd_cli.params",
    "load_set": "dlgmd_cli.presets",
    "open_source": "dlgmd_cli.sources.open",
}


def __getattr__(name: str) -> Any:
    # Late, so that the command line can answer --help without OpenCV.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
