"""Loops over small Gaussians, each on its own: from information to moments and back."""

import math

import numpy as np

from ...numerics.compiled import compiled, inlined


@inlined
def _cholesky(matrix, scales, least, root):
    """Lower root of a matrix scaled to a unit diagonal; whether all its pivots are more than `least`."""
    size = scales.size
    for i in range(size):
        if not matrix[i, i] > 0:
            return False
        scales[i] = math.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j] / (scales[i] * scales[j])
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = value / root[j, j]
            elif value > least:
                root[i, i] = math.sqrt(value)
            else:
                return False
    return True


@inlined
def _inverse(root, scales, lower, out):
    """Inverse of the matrix of which `_cholesky` gave the root; `lower` is for the root's."""
    size = scales.size
    for j in range(size):
        for i in range(j, size):
            value = 1.0 if i == j else 0.0
            for k in range(j, i):
                value -= root[i, k] * lower[k, j]
            lower[i, j] = value / root[i, i]
    for i in range(size):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, size):
                value += lower[k, i] * lower[k, j]
            out[i, j] = out[j, i] = value / (scales[i] * scales[j])


@compiled
def invert(matrices, vectors, least, inverses, products, log_determinants, regular):
    """Inverses of symmetric `(n, d, d)` matrices, and these times vectors `(n, d)`.

    `regular` `(n,)` tells which matrices are positive definite: scaled to a unit diagonal, all pivots of
    their roots are more than `least`. Of the others, what is written is zero.
    """
    size = matrices.shape[1]
    scales, root, lower = np.empty(size), np.zeros((size, size)), np.zeros((size, size))
    for n in range(matrices.shape[0]):
        inverse, product = inverses[n], products[n]
        log_determinant = 0.0
        regular[n] = _cholesky(matrices[n], scales, least, root)
        if regular[n]:
            _inverse(root, scales, lower, inverse)
            for i in range(size):
                log_determinant += math.log(root[i, i] * scales[i])
        else:
            inverse[:] = 0.0
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += inverse[i, j] * vectors[n, j]
            product[i] = value
        log_determinants[n] = 2 * log_determinant
