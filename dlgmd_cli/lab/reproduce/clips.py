"""The clips on which the paper's claims are checked, and the models' responses to them."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.flights import scenes
from dlgmd_cli.lab.flights.ball import BALL_M, BALL_PX, CAPSULES, CONTACT_FRAME, START_PX
from dlgmd_cli.lab.flights.scenes import FlightScene, find_scene, open_scene
from dlgmd_cli.lab.flights.stages import named_flight
from dlgmd_cli.lab.stimuli.base import Scene
from dlgmd_cli.models.base import FloatImage
from dlgmd_cli.models.engines.opencv import sum_4x4
from dlgmd_cli.models.lgmd import INHIBITION
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.parameters import (
    MODELS,
    Parameters,
    load_model_preset,
    load_set,
    merge,
)
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.rows import RowList
from dlgmd_cli.runs.run import responses
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.source import Video

REFERENCE_FPS = 30.0
# Parameters of models by label.
Models = dict[str, Parameters]

# Every combination of latency and saturation, and the released code's FFI, by the name in reports.
VERSIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "released": {"formulation": "released"},
    "bands-unlimited": {"saturate": False},
    "nearest": {"latency": "nearest"},
    "nearest-unlimited": {"latency": "nearest", "saturate": False},
    "interpolated": {"latency": "interpolated"},
    "equations": {"formulation": "equations"},
}
# The null model of each version has no inhibition, and so no delay: some share theirs.
NULL = "/a=0"
NULLS = {name: name + NULL for name in VERSIONS}
NULLS |= {"interpolated": NULLS["nearest"], "equations": NULLS["nearest-unlimited"]}
EVERY = (*VERSIONS, *dict.fromkeys(NULLS.values()))


@dataclass(frozen=True)
class Clip:
    """A scene with its options by flag, or a folder of pictures."""

    scene: str
    flags: tuple[tuple[str, Any], ...] = ()
    folder: str = ""

    @classmethod
    def of(cls, scene: str, **flags: Any) -> "Clip":
        """A scene; `object_size=40` stands for ``--object-size 40``."""
        return cls(scene, tuple((f"--{key.replace('_', '-')}", v) for key, v in flags.items()))


@dataclass(frozen=True)
class ClipResults:
    """The results of models on a clip by label, and the scene's ground truth by column.

    `phases` has the first and the last frame of each phase of a flight.
    """

    results: dict[str, Result]
    truth: dict[str, Series]
    phases: dict[str, tuple[int, int]]

    @property
    def collision_frame(self) -> int:
        """The first frame at or after contact; without contact, the last frame."""
        result = next(iter(self.results.values()))
        found = result.collision_frame
        return int(result.frame[-1]) if found is None else found


def model(name: str, version: str = "default", **changes: Any) -> Parameters:
    """The parameters of `set9`, `lgmd` and so on, with some of them replaced."""
    if name in MODELS:
        return merge(MODELS[name], load_model_preset(name), changes)
    of, null, _ = version.partition(NULL)
    silenced = {"a": 0.0} if null else {}
    return load_set(name.removeprefix("set"), **{**VERSIONS[of], **changes, **silenced})


def all_versions(*names: str, only: Iterable[str] = EVERY, **changes: Any) -> Models:
    """Sets of the D-LGMD in every version, by labels such as `set9/released`."""
    return {f"{name}/{v}": model(name, v, **changes) for name in names for v in only}


def other_models(*names: str) -> Models:
    """Models that the D-LGMD is compared with, by name."""
    return {name: model(name) for name in names}


def run_clip(clip: Clip, models: Models, scales: Mapping[str, float] | None = None) -> ClipResults:
    """Render a clip once, and run every model over it, on frames scaled by `scales` if given.

    If the scene has a collision, the results' peaks end there.
    """
    with open_clip(clip) as video:
        (width, height), steppers = video.size_wh, []
        for label, params in models.items():
            scale = scales[label] if scales else 1.0
            size_wh = max(1, round(width * scale)), max(1, round(height * scale))
            steppers.append(Stepper(params, engine="opencv", size_wh=size_wh))
        collected = [RowList() for _ in steppers]
        for frame, found in responses(video, steppers):
            for rows, response in zip(collected, found, strict=True):
                rows.append(frame, response)
    record, truth = _known(clip)
    phases = {
        one["name"]: (one["first_frame"], one["last_frame"]) for one in record.get("phases", ())
    }
    known = {key: record[key] for key in ("collision_frame",) if record.get(key) is not None}
    results = {}
    for label, stepper, rows in zip(models, steppers, collected, strict=True):
        width, height = stepper.size_wh or video.size_wh
        processed = {"processed": {"width": width, "height": height}}
        results[label] = Result(rows.rows(), stepper.params, {**processed, **known})
    return ClipResults(results, truth, phases)


def open_clip(clip: Clip) -> Video:
    """The frames of a clip as a source, at full size."""
    if clip.folder:
        return open_video(clip.folder, scale=1.0, input_fps=REFERENCE_FPS)
    return open_scene(_scene(clip.scene), dict(clip.flags), scale=1.0)


def _scene(name: str) -> Scene[Any]:
    """A scene of the tool, or group 2 with its brakes at frame 125 instead of 105."""
    return _late_group2() if name == LATE else find_scene(name)


LATE = "group2, brakes at 125"


def _late_group2() -> FlightScene:
    """Group 2 as the paper's Fig. 14 shows it."""
    scene, scripts = find_scene("group2"), Path(scenes.__file__).with_name("scenes.yaml")
    spec = yaml.safe_load(scripts.read_text("utf-8"))["group2"]
    spec["flies"][2][1] += 20  # the phase before the brakes is longer
    return FlightScene(LATE, LATE, scene.defaults, partial(named_flight, spec))


def _known(clip: Clip) -> tuple[dict[str, Any], dict[str, Series]]:
    """The record of a scene, and its ground truth by column; empty for a folder and a flight."""
    if clip.folder:
        return {}, {}
    scene = _scene(clip.scene)
    options = scene.configure(dict(clip.flags))
    rows = [] if scene.is_flight else [vars(row) for row in scene.truth(options)]
    truth = {key: np.array([row[key] for row in rows]) for key in (rows[0] if rows else ())}
    return scene.record(options), truth


def reference_clip(reference: Path | None, scene: str, **flags: Any) -> Clip:
    """The authors' frames of a scene if they are given, otherwise the tool's own scene."""
    folder = None if reference is None else reference / scene.replace("-", "_")
    if folder is not None and folder.is_dir():
        return Clip(scene, folder=str(folder))
    return Clip.of(scene, **flags)


def check_reference(reference: Path | None) -> None:
    """Raise ParameterError if the folder of reference frames has none of them."""
    names = ("looming_ball", "ball_and_capsules")
    if reference is not None and not any((reference / name).is_dir() for name in names):
        why = f"{reference} holds neither {names[0]} nor {names[1]}"
        raise ParameterError("--reference", why, "Give the folder that holds them.")


# Of the paper's Fig. 8, in a picture 800 px wide: half the size of the boxes around the capsules,
# the distance of the ball on arrival in m, and the focal length in px.
_HALF_PX, _ARRIVES_M, _FOCAL_PX = (38.0, 48.0), 0.6, 476.7
# Last frame at which the boxes of the capsules and of the ball do not overlap.
LAST_APART = 42


def object_sums(clip: Clip, models: Models) -> dict[str, tuple[Series, Series]]:
    """Sums of P and S within a box around each object, and `layer_shares` of each frame, by label.

    Shapes (2, n_frames, 5), the ball, then the capsules; and (n_frames, 4). NaN until the model's
    first valid frame.
    """
    steppers = [Stepper(params, engine="opencv") for params in models.values()]
    sums: dict[str, list[Series]] = {label: [] for label in models}
    shares: dict[str, list[Series]] = {label: [] for label in models}
    with open_clip(clip) as video:
        for frame, each in responses(video, steppers, layers=lambda frame: True):
            boxes = object_boxes(frame.grey.shape, frame.index)
            for label, response in zip(models, each, strict=True):
                found, about = np.full((2, len(boxes)), np.nan), np.full(4, np.nan)
                if response.is_valid and response.layers is not None:
                    p, s, g = response.layers.p, response.layers.s, response.layers.g
                    assert p is not None and s is not None and g is not None
                    found = np.array([[float(one[box].sum()) for box in boxes] for one in (p, s)])
                    about = layer_shares(p, s, g)
                sums[label].append(found)
                shares[label].append(about)
    return {label: (np.stack(sums[label], axis=1), np.stack(shares[label])) for label in models}


# A cell is active above this, in luminance; and sparse if at most so many of the 4x4 around it are.
_ACTIVE, _SPARSE = 0.01, 4


def layer_shares(p: FloatImage, s: FloatImage, g: FloatImage) -> Series:
    """Of a frame: how P and S are spread, and which cells of S are not in G.

    The standard deviations of P and of S over the cells where P is active, by their means; then the
    shares of the sparse and of the other active cells of S that G removes. NaN without such cells.
    """
    moving = p > _ACTIVE
    spread = [_spread(one[moving]) for one in (p, s)]
    is_active = (s > _ACTIVE).astype(np.float32)
    around = np.empty_like(is_active)
    sum_4x4(is_active, around)
    removed = [
        (g[cells] == 0.0).mean() if cells.any() else np.nan
        for cells in (is_active * (around <= _SPARSE) > 0, is_active * (around > _SPARSE) > 0)
    ]
    return np.array([*spread, *removed])


def _spread(values: FloatImage) -> float:
    """Standard deviation by mean; NaN if all are 0."""
    return float(values.std() / values.mean()) if values.any() else math.nan


def rectified_lgmd_db(clip: Clip) -> Series:
    """The attenuation of an LGMD with |P| and S rectified, in dB by frame; NaN while undefined."""
    earlier: list[FloatImage] = []
    found = []
    weight = model("lgmd").to_dict()["w_i"]
    with open_clip(clip) as video:
        last = None
        for frame in video:
            grey = frame.grey.astype(np.float32)
            p = np.zeros_like(grey) if last is None else np.abs(grey - last)
            blurred = cv2.filter2D(earlier[-1], -1, INHIBITION, borderType=0) if earlier else p
            s_sum, p_sum = np.maximum(p - weight * blurred, 0.0).sum(), p.sum()
            is_valid = len(earlier) > 1 and p_sum > 0.0
            found.append(10.0 * math.log10(s_sum / p_sum) if is_valid else math.nan)
            earlier, last = [*earlier[-1:], p], grey
    return np.array(found)


def object_boxes(shape: tuple[int, ...], index: int) -> list[tuple[slice, slice]]:
    """Rows and columns of the boxes around the ball and each capsule at a frame."""
    height, width = shape
    px = width / 800.0
    far_m = _FOCAL_PX * BALL_M / BALL_PX
    distance = _ARRIVES_M + (far_m - _ARRIVES_M) * (1.0 - index / CONTACT_FRAME)
    radius = _FOCAL_PX * BALL_M / math.sqrt(distance**2 - BALL_M**2) + 6.0
    places = [(0.0, 0.0, radius, radius)]
    places += [(START_PX + speed * index, down, *_HALF_PX) for down, speed in CAPSULES]

    def side(middle: float, center: float, half: float, length: int) -> slice:
        low, high = middle + (center - half) * px, middle + (center + half) * px
        return slice(max(0, round(low)), min(length, round(high)))

    return [
        (side(height / 2, y, half_y, height), side(width / 2, x, half_x, width))
        for x, y, half_x, half_y in places
    ]
