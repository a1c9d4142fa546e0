"""Loops over the contours of many upper bodies: where they are, what hides them, how edges are there."""

import numpy as np

from ....models.numerics.compiled import compiled, exponential, inlined, logarithm
from .solids import FAR, N_PARTS, NUMBERS, ROUND, ROW, TORSO, fronts, put_body

_f4 = np.float32

LANES = 16
"""Points in a row, which are worked on together: rows are of one part each, and some points do not count."""


@compiled
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


@compiled
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


@inlined
def _turned(angle):
    """Sine and cosine of a float32 angle from -pi/2 to pi/2, error below 1e-6."""
    square = angle * angle
    sine = _f4(2.7557319e-6) - _f4(2.5052108e-8) * square
    sine = _f4(-1 / 6) + square * (_f4(1 / 120) + square * (_f4(-1 / 5040) + square * sine))
    cosine = _f4(1 / 40320) + square * (_f4(-2.7557319e-7) + _f4(2.0876757e-9) * square)
    cosine = _f4(-0.5) + square * (_f4(1 / 24) + square * (_f4(-1 / 720) + square * cosine))
    return angle + angle * square * sine, _f4(1) + square * cosine


@compiled
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


@compiled
def trace(roots, torsos, necks, arms, pose, solid, shapes, bounds, lines, least):
    """The outlines of a pose, and the depth of the nearest other part at each of their points.

    A part is looked up only for parts that come within its bounds.

    Parameters
    ----------
    roots, torsos, necks, arms
        `(n, 2)`, `(n, 3)`, `(n, 3)`, `(n, 2, 2, 3)` as in `BodyPoses`, of which one `pose` is traced.
    shapes, bounds
        `(8, NUMBERS)` and `(8, 4)` float32, to work in.
    lines, least
        `(rows, ROW, LANES)` and `(rows, LANES)` float32, written.
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
def outlines(roots, torsos, necks, arms, solid, places, points, normals, visible):
    """Contours of the parts of each pose, and which of their points are seen.

    Poses as of `trace`; `places` `(m, 2)` are rows and lanes of the points. Writes `points`, `normals`
    `(n, m, 2)` float32 and `visible` `(n, m)` bool.
    """
    shapes, bounds = np.zeros((N_PARTS, NUMBERS), np.float32), np.zeros((N_PARTS, 4), np.float32)
    lines = np.zeros((len(solid.counted), ROW, LANES), np.float32)
    least = np.zeros((len(solid.counted), LANES), np.float32)
    for pose in range(len(roots)):
        trace(roots, torsos, necks, arms, pose, solid, shapes, bounds, lines, least)
        for k in range(len(places)):
            row, lane = places[k, 0], places[k, 1]
            points[pose, k, 0], points[pose, k, 1] = lines[row, 0, lane], lines[row, 1, lane]
            normals[pose, k, 0], normals[pose, k, 1] = lines[row, 3, lane], lines[row, 4, lane]
            visible[pose, k] = least[row, lane] >= lines[row, 2, lane] - solid.tolerance


@compiled
def outline_terms(roots, torsos, necks, arms, solid, ratios, worth, directions, hidden, out):
    """Log likelihood ratios of outlines against edges, added to `out` `(n,)`.

    Parameters
    ----------
    roots, torsos, necks, arms
        as of `trace`. What of an outline is hidden or outside of the picture says nothing.
    ratios
        `(height, width, 3)` float32: how much more likely an edge is so near to an outline than anywhere,
        and cosine and sine of twice the angle of that edge's normal.
    worth
        number of independent points that each is worth.
    directions
        twice the angle scatters about the outline's by a von Mises density; its concentration and I_0 of it.
    hidden
        probability that a point shows no edge.
    """
    height, width = _f4(ratios.shape[0]), _f4(ratios.shape[1])
    flat = ratios.reshape(-1)
    kappa, none = _f4(directions[0]), _f4(hidden)
    scale = (_f4(1) - none) / _f4(directions[1])
    n_rows, tolerance = len(solid.counted), solid.tolerance
    shapes, bounds = np.zeros((N_PARTS, NUMBERS), np.float32), np.zeros((N_PARTS, 4), np.float32)
    lines, least = np.zeros((n_rows, ROW, LANES), np.float32), np.zeros((n_rows, LANES), np.float32)
    places, seen = np.zeros((n_rows, LANES), np.int32), np.zeros((3, LANES), np.float32)
    products = np.zeros(LANES, np.float32)
    for pose in range(len(roots)):
        trace(roots, torsos, necks, arms, pose, solid, shapes, bounds, lines, least)
        products[:] = _f4(1)
        for row in range(n_rows):
            for k in range(places.shape[1]):
                x, y = np.floor(lines[row, 0, k] + _f4(0.5)), np.floor(lines[row, 1, k] + _f4(0.5))
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
