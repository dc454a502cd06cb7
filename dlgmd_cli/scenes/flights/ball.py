"""A looming ball and four translating capsules, after the paper's Fig. 8.

Sizes and speeds in the image follow the authors' frames. With a field of view of 80 degrees and a
width of 800 px, the ball's radius grows from 25 px, and the capsules move at 1.6 to 6.4 px/frame.
"""

import math

import cv2
import numpy as np

from dlgmd_cli.frame import FloatImage
from dlgmd_cli.scenes.flights.drone import PHASES, fly
from dlgmd_cli.scenes.flights.path import REACH_M, Stage
from dlgmd_cli.scenes.flights.rooms import walls
from dlgmd_cli.scenes.flights.solids import Body, Capsule, Solid, Texture, World
from dlgmd_cli.scenes.flights.stages import FRAME_S
from dlgmd_cli.scenes.flights.textures import Rng, reflectance, smooth_noise

CONTACT_FRAME = 61
BALL_M, BALL_PX = 0.5, 25.0
_CAPSULES_AT_M = 4.0
_FOCAL_PX = 400.0 / math.tan(math.radians(40.0))
_EYE = np.array([1.0, 0.0, 20.0])
# Capsules: offset below the middle in px, and speed to the right in px/frame.
CAPSULES = ((-140.0, 6.4), (-40.0, 4.8), (60.0, 3.2), (160.0, 1.6))
START_PX, _CAPSULE_PX = -312.0, (48.0, 80.0)
_BACKGROUND = 0.9
_TEXELS = 768


def ball_and_capsules(seed: int, _agile: bool | None = None) -> Stage:
    """The flight: a still camera in a white room, hit by the ball at frame 61."""
    rng = np.random.default_rng([seed, 1])
    contact_s = CONTACT_FRAME * FRAME_S
    arrives_m = BALL_M + REACH_M
    speed = (_FOCAL_PX * BALL_M / BALL_PX - arrives_m) / contact_s

    def approach(time_s: float) -> tuple[float, float, float]:
        return speed * (contact_s - time_s), 0.0, 0.0

    center = _EYE + np.array([arrives_m, 0.0, 0.0])
    ball = Capsule("ball", np.array([center, center]), BALL_M, _ball_texture(rng), motion=approach)
    room = Solid("room", [*walls((60.0, 80.0, 40.0), Texture(_BACKGROUND)).values()])
    capsules = [_capsule(rng, down, pace) for down, pace in CAPSULES]
    path = fly([PHASES["hover"](contact_s + FRAME_S)], position_m=_EYE, seed=seed, jitter=0.0)
    return Stage(World(room, [ball, *capsules]), path, "ball", contact_s, contact_s)


def _capsule(rng: Rng, down_px: float, px_per_frame: float) -> Body:
    """A capsule that translates from left to right."""
    scale = _CAPSULES_AT_M / _FOCAL_PX
    width, height = (side * scale for side in _CAPSULE_PX)
    middle = _EYE + np.array([_CAPSULES_AT_M, -START_PX * scale, -down_px * scale])
    half = np.array([0.0, 0.0, (height - width) / 2.0])
    ends = np.array([middle - half, middle + half])
    speed_m_s = px_per_frame * scale / FRAME_S

    def passing(time_s: float) -> tuple[float, float, float]:
        return 0.0, -speed_m_s * time_s, 0.0

    return Capsule("capsule", ends, width / 2.0, _capsule_texture(rng), motion=passing)


def _ball_texture(rng: Rng) -> Texture:
    """A bright ball with a dark belt above its equator and small windows below."""
    y, x = (np.mgrid[:_TEXELS, :_TEXELS] + 0.5) * 2.0 / _TEXELS - 1.0
    depth = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    up, right = np.arcsin(np.clip(-y, -1.0, 1.0)), np.arctan2(x, depth)
    tone = 0.68 + 0.02 * smooth_noise(rng, x.shape, (60.0, 60.0))
    wave = 0.35 + 0.05 * np.sin(3.0 * right)
    tone[(up > wave - 0.28) & (up < wave + 0.35)] = 0.07
    tone[np.abs(up - wave + 0.31) < 0.012] = 0.03
    for across in (-0.6, -0.2, 0.2, 0.6):
        window = (np.abs(right - across) < 0.12) & (np.abs(up + 0.4) < 0.07)
        tone[window] = 0.85
        tone[window & (np.abs(up + 0.4) > 0.055)] = 0.3
    light = 0.35 + 0.65 * np.clip(-0.35 * x - 0.45 * y + 0.82 * depth, 0.0, 1.0)
    return Texture(_soft(tone * light))


def _capsule_texture(rng: Rng) -> Texture:
    """Two tones, a ring between them, and a label."""
    height, width = _TEXELS // 2, round(_TEXELS / 2 * _CAPSULE_PX[0] / _CAPSULE_PX[1])
    lower, upper = rng.uniform(0.25, 0.6), rng.uniform(0.06, 0.2)
    tone = np.full((height, width), lower)
    border = round(height * rng.uniform(0.3, 0.5))
    tone[:border] = upper
    tone[border : border + height // 40] = 0.03
    left, top = round(width * rng.uniform(0.3, 0.5)), round(height * 0.6)
    tone[top : top + height // 10, left : left + width // 3] = rng.uniform(0.05, 0.8)
    across = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    return Texture(_soft(tone * (0.45 + 0.55 * np.sqrt(1.0 - across**2))))


def _soft(image: np.ndarray) -> FloatImage:
    """A texture without edges sharper than a pixel."""
    return reflectance(cv2.GaussianBlur(image, (0, 0), 1.2))
