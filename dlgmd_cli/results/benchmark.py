"""The annotations of the LGMD benchmark (MingshuoXu/BiSTS), and its score of a response.

``annotations.json`` maps the path of a video, with either separator, to its ``ground_truth``: a
value for each frame, from 0.5 (nothing approaches) to 1. The folder of a video is its class.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ResultError
from dlgmd_cli.frame import Series
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.keys import Parameters

# The response, and the truth, where nothing approaches.
REST = 0.5
ANNOTATIONS, TRUTH = "annotations.json", "ground_truth"
# The classes over which the benchmark takes its means.
SYNTHETIC = (
    "basic test/looming square",
    "basic test/receding square",
    "basic test/translating bar",
    "basic test/linear deformation",
    "looming ball against driving sense",
    "looming square against nature scenarios",
)
REAL = (
    "looming ball against static bg",
    "vehicle against driving sense",
    "pure driving sense",
)
_VIDEOS = (".mp4", ".avi")


@dataclass(frozen=True)
class Sequence:
    """A video of the benchmark.

    Attributes
    ----------
    name, path : str
        The video's path from the folder of the annotations, with ``/``; its path.
    truth : ndarray, shape (n,)
        The truth of each frame, 0.5 to 1.
    """

    name: str
    path: str
    truth: Series

    @property
    def group(self) -> str:
        """The class: the folder of the video, from that of the annotations."""
        return self.name.rpartition("/")[0]


def separability(response: npt.ArrayLike, truth: npt.ArrayLike) -> float:
    """The benchmark's score SA of a response, its `calculate_IoU_for_PSP`: at most 1.

    Parameters
    ----------
    response, truth : array_like, shape (n,)
        Of each frame, from 0.5 to 1.

    Returns
    -------
    float
        I / U, the areas (trapezoids) that response and truth have in common, and together, above
        the least truth; 0 if U is 0. If no truth is above 0.5, 1 - U.
    """
    r, g = np.asarray(response, np.float64), np.asarray(truth, np.float64)
    common = np.trapezoid(np.minimum(r, g) - g.min()) / len(g) * 2.0
    together = np.trapezoid(np.maximum(r, g) - g.min()) / len(g) * 2.0
    if not g.max() > REST:
        return float(1.0 - together)
    return float(common / together) if together else 0.0


def response_of(level: Series, params: Parameters) -> Series:
    """The response on the benchmark's scale, 0.5 at rest, from a model's `mp_abs`.

    A model at rest at 0.5 has that scale already; of a model at rest at 0, it is 0.5 + mp_abs / 2.
    Before its first response, a model is at rest.
    """
    rest = params.rest
    if rest is None:  # without a half-saturation constant, `mp_abs` is a sigmoid
        rest = REST if params.kappa is None else 0.0
    scaled = REST + (level - rest) / (1.0 - rest) * (1.0 - REST)
    return np.where(np.isnan(level), REST, scaled)


def read_annotations(path: Path) -> tuple[list[Sequence], dict[str, str]]:
    """The videos that annotations list, and the reason why each of the others cannot be scored.

    Raises ResultError if the file cannot be read as annotations.
    """
    try:
        with open_regular(path, "rb") as file:
            listed = json.loads(file.read().decode("utf-8-sig"))
    except OSError as error:
        raise ResultError(str(path), str(error.strerror or error)) from None
    except (ValueError, RecursionError) as error:
        raise ResultError(str(path), f"not JSON ({error})") from None
    if not isinstance(listed, dict) or not listed:
        why = "lists no video"
        raise ResultError(str(path), why, f'Write {{"CLASS/VIDEO": {{"{TRUTH}": [0.5, 1]}}}}.')
    sequences: dict[str, Sequence] = {}
    failed: dict[str, str] = {}
    for key, entry in listed.items():
        name = "/".join(part for part in key.replace("\\", "/").split("/") if part not in ("", "."))
        truth = _truth(entry)
        if isinstance(truth, str):
            failed[name] = truth
        elif name in sequences:
            failed[name] = "it is listed twice"
        else:
            sequences[name] = Sequence(name, str(path.parent / name), truth)
    return [one for name, one in sequences.items() if name not in failed], failed


def _truth(entry: Any) -> Series | str:
    """The truth of an entry, or why it has none."""
    values = entry.get(TRUTH) if isinstance(entry, Mapping) else None
    if not isinstance(values, list) or not values:
        return f"it has no list {TRUTH}"
    if not all(isinstance(value, int | float) and REST <= value <= 1.0 for value in values):
        return f"its {TRUTH} has a value that is no number from 0.5 to 1"
    return np.array(values, np.float64)


def unlisted(path: Path, names: set[str]) -> list[str]:
    """The videos in the folders of the annotated ones that the annotations do not list."""
    folders = sorted({name.rpartition("/")[0] for name in names})
    return [
        name
        for folder in folders
        for file in sorted((path.parent / folder).glob("*"))
        if file.suffix.lower() in _VIDEOS
        and (name := f"{folder}/{file.name}".lstrip("/")) not in names
    ]


def means(scores: Mapping[str, float], sequences: list[Sequence]) -> dict[str, tuple[int, float]]:
    """The number of videos and the mean score of each class, and of several: the last three.

    `synthetic`, `real`, and `weighted mean` are means over the videos of the benchmark's classes,
    so that each class counts by its number of videos. Another class counts only in annotations
    without any of these classes. `scores` has the score of each of the `sequences` by name.
    """
    classes = dict.fromkeys(one.group for one in sequences)
    known = [*SYNTHETIC, *REAL]
    ordered = sorted(classes, key=lambda name: [*known, name].index(name))
    counted = {*known} & {*classes} or {*classes}
    groups = {name: {name} for name in ordered}
    groups |= {"synthetic": {*SYNTHETIC}, "real": {*REAL}, "weighted mean": counted}
    found = {}
    for title, members in groups.items():
        own = [scores[one.name] for one in sequences if one.group in members]
        found[title] = len(own), float(np.mean(own)) if own else np.nan
    return found
