"""The clips on which the paper's claims are checked, and the models' responses to them."""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.frame import Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.base import FloatImage, create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.lgmd import INHIBITION
from dlgmd_cli.models.session import Session
from dlgmd_cli.parameters.facts import Record, Value
from dlgmd_cli.parameters.keys import Parameters
from dlgmd_cli.parameters.presets import (
    MODELS,
    LgmdParameters,
    load_model_preset,
    load_set,
    parameters_of,
)
from dlgmd_cli.results.csv import RowList
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.sheet import LayerSheet
from dlgmd_cli.scenes.flights.scenes import find_scene, open_scene
from dlgmd_cli.tasks.layers import layers
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.source import Video, opencv_threads, read_ahead

Size = tuple[int, int]
# For each model by label: its parameters, and the width and height of its frames.
Sized = Mapping[str, tuple[Parameters, Size]]


def responses(
    video: Video, models: Sized, *, layers: bool = False
) -> Iterator[tuple[Frame, dict[str, Detection]]]:
    """Step models through a clip without duplicates and gaps, which is read once.

    Frames have the video's size, and those of the models. Models that are equal, with frames of one
    size, are computed once. Raises Interrupted if the user asks to stop.
    """
    distinct = [*dict.fromkeys(models.values())]
    sizes_wh = [size_wh for _, size_wh in distinct]
    created = [create_model(params, engine="opencv") for params, _ in distinct]
    session = Session(created, sizes_wh=sizes_wh)
    # OpenCV's threads would only compete with that of the renderer.
    with opencv_threads(1), read_ahead(video.frames(video.size_wh, *sizes_wh)) as ahead:
        for frame in ahead:
            cancel.check()
            answers = dict(zip(distinct, session.step(frame, layers=layers), strict=True))
            yield frame, {label: answers[sized] for label, sized in models.items()}


REFERENCE_FPS = 30.0
# Parameters of models by label; with a scale, the frames are reduced by it.
Models = dict[str, Parameters | tuple[Parameters, float]]

# The readings of the text and of both codes, by the name in reports.
VERSIONS: dict[str, dict[str, Value]] = {
    "default": {},
    "released-2021": {"formulation": "released-2021"},
    "bands-unlimited": {"saturate": False},
    "whole-unlimited": {"latency": "bands-whole", "saturate": False},
    "bands-2020": {"latency": "bands-2020", "grouping": "mean"},
    "released-2020": {"formulation": "released-2020"},
    "nearest-unlimited": {"latency": "nearest", "saturate": False},
    "equations": {"formulation": "equations"},
}
# The null model of each version has no inhibition, and so no delay: some share theirs.
NULL = "/a=0"
NULLS = {name: name + NULL for name in VERSIONS}
NULLS |= dict.fromkeys(("whole-unlimited", "equations"), NULLS["nearest-unlimited"])
EVERY = (*VERSIONS, *dict.fromkeys(NULLS.values()))


@dataclass(frozen=True)
class Clip:
    """A scene with its options, or a folder of images."""

    scene: str
    options: tuple[tuple[str, Any], ...] = ()
    folder: str = ""

    @classmethod
    def of(cls, scene: str, **options: Any) -> "Clip":
        """A scene with options, such as `object_size=40`."""
        return cls(scene, tuple(options.items()))

    @property
    def seed(self) -> int | None:
        """The seed, None if it is not given."""
        seed: int | None = dict(self.options).get("seed")
        return seed

    @property
    def name(self) -> str:
        """The scene, and what distinguishes it from others: its speed."""
        speeds = dict(self.options).get("speed")
        return f"{self.scene} {speeds[0]:g}" if speeds else self.scene


@dataclass(frozen=True)
class ClipResults:
    """The results of models on a clip by label.

    `phases` has the first and the last frame of each phase of a flight, and `sha256` is that of the
    grey frames.
    """

    clip: Clip
    results: dict[str, Result]
    phases: dict[str, tuple[int, int]]
    sha256: str

    @property
    def collision_frame(self) -> int:
        """The first frame at or after contact; without contact, the last frame."""
        result = next(iter(self.results.values()))
        frame = result.collision_frame
        return int(result.frame[-1]) if frame is None else frame

    def arrays(self) -> dict[str, Any]:
        """Everything but the clip and the parameters as arrays."""
        records = {label: result.record for label, result in self.results.items()}
        facts = {"records": records, "phases": self.phases, "sha256": self.sha256}
        rows = {f"rows {label}": result.rows for label, result in self.results.items()}
        return {"facts": np.array(json.dumps(facts)), **rows}

    @classmethod
    def of_arrays(cls, clip: Clip, models: "Models", arrays: dict[str, Any]) -> "ClipResults":
        """The inverse of `arrays`; raises KeyError and ValueError if they are not of these."""
        facts = json.loads(str(arrays["facts"]))
        results = {
            label: Result(arrays[f"rows {label}"], scaled(params)[0], facts["records"][label])
            for label, params in models.items()
        }
        phases = {name: (first, last) for name, (first, last) in facts["phases"].items()}
        return cls(clip, results, phases, facts["sha256"])


def model(name: str, version: str = "default", **changes: Value) -> Parameters:
    """The parameters of `set9`, `lgmd` and so on, with some of them replaced."""
    if name in MODELS:
        return parameters_of(load_model_preset(name), changes)
    of, null, _ = version.partition(NULL)
    silenced = {"a": 0.0} if null else {}
    return load_set(name.removeprefix("set"), **{**VERSIONS[of], **changes, **silenced})


def all_versions(*names: str, only: Iterable[str] = EVERY, **changes: Value) -> Models:
    """Sets of the D-LGMD in every version, by labels such as `set9/released`."""
    return {f"{name}/{v}": model(name, v, **changes) for name in names for v in only}


def other_models(*names: str) -> Models:
    """Models that the D-LGMD is compared with, by name."""
    return {name: model(name) for name in names}


def scaled(params: Parameters | tuple[Parameters, float]) -> tuple[Parameters, float]:
    """The parameters of a model, and the scale of its frames."""
    return params if isinstance(params, tuple) else (params, 1.0)


def run_clip(clip: Clip, models: Models) -> ClipResults:
    """Render a clip once, and run every model over it.

    If the scene has a collision, the results' peaks end there.
    """
    digest = hashlib.sha256()
    with open_clip(clip) as video:
        (width, height), sized = video.size_wh, {}
        for label, (params, scale) in zip(models, map(scaled, models.values()), strict=True):
            sized[label] = params, (max(1, round(width * scale)), max(1, round(height * scale)))
        collected = {label: RowList() for label in models}
        for frame, answers in responses(video, sized):
            digest.update(frame.grey.tobytes())
            for label, response in answers.items():
                collected[label].append(frame, response)
    scene = None if clip.folder else find_scene(clip.scene)
    record: Record = scene.record(scene.configure(dict(clip.options))) if scene else {}
    phases = {
        phase["name"]: (phase["first_frame"], phase["last_frame"])
        for phase in record.get("phases", ())
    }
    known: Record = {}
    if record.get("collision_frame") is not None:
        known["collision_frame"] = record["collision_frame"]
    results = {}
    for label, (params, (width, height)) in sized.items():
        facts: Record = {"processed": {"width": width, "height": height}, **known}
        results[label] = Result(collected[label].rows(), params, facts)
    return ClipResults(clip, results, phases, digest.hexdigest())


def layer_sheet(clip: Clip, version: str, frames: tuple[int, ...]) -> LayerSheet:
    """The layers of set 9 at some frames of a clip, as the paper's layer images show them."""
    with open_clip(clip) as video:
        seen = np.array([frame.grey for frame in islice(video, frames[-1] + 1)])
    params = model("set9", version)
    sheet = layers(seen, params, frames=frames, scale=1.0, fps=REFERENCE_FPS).sheet
    assert sheet is not None
    return replace(sheet, label=f"{clip.scene}, set 9, {version}")


def open_clip(clip: Clip) -> Video:
    """The frames of a clip as a source, at full size."""
    if clip.folder:
        return open_video(clip.folder, scale=1.0, input_fps=REFERENCE_FPS)
    return open_scene(find_scene(clip.scene), dict(clip.options), scale=1.0)


def reference_clip(reference: Path | None, scene: str, **options: Any) -> Clip:
    """The authors' frames of a scene if they are given, otherwise the tool's own scene."""
    if reference and (folder := reference / scene.replace("-", "_")).is_dir():
        return Clip(scene, folder=str(folder))
    return Clip.of(scene, **options)


def check_reference(reference: Path | None) -> None:
    """Raise ParameterError if the folder of reference frames has none of them."""
    names = ("looming_ball", "ball_and_capsules")
    if reference is not None and not any((reference / name).is_dir() for name in names):
        why = f"{reference} holds neither {names[0]} nor {names[1]}"
        raise ParameterError(argument("reference"), why, "Give the folder that holds them.")


def rectified_lgmd_db(clip: Clip) -> Series:
    """The attenuation of an LGMD with |P| and S rectified, in dB by frame; NaN while undefined."""
    earlier: list[FloatImage] = []
    attenuation_db = []
    weight = LgmdParameters.from_mapping(model("lgmd").to_dict()).w_i
    with open_clip(clip) as video:
        last = None
        for frame in video:
            grey = frame.grey.astype(np.float32)
            p = np.zeros_like(grey) if last is None else np.abs(grey - last)
            blurred = cv2.filter2D(earlier[-1], -1, INHIBITION, borderType=0) if earlier else p
            s_sum, p_sum = np.maximum(p - weight * blurred, 0.0).sum(), p.sum()
            is_valid = len(earlier) > 1 and p_sum > 0.0
            attenuation_db.append(10.0 * math.log10(s_sum / p_sum) if is_valid else math.nan)
            earlier, last = [*earlier[-1:], p], grey
    return np.array(attenuation_db)
