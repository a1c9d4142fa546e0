"""Damped Newton steps of many experts at once, each from its own pose."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled

Array = NDArray[np.float64]

NOWHERE = 1e300
"""Energy of a pose in which nothing faces the viewer."""

SLIGHTEST = 1e-12
"""Least pivot of a scaled curvature, which rounding may have made singular."""


class PoseArrays(NamedTuple):
    """The parts of `Poses`."""

    rotations: Array
    translations: Array
    morphs: Array


class Belief(NamedTuple):
    """Minus the log of beliefs at tried poses, but for the prior.

    `energy` `(m,)`, `gradient` `(m, dimension)`, `curvature` `(m, dimension, dimension)`; `seen` `(m,)`:
    whether anything faces the viewer; `rows` `(m, n_vertices, 2, width)` float32: how vertices move with it.
    """

    energy: Array
    gradient: Array
    curvature: Array
    seen: NDArray[np.bool_]
    rows: NDArray[np.float32]


class Climb(NamedTuple):
    """Where experts are: the best pose of each until now, and its belief there, prior included."""

    poses: PoseArrays
    energy: Array
    gradient: Array
    curvature: Array
    rows: NDArray[np.float32]
    damping: Array


class Pace(NamedTuple):
    """px that a vertex may move in a step, and must for a step to be made; whether this is the first look at
    a level, which is taken as it is."""

    longest: float
    shortest: float
    first: bool


@compiled
def advance(active, tried, belief, prior, precision, climb, pace, going, following):
    """Take the poses that were `tried` for experts `active` if they are better, and step on.

    `prior` are the expected poses of all experts, of `precision` `(dimension,)`. Writes `climb`, the experts
    that are `going` on and, in the same order, the poses `following`, of which it gives the number.
    """
    dimension, width = len(precision), belief.rows.shape[3]
    change, step = np.empty(dimension), np.zeros(width, np.float32)
    lower, solved = np.empty((dimension, dimension)), np.empty(dimension)
    n_going = 0
    for m in range(len(active)):
        d = active[m]
        _change(tried, m, prior, d, change)
        energy = belief.energy[m]
        for i in range(dimension):
            energy += 0.5 * precision[i] * change[i] * change[i]
        if not belief.seen[m]:
            energy = NOWHERE
        if pace.first or energy < climb.energy[d]:
            climb.energy[d] = energy
            for i in range(dimension):
                climb.gradient[d, i] = belief.gradient[m, i] + precision[i] * change[i]
                climb.curvature[d, i] = belief.curvature[m, i]
                climb.curvature[d, i, i] += precision[i]
            climb.rows[d] = belief.rows[m]
            climb.poses.rotations[d] = tried.rotations[m]
            climb.poses.translations[d] = tried.translations[m]
            climb.poses.morphs[d] = tried.morphs[m]
            if not pace.first:
                climb.damping[d] *= 0.3
        else:
            climb.damping[d] *= 10.0
        _solve(climb.curvature[d], climb.gradient[d], climb.damping[d], lower, solved)
        for i in range(dimension):
            step[i] = solved[i]
        longest = np.float32(0)
        rows = climb.rows[d]
        for v in range(len(rows)):
            x = y = np.float32(0)
            for i in range(width):
                x += rows[v, 0, i] * step[i]
                y += rows[v, 1, i] * step[i]
            longest = max(longest, x * x + y * y)
        length = np.sqrt(np.float64(longest))
        if length <= pace.shortest:
            continue
        share = -min(1.0, pace.longest / length)
        for i in range(dimension):
            change[i] = share * solved[i]
        going[n_going] = d
        _move(climb.poses, d, change, following, n_going)
        n_going += 1
    return n_going


@compiled
def _solve(curvature, gradient, damping, lower, solution):
    """Solve (H + damping diag H) x = g in columns of like scale (radians stand beside px), by Cholesky."""
    n = len(gradient)
    scale = np.empty(n)
    for i in range(n):
        scale[i] = 1 / np.sqrt(curvature[i, i])
        for j in range(i + 1):
            entry = curvature[i, j] * scale[i] * scale[j]
            if i == j:
                entry += damping
            for k in range(j):
                entry -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = 1 / np.sqrt(max(entry, SLIGHTEST))  # its inverse
            else:
                lower[i, j] = entry * lower[j, j]
    for i in range(n):
        right = gradient[i] * scale[i]
        for k in range(i):
            right -= lower[i, k] * solution[k]
        solution[i] = right * lower[i, i]
    for i in range(n - 1, -1, -1):
        right = solution[i]
        for k in range(i + 1, n):
            right -= lower[k, i] * solution[k]
        solution[i] = right * lower[i, i]
    for i in range(n):
        solution[i] *= scale[i]


@compiled
def _change(poses, m, other, d, change):
    """The change that leads from pose d of `other` to pose m, as of `Poses.changes_from`."""
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += poses.rotations[m, i, k] * other.rotations[d, j, k]
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine = 0.5 * np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1)
    angle = np.arctan2(sine, cosine)
    # nearly half round the sine fades, but no search goes there in a step
    share = 0.5 * angle / sine if sine > 1e-9 else 0.5
    change[0], change[1], change[2] = share * x, share * y, share * z
    for i in range(2):
        change[3 + i] = poses.translations[m, i] - other.translations[d, i]
    for i in range(len(change) - 5):
        change[5 + i] = poses.morphs[m, i] - other.morphs[d, i]


@compiled
def _move(poses, d, change, moved, m):
    """Pose m of `moved` is pose d changed, as of `Poses.moved`."""
    x, y, z = change[0], change[1], change[2]
    angle = np.sqrt(x * x + y * y + z * z)
    sine, cosine = 1.0, 0.5  # of sin(a) / a and (1 - cos(a)) / a^2
    if angle > 1e-4:
        sine, cosine = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    turn = np.empty((3, 3))
    turn[0, 0], turn[1, 1], turn[2, 2] = (
        1 - cosine * (y * y + z * z),
        1 - cosine * (x * x + z * z),
        1 - cosine * (x * x + y * y),
    )
    turn[0, 1], turn[1, 0] = cosine * x * y - sine * z, cosine * x * y + sine * z
    turn[0, 2], turn[2, 0] = cosine * x * z + sine * y, cosine * x * z - sine * y
    turn[1, 2], turn[2, 1] = cosine * y * z - sine * x, cosine * y * z + sine * x
    turned, inner = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turned[i, j] += turn[i, k] * poses.rotations[d, k, j]
    # one Newton step towards the nearest rotation keeps rounding from growing over a long film
    for i in range(3):
        for j in range(3):
            inner[i, j] = 1.5 if i == j else 0.0
            for k in range(3):
                inner[i, j] -= 0.5 * turned[k, i] * turned[k, j]
    for i in range(3):
        for j in range(3):
            moved.rotations[m, i, j] = 0.0
            for k in range(3):
                moved.rotations[m, i, j] += turned[i, k] * inner[k, j]
    for i in range(2):
        moved.translations[m, i] = poses.translations[d, i] + change[3 + i]
    for i in range(len(change) - 5):
        moved.morphs[m, i] = poses.morphs[d, i] + change[5 + i]
