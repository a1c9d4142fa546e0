"""Loops over the points by which two pictures are registered."""

import numpy as np

from ..numerics.compiled import compiled

STEP_UNKNOWNS = 7
"""The six of an affine map, and the contrast."""


@compiled
def strongest(across, down, cell, margin, places):
    """The place of the largest gradient in each cell of the picture, `(n_cells, 2)` columns and rows."""
    height, width = across.shape
    number = 0
    for top in range(margin, height - margin - cell + 1, cell):
        for left in range(margin, width - margin - cell + 1, cell):
            best = np.float32(-1.0)
            for y in range(top, top + cell):
                for x in range(left, left + cell):
                    size = across[y, x] * across[y, x] + down[y, x] * down[y, x]
                    if size > best:
                        best = size
                        places[number, 0], places[number, 1] = x, y
            number += 1
    return number


@compiled
def residuals(image, places, values, about, parameters, contrast, off):
    """What the image shows at the mapped places less `contrast` times `values`; NaN-free: 1e9 outside.

    `about` `(n, 2)` are the places relative to the picture's middle in units of its radius.
    """
    height, width = image.shape
    for n in range(places.shape[0]):
        u, v = about[n, 0], about[n, 1]
        x = places[n, 0] + parameters[0] + parameters[1] * u + parameters[2] * v
        y = places[n, 1] + parameters[3] + parameters[4] * u + parameters[5] * v
        left, top = int(np.floor(x)), int(np.floor(y))
        if left < 0 or top < 0 or left + 1 >= width or top + 1 >= height:
            off[n] = 1e9
            continue
        fx, fy = x - left, y - top
        above = (1 - fx) * image[top, left] + fx * image[top, left + 1]
        below = (1 - fx) * image[top + 1, left] + fx * image[top + 1, left + 1]
        off[n] = (1 - fy) * above + fy * below - contrast * values[n]


@compiled
def normal_equations(off, values, gradients, about, variance, information, vector):
    """Those of a Gauss-Newton step; large residuals count as they do under Student's t (4 degrees)."""
    information[:] = 0.0
    vector[:] = 0.0
    row = np.empty(STEP_UNKNOWNS)
    for n in range(off.shape[0]):
        if off[n] >= 1e9:
            continue
        weight = 5.0 / (4.0 + off[n] * off[n] / variance)
        u, v = about[n, 0], about[n, 1]
        gx, gy = gradients[n, 0], gradients[n, 1]
        row[0], row[1], row[2] = gx, gx * u, gx * v
        row[3], row[4], row[5] = gy, gy * u, gy * v
        row[6] = -values[n]
        for i in range(STEP_UNKNOWNS):
            weighted = weight * row[i]
            vector[i] += weighted * off[n]
            for j in range(i, STEP_UNKNOWNS):
                information[i, j] += weighted * row[j]
    for i in range(STEP_UNKNOWNS):
        for j in range(i):
            information[i, j] = information[j, i]
