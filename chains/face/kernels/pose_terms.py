"""Loops over points of a surface whose places in the picture are known, and over scans across outlines."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled

_f4 = np.float32


class Scans(NamedTuple):
    """Lines across an outline: through `places` `(n, n_points, 2)` px along unit `normals`, each for a
    length of outline, px, 0 where there is none; `reach` steps of `step` px to either side."""

    places: NDArray[np.float64]
    normals: NDArray[np.float64]
    lengths: NDArray[np.float64]
    reach: int
    step: float


@compiled
def place_equations(
    rotations, translations, morphs, which, bases, targets, information, energy, gradient, curvature
):
    """Energy, gradient and Gauss-Newton curvature of sum (x - t)' I (x - t) / 2 over points, pose by pose.

    Pose m goes with row `which[m]` of `bases` `(n, n_points, n_bases, 3)`, `targets` `(n, n_points, 2)` and
    `information` `(n, n_points, 3)` (xx, xy, yy).
    """
    n_points, n_bases = bases.shape[1], bases.shape[2]
    dimension = 5 + n_bases
    across, down = np.zeros(dimension), np.zeros(dimension)
    across[3], down[4] = 1.0, 1.0
    for m in range(len(rotations)):
        r, d = rotations[m], which[m]
        matrix, vector = curvature[m], gradient[m]
        matrix[:] = 0.0
        vector[:] = 0.0
        total = 0.0
        for i in range(n_points):
            xx, xy, yy = information[d, i, 0], information[d, i, 1], information[d, i, 2]
            if xx + yy == 0.0:
                continue
            x = y = z = 0.0
            for j in range(n_bases):
                c = morphs[m, j]
                h0, h1, h2 = bases[d, i, j, 0], bases[d, i, j, 1], bases[d, i, j, 2]
                right = r[0, 0] * h0 + r[0, 1] * h1 + r[0, 2] * h2
                low = r[1, 0] * h0 + r[1, 1] * h1 + r[1, 2] * h2
                across[5 + j], down[5 + j] = right, low
                x += c * right
                y += c * low
                z += c * (r[2, 0] * h0 + r[2, 1] * h1 + r[2, 2] * h2)
            across[1], across[2] = z, -y
            down[0], down[2] = -z, x
            ex, ey = x + translations[m, 0] - targets[d, i, 0], y + translations[m, 1] - targets[d, i, 1]
            fx, fy = xx * ex + xy * ey, xy * ex + yy * ey
            total += 0.5 * (ex * fx + ey * fy)
            for p in range(dimension):
                vector[p] += across[p] * fx + down[p] * fy
                gx, gy = xx * across[p] + xy * down[p], xy * across[p] + yy * down[p]
                for q in range(dimension):
                    matrix[p, q] += gx * across[q] + gy * down[q]
        energy[m] = total


@compiled
def find_edges(contrast, box, scans, share, noise, targets, information):
    """Where along their normals the edge of an object is, given what its background looks like.

    `contrast` `(n_maps, height, width)` float32: log density of the background over that of the
    object, of pixels of the `box`; one map for all, or one each. Writes `targets` `(n, n_points, 2)`
    and `information` `(n, n_points, 3)`, zero where a scan says nothing. The
    variance `noise` in steps is added to what it finds; `share` `(n,)` is
    how much a px of outline counts. Nats are not tempered by it, or the edge would be found too far on the
    side where the background speaks more softly.
    """
    places, normals, lengths, reach, step = scans
    top, left, height, width = box
    n_steps = 2 * reach + 1
    outside = np.empty(n_steps + 1)
    for m in range(len(places)):
        image = contrast[m] if len(contrast) > 1 else contrast[0]
        for i in range(places.shape[1]):
            targets[m, i] = places[m, i]
            information[m, i] = 0.0
            if lengths[m, i] == 0.0:
                continue
            nx, ny = normals[m, i, 0], normals[m, i, 1]
            # outside[k]: nats of all that lies beyond an edge between samples k - 1 and k
            outside[n_steps] = 0.0
            for k in range(n_steps - 1, -1, -1):
                s = (k - reach) * step
                x, y = places[m, i, 0] + s * nx - left, places[m, i, 1] + s * ny - top
                value = _f4(0)
                if (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1):
                    column, row = np.int64(x), np.int64(y)
                    fx, fy = _f4(x - column), _f4(y - row)
                    upper, lower = image[row], image[row + 1]
                    above = upper[column] + fx * (upper[column + 1] - upper[column])
                    below = lower[column] + fx * (lower[column + 1] - lower[column])
                    value = above + fy * (below - above)
                outside[k] = outside[k + 1] + step * value
            best = outside[0]
            for k in range(1, n_steps + 1):
                best = max(best, outside[k])
            total = first = second = prior = 0.0
            for k in range(n_steps + 1):
                s = (k - reach - 0.5) * step
                weight = np.exp(outside[k] - best)
                total += weight
                first += weight * s
                second += weight * s * s
                prior += s * s
            mean = first / total
            variance = second / total - mean * mean + noise * step * step
            gain = 1.0 / variance - (n_steps + 1) / prior
            if gain <= 0.0:
                continue
            # the scan's own prior, about its middle, is taken out of the mean as well
            at = min(max(mean / (variance * gain), -reach * step), reach * step)
            gain *= share[m] * lengths[m, i]
            targets[m, i, 0] += at * nx
            targets[m, i, 1] += at * ny
            information[m, i, 0] = gain * nx * nx
            information[m, i, 1] = gain * nx * ny
            information[m, i, 2] = gain * ny * ny
