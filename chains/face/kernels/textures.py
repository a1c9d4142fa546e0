"""Compiled loops over texels of many experts: places, Kalman updates, densities, background maps.

Texels lie in rows, the k-th of each group side by side (see `SurfaceTexels`). Loops run along rows,
so that whole vectors of texels have the same weights of their corners and no sum crosses a vector.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import LANES, MOST, compiled, inlined, logarithm, own_array

Map = NDArray[np.float32]

_f4 = np.float32

OFF_PICTURE = _f4(6)
"""e^2 / tau that a visible texel off the picture counts for: its density is then about that of any grey value
(-log 256, where tau is 36), so that leaving the picture does not pay."""


class Texels(NamedTuple):
    """Where texels lie on a surface; as of `SurfaceTexels`, with the numbers of the vertices in use.

    `weights` `(n_rows, 3)` and `offsets` `(n_rows, 2)` are those of the rows, `counts` `(n_groups,)` says how
    many texels a group has.
    """

    groups: NDArray[np.uint32]
    first: NDArray[np.int32]
    counts: NDArray[np.int32]
    weights: Map
    offsets: Map
    areas: Map


class Textures(NamedTuple):
    """What experts expect: `mean` `(n_experts, n_levels, n_texels)`, the others `(n_experts, n_texels)`;
    `precision` is 1 / tau."""

    mean: Map
    precision: Map
    log_temperature: Map
    visible: NDArray[np.bool_]


@compiled
def place_corners(positions, texels, block, share, scale, corners):
    """Corners of the groups of a block on a level, and the area that each of their texels stands for.

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
    """How many groups of a block have a texel in a row, where one `share`-th of them is used."""
    fine = row * share
    return min(first[fine + 1] - first[fine] - block, MOST)


@inlined
def whole_vectors(n):
    """The next multiple of a vector's lanes: loops over these have no rest that goes texel by texel."""
    return (n + LANES - 1) // LANES * LANES


@inlined
def place_row(texels, row, n, scale, corners, size, at, inside, rest_x, rest_y):
    """Find the cells of a picture of `size` (height, width) in which the first `n` texels of a row are.

    Writes the number `at` of their upper left pixel (or that of the nearest cell), whether they are `inside`,
    1 or 0, and where they are in the cell.
    """
    ax, bx, cx, ay, by, cy = corners[0], corners[1], corners[2], corners[3], corners[4], corners[5]
    wa, wb, wc = texels.weights[row, 0], texels.weights[row, 1], texels.weights[row, 2]
    shift = _f4(0.5) * (scale - _f4(1))  # pixel centres are whole numbers on every level
    ox, oy = texels.offsets[row, 0] * scale + shift, texels.offsets[row, 1] * scale + shift
    width = np.int32(size[1])
    right, bottom = _f4(size[1] - 1), _f4(size[0] - 1)
    for g in range(n):
        x = wa * ax[g] + wb * bx[g] + wc * cx[g] + ox
        y = wa * ay[g] + wb * by[g] + wc * cy[g] + oy
        inside[g] = _f4((x >= _f4(0)) & (y >= _f4(0)) & (x <= right) & (y <= bottom))
        x = min(max(x, _f4(0)), right - _f4(0.001))
        y = min(max(y, _f4(0)), bottom - _f4(0.001))
        column, line = np.int32(x), np.int32(y)
        at[g] = np.uint32(line * width + column)
        rest_x[g], rest_y[g] = x - _f4(column), y - _f4(line)


@inlined
def fetch(image, width, at, n, cells):
    """Copy the four pixels of cells, one after the other: loads one by one are faster than a vector's."""
    width = np.uint32(width)
    for g in range(n):
        k = at[g]
        p00, p01, p10, p11 = image[k], image[k + 1], image[k + width], image[k + width + 1]
        cells[4 * g], cells[4 * g + 1], cells[4 * g + 2], cells[4 * g + 3] = p00, p01, p10, p11


@compiled
def texel_densities(level, number, texels, textures, owner, positions, extra, sums):
    """Sums of a_i e_i^2 / tau_i, a_i log tau_i, a_i, and a_i times `extra` at x_i, for poses of owners.

    Pose m is judged with the texture and the visibility of expert `owner[m]` on level `number`; `extra`,
    of the shape of the level's image or empty, is a map of which the sum over the covered pixels is wanted (a
    background's log density). Visible texels off the picture count with `OFF_PICTURE`.
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
    """What texels look like in the picture: `values[:, number]`, and `area` `(n, n_texels)` of those seen.

    The area is 0 of hidden ones and below 0 of those off the picture. Of every group the first part is
    sampled, one `share`-th; what belongs to the others is left alone.
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
    """Sums over texels that are `on` `(n_experts, n_texels)` of their area times a map at their place.

    `maps` `(n_maps, height, width)` are one for all or one an expert; they are 0 beyond their edges.
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
    """Of texels, each `(n_experts, n_texels)` float32 or `(1, n_texels)` where it is the same for all.

    Squared grey levels of an observation and of what changed since the last one, and variance after the first
    look.
    """

    rendering: Map
    process: Map
    first: Map


class Lasting(NamedTuple):
    """Lasting textures `(n_experts, n_texels)`, or nothing `(0, 0)`; mean and looks."""

    mean: Map
    looks: Map


class Memory(NamedTuple):
    """How lasting textures learn, of texels `(n_experts, n_texels)` or `(1, n_texels)`: what their first
    picture counts for, and the least share of a new one."""

    first: Map
    share: Map


@compiled
def predict(mean, variance, lasting, returned, noises, most, new_mean, new_variance):
    """Variances grow, up to `most`, and means return by a share to the lasting texture where there is one."""
    process = noises.process
    for d in range(len(variance)):
        change = process[d if len(process) > 1 else 0]
        before, after = variance[d], new_variance[d]
        for i in range(len(before)):
            after[i] = min(before[i] + change[i], most)
        new_mean[d] = mean[d]
        if len(lasting.mean):
            where, looks, its_mean = lasting.mean[d], lasting.looks[d], new_mean[d, 0]
            for i in range(len(before)):
                off = where[i] - its_mean[i] if looks[i] > _f4(0) else _f4(0)
                its_mean[i] += returned * off


@compiled
def learn(observed, seen, mean, variance, noises, unknown, new_mean, new_variance):
    """Kalman update of the finest level of every texel that is seen; the coarse ones hold what is seen.

    Texels of a variance of `unknown` or more take what they are seen to be.
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
    """Means over all that was seen, of texels that are seen; as of `LastingTexture`. A picture counts for
    `weight` of the usual rate."""
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
def explain(observed, mean, visible, seen, least_inside, share):
    """Share of the picture's variance that predictions explain, as of `texture_filter.explained`."""
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
    """Squared grey levels: of an observation, of a change since the last one, and of a pixel never seen."""

    observation: np.float32
    change: np.float32
    unknown: np.float32


@compiled
def compare_with_maps(grey, mean, variance, box, noise, least, ratio, trust, everywhere):
    """Log density of a picture under each map over the uniform one, and the trust in it, cut out of a box.

    `grey` `(height, width)` uint8; `mean` and `variance` `(n, height, width)`; `ratio` (not below `least`
    nats) and `trust` `(n, rows, columns)` of the `box`; `everywhere` `(n,)`: sum of their product over all
    pixels.
    """
    height, width = grey.shape
    top, left, rows, columns = box
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
                ratio[m, y - top] = line[left : left + columns]
                trust[m, y - top] = share[left : left + columns]
        everywhere[m] = total


@compiled
def update_maps(grey, mean, variance, parents, hidden, box, noise, new_mean, new_variance):
    """Kalman filter of every pixel of every map; no gain where `hidden` `(n, rows, columns)` in the box."""
    height, width = grey.shape
    top, left, rows, columns = box
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
