"""Locust-inspired collision detection on video: the D-LGMD model as a command and a library."""

# Nothing is imported here: a Ctrl-C meanwhile would end the command with a traceback.
TYPE_CHECKING = False

__version__ = "0.1.0"

__all__ = ["DLGMD", "Alarm", "DlgmdError", "DlgmdParameters", "load_set", "open_source"]

if TYPE_CHECKING:
    from dlgmd_cli.errors import DlgmdError
    from dlgmd_cli.models.detection import Alarm
    from dlgmd_cli.models.dlgmd import DLGMD
    from dlgmd_cli.parameters import DlgmdParameters, load_set
    from dlgmd_cli.video.open import open_source

_HOMES = {
    "Alarm": "dlgmd_cli.models.detection",
    "DLGMD": "dlgmd_cli.models.dlgmd",
    "DlgmdError": "dlgmd_cli.errors",
    "DlgmdParameters": "dlgmd_cli.parameters",
    "load_set": "dlgmd_cli.parameters",
    "open_source": "dlgmd_cli.video.open",
}


def __getattr__(name: str) -> object:
    # Late, so that the command line can answer --help without OpenCV.
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
