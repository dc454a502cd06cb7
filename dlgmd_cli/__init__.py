"""Locust-inspired collision detection on video: the D-LGMD model as a command and a library."""

# Nothing is imported here: a Ctrl-C meanwhile would end the command with a traceback.
TYPE_CHECKING = False

__version__ = "0.1.0"

__all__ = ["DLGMD", "DlgmdError", "DlgmdParameters", "load_set", "open_video"]

if TYPE_CHECKING:
    from dlgmd_cli.errors import DlgmdError
    from dlgmd_cli.models.dlgmd import DLGMD
    from dlgmd_cli.params import DlgmdParameters
    from dlgmd_cli.presets import load_set
    from dlgmd_cli.video.frames import open_video

_HOMES = {
    "DLGMD": "dlgmd_cli.models.dlgmd",
    "DlgmdError": "dlgmd_cli.errors",
    "DlgmdParameters": "dlgmd_cli.params",
    "load_set": "dlgmd_cli.presets",
    "open_video": "dlgmd_cli.video.frames",
}


def __getattr__(name: str) -> object:
    # Late, so that the command line can answer --help without OpenCV.
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
