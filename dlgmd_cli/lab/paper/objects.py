"""The exhibit with a ball and capsules, Fig. 8: what models make of each object."""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.lab.paper.clips import EVERY, Clip, model, open_clip, reference_clip, responses
from dlgmd_cli.lab.paper.plan import ANY, Evidence, Plan, Steps, by_version, layer_figures
from dlgmd_cli.lab.paper.stimuli import FEW
from dlgmd_cli.models.base import FloatImage
from dlgmd_cli.models.engines.opencv import sum_4x4
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.plots.panels import Panel, plot_panels
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.results.result import Series
from dlgmd_cli.scenes.flights.stages import BALL_M, BALL_PX, CAPSULES, CONTACT_FRAME, START_PX

# Of the paper's Fig. 8, in an image 800 px wide: half the size of the boxes around the capsules,
# the distance of the ball on arrival in m, and the focal length in px.
_HALF_PX, _ARRIVES_M, _FOCAL_PX = (38.0, 48.0), 0.6, 476.7
# Last frame at which the boxes of the capsules and of the ball do not overlap.
LAST_APART = 42


@dataclass(frozen=True)
class ObjectSums:
    """What models make of the objects of a clip, by label.

    `sums` are those of P and S within a box around each object, (2, n_frames, 5): the ball, then
    the capsules. `shares` are the `shares_in` of each frame, (n_frames, 5). NaN until the
    model's first valid frame. `sha256` is that of the grey frames.
    """

    clip: Clip
    sums: dict[str, Series]
    shares: dict[str, Series]
    sha256: str


def object_sums(clip: Clip, models: Mapping[str, Parameters]) -> ObjectSums:
    """Run models over the clip with the ball and the capsules."""
    sums: dict[str, list[Series]] = {label: [] for label in models}
    shares: dict[str, list[Series]] = {label: [] for label in models}
    digest = hashlib.sha256()
    with open_clip(clip) as video:
        sized = {label: (params, video.size_wh) for label, params in models.items()}
        for frame, each in responses(video, sized, layers=True):
            digest.update(frame.grey.tobytes())
            boxes = object_boxes(frame.grey.shape, frame.index)
            for label, response in each.items():
                box_sums, share = np.full((2, len(boxes)), np.nan), np.full(N_SHARES, np.nan)
                if response.is_valid and response.layers is not None:
                    p, s, g = response.layers.p, response.layers.s, response.layers.g
                    assert p is not None and s is not None and g is not None
                    box_sums = np.array([[p[box].sum(), s[box].sum()] for box in boxes], float).T
                    share = shares_in(p, s, g)
                sums[label].append(box_sums)
                shares[label].append(share)
    of_boxes = {label: np.stack(each, axis=1) for label, each in sums.items()}
    of_cells = {label: np.stack(each) for label, each in shares.items()}
    return ObjectSums(clip, of_boxes, of_cells, digest.hexdigest())


N_SHARES = 5
# A cell is active above this, in luminance; and sparse if at most so many of the 4x4 around it are.
_ACTIVE, _SPARSE = 0.01, 4


def shares_in(p: FloatImage, s: FloatImage, g: FloatImage) -> Series:
    """How P and S, (H, W), are spread, and what G makes of the cells of S.

    The standard deviations of P and of S over the cells where P is active, by their means; the
    shares that G removes of the active cells of S with few active cells around them, and of the
    others; and ΣG by ΣS over those others. NaN without such cells.
    """
    is_active, around = s > _ACTIVE, np.empty_like(s)
    sum_4x4(is_active.astype(np.float32), around)
    active, moving = np.flatnonzero(is_active), np.flatnonzero(p > _ACTIVE)
    is_sparse = around.ravel()[active] <= _SPARSE
    places = active[is_sparse], active[~is_sparse]
    spread = [_spread(layer.ravel()[moving]) for layer in (p, s)]
    kept = [g.ravel()[cells] for cells in places]
    removed = [(cells == 0.0).mean() if cells.size else np.nan for cells in kept]
    gain = kept[1].sum() / s.ravel()[places[1]].sum() if kept[1].size else np.nan
    return np.array([*spread, *removed, gain])


def _spread(values: FloatImage) -> float:
    """Standard deviation by mean; NaN if all are 0."""
    return float(values.std() / values.mean()) if values.any() else math.nan


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


# Number of frames before contact over which the ball is measured.
_BALL_FRAMES = 10
# Of the layer images: the paper's go up to frame 80 of a longer clip.
_SHOWN_FRAMES = (10, 20, 40, 50, 58)


def fig8(plan: Plan) -> Steps:
    """The attenuation around a ball that approaches and capsules that translate."""
    if plan.reference is None:
        clips = [Clip.of("ball-and-capsules", size=(600, 800), seed=seed) for seed in plan.seeds]
    else:
        clips = [reference_clip(plan.reference, "ball-and-capsules")]
    keys = [f"fig8, {plan.name}, {number}" for number in range(len(clips))]
    models = {f"set9/{v}": model("set9", v) for v in EVERY}
    needs, pictures = layer_figures("fig8", clips[0], _SHOWN_FRAMES)
    sums = (partial(object_sums, clip, models) for clip in clips)
    data = yield needs | dict(zip(keys, sums, strict=True))
    results = [data[key] for key in keys]
    names = ("ball", *(f"capsule, {speed:g} px/frame" for _, speed in CAPSULES))

    def of(
        measure: Callable[[Series], float], series_of: Callable[[ObjectSums, str], Series]
    ) -> Any:
        return by_version(
            lambda v: [float(measure(series_of(sums, f"set9/{v}"))) for sums in results]
        )

    def curves(sums: Series) -> dict[str, tuple[Series, Series]]:
        db = _decibels(*sums)
        db[LAST_APART + 1 :, 1:] = np.nan
        frame = np.arange(float(len(db)))
        return {name: (frame, db[:, place]) for place, name in enumerate(names)}

    values = {
        "fig8-capsules": of(lambda db: db[1:].max(), _object_db),
        "fig8-ball": of(lambda db: db[0] - db[1:].max(), _object_db),
        "fig8-polarised": of(lambda shares: shares[1] / shares[0], _median_shares),
        "fig8-sparse": of(lambda shares: shares[2] - shares[3], _median_shares),
        "fig8-amplifies": of(lambda shares: shares[4], _median_shares),
        "fig8-p": {ANY: [_p_by_speed(sums) for sums in results]},
    }
    panels = [Panel(v, curves(results[0].sums[f"set9/{v}"])) for v in FEW]
    draw = partial(plot_panels, panels, "Frame", "Attenuation (dB)", emphasise=names[0])
    return Evidence(values, {"fig8": draw} | pictures(data))


def _decibels(p: Series, s: Series) -> Series:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(10.0 * np.log10(s / p), FLOOR_DB)


def _object_db(objects: ObjectSums, label: str) -> Series:
    """The attenuation of the ball shortly before contact, then of each capsule."""
    sums = objects.sums[label]
    p, s = np.nansum(sums[:, : LAST_APART + 1], axis=1)
    p[0], s[0] = np.nansum(sums[:, -_BALL_FRAMES:, 0], axis=1)
    return _decibels(p, s)


def _p_by_speed(objects: ObjectSums) -> float:
    """The sum of P by speed in the box of a capsule, the greatest by the least."""
    p = objects.sums["set9/default"][0, : LAST_APART + 1, 1:]
    by_speed = np.nansum(p, axis=0) / [speed for _, speed in CAPSULES]
    return float(by_speed.max() / by_speed.min())


def _median_shares(objects: ObjectSums, label: str) -> Series:
    """Medians of `shares_in` over the frames."""
    return np.nanmedian(objects.shares[label], axis=0)
