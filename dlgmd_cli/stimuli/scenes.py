"""The scenes by name."""

from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.params import nearest
from dlgmd_cli.stimuli.base import Scene
from dlgmd_cli.stimuli.flat.approach import Approach, ApproachOptions, Ball, Cube
from dlgmd_cli.stimuli.flat.translation import Translation, TranslationOptions

_LOOMING = ApproachOptions()
# Starts where the looming cube ends, so that the one is the other played backwards.
_RECEDING = ApproachOptions(distance_m=_LOOMING.speed_m_s / _LOOMING.fps)

SCENES: dict[str, Scene[Any]] = {
    scene.name: scene
    for scene in (
        Approach("looming-cube", "a cube that comes straight at the camera", Cube(), _LOOMING),
        Approach(
            "receding-cube",
            "a cube that goes straight away from the camera",
            Cube(),
            _RECEDING,
            recedes=True,
        ),
        Approach("looming-ball", "a ball that comes straight at the camera", Ball(), _LOOMING),
        Translation(
            "translating-cubes",
            "cubes that cross the picture, each at its own speed",
            TranslationOptions(),
        ),
    )
}


def find_scene(name: str) -> Scene[Any]:
    """The scene called `name`.

    Raises
    ------
    ParameterError
        If there is none.

    Examples
    --------
    >>> scene = find_scene("looming-cube")
    >>> options = scene.configure({"--speed": 2.0, "--size": (135, 240)})
    >>> next(scene.frames(options)).shape
    (135, 240)
    """
    if name not in SCENES:
        near = nearest(name[:100], SCENES)
        hint = f"Did you mean '{near}'? " if near else ""
        raise ParameterError(
            "", f"there is no scene {name[:100]!r}", f"{hint}Choose from {', '.join(SCENES)}."
        )
    return SCENES[name]
