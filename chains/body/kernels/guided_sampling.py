"""Loops over poses and the places in the picture towards which some of them are drawn."""

import numpy as np

from ....models.numerics.compiled import compiled


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
