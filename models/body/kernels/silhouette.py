"""Loops over the contours of many upper bodies: where they are, and what hides them.

A body is a head (ellipsoid), a torso (flat, with a neck, in a plane that leans and turns), two hands
(spheres) and four limbs (each the union of spheres between its ends), seen along z. All depths are exact for
these solids.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...numerics.compiled import compiled
from .kinematics import rotation

_f4 = np.float32

# parts, as `silhouette.OUTLINE_PARTS` names them
_HEAD, _TORSO = 0, 1
_ROUND = (0, 4, 7)
_N_PARTS = 8

NUMBERS = 13
"""At most so many describe the place of a part."""

_EDGE_ON = 0.1
"""Cosine to which a torso is turned away at most as far as its picture goes, so that it has an inverse."""

_FAR = _f4(1e9)
"""Depth where a part is not."""


class Solid(NamedTuple):
    """A body as these loops take it; all but `lengths` and `firsts` are float32."""

    lengths: NDArray[np.float64]
    """`(12,)` px, see `_put_body`."""
    torso: NDArray[np.float32]
    """`(4, 4)`, see `_torso_fronts`."""
    torso_points: NDArray[np.float32]
    """`(c, 2)` px from the root, in its plane: its contour."""
    torso_normals: NDArray[np.float32]
    """`(c, 2)`: of its contour."""
    circles: NDArray[np.float32]
    """`(m, 2)`: points of unit circles for head and hands."""
    firsts: NDArray[np.intp]
    """`(9,)`: part j has the points `firsts[j]` to `firsts[j + 1]`."""
    tolerance: np.float32
    """px: a point is hidden by what is so much nearer."""
    rim: np.float32
    """Share of a part's squared radius that hides nothing, see `_fronts`."""


@compiled
def _ellipsoid_fronts(shape, rim, xs, ys, out):
    """Depths of an ellipsoid `(centre 3, inverse of the outline's matrix 3, slope 2, depth^2)`."""
    cx, cy, cz, xx, xy, yy = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    gx, gy, square = shape[6], shape[7], shape[8]
    for k in range(len(xs)):
        dx, dy = xs[k] - cx, ys[k] - cy
        inner = _f4(1) - (xx * dx + xy * dy) * dx - (xy * dx + yy * dy) * dy
        front = cz + gx * dx + gy * dy - np.sqrt(square * max(inner, _f4(0)))
        out[k] = front if inner > rim else _FAR


@compiled
def _capsule_fronts(shape, rim, xs, ys, out):
    """Depths of a limb `(start 3, extent 3, radius, its change, a, 1 / a, steepness)`.

    Sphere t of 0 to 1 spans h(t) = r(t)^2 - |p - c(t)|^2 = h(0) + 2 b t - a t^2 in depth about its centre; of
    z(t) - sqrt(h(t)) the least is taken.
    """
    cx, cy, cz, ex, ey, ez = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    radius, change, a, inverse, steepness = shape[6], shape[7], shape[8], shape[9], shape[10]
    square, growth = radius * radius, radius * change
    for k in range(len(xs)):
        wx, wy = xs[k] - cx, ys[k] - cy
        start = square - wx * wx - wy * wy
        b = wx * ex + wy * ey + growth
        widest = b * inverse
        nearest = min(max(widest, _f4(0)), _f4(1))
        inner = start + nearest * (_f4(2) * b - a * nearest)
        t = min(max(widest - steepness * np.sqrt(max(start + b * widest, _f4(0))), _f4(0)), _f4(1))
        span = max(start + t * (_f4(2) * b - a * t), _f4(0))
        front = cz + t * ez - np.sqrt(span)
        out[k] = front if inner > rim * square else _FAR


@compiled
def _end_on_fronts(shape, rim, xs, ys, out):
    """As `_capsule_fronts` for a limb whose one end holds the other: the nearest of its ends."""
    cx, cy, cz, ex, ey, ez = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    first, last = shape[6] * shape[6], (shape[6] + shape[7]) * (shape[6] + shape[7])
    for k in range(len(xs)):
        wx, wy = xs[k] - cx, ys[k] - cy
        start = first - wx * wx - wy * wy
        wx, wy = wx - ex, wy - ey
        end = last - wx * wx - wy * wy
        near = cz - np.sqrt(max(start, _f4(0))) if start > rim * first else _FAR
        other = cz + ez - np.sqrt(max(end, _f4(0))) if end > rim * last else _FAR
        out[k] = min(near, other)


@compiled
def _torso_fronts(torso, shape, xs, ys, out):
    """Depths of a torso `(middle 2, depth below and above it, lean of the neck, its end, axes 6, scale)`.

    The axes are those of its plane in space, across and down; the scale is the inverse of their determinant
    in the picture. `torso` `(4, 4)` has, from the top, pieces (beginning and length in px below the root,
    half width at the beginning, its increase per px); the first is the neck, which leans as the head does,
    and not in depth as the torso.
    """
    cx, cy, low, high, lean, top = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    across_x, across_y = shape[10] * shape[12], -shape[9] * shape[12]
    down_x, down_y = -shape[7] * shape[12], shape[6] * shape[12]
    aside, below = shape[8], shape[11]
    foot, narrow, end = torso[1, 0], torso[0, 2], torso[3, 0] + torso[3, 1]
    length1, steep1 = torso[1, 1], torso[1, 3]
    begin2, length2, steep2 = torso[2, 0], torso[2, 1], torso[2, 3]
    begin3, length3, steep3 = torso[3, 0], torso[3, 1], torso[3, 3]
    for k in range(len(xs)):
        x, y = xs[k] - cx, ys[k] - cy
        off, dy = across_x * x + across_y * y, down_x * x + down_y * y
        dx = abs(off - lean * max(foot - dy, _f4(0)))
        half = narrow + steep1 * min(max(dy - foot, _f4(0)), length1)
        half += steep2 * min(max(dy - begin2, _f4(0)), length2)
        half += steep3 * min(max(dy - begin3, _f4(0)), length3)
        outside = max(dx - half, max(top - dy, dy - end))
        front = aside * off + (low + below * dy if dy > _f4(0) else high)
        out[k] = front if outside < _f4(0) else _FAR


@compiled
def _put_ellipsoid(shape, x, y, z, xx, xy, yy, xz, yz, zz):
    """An ellipsoid |S^(-1/2) (p - c)| <= 1 from its centre and its matrix S."""
    determinant = xx * yy - xy * xy
    shape[0], shape[1], shape[2] = x, y, z
    shape[3], shape[4], shape[5] = yy / determinant, -xy / determinant, xx / determinant
    shape[6] = (yy * xz - xy * yz) / determinant
    shape[7] = (xx * yz - xy * xz) / determinant
    shape[8] = zz - shape[6] * xz - shape[7] * yz


@compiled
def _put_head(shape, vector, neck, axes, x, y):
    """The head of a body with root `(x, y)`: `vector` turns it about there."""
    # where the half axes across, down and through the head point
    (r00, r10, r20), (r01, r11, r21), (r02, r12, r22) = rotation(vector[0], vector[1], vector[2])
    a, b, c = axes[0] * axes[0], axes[1] * axes[1], axes[2] * axes[2]
    _put_ellipsoid(
        shape, x - neck * r01, y - neck * r11, -neck * r21,
        a * r00 * r00 + b * r01 * r01 + c * r02 * r02,
        a * r00 * r10 + b * r01 * r11 + c * r02 * r12,
        a * r10 * r10 + b * r11 * r11 + c * r12 * r12,
        a * r00 * r20 + b * r01 * r21 + c * r02 * r22,
        a * r10 * r20 + b * r11 * r21 + c * r12 * r22,
        a * r20 * r20 + b * r21 * r21 + c * r22 * r22,
    )  # fmt: skip


@compiled
def _put_capsule(shape, x, y, z, ex, ey, ez, first, last):
    """A limb from `(x, y, z)` along `(ex, ey, ez)` whose radius goes from `first` to `last`."""
    shape[0], shape[1], shape[2], shape[3], shape[4], shape[5] = x, y, z, ex, ey, ez
    change = last - first
    a = ex * ex + ey * ey - change * change
    shape[6], shape[7], shape[8] = first, change, a
    # nearly end-on counts as end-on, before the division loses all digits
    if a > 1e-4 * first * first:
        shape[9] = 1 / a
        shape[10] = ez / np.sqrt(a * (a + ez * ez))
    else:
        shape[8] = shape[9] = shape[10] = 0.0


@compiled
def _put_torso(shape, vector, depth, x, y):
    """The plane of a torso, `depth` behind the root `(x, y)`, about which `vector` turns it."""
    right, down, away = rotation(vector[0], vector[1], vector[2])
    shape[0], shape[1], shape[2] = x + depth * away[0], y + depth * away[1], depth * away[2]
    shape[6], shape[7], shape[8] = right
    shape[9], shape[10], shape[11] = down
    shape[12] = 1 / max(right[0] * down[1] - right[1] * down[0], _EDGE_ON)


@compiled
def _put_neck(shape, head, chin, foot, least):
    """The neck of a torso, which goes with the head; the chin, `chin` before its middle, is before it."""
    x, y = head[0] - shape[0], head[1] - shape[1]
    across = (shape[10] * x - shape[9] * y) * shape[12]
    down = (shape[6] * y - shape[7] * x) * shape[12]
    shape[3] = shape[2] + max(head[2] + chin, 0.0)
    # its upper end is in the middle of the head
    shape[5] = min(down, foot)
    shape[4] = across / max(foot - shape[5], least)


@compiled
def _put_body(root, torso_vector, neck_vector, arms, lengths, torso, shapes):
    """Describe the parts of one pose in `shapes` `(8, NUMBERS)`, see the functions `_*_fronts`.

    `lengths` `(12,)` px: neck, half axes of the head (3), shoulder width, upper arm, forearm, hand, radii of
    shoulder, elbow and wrist, depth of the torso's plane.
    """
    head, trunk = shapes[_HEAD], shapes[_TORSO]
    _put_head(head, neck_vector, lengths[0], lengths[1:4], root[0], root[1])
    _put_torso(trunk, torso_vector, lengths[11], root[0], root[1])
    _put_neck(trunk, head, lengths[3], torso[1, 0], 0.25 * lengths[0])
    right, _, _ = rotation(torso_vector[0], torso_vector[1], torso_vector[2])
    for side in range(2):
        first = 2 + 3 * side
        aside = (0.5 - side) * lengths[4]
        x, y, z = root[0] + aside * right[0], root[1] + aside * right[1], aside * right[2]
        ex, ey, ez = (
            lengths[5] * arms[side, 0, 0],
            lengths[5] * arms[side, 0, 1],
            lengths[5] * arms[side, 0, 2],
        )
        _put_capsule(shapes[first], x, y, z, ex, ey, ez, lengths[8], lengths[9])
        x, y, z = x + ex, y + ey, z + ez
        ex, ey, ez = (
            lengths[6] * arms[side, 1, 0],
            lengths[6] * arms[side, 1, 1],
            lengths[6] * arms[side, 1, 2],
        )
        _put_capsule(shapes[first + 1], x, y, z, ex, ey, ez, lengths[9], lengths[10])
        square = lengths[7] * lengths[7]
        _put_ellipsoid(shapes[first + 2], x + ex, y + ey, z + ez, square, 0.0, square, 0.0, 0.0, square)


@compiled
def _trace_torso(shape, contour, across, xs, ys, normals, depths):
    """Points of a torso's outline from those in its plane, `(c, 2)`, and their normals `across` there."""
    for k in range(len(contour)):
        off, down = contour[k, 0], contour[k, 1]
        xs[k] = shape[0] + shape[6] * off + shape[9] * down
        ys[k] = shape[1] + shape[7] * off + shape[10] * down
        depths[k] = shape[2] + shape[8] * off + shape[11] * max(down, _f4(0))
        # normals turn by the inverse, the other way round
        nx = shape[10] * across[k, 0] - shape[7] * across[k, 1]
        ny = shape[6] * across[k, 1] - shape[9] * across[k, 0]
        shrink = _f4(1) / np.sqrt(nx * nx + ny * ny)
        normals[k, 0], normals[k, 1] = nx * shrink, ny * shrink


@compiled
def _trace_ellipsoid(shape, circle, xs, ys, normals, depths):
    """Points of an ellipsoid's outline from points of a circle `(m, 2)`."""
    # the outline is the image of the circle under a triangular root of the matrix's inverse
    diagonal = _f4(1) / np.sqrt(shape[3])
    below = shape[4] * diagonal
    last = _f4(1) / np.sqrt(shape[5] - below * below)
    for k in range(len(circle)):
        dy = circle[k, 1] * last
        dx = (circle[k, 0] - below * dy) * diagonal
        xs[k], ys[k] = shape[0] + dx, shape[1] + dy
        nx, ny = shape[3] * dx + shape[4] * dy, shape[4] * dx + shape[5] * dy
        shrink = _f4(1) / np.sqrt(nx * nx + ny * ny)
        normals[k, 0], normals[k, 1] = nx * shrink, ny * shrink
        depths[k] = shape[2] + shape[6] * dx + shape[7] * dy


@compiled
def _trace_capsule(shape, xs, ys, normals, depths):
    """An even number of points along a limb's outline without the cap at its end: side, cap, other side."""
    if shape[9] > _f4(0):
        shrink = _f4(1) / np.sqrt(shape[3] * shape[3] + shape[4] * shape[4])
        ex, ey = shape[3] * shrink, shape[4] * shrink
        along = -shape[7] * shrink
        across, side = np.sqrt(shape[8]) * shrink, np.sqrt(shape[8])
        half_arc = _f4(np.pi) - _f4(np.arctan2(across, along))
        x, y, z, radius = shape[0], shape[1], shape[2], shape[6]
    else:
        ex, ey, along, across, side, half_arc = _f4(0), _f4(-1), _f4(1), _f4(0), _f4(1), _f4(np.pi)
        wider = _f4(1) if shape[7] > _f4(0) else _f4(0)
        x, y = shape[0] + wider * shape[3], shape[1] + wider * shape[4]
        z, radius = shape[2] + wider * shape[5], shape[6] + wider * shape[7]
    half = len(xs) // 2
    arc = radius * half_arc
    step = (arc + (side if shape[9] > _f4(0) else _f4(0))) / _f4(half)
    # turn from the middle of the cap, half a step at first
    cosine, sine = _f4(np.cos(step / radius)), _f4(np.sin(step / radius))
    forwards, sideways = -_f4(np.cos(_f4(0.5) * step / radius)), _f4(np.sin(_f4(0.5) * step / radius))
    for k in range(half):
        way = (_f4(k) + _f4(0.5)) * step
        t = max(way - arc, _f4(0)) / side
        if way >= arc:
            forwards, sideways = along, across
        reach = radius + t * shape[7]
        cx, cy, depth = x + t * shape[3], y + t * shape[4], z + t * shape[5]
        for sign in (-1, 1):
            place = half + k if sign > 0 else half - 1 - k
            nx, ny = forwards * ex - sign * sideways * ey, forwards * ey + sign * sideways * ex
            xs[place], ys[place], depths[place] = cx + reach * nx, cy + reach * ny, depth
            normals[place, 0], normals[place, 1] = nx, ny
        forwards, sideways = forwards * cosine + sideways * sine, sideways * cosine - forwards * sine


@compiled
def _fronts(shape, kind, torso, rim, xs, ys, out):
    """Depths `out` `(m,)` of a part's front at points `(m,)`, `_FAR` where it is not.

    The outermost share `rim` of a round part's squared radius counts as outside.
    """
    if kind == _TORSO:
        _torso_fronts(torso, shape, xs, ys, out)
    elif kind in _ROUND:
        _ellipsoid_fronts(shape, rim, xs, ys, out)
    elif shape[9] > _f4(0):
        _capsule_fronts(shape, rim, xs, ys, out)
    else:
        _end_on_fronts(shape, rim, xs, ys, out)


@compiled
def outlines(roots, torsos, necks, arms, solid, points, normals, visible):
    """Contours of the parts of each pose, and which of their points are seen.

    `roots` `(n, 2)`, `torsos` and `necks` `(n, 3)`, `arms` `(n, 2, 2, 3)` as in `BodyPoses`. Writes `points`,
    `normals` `(n, m, 2)` float32 and `visible` `(n, m)` bool.
    """
    torso, firsts = solid.torso, solid.firsts
    count = points.shape[1]
    shapes = np.zeros((_N_PARTS, NUMBERS), np.float32)
    xs, ys = np.zeros(count, np.float32), np.zeros(count, np.float32)
    depths, fronts = np.zeros(count, np.float32), np.zeros(count, np.float32)
    least = np.zeros(count, np.float32)
    for pose in range(len(roots)):
        _put_body(roots[pose], torsos[pose], necks[pose], arms[pose], solid.lengths, torso, shapes)
        for part in range(_N_PARTS):
            run = slice(firsts[part], firsts[part + 1])
            shape = shapes[part]
            if part == _TORSO:
                _trace_torso(
                    shape, solid.torso_points, solid.torso_normals,
                    xs[run], ys[run], normals[pose, run], depths[run],
                )  # fmt: skip
            elif part in _ROUND:
                _trace_ellipsoid(shape, solid.circles[run], xs[run], ys[run], normals[pose, run], depths[run])
            else:
                _trace_capsule(shape, xs[run], ys[run], normals[pose, run], depths[run])
        for k in range(count):
            least[k] = _FAR
        for part in range(_N_PARTS):
            _fronts(shapes[part], part, torso, solid.rim, xs, ys, fronts)
            for k in range(firsts[part], firsts[part + 1]):
                fronts[k] = _FAR
            for k in range(count):
                least[k] = min(least[k], fronts[k])
        at, shown = points[pose], visible[pose]
        for k in range(count):
            at[k, 0], at[k, 1] = xs[k], ys[k]
        for k in range(count):
            shown[k] = least[k] >= depths[k] - solid.tolerance
