"""The expansion rate and the time to contact as nested loops in float64."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from reference.slow import total


@dataclass
class Answer:
    """The rates of a frame, in 1/s: ahead, and of what approaches a camera at rest.

    `part` is what the former explains of the change ahead; `is_even` is whether nothing changes.
    """

    ahead: float = math.nan
    beside: float = 0.0
    part: float = 0.0
    is_even: bool = False
    shift: tuple[int, int] = (0, 0)

    @property
    def factor(self):
        """How much of the object ahead is seen, at least half."""
        return max(self.part, 0.5)

    @property
    def is_beside(self):
        """Whether the second rate means less time than the first."""
        return self.beside >= 0.1 and self.factor * self.beside > self.ahead

    @property
    def rate(self):
        return self.beside if self.is_beside else self.ahead

    @property
    def ttc_s(self):
        if self.is_beside:
            return 1 / self.beside
        return self.factor / self.ahead if self.ahead >= 0.1 and not self.is_even else math.nan


def blocks_of(frame):
    """Means over blocks of 4 x 4 cells."""
    height, width = (side // 4 for side in frame.shape)
    means = np.zeros((height, width))
    for i, j in np.ndindex(height, width):
        means[i, j] = total(frame[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]) / 16
    return means


def shift_between(frame, before, last, most):
    """The shift of the picture: in blocks, by descent, and in cells, between the blocks."""
    now, then = blocks_of(frame), blocks_of(before)
    limits = [min(most // 4, side // 3) for side in now.shape]
    if min(limits) == 0:
        return (0, 0), (0, 0)
    change = partial(mean_change, now, then)
    best = last if change(*last) < change(0, 0) else (0, 0)
    while True:
        found = best
        for i in (best[0] - 1, best[0], best[0] + 1):
            for j in (best[1] - 1, best[1], best[1] + 1):
                inside = abs(i) <= limits[0] and abs(j) <= limits[1]
                if inside and change(i, j) < change(*found):
                    found = i, j
        if found == best:
            break
        best = found
    fine = [4 * (place - b) for b, place in zip(best, between(change, *best), strict=True)]
    cells = [4 * b + math.floor(part + 0.5 + 1e-9) for b, part in zip(best, fine, strict=True)]
    return best, tuple(cells)


def between(change, i, j):
    """Where the least change is, at most half a block from (i, j)."""
    sides = ((change(i - 1, j), change(i + 1, j)), (change(i, j - 1), change(i, j + 1)))
    places = []
    for blocks, (less, more) in zip((i, j), sides, strict=True):
        rise = max(less, more) - change(i, j)
        part = (less - more) / (2 * rise) if change(i, j) > 0 and 0 < rise < math.inf else 0.0
        places.append(blocks + min(max(part, -0.5), 0.5))
    return places


def reduced(frame):
    """Means over blocks, so that 120 columns or more remain, then over 3 x 3: whole levels."""
    n = max(1, frame.shape[1] // 120)
    blocks = np.zeros([side // n for side in frame.shape])
    for i, j in np.ndindex(blocks.shape):
        blocks[i, j] = total(frame[n * i : n * i + n, n * j : n * j + n]) / n**2 * 255
    means, (height, width) = np.zeros(blocks.shape), blocks.shape
    for i, j in np.ndindex(blocks.shape):
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                near = min(max(i + di, 0), height - 1), min(max(j + dj, 0), width - 1)
                means[i, j] += blocks[near] / 9
    return np.floor(means + 0.5001)


def motion_of(now, then, rows, columns, start):
    """Shift down and right, growth along both, and what the growth explains of the change.

    Of a part of a picture, by two Newton steps. The last number is NaN if nothing changes.
    """
    v, u, b, a = *start, 0.0, 0.0
    height, width = now.shape
    mid_i, mid_j = (rows[0] + rows[1] - 1) / 2, (columns[0] + columns[1] - 1) / 2
    for _ in range(2):
        found = []
        for i in range(*rows):
            for j in range(*columns):
                y, x = i - mid_i, j - mid_j
                at_i, at_j = i + v + b * y, j + u + a * x
                if not (0 <= at_i < height - 1 and 0 <= at_j < width - 1):
                    continue
                near_i, near_j = int(at_i), int(at_j)
                down, right = at_i - near_i, at_j - near_j
                upper = (1 - right) * now[near_i, near_j] + right * now[near_i, near_j + 1]
                lower = (1 - right) * now[near_i + 1, near_j] + right * now[near_i + 1, near_j + 1]
                around = then[i - 1 : i + 2, j - 1 : j + 2]
                across, along = np.array([1, 2, 1]) / 8, np.array([-1, 0, 1])
                g_y, g_x = along @ around @ across, across @ around @ along
                rest = then[i, j] - (1 - down) * upper - down * lower
                found.append((rest, np.array([g_y, g_x, g_y * y, g_x * x])))
        if 4 * len(found) < (rows[1] - rows[0]) * (columns[1] - columns[0]):
            return 0.0, 0.0, 0.0, 0.0, math.nan
        scale = 1.5 * sum(abs(rest) for rest, _ in found) / len(found) + 1
        matrix, right_side = np.zeros((4, 4)), np.zeros(4)
        for rest, slope in found:
            weight = 1 / (1 + (rest / scale) ** 2)
            matrix += weight * np.outer(slope, slope)
            right_side += weight * rest * slope
        matrix += np.diag(1e-6 * np.diag(matrix) + [1e-3, 1e-3, 0.1, 0.1])
        step = np.linalg.inv(matrix) @ right_side
        v, u, b, a = np.array([v, u, b, a]) + step
    left = by_growth = 0.0
    for rest, slope in found:
        weight = 1 / (1 + (rest / scale) ** 2)
        left += weight * (rest - slope @ step) ** 2
        by_growth += weight * (slope[2] * b + slope[3] * a) ** 2
    nothing = left + by_growth < 0.01 * len(found)
    part = math.nan if nothing else 1 - math.sqrt(left / (left + by_growth))
    return v, u, b, a, part


def growth_ahead(now, then, start):
    """Growth of the square in the middle, and what it explains of the change there."""
    half = min(now.shape) // 2
    rows, columns = (((side - half) // 2, (side - half) // 2 + half) for side in now.shape)
    *_, b, a, part = motion_of(now, then, rows, columns, start)
    return min(a, b) - 0.25 * abs(a - b), part


def growth_beside(now, then):
    """Growth of what moves before a still camera, about a point inside it; else 0."""
    change, half = abs(now - then), min(now.shape) // 2
    above = np.maximum(change - 3 - change.mean(), 0)
    mass = total(above)
    if mass < 0.19 * above.size or (above > 0).sum() > 0.4 * above.size:
        return 0.0
    windows, reaches = [], []
    for axis, side in enumerate(now.shape):
        places = np.indices(now.shape)[axis]
        middle = total(above * places) / mass
        spread = math.sqrt(total(above * (places - middle) ** 2) / mass)
        if spread > 0.9 * half:
            return 0.0
        reach = math.floor(min(max(1.6 * spread, 6), half / 2) + 0.5)
        at = min(max(math.floor(middle + 0.5), reach + 1), side - 2 - reach)
        windows.append((at - reach, at + reach + 1))
        reaches.append(reach)
    v, u, b, a, _ = motion_of(now, then, *windows, (0.0, 0.0))
    passes = abs(v) >= b * reaches[0] or abs(u) >= a * reaches[1]
    return 0.0 if passes else max(min(a, b), 0.0)


def moved(image, dy, dx, entering):
    """The image moved down and right; `entering` where it does not reach."""
    result = entering.astype(float)
    for i, j in np.ndindex(image.shape):
        if 0 <= i - dy < image.shape[0] and 0 <= j - dx < image.shape[1]:
            result[i, j] = image[i - dy, j - dx]
    return result


def mean_change(frame, before, dy, dx):
    """Mean change over the cells that the moved picture covers."""
    other = moved(before, dy, dx, entering=np.full(frame.shape, np.nan))
    covered = [abs(a - b) for a, b in zip(frame.flat, other.flat, strict=True) if b == b]
    return sum(covered) / len(covered)


def within(rate, usual):
    """A rate per second within its limits; the upper one is further off if the usual rate is."""
    return min(max(rate, -2.5), 2.5 + 2 * max(usual, 0.0))


def run(frames, times=None):
    """One `Answer` for every image, none of which flickers; `times` are theirs, in seconds."""
    times = [t / 30 for t in range(len(frames))] if times is None else times
    answers, blocks, ahead, beside, part = [Answer()], (0, 0), 0.0, 0.0, 0.0
    height, width = frames[0].shape
    n, most = max(1, width // 120), 4 * max(1, math.floor(4 * width / 240 + 0.5))
    for t in range(1, len(frames)):
        frame, before = (frames[k].astype(float) for k in (t, t - 1))
        seconds = times[t] - times[t - 1]
        if min(height, width) // n < 20:
            answers.append(Answer())
            continue
        blocks, cells = shift_between(frame, before, blocks, most)
        now, then = reduced(frame), reduced(before)
        growth, newest = growth_ahead(now, then, [c / n for c in cells])
        share = 1 - math.exp(-seconds / 0.1)
        part += 0.0 if math.isnan(newest) else share * (newest - part)
        ahead += share * (within(growth / seconds, ahead) - ahead)
        growth = growth_beside(now, then) if blocks == (0, 0) else 0.0
        beside += (1 - math.exp(-2 * seconds / 0.1)) * (within(growth / seconds, beside) - beside)
        answers.append(Answer(ahead, beside, part, math.isnan(newest), cells))
    return answers
