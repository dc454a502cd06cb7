"""Short clips of what may happen before a camera, as docs/measured.py shows them to the alarm."""

import numpy as np

from dlgmd_cli.scenes.flights.scenes import find_scene


def _scene(name: str, **options: object) -> list[np.ndarray]:
    """The frames of a scene, 240x136 px."""
    scene = find_scene(name)
    chosen = scene.configure({"size": (136, 240), **options})
    return [frame.copy() for frame in scene.frames(chosen)]


def _flicker(frame: np.ndarray, number_: int) -> np.ndarray:
    """Bands of light and dark, an eighth of the brightness to both sides, of lamps at 100 Hz."""
    rows = (number_ / 30 + np.linspace(0, 0.02, len(frame))) * 100
    return frame * (1 + 0.12 * np.sin(2 * np.pi * rows))[:, None]


def _rain(frame: np.ndarray, number_: int) -> np.ndarray:
    """Sixty bright streaks, 12 px long, elsewhere in each frame."""
    rng, wet = np.random.default_rng(number_), frame.copy()
    for x, y in zip(rng.integers(0, 240, 60), rng.integers(0, 124, 60), strict=True):
        wet[y : y + 12, x] = np.minimum(wet[y : y + 12, x] + 60.0, 255.0)
    return wet


def _landing(still: np.ndarray, number_: int) -> np.ndarray:
    """The image moves up by 2 px a frame for a second and a half, and stands."""
    return np.roll(still, -2 * min(number_, 45), axis=0)


def situations() -> dict[str, list[np.ndarray]]:
    """What happens -> the frames, as grey levels."""
    hover = _scene("person-crossing")[0]
    corridor = _scene("along-corridor")
    clips = {
        "A person crosses ahead (`person-crossing`)": _scene("person-crossing"),
        "A wall ahead, 2 m/s (`random --manner wall --speed 2`)": _scene(
            "random", seed=1, manner="wall", speed=2.0
        ),
        "A turn in front of a wall (`turn-at-wall`)": _scene("turn-at-wall"),
        "Past a pillar (`past-pillar`)": _scene("past-pillar"),
        "Through a doorway (`through-doorway`)": _scene("through-doorway"),
        "A lamp is switched on (`light-on`)": _scene("light-on"),
        "Lamps flicker by 12 % at 100 Hz, hovering": [_flicker(hover, n) for n in range(90)],
        "A lens cap after 1 s (black)": corridor[:30] + [np.zeros_like(hover)] * 60,
        "Rain: 60 streaks in each frame, in a corridor": [
            _rain(frame, n) for n, frame in enumerate(corridor)
        ],
        "A landing: the image moves up by 2 px a frame": [_landing(hover, n) for n in range(90)],
        "A ball or a drone hits the hovering drone (`random --manner approached`)": _scene(
            "random", seed=3, manner="approached", speed=3.0
        ),
    }
    return {
        name: [np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in frames]
        for name, frames in clips.items()
    }
