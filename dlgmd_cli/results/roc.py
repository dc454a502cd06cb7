"""How well responses separate frames, or videos, without a threshold: ROC, precision and recall.

A frame is positive if the truth says so. A video is positive if one of its frames is, and has its
strongest response. The ROC is the recall over the share of the negatives that reach a threshold,
and the *AUC* the area below it: the probability that a positive has a stronger response than a
negative. The *average precision* (AP) is the area below the precision over the recall, in steps.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.detection import ROUNDING_S
from dlgmd_cli.parameters.facts import Json, finite
from dlgmd_cli.results.csv import Cell, Cells
from dlgmd_cli.results.intervals import of_resamples, resampled
from dlgmd_cli.results.scoring import Signal

AUC, ROC = "auc.csv", "roc.csv"
FRAMES, VIDEOS = "frames", "videos"
# Maximum number of levels of a curve and of the resamples: equal shares of the responses.
_MAX_LEVELS = 1000
AUC_COLUMNS = (
    *("model", "by", "positives", "negatives"),
    *("auc", "auc_low", "auc_high", "ap", "ap_low", "ap_high"),
)
ROC_COLUMNS = ("model", "by", "response", "false_positive_rate", "recall", "precision")


class Judged(NamedTuple):
    """The responses of a video's judged frames, NaN for none, and whether each is positive."""

    response: Series
    is_positive: Flags

    @property
    def strongest(self) -> "Judged":
        """The whole video as one: the strongest response, positive if any frame is."""
        strongest = np.array([self.known.max(initial=-np.inf)])
        return Judged(strongest, np.array([self.is_positive.any()]))

    @property
    def known(self) -> Series:
        """The responses, the least possible where there is none."""
        return np.where(np.isnan(self.response), -np.inf, self.response)


def judged(signal: Signal) -> Judged:
    """The judged frames of a labelled video.

    Positive are the frames at which an onset may belong to a contact, negative those at which an
    onset is a false alarm; the others are left out.
    """
    positive = np.zeros(len(signal.time_s), np.bool_)
    for contact in signal.contacts:
        is_after = signal.time_s >= contact.from_s - ROUNDING_S
        positive |= is_after & (signal.time_s <= contact.time_s + ROUNDING_S)
    kept = positive | (signal.is_free & ~signal.is_near)
    return Judged(signal.strength[kept], positive[kept])


class Area(NamedTuple):
    """An area below a curve, and the bounds of its 95 % interval; NaN where undefined."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if np.isnan(self.value):
            return "–"
        bounds = "" if np.isnan(self.low) else f" ({self.low:.2f}–{self.high:.2f})"
        return f"{self.value:.3f}{bounds}"


@dataclass(frozen=True)
class Separation:
    """The curves over T decreasing responses, arrays of shape (T,), and the areas below them.

    Each measure is that of the frames or videos with at least the `response`. Without positives or
    without negatives, there is no curve.
    """

    positives: int
    negatives: int
    response: Series
    false_positive_rate: Series
    recall: Series
    precision: Series
    auc: Area
    ap: Area


def separation(videos: Sequence[Judged]) -> Separation:
    """The curves of some videos, and their areas with intervals by resampled videos."""
    response = np.concatenate([np.empty(0), *(video.known for video in videos)])
    positive = np.concatenate([np.empty(0, np.bool_), *(video.is_positive for video in videos)])
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        none, unknown = np.empty(0), Area(np.nan, np.nan, np.nan)
        return Separation(n_positive, n_negative, none, none, none, none, unknown, unknown)
    levels, place = np.unique(response, return_inverse=True)
    exact = _areas(*(_reaching(place, chosen, len(levels)) for chosen in (positive, ~positive)))
    if len(levels) > _MAX_LEVELS:
        places = np.linspace(0, len(response) - 1, _MAX_LEVELS).round().astype(int)
        levels = np.unique(np.sort(response)[places])
        place = np.searchsorted(levels, response, side="right") - 1
    ends = np.cumsum([len(video.response) for video in videos])[:-1]
    of_videos = [*zip(np.split(place, ends), np.split(positive, ends), strict=True)]
    hits = np.stack([_reaching(own, chosen, len(levels)) for own, chosen in of_videos])
    others = np.stack([_reaching(own, ~chosen, len(levels)) for own, chosen in of_videos])
    drawn = resampled(len(videos))
    auc, ap = (of_resamples(area, len(videos)) for area in _areas(drawn @ hits, drawn @ others))
    true, false = hits.sum(axis=0), others.sum(axis=0)
    rates = false / n_negative, true / n_positive, true / (true + false)
    areas = Area(float(exact[0]), *auc), Area(float(exact[1]), *ap)
    return Separation(n_positive, n_negative, levels[::-1], *rates, *areas)


def _reaching(place: npt.NDArray[np.intp], chosen: Flags, n_levels: int) -> Series:
    """The number of chosen responses at or above each level, from the highest level down."""
    return np.cumsum(np.bincount(place[chosen], minlength=n_levels)[::-1]).astype(np.float64)


def _areas(true: Series, false: Series) -> tuple[Series, Series]:
    """AUC and average precision from the numbers of positives and negatives, shape (…, T)."""
    before = [(0, 0)] * (true.ndim - 1) + [(1, 0)]
    more, earlier = np.diff(np.pad(true, before)), np.pad(true, before)[..., :-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        wins = (np.diff(np.pad(false, before)) * (earlier + more / 2.0)).sum(axis=-1)
        auc = wins / (true[..., -1] * false[..., -1])
        precision = np.nan_to_num(true / (true + false))  # 0 of 0 adds nothing
        return auc, (more * precision).sum(axis=-1) / true[..., -1]


# Model -> `FRAMES` or `VIDEOS` -> how well its responses separate them.
Separations = Mapping[str, Mapping[str, Separation]]


def separations(videos: Mapping[str, Sequence[Judged]]) -> Separations:
    """How well each model separates the frames and the videos, from the judged frames by model."""
    return {
        label: {
            FRAMES: separation(of_model),
            VIDEOS: separation([video.strongest for video in of_model if len(video.response)]),
        }
        for label, of_model in videos.items()
    }


def cells(found: Separations) -> Cells:
    """The columns and rows of auc.csv and roc.csv."""
    every = [(label, by, one) for label, of in found.items() for by, one in of.items()]
    areas: list[list[Cell]] = [
        [label, by, s.positives, s.negatives, *s.auc, *s.ap] for label, by, s in every
    ]
    return {AUC: (AUC_COLUMNS, areas), ROC: (ROC_COLUMNS, _points(every))}


def _points(every: Sequence[tuple[str, str, Separation]]) -> Iterator[list[Cell]]:
    for label, by, one in every:
        measures = one.response, one.false_positive_rate, one.recall, one.precision
        for point in zip(*(measure.tolist() for measure in measures), strict=True):
            yield [label, by, *point]


def table(found: Separations) -> tuple[tuple[str, ...], list[tuple[str, ...]]] | None:
    """The table of AUC and AP that a terminal shows; None without positives or negatives."""
    rows = [
        (label, *(str(area) for one in of.values() for area in (one.auc, one.ap)))
        for label, of in found.items()
    ]
    if all(cell == "–" for row in rows for cell in row[1:]):
        return None
    return ("model", *(f"{area}, {by}" for by in (FRAMES, VIDEOS) for area in ("AUC", "AP"))), rows


def areas_json(of: Mapping[str, Separation]) -> dict[str, Json]:
    """Area and name -> value, lower and upper bound, as `auc_frames`; None where undefined."""
    return {
        f"{name}_{by}": [finite(bound) for bound in getattr(one, name)]
        for by, one in of.items()
        for name in ("auc", "ap")
    }
