"""Compiled loops over texels and experts: Kalman updates, densities, Gauss-Newton steps, background maps.

Texels lie in rows, the k-th of each group side by side (see `SurfaceTexels`). Loops run along rows, so that
vectors of texels have common weights of their corners and no sum crosses a vector.

Positions of texels are linear in those of vertices, and these in the change of the pose, x_v = X_v u. So no
Jacobian of a texel is stored: J'J = sum over pairs (v, w) of X_v' M_vw X_w, where the 2 x 2 blocks M_vw
collect the slopes of the picture times the weights of both vertices over texels. There are as many blocks as
vertices and edges, far fewer than texels.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import (
    LANES,
    MOST,
    add_vector,
    add_vectors,
    compiled,
    inlined,
    logarithm,
    own_array,
    put,
)

Map = NDArray[np.float32]
Array = NDArray[np.float64]

_f4 = np.float32

OFF_PICTURE = _f4(6)
"""e^2 / tau of a visible texel outside of the picture: about the uniform density (-log 256, at a tau of 36),
so that leaving the picture is no advantage."""


class Texels(NamedTuple):
    """Texels as of `SurfaceTexels`, with numbers among the used vertices.

    `weights` `(n_rows, 3)` and `offsets` `(n_rows, 2)` of the rows, `counts` `(n_groups,)` of the texels.
    """

    groups: NDArray[np.uint32]
    first: NDArray[np.int32]
    counts: NDArray[np.int32]
    weights: Map
    offsets: Map
    areas: Map


class Textures(NamedTuple):
    """Predicted textures: `mean` `(n_experts, n_levels, n_texels)`, the others `(n_experts, n_texels)`;
    `precision` is 1 / tau."""

    mean: Map
    precision: Map
    log_temperature: Map
    visible: NDArray[np.bool_]


@compiled
def place_corners(positions, texels, block, share, scale, corners):
    """Write the corners of the groups of a block on a level, and the area of each of their texels.

    Of every group the first part, one `share`-th, is used. A block begins at group `block` and has at most
    `MOST`. Writes `corners` `(7, MOST)`: x of the three, y of the three, px of the level, and the area, px
    squared of the picture.
    """
    groups, counts, areas = texels.groups, texels.counts, texels.areas
    for g in range(min(len(groups) - block, MOST)):
        number = block + g
        a, b, c = groups[number, 0], groups[number, 1], groups[number, 2]
        ax, ay = positions[a, 0], positions[a, 1]
        bx, by = positions[b, 0], positions[b, 1]
        cx, cy = positions[c, 0], positions[c, 1]
        corners[0, g], corners[1, g], corners[2, g] = ax * scale, bx * scale, cx * scale
        corners[3, g], corners[4, g], corners[5, g] = ay * scale, by * scale, cy * scale
        each = areas[number] * _f4(counts[number])
        if each == _f4(0):
            each = _f4(0.5) * abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
        corners[6, g] = each / _f4((counts[number] + share - 1) // share)


@inlined
def row_length(first, row, share, block):
    """Return the number of groups of a block with a texel in a row, where one `share`-th is used."""
    fine = row * share
    return min(first[fine + 1] - first[fine] - block, MOST)


@inlined
def whole_vectors(n):
    """Return the next multiple of a vector's lanes, for loops without a scalar remainder."""
    return (n + LANES - 1) // LANES * LANES


@inlined
def place_row(texels, row, n, scale, corners, size, at, inside, rest_x, rest_y):
    """Find the cells of a picture of `size` (height, width) that contain the first `n` texels of a row.

    Writes the number `at` of their upper left pixel (or that of the nearest cell), whether they are `inside`,
    1 or 0, and their position in the cell.
    """
    ax, bx, cx, ay, by, cy = corners[0], corners[1], corners[2], corners[3], corners[4], corners[5]
    wa, wb, wc = texels.weights[row, 0], texels.weights[row, 1], texels.weights[row, 2]
    shift = _f4(0.5) * (scale - _f4(1))  # pixel centres are whole numbers on every level
    ox, oy = texels.offsets[row, 0] * scale + shift, texels.offsets[row, 1] * scale + shift
    width = np.int32(size[1])
    right, bottom = _f4(size[1] - 1), _f4(size[0] - 1)
    last = np.uint32(max((size[0] - 1) * size[1] - 2, 0))  # whatever an overflow makes of positions
    for g in range(n):
        x = wa * ax[g] + wb * bx[g] + wc * cx[g] + ox
        y = wa * ay[g] + wb * by[g] + wc * cy[g] + oy
        inside[g] = _f4((x >= _f4(0)) & (y >= _f4(0)) & (x <= right) & (y <= bottom))
        x = min(max(x, _f4(0)), right - _f4(0.001))
        y = min(max(y, _f4(0)), bottom - _f4(0.001))
        column, line = np.int32(x), np.int32(y)
        at[g] = min(np.uint32(line * width + column), last)
        rest_x[g], rest_y[g] = x - _f4(column), y - _f4(line)


@inlined
def fetch(image, width, at, n, cells):
    """Copy the four pixels of cells by scalar loads, which are faster than gathers."""
    width = np.uint32(width)
    for g in range(n):
        k = at[g]
        p00, p01, p10, p11 = image[k], image[k + 1], image[k + width], image[k + width + 1]
        cells[4 * g], cells[4 * g + 1], cells[4 * g + 2], cells[4 * g + 3] = p00, p01, p10, p11


@compiled
def texel_densities(level, number, texels, textures, owner, positions, extra, sums):
    """Write sums of a_i e_i^2 / tau_i, a_i log tau_i, a_i, and a_i times `extra` at x_i, of each pose.

    Pose m is evaluated with the texture and the visibility of expert `owner[m]` on level `number`; `extra`,
    of the shape of the level's image or empty, is another map to integrate (a background's log density).
    Visible texels outside of the picture count with `OFF_PICTURE`.
    """
    height, width = level.image.shape
    image, other, scale = level.image.reshape(-1), extra.reshape(-1), _f4(level.scale)
    first, n_groups, share = texels.first, len(texels.groups), 4**number
    corners = np.zeros((7, MOST), _f4)
    each = corners[6]
    at, inside, cells = own_array(np.uint32), own_array(_f4), np.zeros(4 * MOST, _f4)
    fx, fy = own_array(_f4), own_array(_f4)
    for m in range(len(positions)):
        d = owner[m]
        squares = logs = total = beside = 0.0
        for block in range(0, n_groups, MOST):
            place_corners(positions[m], texels, block, share, scale, corners)
            for row in range((len(first) - 2) // share + 1):
                n = row_length(first, row, share, block)
                if n <= 0:
                    break
                start = first[row] + block
                place_row(texels, row, whole_vectors(n), scale, corners, (height, width), at, inside, fx, fy)
                fetch(image, width, at, n, cells)
                mean, precision = textures.mean[d, number, start:], textures.precision[d, start:]
                log_temperature, visible = textures.log_temperature[d, start:], textures.visible[d, start:]
                its_squares = its_logs = its_total = its_other = _f4(0)
                for g in range(n):
                    p00, p10 = cells[4 * g], cells[4 * g + 2]
                    above = p00 + fx[g] * (cells[4 * g + 1] - p00)
                    below = p10 + fx[g] * (cells[4 * g + 3] - p10)
                    a = each[g] if visible[g] else _f4(0)
                    e = above + fy[g] * (below - above) - mean[g]
                    its_squares += a * (OFF_PICTURE + inside[g] * (e * e * precision[g] - OFF_PICTURE))
                    its_logs += a * log_temperature[g]
                    its_total += a
                if other.size:
                    fetch(other, width, at, n, cells)
                    for g in range(n):
                        p00, p10 = cells[4 * g], cells[4 * g + 2]
                        above = p00 + fx[g] * (cells[4 * g + 1] - p00)
                        below = p10 + fx[g] * (cells[4 * g + 3] - p10)
                        a = each[g] if visible[g] else _f4(0)
                        its_other += a * inside[g] * (above + fy[g] * (below - above))
                squares += its_squares
                logs += its_logs
                total += its_total
                beside += its_other
        sums[m, 0], sums[m, 1], sums[m, 2], sums[m, 3] = squares, logs, total, beside


@compiled
def sample_texels(level, number, share, texels, visible, positions, values, area):
    """Sample texels in the picture: `values[:, number]`, and the `area` `(n, n_texels)` of visible ones.

    The area of hidden texels is 0, that of texels outside of the picture negative. Of every group the first
    `share`-th is sampled; the entries of others are left unchanged.
    """
    height, width = level.image.shape
    image, scale = level.image.reshape(-1), _f4(level.scale)
    first, n_groups = texels.first, len(texels.groups)
    corners = np.zeros((7, MOST), _f4)
    each = corners[6]
    at, inside, cells = own_array(np.uint32), own_array(_f4), np.zeros(4 * MOST, _f4)
    fx, fy = own_array(_f4), own_array(_f4)
    for m in range(len(positions)):
        for block in range(0, n_groups, MOST):
            place_corners(positions[m], texels, block, share, scale, corners)
            for row in range((len(first) - 2) // share + 1):
                n = row_length(first, row, share, block)
                if n <= 0:
                    break
                start = first[row] + block
                place_row(texels, row, whole_vectors(n), scale, corners, (height, width), at, inside, fx, fy)
                fetch(image, width, at, n, cells)
                seen, value, its_area = visible[m, start:], values[m, number, start:], area[m, start:]
                for g in range(n):
                    p00, p10 = cells[4 * g], cells[4 * g + 2]
                    above = p00 + fx[g] * (cells[4 * g + 1] - p00)
                    below = p10 + fx[g] * (cells[4 * g + 3] - p10)
                    a = each[g] if seen[g] else _f4(0)
                    value[g] = inside[g] * (above + fy[g] * (below - above))
                    its_area[g] = a * (_f4(2) * inside[g] - _f4(1))


@compiled
def map_sums(maps, texels, on, owner, positions, sums):
    """Write sums over texels that are `on` `(n_experts, n_texels)` of their area times a map at them.

    `maps` `(n_maps, height, width)` are one for all or one an expert; they are 0 outside.
    """
    height, width = maps.shape[1], maps.shape[2]
    if height < 2 or width < 2:  # there is nothing between its pixels
        sums[:] = 0.0
        return
    first, n_groups = texels.first, len(texels.groups)
    corners = np.zeros((7, MOST), _f4)
    each = corners[6]
    at, inside, cells = own_array(np.uint32), own_array(_f4), np.zeros(4 * MOST, _f4)
    fx, fy = own_array(_f4), own_array(_f4)
    for m in range(len(positions)):
        d = owner[m]
        image = maps[d if len(maps) > 1 else 0].reshape(-1)
        total = 0.0
        for block in range(0, n_groups, MOST):
            place_corners(positions[m], texels, block, 1, _f4(1), corners)
            for row in range(len(first) - 1):
                n = row_length(first, row, 1, block)
                if n <= 0:
                    break
                place_row(texels, row, whole_vectors(n), _f4(1), corners, (height, width), at, inside, fx, fy)
                fetch(image, width, at, n, cells)
                counted = on[d, first[row] + block :]
                in_row = _f4(0)
                for g in range(n):
                    p00, p10 = cells[4 * g], cells[4 * g + 2]
                    above = p00 + fx[g] * (cells[4 * g + 1] - p00)
                    below = p10 + fx[g] * (cells[4 * g + 3] - p10)
                    a = each[g] if counted[g] else _f4(0)
                    in_row += a * inside[g] * (above + fy[g] * (below - above))
                total += in_row
        sums[m] = total


class Noises(NamedTuple):
    """Noises of texels, each `(n_experts, n_texels)` float32 or `(1, n_texels)` if common to all.

    Squared grey levels of an observation, of the change since the last one, and after the first observation.
    """

    rendering: Map
    process: Map
    first: Map


class Lasting(NamedTuple):
    """Lasting textures `(n_experts, n_texels)`, or none `(0, 0)`; mean and number of pictures."""

    mean: Map
    looks: Map


class Memory(NamedTuple):
    """Learning of lasting textures, `(n_experts, n_texels)` or `(1, n_texels)`: weight of the first picture,
    and least share of a new one."""

    first: Map
    share: Map


@compiled
def predict(mean, variance, lasting, returned, noises, most, new_mean, new_variance):
    """Increase variances, up to `most`, and return means by a share to the lasting texture, if any."""
    process = noises.process
    for d in range(len(variance)):
        change = process[d if len(process) > 1 else 0]
        before, after = variance[d], new_variance[d]
        for i in range(len(before)):
            after[i] = min(before[i] + change[i], most)
        for level in range(mean.shape[1]):
            put(mean[d, level], new_mean[d, level])
        if len(lasting.mean):
            where, looks, its_mean = lasting.mean[d], lasting.looks[d], new_mean[d, 0]
            for i in range(len(before)):
                off = where[i] - its_mean[i] if looks[i] > _f4(0) else _f4(0)
                its_mean[i] += returned * off


@compiled
def learn(observed, seen, mean, variance, noises, unknown, new_mean, new_variance):
    """Update the finest level of seen texels by Kalman's equations; coarse ones hold the observation.

    Texels with a variance of `unknown` or more become the observation.
    """
    rendering, first = noises.rendering, noises.first
    for d in range(len(variance)):
        own = d if len(rendering) > 1 else 0
        noise, least, shown = rendering[own], first[own], seen[d]
        before, after, look, old, new = (
            variance[d],
            new_variance[d],
            observed[d, 0],
            mean[d, 0],
            new_mean[d, 0],
        )
        for i in range(len(before)):
            v = before[i]
            gain = _f4(1) if v >= unknown else v / (v + noise[i])
            gain = gain if shown[i] else _f4(0)
            after[i] = least[i] if shown[i] & (v >= unknown) else (_f4(1) - gain) * v
            new[i] = old[i] + gain * (look[i] - old[i])
        for level in range(1, mean.shape[1]):
            look, old, new = observed[d, level], mean[d, level], new_mean[d, level]
            for i in range(len(before)):
                new[i] = look[i] if shown[i] else old[i]


@compiled
def learn_lasting(observed, seen, lasting, memory, weight, after):
    """Update the long-term means of seen texels; see `LastingTexture`. A picture counts as `weight` pictures
    of the usual rate."""
    for d in range(len(seen)):
        own = d if len(memory.first) > 1 else 0
        first, least, look, shown = memory.first[own], memory.share[own], observed[d, 0], seen[d]
        mean, looks, new_mean, new_looks = lasting.mean[d], lasting.looks[d], after.mean[d], after.looks[d]
        for i in range(len(mean)):
            fresh = looks[i] == _f4(0)
            counts = first[i] if fresh else weight
            total = looks[i] + (counts if shown[i] else _f4(0))
            share = _f4(1) if fresh else max(weight / max(total, weight), least[i])
            new_mean[i] = mean[i] + (share * (look[i] - mean[i]) if shown[i] else _f4(0))
            new_looks[i] = total


@compiled
def write_explained_variance(observed, mean, visible, seen, least_inside, share):
    """Write the share of the picture's variance that predictions explain; see `explained_variance`."""
    for d in range(len(seen)):
        look, expected, shown = observed[d, 0], mean[d, 0], seen[d]
        count = facing = 0
        total = _f4(0)
        for i in range(len(shown)):
            count += shown[i]
            facing += visible[d, i]
            total += look[i] if shown[i] else _f4(0)
        middle = total / _f4(max(count, 1))
        error = power = _f4(0)
        for i in range(len(shown)):
            off, spread = look[i] - expected[i], look[i] - middle
            error += off * off if shown[i] else _f4(0)
            power += spread * spread if shown[i] else _f4(0)
        share[d] = _f4(0)
        if max(count, 1) > least_inside * max(facing, 1):
            share[d] = max(_f4(1) - error / max(power, _f4(1)), _f4(-1))


_LOG_2_PI = _f4(1.8378771)
_LOG_GREYS = _f4(np.log(256))


class MapNoise(NamedTuple):
    """Squared grey levels of an observation, of the change since the last one, and of an unseen pixel."""

    observation: np.float32
    change: np.float32
    unknown: np.float32


@compiled
def compare_with_maps(grey, mean, variance, region, noise, least, ratio, trust, everywhere):
    """Write the log density of a picture under each map over the uniform one, and its trust, in a region.

    `grey` `(height, width)` uint8; `mean` and `variance` `(n, height, width)`; `ratio` (not below `least`
    nats) and `trust` `(n, rows, columns)` of the `region`; `everywhere` `(n,)`: sum of their product over all
    pixels.
    """
    height, width = grey.shape
    top, left, rows, columns = region
    line, share = np.empty(width, _f4), np.empty(width, _f4)
    for m in range(len(mean)):
        total = 0.0
        for y in range(height):
            seen, expected, spread = grey[y], mean[m, y], variance[m, y]
            in_row = _f4(0)
            for x in range(width):
                before = min(spread[x] + noise.change, noise.unknown)
                whole = before + noise.observation
                off = _f4(seen[x]) - expected[x]
                nats = _LOG_GREYS - _f4(0.5) * (_LOG_2_PI + logarithm(whole) + off * off / whole)
                nats = max(nats, least)
                known = _f4(1) - before / noise.unknown
                line[x], share[x] = nats, known
                in_row += known * nats
            total += in_row
            if top <= y < top + rows:
                put(line[left : left + columns], ratio[m, y - top])
                put(share[left : left + columns], trust[m, y - top])
        everywhere[m] = total


@compiled
def update_maps(grey, mean, variance, parents, hidden, region, noise, new_mean, new_variance):
    """Filter every pixel of every map; no gain where `hidden` `(n, rows, columns)` in the region."""
    height, width = grey.shape
    top, left, rows, columns = region
    shown = np.empty(width, _f4)
    for m in range(len(parents)):
        parent = parents[m]
        for y in range(height):
            shown[:] = _f4(1)
            if top <= y < top + rows:
                covered = hidden[m, y - top]
                for x in range(columns):
                    shown[left + x] = _f4(1) - _f4(covered[x])
            seen, before, spread = grey[y], mean[parent, y], variance[parent, y]
            after, narrow = new_mean[m, y], new_variance[m, y]
            for x in range(width):
                wide = min(spread[x] + noise.change, noise.unknown)
                gain = shown[x] * wide / (wide + noise.observation)
                after[x] = before[x] + gain * (_f4(seen[x]) - before[x])
                narrow[x] = (_f4(1) - gain) * wide


class Pairs(NamedTuple):
    """Pairs of vertices with common texels, each vertex with itself first.

    `ends` `(n_pairs, 2)`: the vertices; `of_group` `(6, n_groups)`: pairs of corners aa, bb, cc, ab, bc, ca.
    """

    ends: NDArray[np.uint32]
    of_group: NDArray[np.uint32]


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
    """Write positions x_i and rows d x_i / d u of vertices, for every pose.

    `bases` `(n_vertices, 3, width)` float32, in the columns of the coefficients, 0 in the others; `rotations`
    `(n, 3, 3)`, `translations` `(n, 2)`, `morphs` `(n, n_bases)` float32; writes `positions` `(n, n_vertices,
    2)` px and `rows` `(n, n_vertices, 2, width)`, zero before, with the columns of `Poses.moved`.
    """
    n_vertices, width = len(bases), bases.shape[2]
    shapes = bases.reshape(-1)
    for d in range(len(rotations)):
        r, c, own = rotations[d], morphs[d], rows[d].reshape(-1)
        for i in range(n_vertices):
            h = 3 * i * width
            x = y = z = _f4(0)
            for j in range(len(c)):
                x += c[j] * bases[i, 0, 5 + j]
                y += c[j] * bases[i, 1, 5 + j]
                z += c[j] * bases[i, 2, 5 + j]
            px = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
            py = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
            pz = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
            for axis in range(2):
                for j in range(0, width, LANES):
                    at = (2 * i + axis) * width + j
                    add_vectors(own, at, r[axis, 0], shapes, h + j, r[axis, 1], shapes, h + width + j)
                    add_vector(own, at, r[axis, 2], shapes, h + 2 * width + j)
            rows[d, i, 0, 1], rows[d, i, 0, 2], rows[d, i, 0, 3] = pz, -py, _f4(1)
            rows[d, i, 1, 0], rows[d, i, 1, 2], rows[d, i, 1, 4] = -pz, px, _f4(1)
            positions[d, i, 0], positions[d, i, 1] = px + translations[d, 0], py + translations[d, 1]


@compiled
def normal_equations(level, number, texels, pairs, textures, owner, positions, rows, dimension, sums):
    """Write the normal equations of the texels' weighted squared differences to `sums`, for each pose.

    Pose m has the texture of expert `owner[m]` on level `number`; `rows` `(n, n_used, 2, width)` are d x / d
    u of the vertices, of which the first `dimension` columns are the pose's. Visible texels outside of the
    picture count with `OFF_PICTURE` and have no slope.
    """
    height, width = level.image.shape
    image, scale = level.image.reshape(-1), _f4(level.scale)
    first, n_groups, n_used, share = texels.first, len(texels.groups), rows.shape[1], 4**number
    corners = np.zeros((7, MOST), _f4)
    each = corners[6]
    at, inside, cells = own_array(np.uint32), own_array(_f4), np.zeros(4 * MOST, _f4)
    fx, fy = own_array(_f4), own_array(_f4)
    expected, area, weight = own_array(_f4), own_array(_f4), own_array(_f4)
    xx, xy, yy, xe, ye = own_array(_f4), own_array(_f4), own_array(_f4), own_array(_f4), own_array(_f4)
    expected[:] = _f4(0)
    moments = np.empty((24, MOST), _f4)
    blocks, right = np.empty((3, len(pairs.ends)), _f4), np.empty((2, n_used), _f4)
    for m in range(len(positions)):
        d = owner[m]
        blocks[:] = _f4(0)
        right[:] = _f4(0)
        squares = logs = total = 0.0
        for block in range(0, n_groups, MOST):
            place_corners(positions[m], texels, block, share, scale, corners)
            moments[:] = _f4(0)
            for row in range((len(first) - 2) // share + 1):
                n = row_length(first, row, share, block)
                if n <= 0:
                    break
                start, lanes = first[row] + block, whole_vectors(n)
                place_row(texels, row, lanes, scale, corners, (height, width), at, inside, fx, fy)
                fetch(image, width, at, n, cells)
                mean, precision = textures.mean[d, number, start:], textures.precision[d, start:]
                log_temperature, visible = textures.log_temperature[d, start:], textures.visible[d, start:]
                its_squares = its_logs = its_total = _f4(0)
                for g in range(n):
                    a = each[g] if visible[g] else _f4(0)
                    expected[g], area[g], weight[g] = mean[g], a, a * precision[g]
                    its_logs += a * log_temperature[g]
                    its_total += a
                area[n:lanes] = _f4(0)
                weight[n:lanes] = _f4(0)
                for g in range(lanes):
                    p00, p01, p10, p11 = cells[4 * g], cells[4 * g + 1], cells[4 * g + 2], cells[4 * g + 3]
                    above, below = p01 - p00, p11 - p10
                    slope = p10 - p00 + fx[g] * (below - above)
                    w = weight[g] * inside[g]
                    e = p00 + fx[g] * above + fy[g] * slope - expected[g]
                    across, down = (above + fy[g] * (below - above)) * scale, slope * scale
                    wx, wy = w * across, w * down
                    xx[g], xy[g], yy[g] = wx * across, wx * down, wy * down
                    xe[g], ye[g] = wx * e, wy * e
                    its_squares += w * e * e + (_f4(1) - inside[g]) * area[g] * OFF_PICTURE
                squares += its_squares
                logs += its_logs
                total += its_total
                wa, wb, wc = texels.weights[row, 0], texels.weights[row, 1], texels.weights[row, 2]
                _add_squares(xx, lanes, wa, wb, wc, moments, 0)
                _add_squares(xy, lanes, wa, wb, wc, moments, 6)
                _add_squares(yy, lanes, wa, wb, wc, moments, 12)
                _add_products(xe, lanes, wa, wb, wc, moments, 18)
                _add_products(ye, lanes, wa, wb, wc, moments, 21)
            _collect(pairs.of_group, block, moments, blocks, right)
        sums.totals[m, 0], sums.totals[m, 1], sums.totals[m, 2] = squares, logs, total
        _turn_into_pose(pairs.ends, blocks, right, rows[m], dimension, sums.matrices[m], sums.vectors[m])


@inlined
def _add_squares(value, lanes, a, b, c, moments, begin):
    """Add values times their weights of two corners, aa, bb, cc, ab, bc, ca, to rows of `moments`."""
    flat, at = moments.reshape(-1), begin * MOST
    for g in range(0, lanes, LANES):
        add_vector(flat, at + g, a * a, value, g)
        add_vector(flat, at + MOST + g, b * b, value, g)
        add_vector(flat, at + 2 * MOST + g, c * c, value, g)
        add_vector(flat, at + 3 * MOST + g, a * b, value, g)
        add_vector(flat, at + 4 * MOST + g, b * c, value, g)
        add_vector(flat, at + 5 * MOST + g, c * a, value, g)


@inlined
def _add_products(value, lanes, a, b, c, moments, begin):
    """Add values times their weights of one corner to rows of `moments`."""
    flat, at = moments.reshape(-1), begin * MOST
    for g in range(0, lanes, LANES):
        add_vector(flat, at + g, a, value, g)
        add_vector(flat, at + MOST + g, b, value, g)
        add_vector(flat, at + 2 * MOST + g, c, value, g)


@compiled
def _collect(of_group, block, moments, blocks, right):
    """Add the moments of a block's groups to those of the pairs, and of the vertices."""
    n = min(of_group.shape[1] - block, MOST)
    for part in range(3):
        for pair in range(6):
            numbers, target, values = of_group[pair, block:], blocks[part], moments[6 * part + pair]
            for g in range(n):
                target[numbers[g]] += values[g]
    for part in range(2):
        for corner in range(3):
            numbers, target, values = of_group[corner, block:], right[part], moments[18 + 3 * part + corner]
            for g in range(n):
                target[numbers[g]] += values[g]


@compiled
def _turn_into_pose(ends, blocks, right, rows, dimension, matrix, vector):
    """Turn the moments of pairs into the pose's matrix and vector, by the rows of their vertices."""
    n_vertices, width = len(rows), rows.shape[2]
    flat, step = rows.reshape(-1), 2 * width
    products = np.zeros(n_vertices * step, _f4)  # of which a matrix and its transpose make the sum
    curvature = matrix.reshape(-1)
    matrix[:] = _f4(0)
    vector[:] = _f4(0)
    for j in range(0, width, LANES):
        for p in range(len(ends)):
            half = _f4(0.5) if p < n_vertices else _f4(1)
            xx, xy, yy = half * blocks[0, p], half * blocks[1, p], half * blocks[2, p]
            v, w = step * ends[p, 0] + j, step * ends[p, 1] + j
            add_vectors(products, v, xx, flat, w, xy, flat, w + width)
            add_vectors(products, v + width, xy, flat, w, yy, flat, w + width)
        for v in range(n_vertices):
            begin = step * v + j
            add_vectors(vector, j, right[0, v], flat, begin, right[1, v], flat, begin + width)
            for i in range(dimension):
                x, y = rows[v, 0, i], rows[v, 1, i]
                add_vectors(curvature, i * width + j, x, products, begin, y, products, begin + width)
    for i in range(dimension):
        for j in range(i + 1):
            both = matrix[i, j] + matrix[j, i]
            matrix[i, j] = matrix[j, i] = both


NOWHERE = 1e300  # energy of a pose in which nothing faces the viewer
SLIGHTEST = 1e-12  # least pivot of a scaled curvature, against rounding


class PoseArrays(NamedTuple):
    """The parts of `Poses`."""

    rotations: Array
    translations: Array
    morphs: Array


class Objective(NamedTuple):
    """Energy of poses without the prior, and its derivatives.

    `energy` `(m,)`, `gradient` `(m, dimension)`, `curvature` `(m, dimension, dimension)`; `seen` `(m,)`:
    whether anything faces the viewer; `rows` `(m, n_vertices, 2, width)` float32: d x / d u of vertices.
    """

    energy: Array
    gradient: Array
    curvature: Array
    seen: NDArray[np.bool_]
    rows: NDArray[np.float32]


class SearchState(NamedTuple):
    """Best pose of each expert until now, with energy and derivatives there, prior included."""

    poses: PoseArrays
    energy: Array
    gradient: Array
    curvature: Array
    rows: NDArray[np.float32]
    damping: Array


class StepLimits(NamedTuple):
    """Longest and shortest motion of a vertex in a step, px; whether this is the first evaluation of a level,
    which is always accepted."""

    longest: float
    shortest: float
    first: bool


@compiled
def advance(active, tried, belief, prior, precision, climb, pace, going, following):
    """Accept the poses `tried` for experts `active` if their energy is lower, and propose the next ones.

    `prior` are the predicted poses of all experts, of `precision` `(dimension,)`. Writes `climb`, the experts
    `going` on and, in the same order, the poses `following`. Returns their number.
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
                put(belief.curvature[m, i], climb.curvature[d, i])
                climb.curvature[d, i, i] += precision[i]
            for v in range(belief.rows.shape[1]):
                put(belief.rows[m, v, 0], climb.rows[d, v, 0])
                put(belief.rows[m, v, 1], climb.rows[d, v, 1])
            for i in range(3):
                put(tried.rotations[m, i], climb.poses.rotations[d, i])
            put(tried.translations[m], climb.poses.translations[d])
            put(tried.morphs[m], climb.poses.morphs[d])
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
    """Write the change from pose d of `other` to pose m; see `Poses.changes_from`."""
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
    # the sine vanishes at half a turn, which no step of a search reaches
    share = 0.5 * angle / sine if sine > 1e-9 else 0.5
    change[0], change[1], change[2] = share * x, share * y, share * z
    for i in range(2):
        change[3 + i] = poses.translations[m, i] - other.translations[d, i]
    for i in range(len(change) - 5):
        change[5 + i] = poses.morphs[m, i] - other.morphs[d, i]


@compiled
def _move(poses, d, change, moved, m):
    """Write pose d, changed, to pose m of `moved`; see `Poses.moved`."""
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


class Scans(NamedTuple):
    """Scan lines across an outline: through `places` `(n, n_points, 2)` px along unit `normals`, each for a
    length of outline, px, 0 if unused; `reach` steps of `step` px to either side."""

    places: NDArray[np.float64]
    normals: NDArray[np.float64]
    lengths: NDArray[np.float64]
    reach: int
    step: float


@compiled
def place_equations(
    rotations, translations, morphs, which, bases, targets, information, energy, gradient, curvature
):
    """Write energy, gradient and Gauss-Newton curvature of sum (x - t)' I (x - t) / 2 over points.

    Pose m uses row `which[m]` of `bases` `(n, n_points, n_bases, 3)`, `targets` `(n, n_points, 2)` and
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
def find_edges(contrast, region, scans, share, noise, targets, information):
    """Find the edge of an object along the normals of its outline, between object and background.

    `contrast` `(n_maps, height, width)` float32: log density of the background over that of the object, of
    pixels of the `region`; one map for all, or one each. Writes `targets` `(n, n_points, 2)` and
    `information` `(n, n_points, 3)`, zero if a scan has none. The variance `noise`, in steps, is added to the
    result; `share` `(n,)` is the weight of a px of outline. Nats are not multiplied by it, which would bias
    the edge.
    """
    places, normals, lengths, reach, step = scans
    top, left, height, width = region
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
            # the scan's own prior, about its middle, is divided out of the mean as well
            at = min(max(mean / (variance * gain), -reach * step), reach * step)
            gain *= share[m] * lengths[m, i]
            targets[m, i, 0] += at * nx
            targets[m, i, 1] += at * ny
            information[m, i, 0] = gain * nx * nx
            information[m, i, 1] = gain * nx * ny
            information[m, i, 2] = gain * ny * ny
