"""Compiled loops over poses: densities of the body's dynamics."""

import numpy as np

from ....models.body.kernels import leant_from, rotation
from ....models.numerics.compiled import compiled, exponential, helper

_f4 = np.float32


@helper
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


@helper
def _usual(arms, k, side, usual):
    """Log density of an arm's prior.

    `usual` `(5,)`: middle of left upper arms, concentration, log of the density there.
    """
    away = (1.0 - 2.0 * side) * usual[0] * arms[k, side, 0, 0]
    away += usual[1] * arms[k, side, 0, 1] + usual[2] * arms[k, side, 0, 2] - 1.0
    return usual[3] * away + usual[4]


@compiled
def arm_steps(arms, before, concentrations, heights, usual, out):
    """Write the log densities `(n, 2)` of arms `(n, 2, 2, 3)` given those `before`.

    `concentrations` `(2,)` of upper arms and forearms; `heights` `(3,)`: density of an arm that has not
    jumped, at its peak; probability of a jump; least exponent; `usual` `(5,)` as of `_usual`.
    """
    for k in range(len(arms)):
        for side in range(2):
            turned = 0.0
            for part in range(2):
                cosine = arms[k, side, part, 0] * before[k, side, part, 0]
                cosine += arms[k, side, part, 1] * before[k, side, part, 1]
                cosine += arms[k, side, part, 2] * before[k, side, part, 2]
                turned += concentrations[part] * (cosine - 1.0)
            jumped = heights[1] * np.exp(_usual(arms, k, side, usual))
            out[k, side] = np.log(heights[0] * np.exp(max(turned, heights[2])) + jumped)


@compiled
def crossings(torsos, arms, lengths, out):
    """Write by how many px the hands are crossed into `out` `(n,)`; `lengths` `(3,)` as of `move_blocks`."""
    for k in range(len(torsos)):
        right, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
        across = lengths[1] * (arms[k, 1, 0, 0] - arms[k, 0, 0, 0])
        across += lengths[2] * (arms[k, 1, 1, 0] - arms[k, 0, 1, 0])
        out[k] = across - 2.0 * lengths[0] * right[0]


@compiled
def squared_steps(roots, torsos, necks, old_roots, old_torsos, old_necks, place, decay, stds, out):
    """Write the squared steps `(n,)` from old positions and turns, in standard deviations.

    `place` px of the position; `decay`, `stds` `(6,)` of the turns: as of `BodyDynamics.turn_step`.
    """
    for k in range(len(roots)):
        right, down = roots[k, 0] - old_roots[k, 0], roots[k, 1] - old_roots[k, 1]
        total = (right * right + down * down) / (place * place)
        for axis in range(3):
            torso = (torsos[k, axis] - decay[axis] * old_torsos[k, axis]) / stds[axis]
            neck = (necks[k, axis] - decay[3 + axis] * old_necks[k, axis]) / stds[3 + axis]
            total += torso * torso + neck * neck
        out[k] = total


@compiled
def scaled_poses(
    roots, torsos, necks, arms, origin, stds, decay, peak, jump, least, usual, body, row, floors
):
    """Write what `mixture_values` takes: `body` `(n, 8)`, `row` `(n, 12)`, `floors` `(n, 2)`; float32.

    `origin` `(2,)` px; `stds` `(7,)`: of the position and of the turns, by which they are divided; `decay`
    `(6,)`: factor of the turns; `peak`, `jump`: density of an arm that has not jumped, at its peak, and
    probability of a jump; `least` floor; `usual` as of `_usual`.
    """
    for k in range(len(roots)):
        for axis in range(2):
            body[k, axis] = _f4((roots[k, axis] - origin[axis]) / stds[0])
        for axis in range(3):
            body[k, 2 + axis] = _f4(decay[axis] * torsos[k, axis] / stds[1 + axis])
            body[k, 5 + axis] = _f4(decay[3 + axis] * necks[k, axis] / stds[4 + axis])
        for side in range(2):
            for part in range(2):
                for axis in range(3):
                    row[k, 6 * side + 3 * part + axis] = _f4(arms[k, side, part, axis])
            floors[k, side] = _f4(max(jump * np.exp(_usual(arms, k, side, usual)) / peak, least))


@helper
def von_mises_fisher(concentration, share, turn):
    """Cosine from the mean, by its inverse distribution function, and turn about it, of numbers in 0 to 1."""
    least = np.exp(-2.0 * concentration)
    return 1.0 + np.log(share + (1.0 - share) * least + 1e-300) / concentration, 2.0 * np.pi * turn


RAISED = 40.0  # nats by which sums over ancestors are raised: subnormal products would take six times as long
FARTHEST = -83.0  # nats of a place, over the nearest ancestor's, at least


@helper
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
        place = exponential(max(_f4(-0.5) * (row[j] - nearest), _f4(FARTHEST)) + _f4(RAISED))
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

    `body`, `ancestors` `(n, d)`, `(d, k)`: what moves like a Gaussian, in units in which half the squared
    distance is the exponent; `least` `(n,)`: smallest squared distance of each; exponents are taken relative
    to it; `arms`, `ancestor_arms` `(n, 12)`, `(12, k)`: unit vectors, left upper arm, left forearm, right
    upper arm, right forearm; `weights` `(k,)` of the ancestors; `concentrations` `(2,)` of von Mises and
    Fisher's density, of upper arms and forearms; `floors` `(n, 2)`: density of an arm that jumped, by the
    peak of that of one that did not; `values` `(n,)` filled in, times exp(`RAISED`).
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

    `points` `(n,)`, evenly drawn from 0 to 1; `chosen` `(n,)` indices, filled in; all others as of
    `mixture_values`.
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
def walk(roots, torsos, necks, arms, normals, evens, place, decay, stds, concentrations):
    """Move poses, in place, by one step of a random walk.

    `normals`, `evens` `(n, 8)`: random numbers, standard normal ones, and from 0 to 1; `place` px: standard
    deviation of the position; `decay`, `stds` `(6,)` of the turns; `concentrations` `(2,)` of upper arms and
    forearms.
    """
    for k in range(len(roots)):
        for axis in range(2):
            roots[k, axis] += place * normals[k, axis]
        for axis in range(3):
            torsos[k, axis] = decay[axis] * torsos[k, axis] + stds[axis] * normals[k, 2 + axis]
            necks[k, axis] = decay[3 + axis] * necks[k, axis] + stds[3 + axis] * normals[k, 5 + axis]
        for side in range(2):
            for part in range(2):
                column = 4 * side + 2 * part
                x, y, z = arms[k, side, part, 0], arms[k, side, part, 1], arms[k, side, part, 2]
                cosine, turn = von_mises_fisher(concentrations[part], evens[k, column], evens[k, column + 1])
                x, y, z = leant_from(x, y, z, cosine, turn)
                arms[k, side, part, 0], arms[k, side, part, 1], arms[k, side, part, 2] = x, y, z


"""Points in a row, which are worked on together: rows are of one part each, and some points do not count."""
