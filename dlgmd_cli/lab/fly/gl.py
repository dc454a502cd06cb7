"""MuJoCo, and the library of OpenGL that it draws with."""

import os
import sys
from ctypes.util import find_library

from dlgmd_cli.errors import DlgmdError, MissingExtraError

_HINT = "Run: apt-get install libegl1 libgl1-mesa-dri, or libosmesa6 with MUJOCO_GL=osmesa."


def require() -> None:
    """Import MuJoCo; without a display, choose a library that draws without one.

    `MUJOCO_GL` stays as it is if it is set. Else it is `egl`, or `osmesa` where EGL is missing.

    Raises
    ------
    MissingExtraError
        If MuJoCo is not installed.
    DlgmdError
        If neither library can be used.
    """
    has_display = sys.platform != "linux" or os.environ.get("DISPLAY")
    if not has_display and "mujoco" not in sys.modules:
        os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "osmesa")
    try:
        import mujoco  # noqa: F401
    except ImportError:
        raise MissingExtraError.of("lab fly", "mujoco") from None
    except (AttributeError, OSError, RuntimeError) as error:
        raise unusable(error) from None


def unusable(error: Exception) -> DlgmdError:
    """The error for a library of OpenGL that does not draw."""
    backend = os.environ.get("MUJOCO_GL", "the display")
    why = f"MuJoCo cannot draw with {backend} ({' '.join(str(error).split())[:80]})"
    return DlgmdError("", why, _HINT)
