"""The table of `unmeasured`: what it tells.

Every other clip and flight is in the half on which the point was chosen. A contact is told if the
model was blind in the last 1.5 s. Clear time is without an alarm, more than 3 s before a contact,
and 1 s after it.
"""

from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import dlgmd_cli
from dlgmd_cli.lab.fly.fly import flown
from dlgmd_cli.lab.fly.scripts import Options
from dlgmd_cli.lab.measure.scores import reference, table
from dlgmd_cli.models.health import Measuring
from dlgmd_cli.results.labels import read_cases

# The least quality, and for how long (s) it is missed.
LEAST, LASTS_S = 0.25, 0.7
CLIPS = ("approach", "clips", "footage")
# Flights into blank walls, and flights that are rendered lit, dark and noisy: seed and number.
BLANK_SEED, HIT_SEED, N_FLIGHTS, SIZE_WH = 91000, 92000, 8, (320, 180)
# Seconds before a contact in which it is told, and in which an alarm announces it; and after it.
TOLD_S, ANNOUNCED_S, AFTER_S = 1.5, 3.0, 1.0
# Turns rendered images, (n, H, W), into what a worse camera would show.
Look = Callable[[npt.NDArray[Any]], npt.NDArray[Any]]


class Watched(NamedTuple):
    """A clip or a flight: its result, and the times of its contacts (s)."""

    result: dlgmd_cli.Result
    contacts_s: list[float]

    def counts(self) -> npt.NDArray[np.float64]:
        """Numbers of missed contacts and of told ones; clear time in all, and unmeasured (s)."""
        result, measuring = self.result, Measuring(LEAST, LASTS_S)
        time_s, alarms = result.time_s, result.alarms
        rows = zip(result.expansion_quality, time_s, strict=True)
        unmeasured = np.array([measuring.step(*row) for row in rows]) & ~alarms
        is_clear, n_missed, n_told = ~alarms, 0, 0
        for contact_s in self.contacts_s:
            left_s = contact_s - time_s
            is_clear = is_clear & ((left_s > ANNOUNCED_S) | (left_s < -AFTER_S))
            if not alarms[(left_s >= 0.0) & (left_s <= ANNOUNCED_S)].any():
                n_missed += 1
                n_told += bool(unmeasured[(left_s >= 0.0) & (left_s <= TOLD_S)].any())
        steps_s = np.append(np.diff(time_s), 0.0)
        clear_s = steps_s[is_clear].sum(), steps_s[is_clear & unmeasured].sum()
        return np.array([n_missed, n_told, *clear_s])


def real() -> Iterator[Watched]:
    """The real clips."""
    for case in (case for name in CLIPS for case in read_cases(reference(name))):
        result = dlgmd_cli.run(case.path, "flight", fov=case.labels[0].fov)
        yield Watched(result, result.times_of(case.collisions))


def dark(images: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Images with 6 % of the light, and noise of two levels."""
    return 0.06 * images + np.random.default_rng(3).normal(0.0, 2.0, images.shape)


def noisy(images: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Images with half of the light, and noise of 20 levels."""
    return 0.5 * images + np.random.default_rng(3).normal(0.0, 20.0, images.shape)


def rendered(target: str | None, seed: int, *looks: Look) -> Iterator[list[Watched]]:
    """Flights that hit something, each in all looks."""
    for number in range(N_FLIGHTS):
        flight = flown(Options("hit", seed + number, SIZE_WH, target=target))
        angles = {key: flight.record[key] for key in ("fov", "camera_tilt")}
        watched = []
        for look in looks:
            images = np.uint8(np.clip(np.rint(look(flight.frames)), 0, 255))
            result = dlgmd_cli.run(images, "flight", fps=flight.fps, **angles)
            watched.append(Watched(result, result.times_of([flight.collision_frame or 0])))
        yield watched


def unmeasured() -> str:
    """Told contacts, and the share of clear time; the point was chosen on the first half."""
    clips = [*real()]
    blank = [*rendered("blank", BLANK_SEED, np.asarray)]
    hits = rendered(None, HIT_SEED, dark, noisy)
    flights = [[*a, *b] for a, b in zip(blank, hits, strict=True)]
    head = ["half", "told in flights", "told in clips", "clips' clear time unmeasured, %"]
    rows = [
        [name, *_cells([*chain(*flights[half::2])], clips[half::2])]
        for half, name in enumerate(("first", "second"))
    ]
    return table(head, rows)


def _cells(flights: list[Watched], clips: list[Watched]) -> Iterator[str]:
    """The cells of a half of the flights and clips."""
    of_flights, of_clips = (
        np.sum([one.counts() for one in own], axis=0) for own in (flights, clips)
    )
    for n_missed, n_told, *_ in (of_flights, of_clips):
        yield f"{n_told:.0f} of {n_missed:.0f}"
    yield f"{100.0 * of_clips[3] / of_clips[2]:.1f}"
