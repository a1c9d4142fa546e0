"""Compiled loops over poses of an upper body: joints, limits, inverse kinematics; key points, colours."""

import numpy as np

from ..numerics.compiled import compiled, exponential, helper

_QUARTER = np.pi / 2


@helper
def _sine_cosine(angle):
    """Sine and cosine of a float64 angle, error below 1e-15 up to a few turns (libm's are no vector code)."""
    quarters = np.floor(angle * (1 / _QUARTER) + 0.5)
    rest = angle - quarters * _QUARTER
    square = rest * rest
    # Taylor series from -pi/4 to pi/4
    sine = 1 / 362880.0 + square * (-1 / 39916800.0 + square * (1 / 6227020800.0 - square / 1307674368000.0))
    sine = -1 / 6.0 + square * (1 / 120.0 + square * (-1 / 5040.0 + square * sine))
    sine = rest + rest * square * sine
    cosine = -1 / 3628800.0 + square * (
        1 / 479001600.0 + square * (-1 / 87178291200.0 + square / 20922789888000.0)
    )
    cosine = 1 / 24.0 + square * (-1 / 720.0 + square * (1 / 40320.0 + square * cosine))
    cosine = 1.0 + square * (-0.5 + square * cosine)
    quadrant = quarters - 4.0 * np.floor(0.25 * quarters)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    upright = cosine if odd else sine
    level = sine if odd else cosine
    upright = -upright if quadrant >= 2.0 else upright
    level = -level if (quadrant == 1.0) | (quadrant == 2.0) else level
    return upright, level


@helper
def rotation(x, y, z):
    """Columns of the matrix of a rotation vector (Rodrigues): the turned axes x, y and z."""
    angle = np.sqrt(x * x + y * y + z * z)
    sine, cosine = _sine_cosine(0.5 * angle)
    share = sine / angle if angle > 1e-9 else 0.5
    versine = 2.0 * share * share  # (1 - cos) / angle^2 without its cancellation
    turn = 2.0 * share * cosine
    rest = 1.0 - 2.0 * sine * sine
    xy, xz, yz = versine * x * y, versine * x * z, versine * y * z
    right = (versine * x * x + rest, xy + turn * z, xz - turn * y)
    down = (xy - turn * z, versine * y * y + rest, yz + turn * x)
    away = (xz + turn * y, yz - turn * x, versine * z * z + rest)
    return right, down, away


@compiled
def place_joints(roots, torsos, necks, arms, neck, half, upper, fore, joints):
    """Write the joints of each pose into `joints` `(n, 8, 3)`.

    `roots` `(n, 2)`, `torsos` and `necks` `(n, 3)`, `arms` `(n, 2, 2, 3)` as in `BodyPoses`; `neck`, `half`
    of the shoulders' width, `upper` and `fore` are lengths in px.
    """
    for k in range(len(roots)):
        x, y = roots[k, 0], roots[k, 1]
        right, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
        _, (dx, dy, dz), _ = rotation(necks[k, 0], necks[k, 1], necks[k, 2])
        joints[k, 0, 0], joints[k, 0, 1], joints[k, 0, 2] = x - neck * dx, y - neck * dy, -neck * dz
        joints[k, 1, 0], joints[k, 1, 1], joints[k, 1, 2] = x, y, 0.0
        for side in range(2):
            first = 2 + 3 * side
            aside = (1 - 2 * side) * half
            sx, sy, sz = x + aside * right[0], y + aside * right[1], aside * right[2]
            ex = sx + upper * arms[k, side, 0, 0]
            ey = sy + upper * arms[k, side, 0, 1]
            ez = sz + upper * arms[k, side, 0, 2]
            joints[k, first, 0], joints[k, first, 1], joints[k, first, 2] = sx, sy, sz
            joints[k, first + 1, 0], joints[k, first + 1, 1], joints[k, first + 1, 2] = ex, ey, ez
            joints[k, first + 2, 0] = ex + fore * arms[k, side, 1, 0]
            joints[k, first + 2, 1] = ey + fore * arms[k, side, 1, 1]
            joints[k, first + 2, 2] = ez + fore * arms[k, side, 1, 2]


@compiled
def place_parts(roots, torsos, necks, arms, neck, half, upper, fore, parts):
    """Write head and hands in the image into `parts` `(n, 3, 2)`; otherwise as `place_joints`."""
    for k in range(len(roots)):
        x, y = roots[k, 0], roots[k, 1]
        right, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
        _, (dx, dy, _), _ = rotation(necks[k, 0], necks[k, 1], necks[k, 2])
        parts[k, 0, 0], parts[k, 0, 1] = x - neck * dx, y - neck * dy
        for side in range(2):
            aside = (1 - 2 * side) * half
            sx, sy = x + aside * right[0], y + aside * right[1]
            parts[k, 1 + side, 0] = sx + upper * arms[k, side, 0, 0] + fore * arms[k, side, 1, 0]
            parts[k, 1 + side, 1] = sy + upper * arms[k, side, 0, 1] + fore * arms[k, side, 1, 1]


@helper
def _along(axes, x, y, z):
    """Coordinates of a vector along the axes that `rotation` gives."""
    right, down, away = axes
    return (
        right[0] * x + right[1] * y + right[2] * z,
        down[0] * x + down[1] * y + down[2] * z,
        away[0] * x + away[1] * y + away[2] * z,
    )


@helper
def _in_torso(x, y, z, torso):
    """Whether a point, in the torso's axes, is in the torso or behind it; see `within_limits`."""
    # clothes are soft and bodies differ: points near the border count as outside
    width = torso[0] + min(max(y / torso[2], 0.0), 1.0) * (torso[1] - torso[0])
    return (abs(x) < 0.4 * width) & (y > 0.0) & (y < torso[2]) & (z > -torso[3])


@helper
def is_within(torsos, necks, k, arms, row, half, upper, fore, limits, torso):
    """Whether pose k with the arms of a row is within the limits; parameters as of `within_limits`."""
    cx, cy, cz, cone = limits[2], limits[3], limits[4], limits[5]
    middle_sine, middle_cosine = _sine_cosine(limits[6])
    _, edge = _sine_cosine(limits[7])
    folded, straight = limits[8], limits[9]
    x, y, z = torsos[k, 0], torsos[k, 1], torsos[k, 2]
    axes = rotation(x, y, z)
    right, down, away = rotation(necks[k, 0], necks[k, 1], necks[k, 2])
    trace = (
        axes[0][0] * right[0] + axes[0][1] * right[1] + axes[0][2] * right[2]
        + axes[1][0] * down[0] + axes[1][1] * down[1] + axes[1][2] * down[2]
        + axes[2][0] * away[0] + axes[2][1] * away[1] + axes[2][2] * away[2]
    )  # fmt: skip
    # of a rotation the trace is 1 and twice the cosine
    good = (x * x + y * y + z * z <= limits[0] * limits[0]) & (0.5 * (trace - 1.0) >= limits[1])
    for side in range(2):
        sign = 1.0 - 2.0 * side
        ux, uy, uz = _along(axes, arms[row, side, 0, 0], arms[row, side, 0, 1], arms[row, side, 0, 2])
        fx, fy, fz = _along(axes, arms[row, side, 1, 0], arms[row, side, 1, 1], arms[row, side, 1, 2])
        bend = ux * fx + uy * fy + uz * fz
        good &= (sign * ux * cx + uy * cy + uz * cz >= cone) & (bend >= folded)
        x, y, z = sign * half + upper * ux, upper * uy, upper * uz
        good &= not _in_torso(x, y, z, torso)
        good &= not _in_torso(x + fore * fx, y + fore * fy, z + fore * fz, torso)
        # the turn about the arm that `transport` leaves out; 1 / (1 + y) loses its digits near the top
        square = ux * ux + uz * uz
        over = (square < 1e-28) & (uy < 0.0)
        shrink = (1.0 - uy) / max(square, 1e-28) if uy < 0.0 else 1.0 / (1.0 + uy)
        shrink = 0.0 if over else shrink
        ax, ay, az = fy * uz - fz * uy, fz * ux - fx * uz, fx * uy - fy * ux
        shared = shrink * (ux * ax + uz * az) + ay
        first, third = ax - ux * shared, az - uz * shared
        sine = sign * (third if over else -third)
        # an angle is within a range if its cosine from the middle is that of the end or more
        near = first * middle_cosine + sine * middle_sine
        within = near >= edge * np.sqrt(first * first + sine * sine)
        good &= within | (bend > straight)
    return good


@compiled
def within_limits(torsos, necks, arms, half, upper, fore, limits, torso, allowed):
    """Write into `allowed` `(n,)` whether every joint is within its limits and no arm is in the torso.

    `torsos`, `necks`, `arms`, `half`, `upper`, `fore`: as for `place_joints`. `limits` `(10,)`: greatest
    rotation of the torso; cosine of that of the neck; middle of the left upper arm's cone (a unit vector) and
    cosine of its half angle; middle of the range of the inwards turn and half its length; cosines of the
    elbow's greatest flexion and of the one below which the turn is not tested. Angles in rad. `torso` `(4,)`
    px: width at the shoulders and at the lower end, height, and how far it reaches to the viewer.
    """
    for k in range(len(necks)):
        allowed[k] = is_within(torsos, necks, k, arms, k, half, upper, fore, limits, torso)


@helper
def _towards(x, y, z):
    """Unit vector along a vector (any for 0), and its length."""
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 1.0, 0.0, length
    return x / length, y / length, z / length, length


@helper
def _from_reference(x, y, z, sign, reference):
    """Unit vector across a unit vector that is nearest to `reference` `(3,)`, mirrored for `sign` -1."""
    rx, ry, rz = sign * reference[0], reference[1], reference[2]
    along = x * rx + y * ry + z * rz
    ox, oy, oz = rx - along * x, ry - along * y, rz - along * z
    length = np.sqrt(ox * ox + oy * oy + oz * oz)
    if length < 1e-9:  # any other one
        ox, oy, oz = z * x, z * y, z * z - 1.0
        length = np.sqrt(ox * ox + oy * oy + oz * oz)
    return ox / length, oy / length, oz / length


@helper
def arm_to(hx, hy, hz, swivel, upper, fore, sign, reference):
    """Upper arm and forearm, unit vectors, of an arm with its hand there, and whether it reaches there."""
    x, y, z, distance = _towards(hx, hy, hz)
    reachable = (distance <= upper + fore) & (distance >= abs(upper - fore)) & (distance > 0.0)
    safe = distance if distance > 0.0 else 1.0
    cosine = (upper * upper + distance * distance - fore * fore) / (2.0 * upper * safe)
    cosine = min(max(cosine, -1.0), 1.0)
    sine = np.sqrt(1.0 - cosine * cosine)
    ox, oy, oz = _from_reference(x, y, z, sign, reference)
    turn, level = _sine_cosine(swivel)
    level, turn = sine * level, sine * sign * turn
    ux = cosine * x + level * ox + turn * (y * oz - z * oy)
    uy = cosine * y + level * oy + turn * (z * ox - x * oz)
    uz = cosine * z + level * oz + turn * (x * oy - y * ox)
    fx, fy, fz, _ = _towards(hx - upper * ux, hy - upper * uy, hz - upper * uz)
    return ux, uy, uz, fx, fy, fz, reachable


@compiled
def reach(offsets, swivels, upper, fore, sign, reference, arms, reachable):
    """Write arms `(n, 2, 3)` with hands at `offsets` `(n, 3)`, and whether they reach there, `(n,)`.

    `swivels` `(n,)` rad are measured from `reference` `(3,)`, for `sign` -1 from its mirror image and the
    other way round; `upper` and `fore` are lengths.
    """
    for k in range(len(offsets)):
        hx, hy, hz = offsets[k, 0], offsets[k, 1], offsets[k, 2]
        ux, uy, uz, fx, fy, fz, there = arm_to(hx, hy, hz, swivels[k], upper, fore, sign, reference)
        arms[k, 0, 0], arms[k, 0, 1], arms[k, 0, 2] = ux, uy, uz
        arms[k, 1, 0], arms[k, 1, 1], arms[k, 1, 2] = fx, fy, fz
        reachable[k] = there


@helper
def elbow_of(ux, uy, uz, hx, hy, hz, sign, reference):
    """Sine and cosine of the swivel of an upper arm, a unit vector, with the hand there, up to a factor."""
    x, y, z, _ = _towards(hx, hy, hz)
    ox, oy, oz = _from_reference(x, y, z, sign, reference)
    across = ux * (y * oz - z * oy) + uy * (z * ox - x * oz) + uz * (x * oy - y * ox)
    return sign * across, ux * ox + uy * oy + uz * oz


@compiled
def elbows(arms, upper, fore, sign, reference, upright, level):
    """Write sine and cosine, `(n,)`, of the swivels of `arms` `(n, 2, 3)`, up to a factor; as `reach`."""
    for k in range(len(arms)):
        ux, uy, uz = arms[k, 0, 0], arms[k, 0, 1], arms[k, 0, 2]
        hx, hy, hz = upper * ux + fore * arms[k, 1, 0], upper * uy + fore * arms[k, 1, 1], arms[k, 1, 2]
        upright[k], level[k] = elbow_of(ux, uy, uz, hx, hy, upper * uz + fore * hz, sign, reference)


@helper
def leant_from(x, y, z, cosine, turn):
    """Unit vector at an angle, given by its cosine, from a unit vector; `turn` rad about it.

    The two vectors across a direction are those of Duff et al., "Building an orthonormal basis,
    revisited", JCGT 2017.
    """
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    upright, level = _sine_cosine(turn)
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    one, other = sine * level, sine * upright
    dx = cosine * x + one * (1.0 + sign * x * x * a) + other * b
    dy = cosine * y + one * sign * b + other * (sign + y * y * a)
    dz = cosine * z - one * sign * x - other * y
    shrink = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return shrink * dx, shrink * dy, shrink * dz


@compiled
def lean(directions, cosines, turns, leant):
    """Write unit vectors at given angles from unit vectors `directions` `(n, 3)` into `leant` `(n, 3)`.

    `cosines` `(n,)` of the angles; `turns` `(n,)` rad about the directions, from an arbitrary zero.
    """
    for k in range(len(directions)):
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        leant[k, 0], leant[k, 1], leant[k, 2] = leant_from(x, y, z, cosines[k], turns[k])


_f4 = np.float32


@compiled
def keypoint_terms(joints, places, ends, shares, heights, halves, false, chances, out):
    """Add log likelihood ratios of key points against false ones about a person to `out` `(n,)`.

    `joints` `(n, 8, 2)` or `(n, 8, 3)` px; `places` `(m, 2)` px: detected points; `ends`, `shares`
    `(h, m, 2)` and `(m,)`: the two joints that each is between, and its share of the way, under each of h
    hypotheses; `heights`, `halves` `(m,)`: peak of a point's ratio, and half its precision, 1/px^2; `false`
    `(m,)`: least value of the ratio; `chances` `(h + 1,)`: probabilities of the hypotheses, and of another
    person.
    """
    for k in range(len(joints)):
        total = _f4(chances[len(ends)])
        for h in range(len(ends)):
            product = _f4(chances[h])
            for p in range(len(places)):
                first, second = ends[h, p, 0], ends[h, p, 1]
                x, y, share = joints[k, first, 0], joints[k, first, 1], shares[p]
                x += share * (joints[k, second, 0] - x) - places[p, 0]
                y += share * (joints[k, second, 1] - y) - places[p, 1]
                near = exponential(_f4(-halves[p] * (x * x + y * y)))
                product *= _f4(heights[p]) * near + _f4(false[p])
            total += product
        out[k] += np.log(np.float64(total))


@compiled
def look_up_colours(luma_red_blue, table, out):
    """Write `table` `(8 * 64 * 64,)` at colours `(n, 3)` uint8 (Y, Cr, Cb) into `out` `(n,)`; float32."""
    for i in range(out.size):
        luma, red, blue = luma_red_blue[i, 0], luma_red_blue[i, 1], luma_red_blue[i, 2]
        out[i] = table[(np.int32(luma >> 5) << 12) | (np.int32(red >> 2) << 6) | np.int32(blue >> 2)]
