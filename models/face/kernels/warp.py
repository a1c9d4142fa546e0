"""Loops over texels of many experts: warp the picture, form normal equations, densities, texture updates."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled, inlined

Map = NDArray[np.float32]

_f4 = np.float32

FEW = 8
"""Texels in a group up to which their Jacobians one by one are cheaper than the group's moments."""

OFF_PICTURE = _f4(6)
"""e^2 / tau that a visible texel off the picture counts for: its density is then about that of any grey value
(-log 256, where tau is 36), so that leaving the picture does not pay."""


class Texels(NamedTuple):
    """Where texels lie on a surface; as of `SurfaceTexels`, with the numbers of the vertices in use."""

    groups: NDArray[np.int32]
    first: NDArray[np.int32]
    weights: Map
    offsets: Map
    areas: Map


class Textures(NamedTuple):
    """What experts expect on a level, each `(n_experts, n_texels)`; `precision` is 1 / tau."""

    mean: Map
    precision: Map
    log_temperature: Map
    visible: NDArray[np.bool_]


class NormalSums(NamedTuple):
    """Sums over the texels of each pose.

    With e_i = y(x_i) - v_i and weights a_i / tau_i: `matrices` `(n, width, width)` = sum of J_i' J_i,
    `vectors` `(n, width)` = sum of J_i' e_i, `totals` `(n, 3)` = sums of a_i e_i^2 / tau_i, of a_i log tau_i
    and of a_i.
    """

    matrices: Map
    vectors: Map
    totals: NDArray[np.float64]


@compiled
def vertex_rows(rotations, translations, morphs, bases, positions, rows):
    """Positions x_i and the rows d x_i / d u of vertices, for every pose.

    `bases` `(n_bases, n_vertices, 3)` float32; `rotations` `(n, 3, 3)`, `translations` `(n, 2)`, `morphs`
    `(n, n_bases)` float32; writes `positions` `(n, n_vertices, 2)` px and `rows` `(n, n_vertices, 2, width)`
    with the columns of `Poses.moved`; columns past its dimension, which fill vectors, are left alone.
    """
    n_bases, n_vertices = bases.shape[0], bases.shape[1]
    for d in range(len(rotations)):
        r = rotations[d]
        for i in range(n_vertices):
            x = y = z = _f4(0)
            for j in range(n_bases):
                c = morphs[d, j]
                h0, h1, h2 = bases[j, i, 0], bases[j, i, 1], bases[j, i, 2]
                across = r[0, 0] * h0 + r[0, 1] * h1 + r[0, 2] * h2
                down = r[1, 0] * h0 + r[1, 1] * h1 + r[1, 2] * h2
                x += c * across
                y += c * down
                z += c * (r[2, 0] * h0 + r[2, 1] * h1 + r[2, 2] * h2)
                rows[d, i, 0, 5 + j] = across
                rows[d, i, 1, 5 + j] = down
            rows[d, i, 0, 0] = _f4(0)
            rows[d, i, 0, 1] = z
            rows[d, i, 0, 2] = -y
            rows[d, i, 0, 3] = _f4(1)
            rows[d, i, 0, 4] = _f4(0)
            rows[d, i, 1, 0] = -z
            rows[d, i, 1, 1] = _f4(0)
            rows[d, i, 1, 2] = x
            rows[d, i, 1, 3] = _f4(0)
            rows[d, i, 1, 4] = _f4(1)
            positions[d, i, 0] = x + translations[d, 0]
            positions[d, i, 1] = y + translations[d, 1]


@compiled
def texel_places(positions, texels, share, visible, scale, places, area):
    """Where the texels of one expert lie on a level of `scale` and what area each stands for.

    Of every group the first part, one `share`-th, is used. Writes, without gaps, `places` `(2, n)` float32
    and `area` `(n,)`, 0 where not `visible`; gives how many there are.
    """
    n = 0
    groups, first, weights, offsets, areas = texels
    scale = _f4(scale)
    shift = _f4(0.5) * (scale - _f4(1))  # pixel centres are whole numbers on every level
    for g in range(len(groups)):
        a, b, c = groups[g, 0], groups[g, 1], groups[g, 2]
        start = first[g]
        count = (first[g + 1] - start + share - 1) // share
        ax, ay = positions[a, 0] * scale + shift, positions[a, 1] * scale + shift
        bx, by = positions[b, 0] * scale + shift, positions[b, 1] * scale + shift
        cx, cy = positions[c, 0] * scale + shift, positions[c, 1] * scale + shift
        each = areas[g] * _f4(first[g + 1] - start)
        if each == _f4(0):
            size = (positions[b, 0] - positions[a, 0]) * (positions[c, 1] - positions[a, 1])
            size -= (positions[b, 1] - positions[a, 1]) * (positions[c, 0] - positions[a, 0])
            each = _f4(0.5) * abs(size)
        each /= _f4(max(count, 1))
        for k in range(count):
            i = start + k
            wa, wb, wc = weights[i, 0], weights[i, 1], weights[i, 2]
            places[0, n + k] = wa * ax + wb * bx + wc * cx + offsets[i, 0] * scale
            places[1, n + k] = wa * ay + wb * by + wc * cy + offsets[i, 1] * scale
            area[n + k] = each if visible[i] else _f4(0)
        n += count
    return n


@inlined
def _cell(x, y, right, bottom, width):
    """Whether a place is in the picture; upper left pixel of its (or the nearest) cell, and where in that."""
    inside = (x >= _f4(0)) & (y >= _f4(0)) & (x <= right) & (y <= bottom)
    x = min(max(x, _f4(0)), right - _f4(0.001))
    y = min(max(y, _f4(0)), bottom - _f4(0.001))
    column, row = np.int32(x), np.int32(y)
    return inside, row * np.int32(width) + column, x - _f4(column), y - _f4(row)


@compiled
def sample_with_slopes(level, places, n, samples):
    """Level (of at least 2 px either way) and slopes of its bilinear interpolant at `places`.

    The first rows of `samples`: value, slopes across and down per px of the picture, area. Outside there are
    no slopes, and the area, which is given, changes its sign.
    """
    height, width = level.image.shape
    image, scale = level.image.reshape(-1), _f4(level.scale)
    right, bottom = _f4(width - 1), _f4(height - 1)
    value, across, down, area = samples[0], samples[1], samples[2], samples[3]
    for k in range(n):
        inside, at, fx, fy = _cell(places[0, k], places[1, k], right, bottom, width)
        p00, p01 = image[at], image[at + 1]
        p10, p11 = image[at + width], image[at + width + 1]
        above, below = p01 - p00, p11 - p10
        value[k] = p00 + fx * above + fy * (p10 - p00 + fx * (below - above))
        across[k] = (above + fy * (below - above)) * scale if inside else _f4(0)
        down[k] = (p10 - p00 + fx * (below - above)) * scale if inside else _f4(0)
        area[k] = area[k] if inside else -abs(area[k])


@compiled
def sample(image, places, n, value, area):
    """Picture at `places` by bilinear interpolation; outside 0, and minus the area."""
    height, width = image.shape
    pixels = image.reshape(-1)
    right, bottom = _f4(width - 1), _f4(height - 1)
    for k in range(n):
        inside, at, fx, fy = _cell(places[0, k], places[1, k], right, bottom, width)
        p00, p01 = pixels[at], pixels[at + 1]
        p10, p11 = pixels[at + width], pixels[at + width + 1]
        above = p00 + fx * (p01 - p00)
        value[k] = above + fy * (p10 + fx * (p11 - p10) - above) if inside else _f4(0)
        area[k] = area[k] if inside else -abs(area[k])


@compiled
def normal_equations(level, share, texels, textures, owner, positions, rows, dimension, sums):
    """Gauss-Newton's normal equations of the texels' weighted squared differences, for poses of experts.

    Pose m is that of expert `owner[m]`, whose texture is taken; `rows` `(n, n_used, 2, width)` are d x / d u
    of the vertices, of which the first `dimension` columns are the pose's. Writes `sums` (`NormalSums`).

    No Jacobian of a texel is kept where a group has many: all are linear in those of the three vertices, so
    that 6 x 6 moments are summed first and turned into the pose's once. Visible texels off the picture count
    with `OFF_PICTURE` and have no slope.
    """
    # arrays are taken out of tuples before loops: each time costs as much as a few texels
    groups, first, weights = texels.groups, texels.first, texels.weights
    n_texels, width = len(weights), rows.shape[3]
    places, samples = np.empty((2, n_texels), _f4), np.empty((6, n_texels), _f4)
    six, product = np.empty((6, width), _f4), np.empty(width, _f4)
    moments, right = np.empty((6, 6), _f4), np.empty(6, _f4)
    for m in range(len(positions)):
        visible = textures.visible[owner[m]]
        n = texel_places(positions[m], texels, share, visible, level.scale, places, samples[3])
        sample_with_slopes(level, places, n, samples)
        _compare(samples, texels, share, textures, owner[m])
        matrix, vector, moves = sums.matrices[m], sums.vectors[m], rows[m]
        matrix[:] = _f4(0)
        vector[:] = _f4(0)
        squares = logs = total = 0.0
        n = 0
        for g in range(len(groups)):
            a, b, c = groups[g, 0], groups[g, 1], groups[g, 2]
            start = first[g]
            count = (first[g + 1] - start + share - 1) // share
            if count <= FEW:
                for k in range(n, n + count):
                    size = abs(samples[3, k])
                    if size == _f4(0):
                        continue
                    e, gx, gy, w = samples[0, k], samples[1, k], samples[2, k], samples[4, k]
                    squares += w * e * e if samples[3, k] > _f4(0) else size * OFF_PICTURE
                    logs += size * samples[5, k]
                    total += size
                    i = start + k - n
                    b0, b1, b2 = weights[i, 0], weights[i, 1], weights[i, 2]
                    one, other, third = moves[a], moves[b], moves[c]
                    for j in range(width):
                        product[j] = (
                            b0 * (gx * one[0, j] + gy * one[1, j])
                            + b1 * (gx * other[0, j] + gy * other[1, j])
                            + b2 * (gx * third[0, j] + gy * third[1, j])
                        )
                    for j in range(width):
                        vector[j] += w * e * product[j]
                    for row in range(dimension):
                        factor, target = w * product[row], matrix[row]
                        for j in range(width):
                            target[j] += factor * product[j]
            else:
                part = (start, n, count)
                its_squares, its_logs, its_total = _sum_moments(part, samples, weights, moments, right)
                squares += its_squares
                logs += its_logs
                total += its_total
                for corner, vertex in enumerate((a, b, c)):
                    six[corner], six[3 + corner] = moves[vertex, 0], moves[vertex, 1]
                _add_moments(moments, right, six, dimension, product, matrix, vector)
            n += count
        sums.totals[m, 0], sums.totals[m, 1], sums.totals[m, 2] = squares, logs, total


@compiled
def _compare(samples, texels, share, textures, owner):
    """Turn values of `samples` into errors e, and write what belongs to them below: a / tau, log tau."""
    first, mean, precision = texels.first, textures.mean[owner], textures.precision[owner]
    log_temperature = textures.log_temperature[owner]
    n = 0
    for g in range(len(first) - 1):
        start = first[g]
        count = (first[g + 1] - start + share - 1) // share
        for k in range(count):
            i, at = start + k, n + k
            samples[0, at] -= mean[i]
            samples[4, at] = abs(samples[3, at]) * precision[i]
            samples[5, at] = log_temperature[i]
        n += count


@inlined
def _sum_moments(part, samples, weights, moments, right):
    """Sum a group's texels: `moments` `(6, 6)` of slopes times weights, first across, then down, and `right`,
    the same times e; gives its sums of a e^2 / tau, a log tau and a."""
    start, first, count = part
    xx00 = xx01 = xx02 = xx11 = xx12 = xx22 = _f4(0)
    xy00 = xy01 = xy02 = xy11 = xy12 = xy22 = _f4(0)
    yy00 = yy01 = yy02 = yy11 = yy12 = yy22 = _f4(0)
    x0 = x1 = x2 = y0 = y1 = y2 = _f4(0)
    squares = logs = area = _f4(0)
    for k in range(count):
        i, at = start + k, first + k
        a = abs(samples[3, at])
        e, gx, gy, w = samples[0, at], samples[1, at], samples[2, at], samples[4, at]
        squares += w * e * e if samples[3, at] > _f4(0) else a * OFF_PICTURE
        logs += a * samples[5, at]
        area += a
        b0, b1, b2 = weights[i, 0], weights[i, 1], weights[i, 2]
        b00, b01, b02, b11, b12, b22 = b0 * b0, b0 * b1, b0 * b2, b1 * b1, b1 * b2, b2 * b2
        wxx, wxy, wyy = w * gx * gx, w * gx * gy, w * gy * gy
        xx00 += wxx * b00
        xx01 += wxx * b01
        xx02 += wxx * b02
        xx11 += wxx * b11
        xx12 += wxx * b12
        xx22 += wxx * b22
        xy00 += wxy * b00
        xy01 += wxy * b01
        xy02 += wxy * b02
        xy11 += wxy * b11
        xy12 += wxy * b12
        xy22 += wxy * b22
        yy00 += wyy * b00
        yy01 += wyy * b01
        yy02 += wyy * b02
        yy11 += wyy * b11
        yy12 += wyy * b12
        yy22 += wyy * b22
        wex, wey = w * e * gx, w * e * gy
        x0 += wex * b0
        x1 += wex * b1
        x2 += wex * b2
        y0 += wey * b0
        y1 += wey * b1
        y2 += wey * b2
    moments[0, 0], moments[0, 1], moments[0, 2] = xx00, xx01, xx02
    moments[1, 1], moments[1, 2], moments[2, 2] = xx11, xx12, xx22
    moments[0, 3], moments[0, 4], moments[0, 5] = xy00, xy01, xy02
    moments[1, 3], moments[1, 4], moments[1, 5] = xy01, xy11, xy12
    moments[2, 3], moments[2, 4], moments[2, 5] = xy02, xy12, xy22
    moments[3, 3], moments[3, 4], moments[3, 5] = yy00, yy01, yy02
    moments[4, 4], moments[4, 5], moments[5, 5] = yy11, yy12, yy22
    for p in range(6):
        for q in range(p):
            moments[p, q] = moments[q, p]
    right[0], right[1], right[2], right[3], right[4], right[5] = x0, x1, x2, y0, y1, y2
    return squares, logs, area


@inlined
def _add_moments(moments, right, six, dimension, product, matrix, vector):
    """Turn a group's moments into the pose's, by the rows `six` of its three vertices."""
    for j in range(len(product)):
        vector[j] += (
            six[0, j] * right[0] + six[1, j] * right[1] + six[2, j] * right[2]
            + six[3, j] * right[3] + six[4, j] * right[4] + six[5, j] * right[5]
        )  # fmt: skip
    for p in range(6):
        for j in range(len(product)):
            product[j] = (
                moments[p, 0] * six[0, j] + moments[p, 1] * six[1, j] + moments[p, 2] * six[2, j]
                + moments[p, 3] * six[3, j] + moments[p, 4] * six[4, j] + moments[p, 5] * six[5, j]
            )  # fmt: skip
        for row in range(dimension):
            factor = six[p, row]
            for j in range(len(product)):
                matrix[row, j] += factor * product[j]


@compiled
def texel_densities(level, share, texels, textures, owner, positions, extra, sums):
    """Sums of a_i e_i^2 / tau_i, a_i log tau_i, a_i, and a_i times `extra` at x_i, for poses of owners.

    Pose m is judged with the texture and the visibility of expert `owner[m]`; `extra`, of the shape of the
    level's image or empty, is a map of which the sum over the covered pixels is wanted (a background's log
    density). Visible texels off the picture count with `OFF_PICTURE`.
    """
    n_texels = len(texels.weights)
    places = np.empty((2, n_texels), _f4)
    area, value = np.empty(n_texels, _f4), np.empty(n_texels, _f4)
    background = np.zeros(n_texels, _f4)
    first, (mean, precision, log_temperature, visible) = texels.first, textures
    for m in range(len(positions)):
        d = owner[m]
        n = texel_places(positions[m], texels, share, visible[d], level.scale, places, area)
        sample(level.image, places, n, value, area)
        if extra.size:
            sample(extra, places, n, background, area)
        squares = logs = total = other = 0.0
        n = 0
        for g in range(len(first) - 1):
            start = first[g]
            count = (first[g + 1] - start + share - 1) // share
            group_squares = group_logs = group_total = group_other = _f4(0)
            for k in range(count):
                i, at = start + k, n + k
                a = abs(area[at])
                e = value[at] - mean[d, i]
                group_squares += a * e * e * precision[d, i] if area[at] > _f4(0) else a * OFF_PICTURE
                group_logs += a * log_temperature[d, i]
                group_total += a
                group_other += a * background[at]
            n += count
            squares += group_squares
            logs += group_logs
            total += group_total
            other += group_other
        sums[m, 0], sums[m, 1], sums[m, 2], sums[m, 3] = squares, logs, total, other


@compiled
def sample_texels(level, texels, visible, positions, values, area):
    """What all texels look like in the picture: `values`, and `area` `(n, n_texels)` of those seen.

    The area is 0 of hidden ones and not above 0 of those off the picture.
    """
    n_texels = len(texels.weights)
    places = np.empty((2, n_texels), _f4)
    for d in range(len(positions)):
        texel_places(positions[d], texels, 1, visible[d], level.scale, places, area[d])
        sample(level.image, places, n_texels, values[d], area[d])
