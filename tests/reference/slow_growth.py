"""The growth of tracked points, their mean over time, and the window ahead, as loops in float64."""

import math

TAU_S, ERROR, LEAST_WEIGHT = 0.12, 0.2, 1e-4


def median(values):
    """The middle value; of an even number of values, the mean of the two in the middle."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2.0


def normal_equations(points, moves, weights):
    """Shift x and y at the origin, growth and turn of least squares, by Gauss's elimination.

    A point (x, y) moves by (a + g x - r y, b + g y + r x).
    """
    table = [[0.0] * 5 for _ in range(4)]
    for (x, y), (dx, dy), weight in zip(points, moves, weights, strict=True):
        for row, moved in (((1.0, 0.0, x, -y), dx), ((0.0, 1.0, y, x), dy)):
            for i in range(4):
                for j in range(4):
                    table[i][j] += weight * row[i] * row[j]
                table[i][4] += weight * row[i] * moved
    for k in range(4):
        pivot = max(range(k, 4), key=lambda i: abs(table[i][k]))
        table[k], table[pivot] = table[pivot], table[k]
        for i in range(4):
            if i != k:
                share = table[i][k] / table[k][k]
                table[i] = [
                    one - share * other for one, other in zip(table[i], table[k], strict=True)
                ]
    return [table[k][4] / table[k][k] for k in range(4)]


def fitted(points, there, *, n_steps, residuals, least_px, overlap):
    """Growth, its standard error, the shift of the mean of the points, x and y; the weights."""
    points = [(float(x), float(y)) for x, y in points]
    moves = [(float(x) - a, float(y) - b) for (x, y), (a, b) in zip(there, points, strict=True)]
    weights = [1.0] * len(points)
    for _ in range(n_steps):
        a, b, growth, turn = normal_equations(points, moves, weights)
        total = sum(weights)
        middle_x = sum(w * x for w, (x, _) in zip(weights, points, strict=True)) / total
        middle_y = sum(w * y for w, (_, y) in zip(weights, points, strict=True)) / total
        moment, rest = 0.0, []
        for w, (x, y), (dx, dy) in zip(weights, points, moves, strict=True):
            moment += w * ((x - middle_x) ** 2 + (y - middle_y) ** 2)
            left_x, left_y = dx - a - growth * x + turn * y, dy - b - growth * y - turn * x
            rest.append(math.hypot(left_x, left_y))
        scale = residuals * median(rest) + least_px
        weights = [1.0 / (1.0 + (one / scale) ** 2) for one in rest]
    squares = sum((w * one) ** 2 for w, one in zip(weights, rest, strict=True))
    error = overlap * math.sqrt(squares / (2.0 * sum(weights) * moment))
    mean_x = sum(x for x, _ in points) / len(points)
    mean_y = sum(y for _, y in points) / len(points)
    shift_x, shift_y = a + growth * mean_x - turn * mean_y, b + growth * mean_y + turn * mean_x
    return growth, error, shift_x, shift_y, weights


def line(places, moves, weights):
    """The slope of a straight line through moves over places, by weighted least squares."""
    total = sum(weights)
    middle = sum(w * p for w, p in zip(weights, places, strict=True)) / total
    pairs = list(zip(places, moves, weights, strict=True))
    moment = sum(w * (p - middle) ** 2 for p, _, w in pairs)
    return sum(w * (p - middle) * m for p, m, w in pairs) / moment


def upright(points, there, weights):
    """Twice the growth across less the growth down, each weighted from row to row alike."""
    xs, ys = [float(x) for x, _ in points], [float(y) for _, y in points]
    us = [float(x) - a for (x, _), a in zip(there, xs, strict=True)]
    vs = [float(y) - b for (_, y), b in zip(there, ys, strict=True)]
    middle = sum(w * y for w, y in zip(weights, ys, strict=True)) / sum(weights)
    rows, across, shares = sorted(set(ys)), [], []
    for y in rows:
        at = [k for k in range(len(ys)) if ys[k] == y]
        across.append(line([xs[k] for k in at], [us[k] for k in at], [weights[k] for k in at]))
        below = [k for k in range(len(ys)) if ys[k] > y]
        shares.append(sum(weights[k] * (ys[k] - middle) for k in below))
    total = mean = 0.0
    for k in range(len(rows) - 1):  # from one row to the next, the mean of the growths of both
        share = shares[k] * (rows[k + 1] - rows[k])
        total += share
        mean += share * (across[k] + across[k + 1]) / 2.0
    return 2.0 * mean / total - line(ys, vs, weights)


def middles(width, height, n_across):
    """The middles of cells that cover an image, `n_across` in a row; those near its edge, not."""
    n_down = round(n_across * height / width)
    across, down = width / n_across, height / n_down
    return [
        ((j + 0.5) * across - 0.5, (i + 0.5) * down - 0.5)
        for i in range(n_down)
        for j in range(n_across)
    ]


def approach(points, there, found, texture, n_across, *, n_steps, residuals, least_px, overlap):
    """Growth of what leaves the background, less its error, and its middle; all points are given.

    Points count in rows of `n_across`. The growth is 0 if nothing approaches.
    """
    nothing = 0.0, (math.nan, math.nan)
    numbers = [k for k in range(len(points)) if found[k]]
    least = 0.3 * sum(float(texture[k]) for k in numbers) / len(numbers)
    numbers = [k for k in numbers if texture[k] >= least]
    z = {k: complex(*map(float, points[k])) for k in numbers}
    moves = {k: complex(*map(float, there[k])) - z[k] for k in numbers}
    weights = dict.fromkeys(numbers, 1.0)
    for _ in range(n_steps):
        pairs = (
            [(z[k].real, z[k].imag) for k in numbers],
            [(m.real, m.imag) for m in moves.values()],
        )
        a, b, grown, turn = normal_equations(*pairs, weights.values())
        left = {k: moves[k] - complex(a, b) - complex(grown, turn) * z[k] for k in numbers}
        scale = residuals * median([abs(one) for one in left.values()]) + least_px
        weights = {k: 1.0 / (1.0 + (abs(left[k]) / scale) ** 2) for k in numbers}
    apart = {k for k in numbers if abs(left[k]) > 2.0 * scale}
    groups, rest = [], set(apart)
    while rest:
        group, edge = set(), {min(rest)}
        while edge:
            group |= edge
            edge = {
                k
                for k in rest - group
                for one in edge
                if abs(k // n_across - one // n_across) <= 1
                and abs(k % n_across - one % n_across) <= 1
            }
        groups.append(group)
        rest -= group
    group = max(groups, key=len, default=set())
    if scale > 0.5 or abs(grown) > 0.01 or len(group) < 4 or len(group) < 0.6 * len(apart):
        return nothing
    middle, move = (sum(one[k] for k in group) / len(group) for one in (z, left))
    moment = sum(abs(z[k] - middle) ** 2 for k in group)
    slope = sum((z[k] - middle).conjugate() * (left[k] - move) for k in group) / moment
    squares = sum(abs(left[k] - move - slope * (z[k] - middle)) ** 2 for k in group)
    rate = slope.real - math.sqrt(squares / (2 * (len(group) - 2) * moment))
    if abs(move) >= rate * math.sqrt(moment / len(group)):
        return nothing
    at = sum(z[k] + moves[k] for k in group) / len(group)
    return 1.25 * rate, (at.real, at.imag)


def mean_of(rates, errors, intervals_s):
    """The mean rate after the last of some intervals, and its quality: sums over all of them."""
    weight = total = 0.0
    for k, (rate, error) in enumerate(zip(rates, errors, strict=True)):
        if math.isnan(rate):
            continue
        age_s = sum(intervals_s[k + 1 :])
        newest = 1.0 - math.exp(-intervals_s[k] / TAU_S)
        one = newest * math.exp(-age_s / TAU_S) * ERROR**2 / (ERROR**2 + error**2)
        weight += one
        total += one * rate
    return (total / weight if weight > LEAST_WEIGHT else math.nan), weight


def window(width, height, fov_deg, right_deg, up_deg):
    """Edges of the window in px, a pinhole's: left, top, right, bottom; the first pixel is at 0."""
    focal = width / 2.0 / math.tan(math.radians(fov_deg / 2.0))
    x, y = (width - 1) / 2, (height - 1) / 2
    left, right = (x + focal * math.tan(math.radians(right_deg + side)) for side in (-10, 10))
    top, bottom = (y + focal * math.tan(math.radians(side - up_deg)) for side in (-10, 16))
    return left, top, right, bottom


def places(edges, n):
    """n x n points from edge to edge, row by row."""
    left, top, right, bottom = edges
    found = []
    for i in range(n):
        for j in range(n):
            x, y = left + (right - left) * j / (n - 1), top + (bottom - top) * i / (n - 1)
            found.append((x, y))
    return found
