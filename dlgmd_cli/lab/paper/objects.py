"""The exhibit with a ball and capsules, Fig. 8: what models make of each object."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli import DLGMD, DlgmdParameters
from dlgmd_cli.lab.paper.clips import EVERY, Clip, Series, model, reference_clip, seen
from dlgmd_cli.lab.paper.free import frames, free
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.lab.paper.plan import ANY, FEW, Evidence, Plan, Steps, by_version
from dlgmd_cli.plots.style import FLOOR_DB

Layer = npt.NDArray[np.float32]
# The authors' frames of Fig. 8, 800 px wide: the radius of the ball in m and at first in px, its
# distance on arrival in m, the frame of contact, and the focal length in px.
_BALL_M, _BALL_PX, _ARRIVES_M, _CONTACT_FRAME, _FOCAL_PX = 0.5, 25.0, 0.6, 61, 476.7
# Half the size of the boxes around the capsules, where these start from the middle, and how far
# below the middle each crosses at which speed, in px and px/frame.
_HALF_PX, _START_PX = (38.0, 48.0), -312.0
CAPSULES = ((-140.0, 6.4), (-40.0, 4.8), (60.0, 3.2), (160.0, 1.6))
# Last frame at which the boxes of the capsules and of the ball do not overlap.
LAST_APART = 42


@dataclass(frozen=True)
class ObjectSums:
    """What models make of the objects of a clip, by label.

    `sums` are those of P and S within a box around each object, (2, n_frames, 5): the ball, then
    the capsules. `shares` are the `shares_in` of each frame, (n_frames, 5). NaN until the
    model's first valid frame.
    """

    sums: dict[str, Series]
    shares: dict[str, Series]


def object_sums(
    clip: Clip, models: Mapping[str, DlgmdParameters], active: float, sparse: int
) -> ObjectSums:
    """Run models over the clip with the ball and the capsules; see `shares_in`."""
    frames = seen(clip).frames
    boxes = [object_boxes(frames.shape[1:], index) for index in range(len(frames))]
    sums, shares = {}, {}
    for label, params in models.items():
        cell = DLGMD(params)
        sums[label] = np.full((2, len(frames), len(boxes[0])), np.nan)
        shares[label] = np.full((len(frames), N_SHARES), np.nan)
        for index, frame in enumerate(frames):
            response = cell.step(frame, layers=True)
            if not response.is_valid or response.layers is None:
                continue
            p, s, g = response.layers.p, response.layers.s, response.layers.g
            assert p is not None and s is not None and g is not None
            sums[label][:, index] = np.array([[p[b].sum(), s[b].sum()] for b in boxes[index]]).T
            shares[label][index] = shares_in(p, s, g, active, sparse)
    return ObjectSums(sums, shares)


N_SHARES = 5


def shares_in(p: Layer, s: Layer, g: Layer, active: float, sparse: int) -> Series:
    """How P and S, (H, W), are spread, and what G makes of the cells of S.

    A cell is active above a luminance, and sparse if at most so many of the 4x4 around it are.

    The standard deviations of P and of S over the cells where P is active, by their means; the
    shares that G removes of the active cells of S with few active cells around them, and of the
    others; and ΣG by ΣS over those others. NaN without such cells.
    """
    is_active = s > active
    # Rows and columns -1 to +2 about each cell, as G sums them.
    window, edge = np.ones((4, 4), np.float32), cv2.BORDER_CONSTANT
    around = cv2.filter2D(is_active.astype(np.float32), -1, window, anchor=(1, 1), borderType=edge)
    cells, moving = np.flatnonzero(is_active), np.flatnonzero(p > active)
    is_sparse = around.ravel()[cells] <= sparse
    places = cells[is_sparse], cells[~is_sparse]
    spread = [_spread(layer.ravel()[moving]) for layer in (p, s)]
    kept = [g.ravel()[at] for at in places]
    removed = [(of == 0.0).mean() if of.size else np.nan for of in kept]
    gain = kept[1].sum() / s.ravel()[places[1]].sum() if kept[1].size else np.nan
    return np.array([*spread, *removed, gain])


def _spread(values: Layer) -> float:
    """Standard deviation by mean; NaN if all are 0."""
    return float(values.std() / values.mean()) if values.any() else math.nan


def object_boxes(shape: tuple[int, ...], index: int) -> list[tuple[slice, slice]]:
    """Rows and columns of the boxes around the ball and each capsule at a frame."""
    height, width = shape
    px = width / 800.0
    far_m = _FOCAL_PX * _BALL_M / _BALL_PX
    distance = _ARRIVES_M + (far_m - _ARRIVES_M) * (1.0 - index / _CONTACT_FRAME)
    radius = _FOCAL_PX * _BALL_M / math.sqrt(distance**2 - _BALL_M**2) + 6.0
    places = [(0.0, 0.0, radius, radius)]
    places += [(_START_PX + speed * index, down, *_HALF_PX) for down, speed in CAPSULES]

    def side(middle: float, center: float, half: float, length: int) -> slice:
        low, high = middle + (center - half) * px, middle + (center + half) * px
        return slice(max(0, round(low)), min(length, round(high)))

    return [
        (side(height / 2, y, half_y, height), side(width / 2, x, half_x, width))
        for x, y, half_x, half_y in places
    ]


def fig8(plan: Plan) -> Steps:
    """The attenuation around a ball that approaches and capsules that translate.

    The clip is the authors'; without it, no claim can be tested.
    """
    if plan.reference is None:
        yield {}
        untested = [name for name in (*_MEASURES, "p") if "~" not in name]
        return Evidence({f"fig8-{name}": {ANY: [math.nan]} for name in untested})
    clip = reference_clip(plan.reference, "ball-and-capsules")
    models = {f"set9/{v}": model(9, v) for v in EVERY}
    key = f"fig8, {free('active')}, {free('sparse')}"
    data = yield {key: partial(object_sums, clip, models, free("active"), frames("sparse"))}
    objects: ObjectSums = data[key]
    names = ("ball", *(f"capsule, {speed:g} px/frame" for _, speed in CAPSULES))

    def curves(sums: Series) -> dict[str, tuple[Series, Series]]:
        db = _decibels(*sums)
        db[LAST_APART + 1 :, 1:] = np.nan
        frame = np.arange(float(len(db)))
        return {name: (frame, db[:, place]) for place, name in enumerate(names)}

    values = {f"fig8-{n}": by_version(partial(_measured, objects, n)) for n in _MEASURES}
    values["fig8-p"] = {ANY: [float(np.divide(*_p_by_speed(objects)[[-1, 0]]))]}
    values["fig8-p~without"] = {ANY: [float(np.divide(*_p_by_speed(objects)[[-1, 1]]))]}
    panels = [Panel(v, curves(objects.sums[f"set9/{v}"])) for v in FEW]
    draw = partial(plot_panels, panels, "Frame", "Attenuation (dB)", emphasise=names[0])
    return Evidence(values, {"fig8": draw})


def _decibels(p: Series, s: Series) -> Series:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(10.0 * np.log10(s / p), FLOOR_DB)


def _object_db(objects: ObjectSums, label: str) -> Series:
    """The attenuation of the ball shortly before contact, then of each capsule."""
    sums = objects.sums[label]
    p, s = np.nansum(sums[:, : LAST_APART + 1], axis=1)
    p[0], s[0] = np.nansum(sums[:, -frames("looming") :, 0], axis=1)
    return _decibels(p, s)


def _shares(pool: Callable[..., Series], objects: ObjectSums, label: str) -> Series:
    """The `shares_in` of the frames, pooled."""
    return np.asarray(pool(objects.shares[label], axis=0))


# What a claim measures, and of which series.
_Measure = tuple[Callable[[Series], float], Callable[[ObjectSums, str], Series]]
_MEASURES: dict[str, _Measure] = {
    "capsules": (lambda db: db[1:].max(), _object_db),
    "capsules~middle": (lambda db: float(np.median(db[1:])), _object_db),
    "ball": (lambda db: db[0] - db[1:].max(), _object_db),
    "ball~middle": (lambda db: db[0] - float(np.median(db[1:])), _object_db),
}
for _how, _of in (("", partial(_shares, np.nanmedian)), ("~mean", partial(_shares, np.nanmean))):
    _MEASURES |= {
        f"polarised{_how}": (lambda shares: shares[1] / shares[0], _of),
        f"sparse{_how}": (lambda shares: shares[2] - shares[3], _of),
        f"amplifies{_how}": (lambda shares: shares[4], _of),
    }


def _measured(objects: ObjectSums, name: str, version: str) -> float:
    measure, series_of = _MEASURES[name]
    return float(measure(series_of(objects, f"set9/{version}")))


def _p_by_speed(objects: ObjectSums) -> Series:
    """The sum of P by speed in the box of each capsule, the least first."""
    p = objects.sums["set9/default"][0, : LAST_APART + 1, 1:]
    return np.sort(np.nansum(p, axis=0) / [speed for _, speed in CAPSULES])
