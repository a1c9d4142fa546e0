"""Compiled loops over poses in time: densities of the dynamics, guided draws, strata."""

import numpy as np

from ....models.numerics.compiled import compiled, exponential, inlined

_f4 = np.float32


@compiled
def _squares_to_rows(point, rows, squares):
    """Squared distances `(k,)` of a point `(d,)` to rows `(d, k)`, axis after axis for vector units."""
    squares[:] = _f4(0.0)
    for axis in range(len(rows)):
        place, row = point[axis], rows[axis]
        for j in range(len(squares)):
            step = place - row[j]
            squares[j] += step * step


@compiled
def least_squares_to_rows(points, rows, least):
    """For each point `(n, d)` the least squared distance to any row `(d, k)`, filled into `least`."""
    squares = np.empty(rows.shape[1], np.float32)
    for i in range(len(points)):
        _squares_to_rows(points[i], rows, squares)
        best = _f4(3e38)
        for j in range(len(squares)):
            best = min(best, squares[j])
        least[i] = best


@compiled
def _products_to_row(i, body, ancestors, nearest, arms, ancestor_arms, weights, concentrations, floors, row):
    """For pose i, fill `row` `(k,)` with weight, Gaussian of the body's place and kernels of both arms."""
    upper, fore = concentrations[0], concentrations[1]
    a0, a1, a2 = arms[i, 0], arms[i, 1], arms[i, 2]
    a3, a4, a5 = arms[i, 3], arms[i, 4], arms[i, 5]
    b0, b1, b2 = arms[i, 6], arms[i, 7], arms[i, 8]
    b3, b4, b5 = arms[i, 9], arms[i, 10], arms[i, 11]
    floor, floor_2 = floors[i, 0], floors[i, 1]
    _squares_to_rows(body[i], ancestors, row)
    for j in range(len(row)):
        place = exponential(_f4(-0.5) * (row[j] - nearest))
        left = upper * (
            a0 * ancestor_arms[0, j] + a1 * ancestor_arms[1, j] + a2 * ancestor_arms[2, j] - _f4(1.0)
        ) + fore * (a3 * ancestor_arms[3, j] + a4 * ancestor_arms[4, j] + a5 * ancestor_arms[5, j] - _f4(1.0))
        right = upper * (
            b0 * ancestor_arms[6, j] + b1 * ancestor_arms[7, j] + b2 * ancestor_arms[8, j] - _f4(1.0)
        ) + fore * (
            b3 * ancestor_arms[9, j] + b4 * ancestor_arms[10, j] + b5 * ancestor_arms[11, j] - _f4(1.0)
        )
        one = exponential(min(left, _f4(0.0))) + floor
        other = exponential(min(right, _f4(0.0))) + floor_2
        row[j] = weights[j] * place * one * other


@compiled
def mixture_values(body, ancestors, least, arms, ancestor_arms, weights, concentrations, floors, values):
    """Sum over ancestors of weight, Gaussian of the body's place and the kernels of both arms.

    Parameters
    ----------
    body, ancestors
        `(n, d)`, `(d, k)`: what moves like a Gaussian, in units in which half the squared distance is the
        exponent.
    least
        `(n,)`: smallest squared distance of each; exponents are taken relative to it.
    arms, ancestor_arms
        `(n, 12)`, `(12, k)`: unit vectors, left upper arm, left forearm, right upper arm, right forearm.
    weights
        `(k,)` of the ancestors.
    concentrations
        `(2,)` of von Mises and Fisher's density, of upper arms and forearms.
    floors
        `(n, 2)`: density of an arm that jumped, by the peak of that of one that did not.
    values
        `(n,)` filled in.
    """
    row = np.empty(ancestors.shape[1], np.float32)
    for i in range(len(body)):
        _products_to_row(
            i, body, ancestors, least[i], arms, ancestor_arms, weights, concentrations, floors, row
        )
        total = _f4(0.0)
        for j in range(len(row)):
            total += row[j]
        values[i] = total


@compiled
def draw_terms(body, ancestors, least, arms, ancestor_arms, weights, concentrations, floors, points, chosen):
    """For each pose draw a term of the sum of `mixture_values` in proportion to its value.

    Parameters
    ----------
    points
        `(n,)`, evenly drawn from 0 to 1.
    chosen
        `(n,)` indices, filled in; all others as of `mixture_values`.
    """
    row = np.empty(ancestors.shape[1], np.float32)
    for i in range(len(body)):
        _products_to_row(
            i, body, ancestors, least[i], arms, ancestor_arms, weights, concentrations, floors, row
        )
        total = 0.0
        for j in range(len(row)):
            total += row[j]
        rest = points[i] * total
        last = 0
        for j in range(len(row)):
            if row[j] > _f4(0.0):
                last = j
                rest -= row[j]
                if rest < 0.0:
                    break
        chosen[i] = last


@compiled
def closeness_to(hands, sides, means, precisions, least, choice, closeness):
    """By how much more readily each pose is chosen for a target.

    Parameters
    ----------
    hands
        `(n, 2, 2)` px: left and right.
    sides, means, precisions
        `(k,)`, `(k, 2)`, `(k, 2, 2)` of the targets and of how far away hands may be.
    least
        how readily one is chosen that is anywhere, over one that is there.
    choice
        `(n,)`: probabilities with which poses are chosen without a target.
    closeness
        `(k, n)` written, with means of 1 under `choice`.
    """
    for k in range(len(sides)):
        side = sides[k]
        x0, y0, total = means[k, 0], means[k, 1], 0.0
        xx, xy, yy = precisions[k, 0, 0], precisions[k, 0, 1], precisions[k, 1, 1]
        for i in range(len(hands)):
            x, y = hands[i, side, 0] - x0, hands[i, side, 1] - y0
            near = np.exp(-0.5 * (xx * x * x + 2 * xy * x * y + yy * y * y)) + least
            closeness[k, i] = near
            total += choice[i] * near
        for i in range(len(hands)):
            closeness[k, i] /= total


@compiled
def choose(choice, closeness, counts, shifts, chosen):
    """Draw poses for each target by systematic resampling, and at last some for none.

    Parameters
    ----------
    choice, closeness
        `(n,)`, `(k, n)` as of `closeness_to`.
    counts, shifts
        `(k + 1,)`: how many are drawn, and numbers from 0 to 1 that say where their steps begin.
    chosen
        `(sum of counts,)` indices, written.
    """
    n, place = len(choice), 0
    for k in range(len(counts)):
        total = 0.0
        for i in range(n):
            total += choice[i] * closeness[k, i] if k < len(closeness) else choice[i]
        step = total / max(counts[k], 1)
        wanted, so_far, end = shifts[k] * step, 0.0, place + counts[k]
        for i in range(n):
            so_far += choice[i] * closeness[k, i] if k < len(closeness) else choice[i]
            while place < end and wanted < so_far:
                chosen[place] = i
                place += 1
                wanted += step
        while place < end:  # sums are not exact
            chosen[place] = n - 1
            place += 1


@compiled
def guided_values(hands, chosen, walks, completions, sides, means, precisions, heights, closeness, values):
    """Log densities of poses some of which were drawn with a hand at a target, given their ancestors.

    Parameters
    ----------
    hands
        `(n, 2, 2)` px: left and right.
    chosen
        `(n,)` of the ancestors.
    walks, completions
        `(n, 2)` nats of each arm: its density if the dynamics moved it, and that of all but its hand's place
        if it was put in place.
    sides, means, precisions
        `(k,)`, `(k, 2)`, `(k, 2, 2)` of the targets.
    heights
        `(k + 1,)`: share of the draws times peak of the density; at last the share of those without target.
    closeness
        `(k, n_ancestors)` as of `closeness_to`.
    values
        `(n,)` filled in.
    """
    n = len(hands)
    totals, limits = np.empty(n), np.empty(n)
    gains, xs, ys = np.empty((2, n)), np.empty((2, n)), np.empty((2, n))
    for i in range(n):
        left, right = completions[i, 0] - walks[i, 0], completions[i, 1] - walks[i, 1]
        peak = max(max(left, right), 0.0)
        totals[i] = heights[len(sides)] * np.exp(-peak)
        gains[0, i], gains[1, i] = np.exp(left - peak), np.exp(right - peak)
        limits[i] = 2.0 * peak + 90.0  # of farther ones all digits are lost
        xs[0, i], ys[0, i], xs[1, i], ys[1, i] = (
            hands[i, 0, 0],
            hands[i, 0, 1],
            hands[i, 1, 0],
            hands[i, 1, 1],
        )
    for k in range(len(sides)):
        side, x0, y0 = sides[k], means[k, 0], means[k, 1]
        xx, xy, yy = precisions[k, 0, 0], precisions[k, 0, 1], precisions[k, 1, 1]
        for i in range(n):
            x, y = xs[side, i] - x0, ys[side, i] - y0
            square = xx * x * x + 2 * xy * x * y + yy * y * y
            if square < limits[i]:
                totals[i] += gains[side, i] * heights[k] * closeness[k, chosen[i]] * np.exp(-0.5 * square)
    for i in range(n):
        values[i] = 0.5 * limits[i] - 45.0 + np.log(totals[i]) + walks[i, 0] + walks[i, 1]


@inlined
def _spread(points, order, first, end, variances):
    """Write into `variances` `(d,)` those of the points `order[first]` to before `order[end]`."""
    count = end - first
    for axis in range(points.shape[1]):
        mean = 0.0
        for k in range(first, end):
            mean += points[order[k], axis]
        mean /= count
        total = 0.0
        for k in range(first, end):
            step = points[order[k], axis] - mean
            total += step * step
        variances[axis] = total / count


@compiled
def cut(points, narrow, most, rounds, numbers):
    """Cut points in two, again and again, where and along which axis they are widest.

    Parameters
    ----------
    points
        `(n, d)`.
    narrow
        variance along an axis below which nothing is cut.
    most
        pieces.
    rounds
        in which the middle between two halves is found, each of which is nearer to its own mean.
    numbers
        `(n,)` int64 written: the piece of each point.
    """
    n, d = points.shape
    order, kept = np.arange(n), np.empty(n, np.int64)
    firsts, ends = np.zeros(most, np.int64), np.zeros(most, np.int64)
    variances = np.zeros((most, d))
    ends[0], count = n, 1
    numbers[:] = 0
    if n > 1:
        _spread(points, order, 0, n, variances[0])
    while count < most:
        widest, axis = 0, 0
        for piece in range(count):
            for k in range(d):
                if variances[piece, k] > variances[widest, axis]:
                    widest, axis = piece, k
        if variances[widest, axis] < narrow:
            break
        first, end = firsts[widest], ends[widest]
        middle = 0.0
        for k in range(first, end):
            middle += points[order[k], axis]
        middle /= end - first
        for _ in range(rounds):
            above, below, n_above = 0.0, 0.0, 0
            for k in range(first, end):
                value = points[order[k], axis]
                if value > middle:
                    above, n_above = above + value, n_above + 1
                else:
                    below += value
            middle = 0.5 * (above / n_above + below / (end - first - n_above))
        split, n_above = first, 0
        for k in range(first, end):
            point = order[k]
            if points[point, axis] > middle:
                kept[n_above] = point
                numbers[point] = count
                n_above += 1
            else:
                order[split] = point
                split += 1
        for k in range(n_above):
            order[split + k] = kept[k]
        ends[widest], firsts[count], ends[count] = split, split, end
        _spread(points, order, first, split, variances[widest])
        _spread(points, order, split, end, variances[count])
        count += 1
