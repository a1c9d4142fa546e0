"""Compiled loops over the outlines of bodies.

A body is a head (ellipsoid), a torso (flat, with a neck, in a plane that leans and turns), two hands
(spheres) and four limbs (each the union of spheres between its ends), seen along z, with exact depths. Arrays
are handed on whole with the number of a row: a view of a row costs as much as ten points.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.body.kernels import rotation
from ....models.numerics.compiled import compiled, exponential, helper, logarithm

_f4 = np.float32

# parts, as `silhouette.OUTLINE_PARTS` names them
HEAD, TORSO = 0, 1
ROUND = (0, 4, 7)
N_PARTS = 8

NUMBERS = 13  # at most so many describe the place of a part
ROW = 5  # numbers of each point of an outline: x, y, depth, the normal's x and y
_EDGE_ON = 0.1  # cosine to which a torso's picture turns away at most, so that it has an inverse
FAR = _f4(1e9)  # depth where a part is not


class Solid(NamedTuple):
    """A body as these loops take it; all but `lengths` and `firsts` are float32."""

    lengths: NDArray[np.float64]  # `(12,)` px, see `put_body`
    torso: NDArray[np.float32]  # `(4, 4)`, see `_torso_fronts`
    # `(r, 4, LANES)`: x and y px of its contour from the root, in its plane, and those of its normals
    torso_points: NDArray[np.float32]
    circles: NDArray[np.float32]  # `(rows, 2, LANES)`: points of unit circles for head and hands
    # `(3, LANES)`: by how many steps a point is from the beginning of a limb's outline, on which side it is,
    # and how many steps there are
    limb_points: NDArray[np.float32]
    firsts: NDArray[np.intp]  # `(9,)`: part j has the rows `firsts[j]` to `firsts[j + 1]`
    counted: NDArray[np.float32]  # `(rows, LANES)`: 1 where a point counts, else 0
    tolerance: np.float32  # px: a point is hidden by what is so much nearer
    rim: np.float32  # share of a part's squared radius that hides nothing, see `fronts`


@helper
def _put_ellipsoid(shapes, part, bounds, middle, matrix):
    """An ellipsoid |S^(-1/2) (p - c)| <= 1 from its centre and its matrix S (xx, xy, yy, xz, yz, zz)."""
    x, y, z = middle
    xx, xy, yy, xz, yz, zz = matrix
    inverse = 1 / (xx * yy - xy * xy)
    gx, gy = inverse * (yy * xz - xy * yz), inverse * (xx * yz - xy * xz)
    shapes[part, 0], shapes[part, 1], shapes[part, 2] = x, y, z
    shapes[part, 3], shapes[part, 4], shapes[part, 5] = yy * inverse, -xy * inverse, xx * inverse
    shapes[part, 6], shapes[part, 7] = gx, gy
    shapes[part, 8] = zz - gx * xz - gy * yz
    wide, high = np.sqrt(xx), np.sqrt(yy)
    bounds[part, 0], bounds[part, 1] = x - wide, x + wide
    bounds[part, 2], bounds[part, 3] = y - high, y + high


@helper
def _put_capsule(shapes, part, bounds, start, extent, first, last):
    """A limb from `start` along `extent`, both x, y, z, whose radius goes from `first` to `last`."""
    x, y, z = start
    ex, ey, ez = extent
    shapes[part, 0], shapes[part, 1], shapes[part, 2] = x, y, z
    shapes[part, 3], shapes[part, 4], shapes[part, 5] = ex, ey, ez
    change = last - first
    a = ex * ex + ey * ey - change * change
    shapes[part, 6], shapes[part, 7], shapes[part, 8] = first, change, a
    # nearly end-on counts as end-on, before the division loses all digits
    if a > 1e-4 * first * first:
        shapes[part, 9] = 1 / a
        shapes[part, 10] = ez / np.sqrt(a * (a + ez * ez))
    else:
        shapes[part, 8] = shapes[part, 9] = shapes[part, 10] = 0.0
    bounds[part, 0], bounds[part, 1] = min(x - first, x + ex - last), max(x + first, x + ex + last)
    bounds[part, 2], bounds[part, 3] = min(y - first, y + ey - last), max(y + first, y + ey + last)


@helper
def _put_torso(shapes, bounds, axes, depth, x, y, chin, torso, least):
    """A torso whose plane is `depth` behind the root `(x, y)`, with its neck, which goes with the head."""
    right, down, away = axes
    cx, cy, cz = x + depth * away[0], y + depth * away[1], depth * away[2]
    scale = 1 / max(right[0] * down[1] - right[1] * down[0], _EDGE_ON)
    off_x, off_y = shapes[HEAD, 0] - cx, shapes[HEAD, 1] - cy
    across = (down[1] * off_x - down[0] * off_y) * scale
    foot, bottom = torso[1, 0], torso[3, 0] + torso[3, 1]
    # its upper end is in the middle of the head
    top = min((right[0] * off_y - right[1] * off_x) * scale, foot)
    lean = across / max(foot - top, least)
    shapes[TORSO, 0], shapes[TORSO, 1], shapes[TORSO, 2] = cx, cy, cz
    shapes[TORSO, 3] = cz + max(shapes[HEAD, 2] + chin, 0.0)
    shapes[TORSO, 4], shapes[TORSO, 5] = lean, top
    shapes[TORSO, 6], shapes[TORSO, 7], shapes[TORSO, 8] = right
    shapes[TORSO, 9], shapes[TORSO, 10], shapes[TORSO, 11] = down
    shapes[TORSO, 12] = scale
    half = max(max(torso[0, 2], torso[1, 2]), max(torso[2, 2], torso[3, 2]))
    half = max(half, torso[3, 2] + torso[3, 1] * torso[3, 3]) + abs(lean) * (foot - top)
    wide, high = half * abs(right[0]), half * abs(right[1])
    if scale * _EDGE_ON > 0.99:  # its picture is not quite this plane's
        wide = high = FAR
    bounds[TORSO, 0] = cx + min(top * down[0], bottom * down[0]) - wide
    bounds[TORSO, 1] = cx + max(top * down[0], bottom * down[0]) + wide
    bounds[TORSO, 2] = cy + min(top * down[1], bottom * down[1]) - high
    bounds[TORSO, 3] = cy + max(top * down[1], bottom * down[1]) + high


@helper
def put_body(roots, torsos, necks, arms, pose, lengths, torso, shapes, bounds):
    """Describe the parts of a pose in `shapes` `(8, NUMBERS)`, and in `bounds` `(8, 4)` left, right, top and
    bottom, px, of where each may be.

    `lengths` `(12,)` px: neck, half axes of the head (3), shoulder width, upper arm, forearm, hand, radii of
    shoulder, elbow and wrist, depth of the torso's plane. Poses as in `BodyPoses`.
    """
    x, y, neck = roots[pose, 0], roots[pose, 1], lengths[0]
    # where the half axes of the head across, down and through it point
    (r00, r10, r20), (r01, r11, r21), (r02, r12, r22) = rotation(
        necks[pose, 0], necks[pose, 1], necks[pose, 2]
    )
    a, b, c = lengths[1] * lengths[1], lengths[2] * lengths[2], lengths[3] * lengths[3]
    _put_ellipsoid(
        shapes, HEAD, bounds, (x - neck * r01, y - neck * r11, -neck * r21), (
        a * r00 * r00 + b * r01 * r01 + c * r02 * r02,
        a * r00 * r10 + b * r01 * r11 + c * r02 * r12,
        a * r10 * r10 + b * r11 * r11 + c * r12 * r12,
        a * r00 * r20 + b * r01 * r21 + c * r02 * r22,
        a * r10 * r20 + b * r11 * r21 + c * r12 * r22,
        a * r20 * r20 + b * r21 * r21 + c * r22 * r22),
    )  # fmt: skip
    axes = rotation(torsos[pose, 0], torsos[pose, 1], torsos[pose, 2])
    _put_torso(shapes, bounds, axes, lengths[11], x, y, lengths[3], torso, 0.25 * neck)
    right = axes[0]
    square = lengths[7] * lengths[7]
    for side in range(2):
        part = 2 + 3 * side
        aside = (0.5 - side) * lengths[4]
        sx, sy, sz = x + aside * right[0], y + aside * right[1], aside * right[2]
        ex, ey, ez = arms[pose, side, 0, 0], arms[pose, side, 0, 1], arms[pose, side, 0, 2]
        ex, ey, ez = lengths[5] * ex, lengths[5] * ey, lengths[5] * ez
        _put_capsule(shapes, part, bounds, (sx, sy, sz), (ex, ey, ez), lengths[8], lengths[9])
        sx, sy, sz = sx + ex, sy + ey, sz + ez
        ex, ey, ez = arms[pose, side, 1, 0], arms[pose, side, 1, 1], arms[pose, side, 1, 2]
        ex, ey, ez = lengths[6] * ex, lengths[6] * ey, lengths[6] * ez
        _put_capsule(shapes, part + 1, bounds, (sx, sy, sz), (ex, ey, ez), lengths[9], lengths[10])
        sx, sy, sz = sx + ex, sy + ey, sz + ez
        _put_ellipsoid(shapes, part + 2, bounds, (sx, sy, sz), (square, 0.0, square, 0.0, 0.0, square))


@helper
def _ellipsoid_fronts(shapes, part, rim, lines, least, row):
    """Depths of an ellipsoid `(centre 3, inverse of the outline's matrix 3, slope 2, depth^2)`."""
    cx, cy, cz = shapes[part, 0], shapes[part, 1], shapes[part, 2]
    xx, xy, yy = shapes[part, 3], shapes[part, 4], shapes[part, 5]
    gx, gy, square = shapes[part, 6], shapes[part, 7], shapes[part, 8]
    for k in range(lines.shape[2]):
        dx, dy = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        inner = _f4(1) - (xx * dx + xy * dy) * dx - (xy * dx + yy * dy) * dy
        front = cz + gx * dx + gy * dy - np.sqrt(square * max(inner, _f4(0)))
        least[row, k] = min(least[row, k], front if inner > rim else FAR)


@helper
def _capsule_fronts(shapes, part, rim, lines, least, row):
    """Depths of a limb `(start 3, extent 3, radius, its change, a, 1 / a, steepness)`.

    Sphere t of 0 to 1 spans h(t) = r(t)^2 - |p - c(t)|^2 = h(0) + 2 b t - a t^2 in depth about its centre; of
    z(t) - sqrt(h(t)) the least is taken.
    """
    cx, cy, cz = shapes[part, 0], shapes[part, 1], shapes[part, 2]
    ex, ey, ez = shapes[part, 3], shapes[part, 4], shapes[part, 5]
    radius, change, a = shapes[part, 6], shapes[part, 7], shapes[part, 8]
    inverse, steepness = shapes[part, 9], shapes[part, 10]
    square, growth = radius * radius, radius * change
    for k in range(lines.shape[2]):
        wx, wy = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        start = square - wx * wx - wy * wy
        b = wx * ex + wy * ey + growth
        widest = b * inverse
        nearest = min(max(widest, _f4(0)), _f4(1))
        inner = start + nearest * (_f4(2) * b - a * nearest)
        t = min(max(widest - steepness * np.sqrt(max(start + b * widest, _f4(0))), _f4(0)), _f4(1))
        span = max(start + t * (_f4(2) * b - a * t), _f4(0))
        front = cz + t * ez - np.sqrt(span)
        least[row, k] = min(least[row, k], front if inner > rim * square else FAR)


@helper
def _end_on_fronts(shapes, part, rim, lines, least, row):
    """As `_capsule_fronts` for a limb whose one end holds the other: the nearest of its ends."""
    cx, cy, cz = shapes[part, 0], shapes[part, 1], shapes[part, 2]
    ex, ey, ez = shapes[part, 3], shapes[part, 4], shapes[part, 5]
    radius, other = shapes[part, 6], shapes[part, 6] + shapes[part, 7]
    first, last = radius * radius, other * other
    for k in range(lines.shape[2]):
        wx, wy = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        start = first - wx * wx - wy * wy
        wx, wy = wx - ex, wy - ey
        end = last - wx * wx - wy * wy
        near = cz - np.sqrt(max(start, _f4(0))) if start > rim * first else FAR
        behind = cz + ez - np.sqrt(max(end, _f4(0))) if end > rim * last else FAR
        least[row, k] = min(least[row, k], min(near, behind))


@helper
def _torso_fronts(torso, shapes, lines, least, row):
    """Depths of a torso `(middle 2, depth below and above it, lean of the neck, its end, axes 6, scale)`.

    The axes are those of its plane in space, across and down; the scale is the inverse of their determinant
    in the picture. `torso` `(4, 4)` has, from the top, pieces (beginning and length in px below the root,
    half width at the beginning, its increase per px); the first is the neck, which leans as the head does,
    and not in depth as the torso.
    """
    cx, cy, low, high = shapes[TORSO, 0], shapes[TORSO, 1], shapes[TORSO, 2], shapes[TORSO, 3]
    lean, top, scale = shapes[TORSO, 4], shapes[TORSO, 5], shapes[TORSO, 12]
    across_x, across_y = shapes[TORSO, 10] * scale, -shapes[TORSO, 9] * scale
    down_x, down_y = -shapes[TORSO, 7] * scale, shapes[TORSO, 6] * scale
    aside, below = shapes[TORSO, 8], shapes[TORSO, 11]
    foot, narrow, bottom = torso[1, 0], torso[0, 2], torso[3, 0] + torso[3, 1]
    length1, steep1 = torso[1, 1], torso[1, 3]
    begin2, length2, steep2 = torso[2, 0], torso[2, 1], torso[2, 3]
    begin3, length3, steep3 = torso[3, 0], torso[3, 1], torso[3, 3]
    for k in range(lines.shape[2]):
        x, y = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        off, dy = across_x * x + across_y * y, down_x * x + down_y * y
        dx = abs(off - lean * max(foot - dy, _f4(0)))
        half = narrow + steep1 * min(max(dy - foot, _f4(0)), length1)
        half += steep2 * min(max(dy - begin2, _f4(0)), length2)
        half += steep3 * min(max(dy - begin3, _f4(0)), length3)
        outside = max(dx - half, max(top - dy, dy - bottom))
        front = aside * off + (low + below * dy if dy > _f4(0) else high)
        least[row, k] = min(least[row, k], front if outside < _f4(0) else FAR)


@helper
def fronts(shapes, part, torso, rim, lines, least, row):
    """Bring depths `least` `(rows, n)` down to that of a part's front at the points of a row of `lines`.

    The outermost share `rim` of a round part's squared radius counts as outside.
    """
    if part == TORSO:
        _torso_fronts(torso, shapes, lines, least, row)
    elif part in ROUND:
        _ellipsoid_fronts(shapes, part, rim, lines, least, row)
    elif shapes[part, 9] > _f4(0):
        _capsule_fronts(shapes, part, rim, lines, least, row)
    else:
        _end_on_fronts(shapes, part, rim, lines, least, row)


LANES = 16


@helper
def _trace_torso(shapes, contour, lines, first):
    """Points of a torso's outline from those in its plane, and their normals, `(r, 4, LANES)`."""
    cx, cy, cz = shapes[TORSO, 0], shapes[TORSO, 1], shapes[TORSO, 2]
    ax, ay, az = shapes[TORSO, 6], shapes[TORSO, 7], shapes[TORSO, 8]
    bx, by, bz = shapes[TORSO, 9], shapes[TORSO, 10], shapes[TORSO, 11]
    for j in range(len(contour)):
        row = first + j
        for k in range(lines.shape[2]):
            lines[row, 0, k] = cx + ax * contour[j, 0, k] + bx * contour[j, 1, k]
        for k in range(lines.shape[2]):
            lines[row, 1, k] = cy + ay * contour[j, 0, k] + by * contour[j, 1, k]
        for k in range(lines.shape[2]):
            lines[row, 2, k] = cz + az * contour[j, 0, k] + bz * max(contour[j, 1, k], _f4(0))
        # normals turn by the inverse, the other way round
        for k in range(lines.shape[2]):
            nx = by * contour[j, 2, k] - ay * contour[j, 3, k]
            ny = ax * contour[j, 3, k] - bx * contour[j, 2, k]
            lines[row, 3, k] = nx / np.sqrt(nx * nx + ny * ny)
        for k in range(lines.shape[2]):
            nx = by * contour[j, 2, k] - ay * contour[j, 3, k]
            ny = ax * contour[j, 3, k] - bx * contour[j, 2, k]
            lines[row, 4, k] = ny / np.sqrt(nx * nx + ny * ny)


@helper
def _trace_ellipsoid(shapes, part, circles, lines, row):
    """Points of an ellipsoid's outline from points of a circle."""
    cx, cy, cz = shapes[part, 0], shapes[part, 1], shapes[part, 2]
    xx, xy, yy = shapes[part, 3], shapes[part, 4], shapes[part, 5]
    gx, gy = shapes[part, 6], shapes[part, 7]
    # the outline is the image of the circle under a triangular root of the matrix's inverse
    diagonal = _f4(1) / np.sqrt(xx)
    last = _f4(1) / np.sqrt(yy - xy * xy * diagonal * diagonal)
    below = xy * diagonal * diagonal * last
    for k in range(lines.shape[2]):
        lines[row, 0, k] = cx + circles[row, 0, k] * diagonal - circles[row, 1, k] * below
    for k in range(lines.shape[2]):
        lines[row, 1, k] = cy + circles[row, 1, k] * last
    for k in range(lines.shape[2]):
        lines[row, 2, k] = cz + gx * (lines[row, 0, k] - cx) + gy * (lines[row, 1, k] - cy)
    for k in range(lines.shape[2]):
        dx, dy = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        nx, ny = xx * dx + xy * dy, xy * dx + yy * dy
        lines[row, 3, k] = nx / np.sqrt(nx * nx + ny * ny)
    for k in range(lines.shape[2]):
        dx, dy = lines[row, 0, k] - cx, lines[row, 1, k] - cy
        nx, ny = xx * dx + xy * dy, xy * dx + yy * dy
        lines[row, 4, k] = ny / np.sqrt(nx * nx + ny * ny)


@helper
def _turned(angle):
    """Sine and cosine of a float32 angle from -pi/2 to pi/2, error below 1e-6."""
    square = angle * angle
    sine = _f4(2.7557319e-6) - _f4(2.5052108e-8) * square
    sine = _f4(-1 / 6) + square * (_f4(1 / 120) + square * (_f4(-1 / 5040) + square * sine))
    cosine = _f4(1 / 40320) + square * (_f4(-2.7557319e-7) + _f4(2.0876757e-9) * square)
    cosine = _f4(-0.5) + square * (_f4(1 / 24) + square * (_f4(-1 / 720) + square * cosine))
    return angle + angle * square * sine, _f4(1) + square * cosine


@helper
def _trace_capsule(shapes, part, points, lines, row):
    """Points along a limb's outline without the cap at its end: on both sides from the middle of the cap."""
    x, y, z, radius = shapes[part, 0], shapes[part, 1], shapes[part, 2], shapes[part, 6]
    dx, dy, dz, change = shapes[part, 3], shapes[part, 4], shapes[part, 5], shapes[part, 7]
    if shapes[part, 9] > _f4(0):
        shrink = _f4(1) / np.sqrt(dx * dx + dy * dy)
        ex, ey, steep = dx * shrink, dy * shrink, change * shrink
        side = np.sqrt(shapes[part, 8])
        level, length = side * shrink, side
        arc_turn = _f4(0.5 * np.pi) - _f4(np.arcsin(steep))
    else:
        ex, ey, steep, level = _f4(0), _f4(-1), _f4(-1), _f4(0)
        side, length, arc_turn = _f4(1), _f4(0), _f4(np.pi)
        if change > _f4(0):
            x, y, z, radius = x + dx, y + dy, z + dz, radius + change
    arc = radius * arc_turn
    step = (arc + length) / points[2, 0]
    turn, slide, begin = step / radius, step / side, arc / side
    for k in range(lines.shape[2]):
        forwards, sideways = _turned(min(points[0, k] * turn, arc_turn) - _f4(0.5 * np.pi))
        on_side = points[0, k] * step >= arc
        forwards, sideways = -steep if on_side else forwards, level if on_side else sideways
        lines[row, 3, k] = forwards * ex - points[1, k] * sideways * ey
    for k in range(lines.shape[2]):
        forwards, sideways = _turned(min(points[0, k] * turn, arc_turn) - _f4(0.5 * np.pi))
        on_side = points[0, k] * step >= arc
        forwards, sideways = -steep if on_side else forwards, level if on_side else sideways
        lines[row, 4, k] = forwards * ey + points[1, k] * sideways * ex
    for k in range(lines.shape[2]):
        t = max(points[0, k] * slide - begin, _f4(0))
        lines[row, 0, k] = x + t * dx + (radius + t * change) * lines[row, 3, k]
    for k in range(lines.shape[2]):
        t = max(points[0, k] * slide - begin, _f4(0))
        lines[row, 1, k] = y + t * dy + (radius + t * change) * lines[row, 4, k]
    for k in range(lines.shape[2]):
        lines[row, 2, k] = z + max(points[0, k] * slide - begin, _f4(0)) * dz


@helper
def trace(roots, torsos, necks, arms, pose, solid, shapes, bounds, lines, least):
    """The outlines of a pose, and the depth of the nearest other part at each of their points.

    A part is looked up only for parts that come within its bounds.

    `roots`, `torsos`, `necks`, `arms` `(n, 2)`, `(n, 3)`, `(n, 3)`, `(n, 2, 2, 3)` as in `BodyPoses`, of
    which one `pose` is traced; `shapes`, `bounds` `(8, NUMBERS)` and `(8, 4)` float32, to work in; `lines`,
    `least` `(rows, ROW, LANES)` and `(rows, LANES)` float32, written.
    """
    torso, firsts = solid.torso, solid.firsts
    put_body(roots, torsos, necks, arms, pose, solid.lengths, torso, shapes, bounds)
    for part in range(N_PARTS):
        if part == TORSO:
            _trace_torso(shapes, solid.torso_points, lines, firsts[part])
        elif part in ROUND:
            for row in range(firsts[part], firsts[part + 1]):
                _trace_ellipsoid(shapes, part, solid.circles, lines, row)
        else:
            _trace_capsule(shapes, part, solid.limb_points, lines, firsts[part])
    least[:] = FAR
    for own in range(N_PARTS):
        for part in range(N_PARTS):
            apart = (bounds[own, 0] > bounds[part, 1]) | (bounds[own, 1] < bounds[part, 0])
            apart |= (bounds[own, 2] > bounds[part, 3]) | (bounds[own, 3] < bounds[part, 2])
            if not (apart | (part == own)):
                for row in range(firsts[own], firsts[own + 1]):
                    fronts(shapes, part, torso, solid.rim, lines, least, row)


@compiled
def outline_terms(roots, torsos, necks, arms, solid, ratios, scales, worth, directions, hidden, out):
    """Log likelihood ratios of outlines against edges, added to `out` `(n,)`.

    `roots`, `torsos`, `necks`, `arms`: as of `trace`. What of an outline is hidden or outside of the picture
    says nothing. `ratios` `(height, width, 3)` float32: how much more likely an edge is so near to an outline
    than anywhere, and cosine and sine of twice the angle of that edge's normal; `scales` `(2,)` are its
    entries a px, along x and y; `worth`: number of independent points that each is worth; `directions`: twice
    the angle scatters about the outline's by a von Mises density; its concentration and I_0 of it; `hidden`:
    probability that a point shows no edge.
    """
    height, width = _f4(ratios.shape[0]), _f4(ratios.shape[1])
    across, down, flat = _f4(scales[0]), _f4(scales[1]), ratios.reshape(-1)
    kappa, none = _f4(directions[0]), _f4(hidden)
    scale = (_f4(1) - none) / _f4(directions[1])
    n_rows, tolerance = len(solid.counted), solid.tolerance
    shapes, bounds = np.empty((N_PARTS, NUMBERS), np.float32), np.empty((N_PARTS, 4), np.float32)
    lines, least = np.empty((n_rows, ROW, LANES), np.float32), np.empty((n_rows, LANES), np.float32)
    places, seen = np.empty((n_rows, LANES), np.int32), np.empty((3, LANES), np.float32)
    products = np.empty(LANES, np.float32)
    for pose in range(len(roots)):
        trace(roots, torsos, necks, arms, pose, solid, shapes, bounds, lines, least)
        products[:] = _f4(1)
        for row in range(n_rows):
            for k in range(places.shape[1]):
                x = np.floor((lines[row, 0, k] + _f4(0.5)) * across)
                y = np.floor((lines[row, 1, k] + _f4(0.5)) * down)
                counts = solid.counted[row, k] if least[row, k] >= lines[row, 2, k] - tolerance else _f4(0)
                counts = counts if (x >= _f4(0)) & (y >= _f4(0)) & (x < width) & (y < height) else _f4(0)
                places[row, k] = np.int32(y * width + x) if counts > _f4(0) else np.int32(-1)
            for k in range(LANES):
                place = 3 * max(places[row, k], np.int32(0))
                seen[0, k], seen[1, k], seen[2, k] = flat[place], flat[place + 1], flat[place + 2]
            for k in range(seen.shape[1]):
                x, y = lines[row, 3, k], lines[row, 4, k]
                along = (x * x - y * y) * seen[1, k] + _f4(2) * x * y * seen[2, k]
                value = none + scale * seen[0, k] * exponential(kappa * along)
                # each is between `none` and about 15: of so few, the product is a number of single precision
                products[k] *= value if places[row, k] >= np.int32(0) else _f4(1)
        total = _f4(0)
        for k in range(products.shape[0]):
            total += logarithm(products[k])
        out[pose] += worth * total
