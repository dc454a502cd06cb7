"""Classify the alarms of one video, at any threshold: hits, alarms at contact, false alarms.

An alarm counts at its onset, the n_sp-th spike. Its kind depends on the time of the onset:

- within the horizon before a collision: a *hit*. The collision is announced, and the lead is the
  time left. Of several hits, the first counts;
- from the collision to 3 frames after it: *at contact*, neither a hit nor false;
- after that, up to the horizon before the video's next collision: *ignored*;
- at any other time: *false*. Within 2 s before the first collision, it is also *early*.

The minutes end at the first collision, or with the video: after a collision no alarm is false.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.detection import MERGE_S, ROUNDING_S, Flags, Series

HORIZON_S, EARLY_S, CONTACT_FRAMES = 1.0, 2.0, 3

FALSE, EARLY, HIT, AT_CONTACT, IGNORED = range(5)
KINDS = ("false", "early", "hit", "contact", "ignored")


@dataclass(frozen=True)
class Signal:
    """The signal of one video that is compared with a threshold, and the times of its collisions.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the frames, in seconds, increasing; n is at least 1.
    strength : ndarray, shape (n,)
        There is a spike where it reaches the threshold; NaN (no spike) where undefined.
    contacts_s : tuple of float
        Times of the collisions, in seconds, increasing.
    frame_s : float
        Duration of a frame of the video, in seconds.
    repeated : ndarray, shape (n,), bool, optional
        Frames that repeat the one before. They have its strength, but are not counted as spikes.
    frame : int ndarray, shape (n,), optional
        Frame numbers in the video; 0 to n - 1 unless given.
    """

    time_s: Series
    strength: Series
    contacts_s: tuple[float, ...]
    frame_s: float
    repeated: Flags | None = None
    frame: npt.NDArray[np.int64] | None = None

    def sustained(self, n_sp: int) -> Series:
        """The least strength of the last n_sp frames, shape (n,); -inf if there are fewer.

        Frames that repeat the one before do not count.
        """
        filled = np.where(np.isnan(self.strength), -np.inf, self.strength)
        seen = np.ones(len(filled), np.bool_) if self.repeated is None else ~self.repeated
        seen[:1] = True
        padded = np.concatenate((np.full(n_sp - 1, -np.inf), filled[seen]))
        least = np.lib.stride_tricks.sliding_window_view(padded, n_sp).min(axis=-1)
        return np.asarray(least[np.cumsum(seen) - 1])

    @property
    def minutes(self) -> float:
        """Time before the first collision, horizon included, or the whole video."""
        end_s = min([float(self.time_s[-1]) + self.frame_s, *self.contacts_s[:1]])
        return max(end_s - float(self.time_s[0]), 0.0) / 60.0


@dataclass(frozen=True)
class Tally:
    """The alarms of one video, counted at each of T thresholds.

    Attributes
    ----------
    lead_s : ndarray, shape (collisions, T)
        Time from the first hit to the collision, in seconds; NaN if it is not announced.
    at_contact : ndarray, shape (collisions, T), bool
        Whether the collision is not announced, but an alarm begins at contact.
    n_false, n_early : int ndarray, shape (T,)
        Number of false alarms, and how many of them are early.
    minutes : float
        Time in which an alarm counts as false.
    inside, outside : ndarray, shape (collisions,) and (m,)
        Peaks of the strength, see `peaks`.
    """

    lead_s: Series
    at_contact: Flags
    n_false: npt.NDArray[np.intp]
    n_early: npt.NDArray[np.intp]
    minutes: float
    inside: Series
    outside: Series

    def only(self, collisions: Flags) -> "Tally":
        """The same for some of the collisions, but with all false alarms."""
        own = ("lead_s", "at_contact", "inside")
        return replace(self, **{name: getattr(self, name)[collisions] for name in own})


def onset_thresholds(signal: Signal, n_sp: int) -> tuple[Series, Series]:
    """The range of thresholds at which an alarm begins at each row: above `low`, up to `high`.

    The alarm is on while the sustained strength reaches the threshold. It begins at a row unless it
    was on at the row before, or within the `MERGE_S` before; the greatest sustained strength of
    that time is `low`.

    Returns
    -------
    low, high : ndarray, shape (n,)
        The range is empty if `low` is not less than `high`.
    """
    time_s, high = signal.time_s, signal.sustained(n_sp)
    low = np.concatenate(([-np.inf], high[:-1]))
    # For each row, the first earlier one that is too close for a separate alarm.
    first = np.searchsorted(time_s, time_s - (MERGE_S - ROUNDING_S), side="right")
    rows = np.arange(len(high))
    for back in range(2, int((rows - first).max(initial=0)) + 1):
        near = rows[back:][rows[back:] - back >= first[back:]]
        low[near] = np.maximum(low[near], high[near - back])
    return low, high


def kinds(signal: Signal, horizon_s: float) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.intp]]:
    """The kind of an alarm that began at each row, and the collision it belongs to.

    Returns
    -------
    kind : int ndarray, shape (n,)
        `FALSE`, `EARLY`, `HIT`, `AT_CONTACT` or `IGNORED`.
    collision : int ndarray, shape (n,)
        Number of the collision for hits and alarms at contact; otherwise -1.
    """
    time_s = signal.time_s
    kind = np.full(len(time_s), FALSE, np.int8)
    collision = np.full(len(time_s), -1)
    over_s = -np.inf  # end of the previous collision's contact
    for number, contact_s in enumerate(signal.contacts_s):
        grace_s = contact_s + CONTACT_FRAMES * signal.frame_s + ROUNDING_S
        before = (time_s < contact_s - ROUNDING_S) & (time_s > over_s)
        if number == 0:
            kind[before & (time_s >= contact_s - EARLY_S - ROUNDING_S)] = EARLY
        is_hit = before & (time_s >= contact_s - horizon_s - ROUNDING_S)
        is_at_contact = (time_s >= contact_s - ROUNDING_S) & (time_s <= grace_s)
        kind[time_s > grace_s] = IGNORED
        kind[is_hit], kind[is_at_contact] = HIT, AT_CONTACT
        collision[is_hit | is_at_contact] = number
        over_s = grace_s
    return kind, collision


def tally(
    signal: Signal, n_sp: int, thresholds: npt.ArrayLike, horizon_s: float = HORIZON_S
) -> Tally:
    """Count the alarms of a video by kind, at one threshold or at T."""
    at = np.atleast_1d(np.asarray(thresholds, np.float64))
    low, high = onset_thresholds(signal, n_sp)
    kind, collision = kinds(signal, horizon_s)
    may_begin = low < high

    def count(wanted: Flags) -> npt.NDArray[np.intp]:
        """Number of alarms that begin at the wanted rows, shape (T,)."""
        lows, highs = np.sort(low[wanted]), np.sort(high[wanted])
        return np.searchsorted(lows, at, side="left") - np.searchsorted(highs, at, side="left")

    lead_s = np.full((len(signal.contacts_s), len(at)), np.nan)
    at_contact = np.zeros(lead_s.shape, np.bool_)
    for number, contact_s in enumerate(signal.contacts_s):
        is_own = may_begin & (collision == number)
        rows = np.flatnonzero(is_own & (kind == HIT))
        for row in rows[::-1]:  # the first hit overwrites later ones
            begins = (low[row] < at) & (at <= high[row])
            lead_s[number, begins] = contact_s - signal.time_s[row]
        at_contact[number] = (count(is_own & (kind == AT_CONTACT)) > 0) & np.isnan(lead_s[number])
    n_early = count(may_begin & (kind == EARLY))
    n_false = count(may_begin & (kind == FALSE)) + n_early
    sides = peaks(signal, n_sp, horizon_s)
    return Tally(lead_s, at_contact, n_false, n_early, signal.minutes, *sides)


def alarms(
    signal: Signal, n_sp: int, threshold: float, horizon_s: float = HORIZON_S
) -> list[tuple[int, int]]:
    """Row and kind of every alarm at one threshold, in order."""
    low, high = onset_thresholds(signal, n_sp)
    kind, _ = kinds(signal, horizon_s)
    return [
        (int(row), int(kind[row]))
        for row in np.flatnonzero((low < threshold) & (threshold <= high))
    ]


def peaks(signal: Signal, n_sp: int, horizon_s: float = HORIZON_S) -> tuple[Series, Series]:
    """The peak of the sustained strength within each horizon, and in windows outside of them.

    Returns
    -------
    inside : ndarray, shape (collisions,)
        One value per collision; -inf if the video starts too late for the model to respond.
    outside : ndarray, shape (m,)
        One value per window. Windows are as long as the horizon, and are laid backwards from the
        first horizon, or from the end of a video without a collision. A remainder of at least half
        a window counts, too.
    """
    strongest = signal.sustained(n_sp)
    kind, collision = kinds(signal, horizon_s)
    inside = [
        np.max(strongest[(kind == HIT) & (collision == number)], initial=-np.inf)
        for number in range(len(signal.contacts_s))
    ]
    start_s, outside = float(signal.time_s[0]), []
    end_s = start_s + 60.0 * signal.minutes - (horizon_s if signal.contacts_s else 0.0)
    while end_s - start_s >= horizon_s / 2:
        is_in = (signal.time_s >= end_s - horizon_s) & (signal.time_s < end_s - ROUNDING_S)
        if is_in.any():
            outside.append(strongest[is_in].max())
        end_s -= horizon_s
    return np.array(inside), np.array(outside)
