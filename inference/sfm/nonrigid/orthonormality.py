"""Rotations of a deforming shape, from what a factorisation has to fulfil whatever the deformation is.

Positions of a deforming shape under orthography are W = M B with M (2 n_frames, r). Three columns of M Q are
the rows of rotations times the weight of one basis; for the mean shape that is 1, so that the two rows (a, b)
of each frame fulfil a a' = b b' = 1 and a b' = 0 (Bregler, Hertzmann and Biermann 2000). Xiao, Chai and
Kanade (2004) showed that many Q do so, and Akhter, Sheikh and Khan (2009) that all of them give the right
rotations if r is three times the number of bases. Where r is smaller some of the deformation is left out,
which is better where noise or finer deformations hide the last of them: several ranks are tried.
"""

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.rotations import nearest_rotation

Numbers = NDArray[np.float64]

STEPS = 100
FIRST_DAMPING, MOST_DAMPING = 1e-2, 1e10
LEAST_GAIN = 1e-7
"""Of the sum of squares, as a share: below this nothing more is to be had."""
RIDGE = 1e-9
"""Of the mean diagonal: the axes of space are free, and with them three directions of Q."""
LEAST_RANK = 3
LEAST_STRENGTH = 1e-6
"""Singular values below this share of the largest are rounding."""
RANDOM_STARTS, SEED = 4, 0


def rotations_of_rank(positions: Numbers, ranks: set[int]) -> list[Numbers]:
    """Rotations `(n_frames, 3, 3)`, two for each rank, by the method of Levenberg and Marquardt.

    One starts from the three strongest columns. The other one is what fulfils the constraints best of some
    that start from random ones: there are local optima, more of them the more there is of deformation.

    Parameters
    ----------
    positions
        `(n_frames, n_points, 2)` about the middle of each frame and in units of their spread, complete.
    ranks
        numbers of singular vectors; if positions have fewer, all that they have. Of fewer than three there
        are no rotations.
    """
    n_frames, n_points, _ = positions.shape
    left, values, _ = np.linalg.svd(positions.transpose(0, 2, 1).reshape(-1, n_points), full_matrices=False)
    random = np.random.default_rng(SEED)
    found = []
    strong = int(np.count_nonzero(values > LEAST_STRENGTH * values[0]))
    for rank in sorted({min(rank, strong) for rank in ranks if strong >= LEAST_RANK}):
        motion = left[:, :rank] * np.sqrt(2 * n_frames * values[:rank] / values[0])
        motion = motion.reshape(n_frames, 2, rank)
        found.append(_rotations(_corrected(motion, np.eye(rank, 3))[0]))
        firsts = random.standard_normal((RANDOM_STARTS, rank, 3)) / np.sqrt(rank)
        solved = [_corrected(motion, first) for first in firsts]
        found.append(_rotations(min(solved, key=lambda each: each[1])[0]))
    return found


def _corrected(motion: Numbers, correction: Numbers) -> tuple[Numbers, float]:
    """Rows `(n_frames, 2, 3)` near orthonormality, `motion` `(n_frames, 2, r)` times Q; the squares left."""
    rank = motion.shape[2]
    rows = motion @ correction
    residual = _violations(rows)
    squares, damping = float(residual @ residual), FIRST_DAMPING
    for _ in range(STEPS):
        jacobian = _derivatives(motion, rows)
        normal, pull = jacobian.T @ jacobian, jacobian.T @ residual
        diagonal = np.diag(normal)
        before = squares
        while damping < MOST_DAMPING:
            damped = normal + np.diag(damping * diagonal + RIDGE * diagonal.mean())
            tried = correction - np.linalg.solve(damped, pull).reshape(rank, 3)
            left = _violations(motion @ tried)
            if left @ left < squares:
                correction, rows, residual, squares = tried, motion @ tried, left, float(left @ left)
                damping /= 10
                break
            damping *= 4
        if before - squares <= LEAST_GAIN * before:
            break
    return rows, squares


def _violations(rows: Numbers) -> Numbers:
    """`(3 n_frames,)`: a a' - 1, b b' - 1, sqrt(2) a b'."""
    gram = rows @ rows.transpose(0, 2, 1)
    return np.concatenate([gram[:, 0, 0] - 1, gram[:, 1, 1] - 1, np.sqrt(2) * gram[:, 0, 1]])


def _derivatives(motion: Numbers, rows: Numbers) -> Numbers:
    """`(3 n_frames, 3 r)`: of the violations by Q."""
    first, second = motion[:, 0, :, None], motion[:, 1, :, None]
    one, other = rows[:, 0, None], rows[:, 1, None]
    parts = [2 * first * one, 2 * second * other, np.sqrt(2) * (first * other + second * one)]
    together: Numbers = np.concatenate(parts).reshape(3 * len(rows), -1)
    return together


def _rotations(rows: Numbers) -> Numbers:
    """The rotations whose first two rows are nearest to `(n_frames, 2, 3)`."""
    whole = np.concatenate([rows, np.cross(rows[:, 0], rows[:, 1])[:, None]], axis=1)
    # the third row has no say in which are nearest: it is perpendicular to both
    rotations: Numbers = nearest_rotation(whole)
    return rotations
