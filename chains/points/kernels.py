"""Nearest descriptors, and features of many pictures joined into tracks."""

import numpy as np

from ...models.numerics.compiled import compiled


@compiled
def best_and_second(likeness):
    """Column of the largest value of each row of `likeness` (n, m), that value, and the second largest."""
    n = likeness.shape[0]
    nearest = np.zeros(n, np.int64)
    best, second = np.zeros(n, np.float32), np.zeros(n, np.float32)
    for i in range(n):
        row = likeness[i]
        first, after, place = np.float32(-1), np.float32(-1), 0
        for j in range(row.shape[0]):
            value = row[j]
            if value > after:
                if value > first:
                    after, first, place = first, value, j
                else:
                    after = value
        nearest[i], best[i], second[i] = place, first, after
    return nearest, best, second


@compiled
def keep_near(likeness, lines, middle, reach, positions, tolerance):
    """Set `likeness` (n, m) to 0 but where `positions` (m, 2) are near.

    That is within `tolerance` from the line (n, 3), of which the normal has length 1, and within `reach` (n,)
    from `middle` (n, 2).
    """
    for i in range(likeness.shape[0]):
        a, b, c = lines[i, 0], lines[i, 1], lines[i, 2]
        for j in range(likeness.shape[1]):
            x, y = positions[j, 0], positions[j, 1]
            off = abs(a * x + b * y + c)
            square = (x - middle[i, 0]) ** 2 + (y - middle[i, 1]) ** 2
            if off > tolerance or square > reach[i] ** 2:
                likeness[i, j] = np.float32(0)


@compiled
def join_matches(matches, frame, n_frames):
    """Track of each of the features, of which `frame` (n,) tells in which of the pictures they are.

    Matches (m, 2), the surest first, join tracks, but never two that have a picture in common. Members of a
    track are a ring: `after` is the next one.
    """
    n = frame.shape[0]
    track, after, length = np.arange(n), np.arange(n), np.ones(n, np.int64)
    stamp = np.full(n_frames, -1)
    for number in range(matches.shape[0]):
        one, other = track[matches[number, 0]], track[matches[number, 1]]
        if one == other:
            continue
        if length[one] < length[other]:
            one, other = other, one
        member = one
        for _ in range(length[one]):
            stamp[frame[member]] = number
            member = after[member]
        member, apart = other, True
        for _ in range(length[other]):
            apart = apart and stamp[frame[member]] != number
            member = after[member]
        if apart:
            for _ in range(length[other]):
                track[member] = one
                member = after[member]
            after[one], after[other] = after[other], after[one]
            length[one] += length[other]
    return track
