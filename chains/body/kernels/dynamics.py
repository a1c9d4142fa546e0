"""Densities of mixtures over many previous poses of a body, each new pose against each previous one."""

import numpy as np

from ....models.numerics.compiled import compiled, exponential

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
