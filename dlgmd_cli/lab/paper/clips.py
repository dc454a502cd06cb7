"""The clips on which the paper's claims are checked, and the responses of models to them."""

import hashlib
import math
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import dlgmd_cli
from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.lab.fly.fly import fly

# One number per frame, (n,); or several.
Series = npt.NDArray[np.float64]
Images = npt.NDArray[np.uint8]
# What a table of a report has, and a parameter.
Value = bool | int | float | str
# Parameters, or the name of another model; with a scale, the frames are reduced by it.
AnyModel = dlgmd_cli.Parameters | str
Models = dict[str, AnyModel | tuple[AnyModel, float]]

FPS = 30.0
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
# The flights of the paper's Table III; other scenes are plain stimuli.
GROUPS = ("group1", "group2", "group3", "group4", "group5")
# The code that makes responses: if it changes, none that is kept is good.
_CODE = ("frame.py", "reduction.py", "scenes", "models", "parameters", "lab/fly")
# The kernel of the LGMD's inhibition.
_LGMD_INHIBITION = np.array([[1, 2, 1], [2, 0, 2], [1, 2, 1]], np.float32) / 8.0


@dataclass(frozen=True)
class Clip:
    """A stimulus or a flight with its options, or a folder of images."""

    scene: str
    options: tuple[tuple[str, Any], ...] = ()
    folder: str = ""

    @classmethod
    def of(cls, scene: str, **options: Any) -> "Clip":
        """A stimulus with options of `synth`, or a flight with those of `fly`."""
        return cls(scene, tuple(options.items()))

    @property
    def seed(self) -> int | None:
        """The seed, None if it is not given."""
        seed: int | None = dict(self.options).get("seed")
        return seed

    @property
    def name(self) -> str:
        """The scene, and what distinguishes it from others: its speed."""
        speed = dict(self.options).get("speed")
        return f"{self.scene} {speed:g}" if speed else self.scene


@dataclass(frozen=True)
class Seen:
    """The grey frames of a clip, (n, H, W), and what is known of a flight.

    `phases` has the first and the last frame of each phase, and `collision_frame` is None where
    nothing is hit.
    """

    frames: Images
    phases: Mapping[str, tuple[int, int]]
    collision_frame: int | None = None


@dataclass(frozen=True)
class ClipResults:
    """The results of models on a clip by label.

    `phases` has the first and the last frame of each phase of a flight, and `sha256` is that of the
    grey frames.
    """

    clip: Clip
    results: dict[str, dlgmd_cli.Result]
    phases: Mapping[str, tuple[int, int]]
    sha256: str

    @property
    def collision_frame(self) -> int:
        """The first frame at or after contact; without contact, the last frame."""
        result = next(iter(self.results.values()))
        frame = result.collision_frame
        return int(result.frame[-1]) if frame is None else frame


def model(number: int, version: str = "default", **changes: Value) -> dlgmd_cli.DlgmdParameters:
    """The parameters of a set of the D-LGMD in a version, with some of them replaced."""
    of, null, _ = version.partition(NULL)
    silenced = {"a": 0.0} if null else {}
    return dlgmd_cli.load_set(number, **{**VERSIONS[of], **changes, **silenced})


def all_versions(*numbers: int, only: Iterable[str] = EVERY, **changes: Value) -> Models:
    """Sets of the D-LGMD in every version, by labels such as `set9/released-2020`."""
    return {f"set{n}/{v}": model(n, v, **changes) for n in numbers for v in only}


def seen(clip: Clip) -> Seen:
    """The frames of a clip: read, flown or drawn."""
    options = dict(clip.options)
    if clip.folder:
        with dlgmd_cli.open_video(clip.folder, scale=1.0, input_fps=FPS) as video:
            return Seen(np.stack([frame.grey for frame in video]), {})
    if clip.scene in GROUPS:
        flight = fly(clip.scene, fps=FPS, **options)
        phases = {name: (first, last) for name, (first, last) in flight.record["phases"].items()}
        return Seen(flight.frames, phases, flight.collision_frame)
    frames = dlgmd_cli.synth(clip.scene, **options).frames
    assert frames is not None  # they are in memory, as no folder was named
    return Seen(frames, {})


def run_clip(clip: Clip, models: Models, kept: Path | None = None) -> ClipResults:
    """Run every model over a clip; if the scene has a collision, the results' peaks end there.

    Models that are equal, with frames of one size, are computed once. With a folder `kept`, those
    that an earlier run has left there are read, and what is computed is added to them.
    """
    wanted = {label: m if isinstance(m, tuple) else (m, 1.0) for label, m in models.items()}
    path = kept and kept / f"{clip.name}-{_digest(clip)}.pickle"
    known: ClipResults | None = None
    if path and path.exists():
        known = pickle.loads(path.read_bytes())
    results = dict(known.results) if known else {}
    keys = {label: _digest(each) for label, each in wanted.items()}
    missing = {keys[label]: wanted[label] for label in keys if keys[label] not in results}
    if known is None or missing:
        shown = seen(clip)
        for scale in dict.fromkeys(scale for _, scale in missing.values()):
            distinct = {key: m for key, (m, at) in missing.items() if at == scale}
            options = {"scale": scale, "fps": FPS, "repeats": "keep"}
            answers = dlgmd_cli.run(shown.frames, tuple(distinct.values()), **options)
            for key, answer in zip(distinct, answers, strict=True):
                results[key] = answer.until(shown.collision_frame)
        digest = hashlib.sha256(shown.frames.tobytes()).hexdigest()
        known = ClipResults(clip, results, shown.phases, digest)
        if path:  # an interruption leaves the earlier file, or the whole new one
            path.with_suffix(".part").write_bytes(pickle.dumps(known))
            path.with_suffix(".part").replace(path)
    return replace(known, results={label: results[key] for label, key in keys.items()})


def _digest(value: Any) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:12]


def code_digest() -> str:
    """A digest of the code that makes responses."""
    package, sha = Path(dlgmd_cli.__file__).parent, hashlib.sha256()
    for place in (package / name for name in _CODE):
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            sha.update(path.read_bytes())
    return sha.hexdigest()[:12]


def reference_clip(reference: Path | None, scene: str, **options: Any) -> Clip:
    """The authors' frames of a scene if they are given, otherwise the stimulus of this name."""
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
    luminance = seen(clip).frames.astype(np.float32)
    change = np.abs(np.diff(luminance, axis=0))
    attenuation_db, strength = [math.nan, math.nan], dlgmd_cli.LGMD().params.w_i
    for before, p in pairwise(change):
        blurred = cv2.filter2D(before, -1, _LGMD_INHIBITION, borderType=cv2.BORDER_CONSTANT)
        s_sum, p_sum = np.maximum(p - strength * blurred, 0.0).sum(), p.sum()
        attenuation_db.append(10.0 * math.log10(s_sum / p_sum) if p_sum > 0.0 else math.nan)
    return np.array(attenuation_db)
