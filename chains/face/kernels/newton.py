"""Compiled loops of Gauss-Newton: normal equations of textured surfaces, damped steps of many experts.

The places of texels are linear in those of vertices, and these in the change of the pose, x_v = X_v u. So no
Jacobian of a texel is kept: J'J = sum over pairs (v, w) of X_v' M_vw X_w, where the 2 x 2 blocks M_vw collect
the slopes of the picture times the weights of both vertices, texel by texel. There are as many of them as
vertices and edges, far fewer than texels.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import LANES, MOST, add_vector, add_vectors, compiled, inlined, own_array
from .textures import OFF_PICTURE, Map, fetch, place_corners, place_row, row_length, whole_vectors

_f4 = np.float32


class Pairs(NamedTuple):
    """Pairs of vertices that texels share, each vertex with itself first.

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
    """Positions x_i and the rows d x_i / d u of vertices, for every pose.

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
    """Normal equations of the texels' weighted squared differences, for poses of experts.

    Pose m is that of expert `owner[m]`, whose texture on level `number` is taken; `rows` `(n, n_used, 2,
    width)` are d x / d u of the vertices, of which the first `dimension` columns are the pose's. Writes
    `sums` (`NormalSums`).
    Visible texels off the picture count with `OFF_PICTURE` and have no slope.
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
    """The same times the weight of one corner."""
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
