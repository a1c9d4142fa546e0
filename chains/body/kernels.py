"""Compiled loops over poses of bodies: densities of the dynamics, guided draws, maps of an image, outlines.

For outlines a body is a head (ellipsoid), a torso (flat, with a neck, in a plane that leans and turns), two
hands (spheres) and four limbs (each the union of spheres between its ends), seen along z, with exact depths.
There, arrays are handed on whole with the number of a row: a view of a row costs as much as ten points.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...models.body.kernels import arm_to, elbow_of, is_within, leant_from, rotation
from ...models.numerics.compiled import compiled, exponential, falling, helper, logarithm

_f4 = np.float32


@helper
def _squares_to_rows(point, rows, squares):
    """Squared distances `(k,)` of a point `(d,)` to rows `(d, k)`, axis after axis for vector units."""
    squares[:] = _f4(0.0)
    for axis in range(len(rows)):
        place, row = point[axis], rows[axis]
        for j in range(len(squares)):
            step = place - row[j]
            squares[j] += step * step


@compiled
def least_squares_to_rows(points, rows, least):
    """For each point `(n, d)` the least squared distance to any row `(d, k)`, filled into `least`."""
    squares = np.empty(rows.shape[1], np.float32)
    for i in range(len(points)):
        _squares_to_rows(points[i], rows, squares)
        best = _f4(3e38)
        for j in range(len(squares)):
            best = min(best, squares[j])
        least[i] = best


@helper
def _usual(arms, k, side, usual):
    """Log density of an arm's prior.

    `usual` `(5,)`: middle of left upper arms, concentration, log of the density there.
    """
    away = (1.0 - 2.0 * side) * usual[0] * arms[k, side, 0, 0]
    away += usual[1] * arms[k, side, 0, 1] + usual[2] * arms[k, side, 0, 2] - 1.0
    return usual[3] * away + usual[4]


@compiled
def arm_steps(arms, before, concentrations, heights, usual, out):
    """Write the log densities `(n, 2)` of arms `(n, 2, 2, 3)` given those `before`.

    `concentrations` `(2,)` of upper arms and forearms; `heights` `(3,)`: density of an arm that has not
    jumped, at its peak; probability of a jump; least exponent; `usual` `(5,)` as of `_usual`.
    """
    for k in range(len(arms)):
        for side in range(2):
            turned = 0.0
            for part in range(2):
                cosine = arms[k, side, part, 0] * before[k, side, part, 0]
                cosine += arms[k, side, part, 1] * before[k, side, part, 1]
                cosine += arms[k, side, part, 2] * before[k, side, part, 2]
                turned += concentrations[part] * (cosine - 1.0)
            jumped = heights[1] * np.exp(_usual(arms, k, side, usual))
            out[k, side] = np.log(heights[0] * np.exp(max(turned, heights[2])) + jumped)


@compiled
def crossings(torsos, arms, lengths, out):
    """Write by how many px the hands are crossed into `out` `(n,)`; `lengths` `(3,)` as of `move_blocks`."""
    for k in range(len(torsos)):
        right, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
        across = lengths[1] * (arms[k, 1, 0, 0] - arms[k, 0, 0, 0])
        across += lengths[2] * (arms[k, 1, 1, 0] - arms[k, 0, 1, 0])
        out[k] = across - 2.0 * lengths[0] * right[0]


@compiled
def squared_steps(roots, torsos, necks, old_roots, old_torsos, old_necks, place, decay, stds, out):
    """Write the squared steps `(n,)` from old positions and turns, in standard deviations.

    `place` px of the position; `decay`, `stds` `(6,)` of the turns: as of `BodyDynamics.turn_step`.
    """
    for k in range(len(roots)):
        right, down = roots[k, 0] - old_roots[k, 0], roots[k, 1] - old_roots[k, 1]
        total = (right * right + down * down) / (place * place)
        for axis in range(3):
            torso = (torsos[k, axis] - decay[axis] * old_torsos[k, axis]) / stds[axis]
            neck = (necks[k, axis] - decay[3 + axis] * old_necks[k, axis]) / stds[3 + axis]
            total += torso * torso + neck * neck
        out[k] = total


@compiled
def scaled_poses(
    roots, torsos, necks, arms, origin, stds, decay, peak, jump, least, usual, body, row, floors
):
    """Write what `mixture_values` takes: `body` `(n, 8)`, `row` `(n, 12)`, `floors` `(n, 2)`; float32.

    `origin` `(2,)` px; `stds` `(7,)`: of the position and of the turns, by which they are divided; `decay`
    `(6,)`: factor of the turns; `peak`, `jump`: density of an arm that has not jumped, at its peak, and
    probability of a jump; `least` floor; `usual` as of `_usual`.
    """
    for k in range(len(roots)):
        for axis in range(2):
            body[k, axis] = _f4((roots[k, axis] - origin[axis]) / stds[0])
        for axis in range(3):
            body[k, 2 + axis] = _f4(decay[axis] * torsos[k, axis] / stds[1 + axis])
            body[k, 5 + axis] = _f4(decay[3 + axis] * necks[k, axis] / stds[4 + axis])
        for side in range(2):
            for part in range(2):
                for axis in range(3):
                    row[k, 6 * side + 3 * part + axis] = _f4(arms[k, side, part, axis])
            floors[k, side] = _f4(max(jump * np.exp(_usual(arms, k, side, usual)) / peak, least))


@helper
def von_mises_fisher(concentration, share, turn):
    """Cosine from the mean, by its inverse distribution function, and turn about it, of numbers in 0 to 1."""
    least = np.exp(-2.0 * concentration)
    return 1.0 + np.log(share + (1.0 - share) * least + 1e-300) / concentration, 2.0 * np.pi * turn


RAISED = 40.0  # nats by which sums over ancestors are raised: subnormal products would take six times as long
FARTHEST = -83.0  # nats of a place, over the nearest ancestor's, at least


@helper
def _products_to_row(i, body, ancestors, nearest, arms, ancestor_arms, weights, concentrations, floors, row):
    """For pose i, fill `row` `(k,)` with weight, Gaussian of the body's place and kernels of both arms."""
    upper, fore = concentrations[0], concentrations[1]
    a0, a1, a2 = arms[i, 0], arms[i, 1], arms[i, 2]
    a3, a4, a5 = arms[i, 3], arms[i, 4], arms[i, 5]
    b0, b1, b2 = arms[i, 6], arms[i, 7], arms[i, 8]
    b3, b4, b5 = arms[i, 9], arms[i, 10], arms[i, 11]
    floor, floor_2 = floors[i, 0], floors[i, 1]
    _squares_to_rows(body[i], ancestors, row)
    for j in range(len(row)):
        place = exponential(max(_f4(-0.5) * (row[j] - nearest), _f4(FARTHEST)) + _f4(RAISED))
        left = upper * (
            a0 * ancestor_arms[0, j] + a1 * ancestor_arms[1, j] + a2 * ancestor_arms[2, j] - _f4(1.0)
        ) + fore * (a3 * ancestor_arms[3, j] + a4 * ancestor_arms[4, j] + a5 * ancestor_arms[5, j] - _f4(1.0))
        right = upper * (
            b0 * ancestor_arms[6, j] + b1 * ancestor_arms[7, j] + b2 * ancestor_arms[8, j] - _f4(1.0)
        ) + fore * (
            b3 * ancestor_arms[9, j] + b4 * ancestor_arms[10, j] + b5 * ancestor_arms[11, j] - _f4(1.0)
        )
        one = exponential(min(left, _f4(0.0))) + floor
        other = exponential(min(right, _f4(0.0))) + floor_2
        row[j] = weights[j] * place * one * other


@compiled
def mixture_values(body, ancestors, least, arms, ancestor_arms, weights, concentrations, floors, values):
    """Sum over ancestors of weight, Gaussian of the body's place and the kernels of both arms.

    `body`, `ancestors` `(n, d)`, `(d, k)`: what moves like a Gaussian, in units in which half the squared
    distance is the exponent; `least` `(n,)`: smallest squared distance of each; exponents are taken relative
    to it; `arms`, `ancestor_arms` `(n, 12)`, `(12, k)`: unit vectors, left upper arm, left forearm, right
    upper arm, right forearm; `weights` `(k,)` of the ancestors; `concentrations` `(2,)` of von Mises and
    Fisher's density, of upper arms and forearms; `floors` `(n, 2)`: density of an arm that jumped, by the
    peak of that of one that did not; `values` `(n,)` filled in, times exp(`RAISED`).
    """
    row = np.empty(ancestors.shape[1], np.float32)
    for i in range(len(body)):
        _products_to_row(
            i, body, ancestors, least[i], arms, ancestor_arms, weights, concentrations, floors, row
        )
        total = _f4(0.0)
        for j in range(len(row)):
            total += row[j]
        values[i] = total


@compiled
def draw_terms(body, ancestors, least, arms, ancestor_arms, weights, concentrations, floors, points, chosen):
    """For each pose draw a term of the sum of `mixture_values` in proportion to its value.

    `points` `(n,)`, evenly drawn from 0 to 1; `chosen` `(n,)` indices, filled in; all others as of
    `mixture_values`.
    """
    row = np.empty(ancestors.shape[1], np.float32)
    for i in range(len(body)):
        _products_to_row(
            i, body, ancestors, least[i], arms, ancestor_arms, weights, concentrations, floors, row
        )
        total = 0.0
        for j in range(len(row)):
            total += row[j]
        rest = points[i] * total
        last = 0
        for j in range(len(row)):
            if row[j] > _f4(0.0):
                last = j
                rest -= row[j]
                if rest < 0.0:
                    break
        chosen[i] = last


@compiled
def closeness_to(hands, sides, means, precisions, least, choice, closeness):
    """By how much more readily each pose is chosen for a target.

    `hands` `(n, 2, 2)` px: left and right; `sides`, `means`, `precisions` `(k,)`, `(k, 2)`, `(k, 2, 2)` of
    the targets and of how far away hands may be; `least`: how readily one is chosen that is anywhere, over
    one that is there; `choice` `(n,)`: probabilities with which poses are chosen without a target;
    `closeness` `(k, n)` written, with means of 1 under `choice`.
    """
    for k in range(len(sides)):
        side = sides[k]
        x0, y0, total = means[k, 0], means[k, 1], 0.0
        xx, xy, yy = precisions[k, 0, 0], precisions[k, 0, 1], precisions[k, 1, 1]
        for i in range(len(hands)):
            x, y = hands[i, side, 0] - x0, hands[i, side, 1] - y0
            near = falling(-0.5 * (xx * x * x + 2 * xy * x * y + yy * y * y)) + least
            closeness[k, i] = near
            total += choice[i] * near
        for i in range(len(hands)):
            closeness[k, i] /= total


@compiled
def choose(choice, closeness, counts, shifts, chosen):
    """Draw poses for each target by systematic resampling, and at last some for none.

    `choice`, `closeness` `(n,)`, `(k, n)` as of `closeness_to`; `counts`, `shifts` `(k + 1,)`: how many are
    drawn, and numbers from 0 to 1 that say where their steps begin; `chosen` `(sum of counts,)` indices,
    written.
    """
    n, place = len(choice), 0
    for k in range(len(counts)):
        total = 0.0
        for i in range(n):
            total += choice[i] * closeness[k, i] if k < len(closeness) else choice[i]
        step = total / max(counts[k], 1)
        wanted, so_far, end = shifts[k] * step, 0.0, place + counts[k]
        for i in range(n):
            so_far += choice[i] * closeness[k, i] if k < len(closeness) else choice[i]
            while place < end and wanted < so_far:
                chosen[place] = i
                place += 1
                wanted += step
        while place < end:  # sums are not exact
            chosen[place] = n - 1
            place += 1


@compiled
def guided_values(hands, chosen, walks, completions, sides, means, precisions, heights, closeness, values):
    """Log densities of poses some of which were drawn with a hand at a target, given their ancestors.

    `hands` `(n, 2, 2)` px: left and right; `chosen` `(n,)` of the ancestors; `walks`, `completions` `(n, 2)`
    nats of each arm: its density if the dynamics moved it, and that of all but its hand's place if it was put
    in place; `sides`, `means`, `precisions` `(k,)`, `(k, 2)`, `(k, 2, 2)` of the targets; `heights`
    `(k + 1,)`: share of the draws times peak of the density; at last the share of those without target;
    `closeness` `(k, n_ancestors)` as of `closeness_to`; `values` `(n,)` filled in.
    """
    n_targets = len(sides)
    # row after row for vector units
    table = np.empty((6, n_targets))
    for k in range(n_targets):
        table[0, k], table[1, k], table[2, k] = means[k, 0], means[k, 1], precisions[k, 0, 0]
        table[3, k], table[4, k], table[5, k] = 2.0 * precisions[k, 0, 1], precisions[k, 1, 1], heights[k]
    xs, ys, xx, xy, yy, high = table[0], table[1], table[2], table[3], table[4], table[5]
    near = np.empty((closeness.shape[1], n_targets))
    for k in range(n_targets):
        for j in range(len(near)):
            near[j, k] = closeness[k, j]
    for i in range(len(hands)):
        left, right = completions[i, 0] - walks[i, 0], completions[i, 1] - walks[i, 1]
        peak = max(max(left, right), 0.0)
        gain, other = np.exp(left - peak), np.exp(right - peak)
        limit = 2.0 * peak + 90.0  # of farther ones all digits are lost
        row = near[chosen[i]]
        left_x, left_y, right_x, right_y = hands[i, 0, 0], hands[i, 0, 1], hands[i, 1, 0], hands[i, 1, 1]
        total = heights[n_targets] * np.exp(-peak)
        for k in range(n_targets):
            is_left = sides[k] == 0
            x, y = (left_x if is_left else right_x) - xs[k], (left_y if is_left else right_y) - ys[k]
            square = xx[k] * x * x + xy[k] * x * y + yy[k] * y * y
            value = falling(-0.5 * square) if square < limit else 0.0
            total += (gain if is_left else other) * high[k] * row[k] * value
        values[i] = peak + np.log(total) + walks[i, 0] + walks[i, 1]


@helper
def _spread(points, numbers, piece, variances):
    """Write into `variances` `(d,)` those of the points whose number is that of a piece."""
    for axis in range(points.shape[1]):
        count, mean, total = 0, 0.0, 0.0
        for i in range(len(points)):
            if numbers[i] == piece:
                count += 1
                mean += points[i, axis]
        mean /= max(count, 1)
        for i in range(len(points)):
            if numbers[i] == piece:
                step = points[i, axis] - mean
                total += step * step
        variances[axis] = total / max(count, 1)


@compiled
def cut(points, narrow, rounds, variances, numbers):
    """Cut points in two, again and again, where and along which axis they are widest.

    `points` `(n, d)`; `narrow`: variance along an axis below which nothing is cut; `rounds`: in which the
    middle between two halves is found, each of which is nearer to its own mean; `variances` `(most, d)`:
    those of the pieces, which are at most so many, written; `numbers` `(n,)` int64 written: the piece of each
    point.
    """
    numbers[:] = 0
    variances[:] = 0.0
    for count in range(1, len(variances) + 1):
        _spread(points, numbers, count - 1, variances[count - 1])
        if count == len(variances):
            break
        widest, axis = 0, 0
        for piece in range(count):
            for k in range(variances.shape[1]):
                if variances[piece, k] > variances[widest, axis]:
                    widest, axis = piece, k
        if variances[widest, axis] < narrow:
            break
        middle = 1e300  # above all, so that the first round gives the mean
        for _ in range(rounds + 1):
            above, below, n_above, n_below = 0.0, 0.0, 0, 0
            for i in range(len(points)):
                if numbers[i] == widest:
                    value = points[i, axis]
                    if value > middle:
                        above, n_above = above + value, n_above + 1
                    else:
                        below, n_below = below + value, n_below + 1
            middle = 0.5 * (above / n_above + below / n_below) if n_above else below / n_below
        for i in range(len(points)):
            if numbers[i] == widest and points[i, axis] > middle:
                numbers[i] = count
        _spread(points, numbers, widest, variances[widest])


@compiled
def redraw_arms(
    rows,
    joints,
    torsos,
    necks,
    swap,
    deep,
    evens,
    reference,
    least,
    half,
    upper,
    fore,
    limits,
    torso,
    arms,
    possible,
):
    """Write `arms` `(n, 2, 2, 3)` with the hands of some poses, and whether they are `possible` `(n,)`.

    `rows` `(n,)` of the poses; `joints` `(k, 8, 3)` px, `torsos`, `necks` of these; `swap`: whether hands
    change places in the image; `deep`: whether they keep their depths; `evens` `(n, 4)`: numbers from -1 to 1
    that choose swivels and depths, of which the range is `least` px at least; `reference` as of `arm_to`, the
    rest as of `within_limits`.
    """  # fmt: skip
    for i in range(len(rows)):
        k, reachable = rows[i], True
        for side in range(2):
            hand, shoulder = 4 + 3 * (1 - side if swap else side), 2 + 3 * side
            x, y = joints[k, hand, 0] - joints[k, shoulder, 0], joints[k, hand, 1] - joints[k, shoulder, 1]
            z = joints[k, hand, 2] - joints[k, shoulder, 2]
            if not deep:
                square = (upper + fore) * (upper + fore) - x * x - y * y
                z = np.sqrt(max(square, least * least)) * evens[i, side]
            ux, uy, uz, fx, fy, fz, there = arm_to(
                x, y, z, np.pi * evens[i, 2 + side], upper, fore, 1.0 - 2.0 * side, reference
            )
            arms[i, side, 0, 0], arms[i, side, 0, 1], arms[i, side, 0, 2] = ux, uy, uz
            arms[i, side, 1, 0], arms[i, side, 1, 1], arms[i, side, 1, 2] = fx, fy, fz
            reachable &= there
        possible[i] = reachable and is_within(torsos, necks, k, arms, i, half, upper, fore, limits, torso)


@compiled
def walk(roots, torsos, necks, arms, normals, evens, place, decay, stds, concentrations):
    """Move poses, in place, by one step of a random walk.

    `normals`, `evens` `(n, 8)`: random numbers, standard normal ones, and from 0 to 1; `place` px: standard
    deviation of the position; `decay`, `stds` `(6,)` of the turns; `concentrations` `(2,)` of upper arms and
    forearms.
    """
    for k in range(len(roots)):
        for axis in range(2):
            roots[k, axis] += place * normals[k, axis]
        for axis in range(3):
            torsos[k, axis] = decay[axis] * torsos[k, axis] + stds[axis] * normals[k, 2 + axis]
            necks[k, axis] = decay[3 + axis] * necks[k, axis] + stds[3 + axis] * normals[k, 5 + axis]
        for side in range(2):
            for part in range(2):
                column = 4 * side + 2 * part
                x, y, z = arms[k, side, part, 0], arms[k, side, part, 1], arms[k, side, part, 2]
                cosine, turn = von_mises_fisher(concentrations[part], evens[k, column], evens[k, column + 1])
                x, y, z = leant_from(x, y, z, cosine, turn)
                arms[k, side, part, 0], arms[k, side, part, 1], arms[k, side, part, 2] = x, y, z


@compiled
def completion_terms(
    joints, arms, chosen, depths, swivels, step, concentration, anywhere, lengths, least, reference, out
):
    """Write log densities `(n, 2)` of arms, over directions, that were completed given the hands' places.

    `joints` `(n, 8, 3)` px; `arms` as in `BodyPoses`; `chosen` `(n,)`: ancestors, of which `depths`,
    `swivels` `(k, 2)` are those of the hands, px, and of the elbows, rad; `step` px, `concentration` about
    these; `anywhere`: share that ignores them; `lengths` `(2,)` px of upper arm and forearm; `least` px: half
    the range of a depth; `reference` as of `arm_to`.
    """
    upper, fore = lengths[0], lengths[1]
    # of the Gaussian, and of von Mises' density with its peak as 1
    normal = np.sqrt(2.0 * np.pi) * step * concentration[1]
    for k in range(len(joints)):
        for side in range(2):
            x = joints[k, 4 + 3 * side, 0] - joints[k, 2 + 3 * side, 0]
            y = joints[k, 4 + 3 * side, 1] - joints[k, 2 + 3 * side, 1]
            z = joints[k, 4 + 3 * side, 2] - joints[k, 2 + 3 * side, 2]
            ux, uy, uz = arms[k, side, 0, 0], arms[k, side, 0, 1], arms[k, side, 0, 2]
            upright, level = elbow_of(ux, uy, uz, x, y, z, 1.0 - 2.0 * side, reference)
            away = (z - depths[chosen[k], side]) / step
            turned = np.cos(np.arctan2(upright, level) - swivels[chosen[k], side]) - 1.0
            near = np.exp(concentration[0] * turned - 0.5 * away * away) / normal
            half = np.sqrt(max((upper + fore) * (upper + fore) - x * x - y * y, least * least))
            density = (1.0 - anywhere) * near + anywhere / (4.0 * np.pi * half)
            square = max(x * x + y * y + z * z, 1e-300)
            out[k, side] = np.log(density * upper * fore * np.sqrt(square))


@compiled
def choose_arms(shares, points, near, centres, follows, scales, scaled, about, evens, drawn):
    """Draw arms `(n, 2, 3)` about `near` `(n, 2, 3)` where `follows` `(n,)`, else about one of the centres.

    `shares` `(n, k)` of the centres `(k, 2, 3)`, with sums 1; `points` `(n,)`: numbers from 0 to 1 that
    choose one; `scales` `(n,)`: which concentrations of `scaled` `(m, 2)` are those about `near`; `about`
    `(2,)`: those about centres; `evens` `(n, 4)`: numbers from 0 to 1 that choose cosines and turns.
    """
    for k in range(len(near)):
        centre, rest = 0, points[k]
        while rest >= shares[k, centre] and centre < len(centres) - 1:
            rest -= shares[k, centre]
            centre += 1
        for part in range(2):
            if follows[k]:
                x, y, z = near[k, part, 0], near[k, part, 1], near[k, part, 2]
                kappa = scaled[scales[k], part]
            else:
                x, y, z = centres[centre, part, 0], centres[centre, part, 1], centres[centre, part, 2]
                kappa = about[part]
            cosine, turn = von_mises_fisher(kappa, evens[k, 2 * part], evens[k, 2 * part + 1])
            x, y, z = leant_from(x, y, z, cosine, turn)
            drawn[k, part, 0], drawn[k, part, 1], drawn[k, part, 2] = x, y, z


@compiled
def chosen_arms(arms, shares, near, centres, scaled, about, heights, follows, least, out):
    """Write log densities `(n,)` of `choose_arms`.

    `heights` `(m + 1,)`: peaks of the densities about `near`, and at last about centres; `follows`: share of
    the former; `least` floor; the rest is as of `choose_arms`.
    """
    n_scales = len(scaled)
    for k in range(len(arms)):
        ux, uy, uz = arms[k, 0, 0], arms[k, 0, 1], arms[k, 0, 2]
        fx, fy, fz = arms[k, 1, 0], arms[k, 1, 1], arms[k, 1, 2]
        total = 0.0
        for j in range(len(centres)):
            upper = ux * centres[j, 0, 0] + uy * centres[j, 0, 1] + uz * centres[j, 0, 2] - 1.0
            fore = fx * centres[j, 1, 0] + fy * centres[j, 1, 1] + fz * centres[j, 1, 2] - 1.0
            total += shares[k, j] * np.exp(about[0] * upper + about[1] * fore)
        total *= (1.0 - follows) * heights[n_scales]
        upper = ux * near[k, 0, 0] + uy * near[k, 0, 1] + uz * near[k, 0, 2] - 1.0
        fore = fx * near[k, 1, 0] + fy * near[k, 1, 1] + fz * near[k, 1, 2] - 1.0
        for j in range(n_scales):
            total += follows / n_scales * heights[j] * np.exp(scaled[j, 0] * upper + scaled[j, 1] * fore)
        out[k] = np.log(total + least)


NEVER = -1e300  # nats of what is impossible


@compiled
def move_blocks(
    blocks, scales, normals, evens, rates, lengths, reference, roots, torsos, necks, arms, correction
):
    """Change each pose, in place, in one block of coordinates: see `tempering.BLOCKS`.

    `blocks`, `scales` `(n,)` of the changes; `normals`, `evens` `(n, 5)` and `(n, 4)`: random numbers,
    standard normal ones, and from 0 to 1; `rates` `(9,)`: standard deviations at scale 1 of the position, px,
    of the neck, of the torso (3), of the directions of upper arms and forearms, rad, of a hand's depth, px,
    and of a swivel, rad; `lengths` `(3,)` px: half the shoulders, upper arm, forearm; `reference` as of
    `arm_to`; poses as in `BodyPoses`; `correction` `(n,)` written: log of the Hastings ratio.
    """
    half, upper, fore = lengths[0], lengths[1], lengths[2]
    for k in range(len(blocks)):
        block, scale = blocks[k], scales[k]
        correction[k] = 0.0
        if block == 0:
            for axis in range(2):
                roots[k, axis] += scale * rates[0] * normals[k, axis]
            for axis in range(3):
                necks[k, axis] += scale * rates[1] * normals[k, 2 + axis]
        elif block <= 2:
            for part in range(2):
                x, y, z = (
                    arms[k, block - 1, part, 0],
                    arms[k, block - 1, part, 1],
                    arms[k, block - 1, part, 2],
                )
                kappa = 1.0 / (scale * rates[5 + part]) ** 2
                cosine, turn = von_mises_fisher(kappa, evens[k, 2 * part], evens[k, 2 * part + 1])
                x, y, z = leant_from(x, y, z, cosine, turn)
                arms[k, block - 1, part, 0], arms[k, block - 1, part, 1] = x, y
                arms[k, block - 1, part, 2] = z
        else:
            leaning = block == 5
            right, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
            if leaning:
                for axis in range(3):
                    torsos[k, axis] += scale * rates[2 + axis] * normals[k, axis]
            after, _, _ = rotation(torsos[k, 0], torsos[k, 1], torsos[k, 2])
            size = 0.0 if leaning else scale
            for side in range(2):
                if leaning or side == block - 3:
                    sign = 1.0 - 2.0 * side
                    ux, uy, uz = arms[k, side, 0, 0], arms[k, side, 0, 1], arms[k, side, 0, 2]
                    x = upper * ux + fore * arms[k, side, 1, 0]
                    y = upper * uy + fore * arms[k, side, 1, 1]
                    z = upper * uz + fore * arms[k, side, 1, 2]
                    upright, level = elbow_of(ux, uy, uz, x, y, z, sign, reference)
                    angle = np.arctan2(upright, level) + size * rates[8] * normals[k, 0]
                    before = x * x + y * y + z * z
                    x += sign * half * (right[0] - after[0])
                    y += sign * half * (right[1] - after[1])
                    z += sign * half * (right[2] - after[2]) + size * rates[7] * normals[k, 1]
                    ux, uy, uz, fx, fy, fz, there = arm_to(x, y, z, angle, upper, fore, sign, reference)
                    arms[k, side, 0, 0], arms[k, side, 0, 1], arms[k, side, 0, 2] = ux, uy, uz
                    arms[k, side, 1, 0], arms[k, side, 1, 1], arms[k, side, 1, 2] = fx, fy, fz
                    # the ratio of volumes, as of `log_volume`
                    tiny = 1e-300
                    volume = 0.5 * np.log(max(before, tiny) / max(x * x + y * y + z * z, tiny))
                    correction[k] = correction[k] + volume if there else NEVER


NECK = 0.62  # of the way from the head's centre to the root: middle of the neck's skin
FOREARM_POINTS = 4  # places between elbow and wrist at which skin is looked up


@helper
def _at(picture, x, y):
    """Bilinear value of a map `(height, width)`; that of the border outside."""
    height, width = picture.shape
    x = min(max(x, _f4(0.0)), _f4(width - 1))
    y = min(max(y, _f4(0.0)), _f4(height - 1))
    column, row = max(min(np.int64(x), width - 2), 0), max(min(np.int64(y), height - 2), 0)
    right, down = x - _f4(column), y - _f4(row)
    after, next_row = min(column + 1, width - 1), min(row + 1, height - 1)
    above = picture[row, column] + right * (picture[row, after] - picture[row, column])
    below = picture[next_row, column] + right * (picture[next_row, after] - picture[next_row, column])
    return above + down * (below - above)


@helper
def _inside(distance, radius, spread):
    """Share of a Gaussian window that a large disc covers whose centre is so far from the window's."""
    steep = min(_f4(1.7) * (distance - radius) / spread, _f4(60.0))  # `exponential` ends at 80
    return _f4(1.0) / (_f4(1.0) + exponential(steep))


@helper
def _before(edge, spread):
    """Share of a Gaussian window that is on the near side of an edge `edge` px beyond its centre."""
    steep = min(max(_f4(-1.7) * edge / spread, _f4(-60.0)), _f4(60.0))
    return _f4(1.0) / (_f4(1.0) + exponential(steep))


@helper
def _in_strip(right, below, arm, half, spread):
    """Share that an arm (direction, length) covers of a window `right` and `below` of its beginning."""
    along, off = right * arm[0] + below * arm[1], below * arm[0] - right * arm[1]
    covered = _before(arm[2] - along, spread) - _before(-along, spread)
    return covered * (_before(half - off, spread) - _before(-half - off, spread))


@helper
def _in_picture(column, row, picture, spread):
    """Share of a Gaussian window within a map, of `spread` entries: nothing is known of what is outside."""
    height, width = picture.shape
    across = min(column + _f4(0.5), _f4(width) - _f4(0.5) - column)
    down = min(row + _f4(0.5), _f4(height) - _f4(0.5) - row)
    return _before(min(across, down), spread)


@helper
def _seen_or_not(nats, hidden):
    """Log of a mixture: seen with a likelihood ratio of `nats`, or `hidden` and then of 1."""
    return logarithm((_f4(1.0) - hidden) * exponential(min(nats, _f4(60.0))) + hidden)


class HandModel(NamedTuple):
    """What a hand's skin looks like, and what else may be there."""

    radius: float  # px
    windows: NDArray[np.float64]  # `(2,)` px: standard deviations of the inner and the outer window
    head: NDArray[np.float64]  # `(2,)` px: its half width and half height
    neck_radius: float  # px
    # `(3,)`: nats of all that a hand shows, and of nothing of it; probability of a hand without skin
    scores: NDArray[np.float64]
    forearm: NDArray[np.float64]  # `(2,)` px: its length from the elbow to the hand, and half its width
    bare_scores: NDArray[np.float64]  # `(3,)`: the scores of a bare forearm that is seen in its full length
    faces: NDArray[np.float64]  # `(m, 4)` px: ellipses of detected heads and necks, whose skin is no hand's
    own: float  # half axes of a head within which a detected one is its own, and explains nothing more


@helper
def _explained(x, y, parts, roots, k, hand, spread):
    """Share of a Gaussian window at x, y that head and neck of pose k, or detected ones, cover."""
    wide, high = _f4(hand.head[0]), _f4(hand.head[1])
    radius = np.sqrt(wide * high)
    neck_x = x - _f4(parts[k, 0, 0] + NECK * (roots[k, 0] - parts[k, 0, 0]))
    neck_y = y - _f4(parts[k, 0, 1] + NECK * (roots[k, 1] - parts[k, 0, 1]))
    off_x = (x - _f4(parts[k, 0, 0])) / wide
    off_y = (y - _f4(parts[k, 0, 1])) / high
    from_head = np.sqrt(off_x * off_x + off_y * off_y) * radius
    from_neck = np.sqrt(neck_x * neck_x + neck_y * neck_y)
    covered = max(_inside(from_head, radius, spread), _inside(from_neck, _f4(hand.neck_radius), spread))
    for face in hand.faces:
        away_x = (_f4(parts[k, 0, 0]) - _f4(face[0])) / _f4(hand.head[0])
        away_y = (_f4(parts[k, 0, 1]) - _f4(face[1])) / _f4(hand.head[1])
        if away_x * away_x + away_y * away_y < _f4(hand.own * hand.own):
            continue
        wide, high = _f4(face[2]), _f4(face[3])
        radius = np.sqrt(wide * high)
        off_x, off_y = (x - _f4(face[0])) / wide, (y - _f4(face[1])) / high
        covered = max(covered, _inside(np.sqrt(off_x * off_x + off_y * off_y) * radius, radius, spread))
    return covered


@helper
def _forearm(parts, elbows, k, side, radius, arm):
    """Write direction and length (3,) of a forearm in the picture, from the elbow to the wrist."""
    x = _f4(parts[k, 1 + side, 0] - elbows[k, side, 0])
    y = _f4(parts[k, 1 + side, 1] - elbows[k, side, 1])
    length = max(np.sqrt(x * x + y * y), _f4(1e-3))
    arm[0], arm[1], arm[2] = x / length, y / length, max(length - radius, _f4(0.0))


@compiled
def hand_terms(parts, roots, elbows, centre, surround, scales, hand, bare, out, nats):
    """Log likelihood ratios of both hands' skin, added to `out` `(n,)`.

    A hand is a disc of skin amid none, as two Gaussian windows see it: much in the inner one, little in the
    outer one. What head, neck and the other hand explain counts for neither; two hands at one place see the
    same skin, which counts once. Bare forearms explain skin as well.

    `parts`, `roots`, `elbows` `(n, 3, 2)`, `(n, 2)` and `(n, 2, 2)` px; `centre`, `surround`: maps of skin,
    from 0 to 1, in the inner and the outer window; `scales` `(2,)` are their entries a px, along x and y;
    `hand`: a `HandModel`; `bare`: whether forearms are bare. Into `nats` `(n, 2)` those of either hand if it
    is seen are written.
    """
    full, none, hidden = _f4(hand.scores[0]), _f4(hand.scores[1]), _f4(hand.scores[2])
    inner, outer = _f4(hand.windows[0]), _f4(hand.windows[1])
    radius, half = _f4(hand.radius), _f4(hand.forearm[1])
    across, down = _f4(scales[0]), _f4(scales[1])
    # a disc of skin of the hand's size, as the windows see it from its centre
    ideal = exponential(_f4(-0.5) * (radius / outer) ** 2) - exponential(_f4(-0.5) * (radius / inner) ** 2)
    width = outer * outer + _f4(0.25) * radius * radius
    arms = np.empty((2, 3), np.float32)
    for k in range(len(parts)):
        apart_x = _f4(parts[k, 1, 0] - parts[k, 2, 0])
        apart_y = _f4(parts[k, 1, 1] - parts[k, 2, 1])
        squared = apart_x * apart_x + apart_y * apart_y
        neighbour = _f4(0.5) * radius * radius / width * exponential(_f4(-0.5) * squared / width)
        least, total = _f4(1e9), _f4(0.0)
        if bare:
            for side in range(2):
                _forearm(parts, elbows, k, side, radius, arms[side])
        for side in range(1, 3):
            x, y = _f4(parts[k, side, 0]), _f4(parts[k, side, 1])
            before = _explained(x, y, parts, roots, k, hand, inner)
            around = _explained(x, y, parts, roots, k, hand, outer)
            if bare:
                for arm in range(2):
                    right, below = x - _f4(elbows[k, arm, 0]), y - _f4(elbows[k, arm, 1])
                    around += _in_strip(right, below, arms[arm], half, outer)
                    if arm != side - 1:
                        before = max(before, _in_strip(right, below, arms[arm], half, inner))
            column = (x + _f4(0.5)) * across - _f4(0.5)
            row = (y + _f4(0.5)) * down - _f4(0.5)
            # what head, arms and other hand explain tells nothing: it is there anyway; other skin around the
            # hand speaks against it
            foreign = max(_at(surround, column, row) - neighbour - around, _f4(0.0))
            response = (max(_at(centre, column, row) - before, _f4(0.0)) - foreign) / ideal
            free = _f4(1.0) - before
            seen = free * none + (full - none) * min(max(response, _f4(0.0)), free)
            seen *= _in_picture(column, row, centre, inner * across)
            nats[k, side - 1] = seen
            gain = _seen_or_not(seen, hidden)
            least = min(least, gain)
            total += gain
        apart = np.sqrt(squared) / (_f4(2.0) * radius)
        if apart < _f4(1.0):  # share of a disc that the other one covers: they see the same skin once
            shared = (np.arccos(apart) - apart * np.sqrt(_f4(1.0) - apart * apart)) * _f4(2.0 / np.pi)
            total -= min(_f4(2.0) * shared, _f4(1.0)) * max(least, _f4(0.0))
        out[k] += total


@compiled
def forearm_terms(parts, roots, elbows, centre, scales, hand, out):
    """Log likelihood ratios of both forearms' skin, if they are bare, added to `out` `(n,)`.

    They are looked up at points between elbow and wrist, and count as far as they are long in the picture.
    What head, neck, hands and the other forearm explain tells nothing. Parameters as of `hand_terms`.
    """
    full, none, hidden = _f4(hand.bare_scores[0]), _f4(hand.bare_scores[1]), _f4(hand.bare_scores[2])
    inner, radius, half = _f4(hand.windows[0]), _f4(hand.radius), _f4(hand.forearm[1])
    across, down = _f4(scales[0]), _f4(scales[1])
    ideal = _before(half, inner) - _before(-half, inner)
    whole = _f4(hand.forearm[0]) - radius
    arms = np.empty((2, 3), np.float32)
    for k in range(len(parts)):
        for side in range(2):
            _forearm(parts, elbows, k, side, radius, arms[side])
        for side in range(2):
            nats = _f4(0.0)
            for step in range(FOREARM_POINTS):
                share = (_f4(step) + _f4(0.5)) / _f4(FOREARM_POINTS) * arms[side, 2]
                x = _f4(elbows[k, side, 0]) + share * arms[side, 0]
                y = _f4(elbows[k, side, 1]) + share * arms[side, 1]
                before = _explained(x, y, parts, roots, k, hand, inner)
                for other in range(2):
                    right, below = x - _f4(parts[k, 1 + other, 0]), y - _f4(parts[k, 1 + other, 1])
                    before = max(before, _inside(np.sqrt(right * right + below * below), radius, inner))
                if side == 1:
                    right, below = x - _f4(elbows[k, 0, 0]), y - _f4(elbows[k, 0, 1])
                    before = max(before, _in_strip(right, below, arms[0], half, inner))
                column = (x + _f4(0.5)) * across - _f4(0.5)
                row = (y + _f4(0.5)) * down - _f4(0.5)
                free = _f4(1.0) - before
                response = max(_at(centre, column, row) / ideal - before, _f4(0.0))
                seen = _in_picture(column, row, centre, inner * across)
                nats += seen * (free * none + (full - none) * min(response, free))
            nats *= arms[side, 2] / (whole * _f4(FOREARM_POINTS))
            out[k] += _seen_or_not(nats, hidden)


@compiled
def head_terms(heads, contrast, scales, scores, out):
    """Log likelihood ratios of skin where the head is to be, added to `out` `(n,)`.

    `heads` are `(n, 2)` px; `contrast`, up to 1, is how much more skin there is in a head's place than
    around it, `scales` `(2,)` its entries a px; `scores` `(2,)`: nats of a full one, probability of none.
    """
    full, hidden = _f4(scores[0]), _f4(scores[1])
    for k in range(len(heads)):
        column = (_f4(heads[k, 0]) + _f4(0.5)) * _f4(scales[0]) - _f4(0.5)
        row = (_f4(heads[k, 1]) + _f4(0.5)) * _f4(scales[1]) - _f4(0.5)
        response = min(max(_at(contrast, column, row), _f4(0.0)), _f4(1.0))
        out[k] += _seen_or_not(full * response, hidden)


@compiled
def arm_terms(joints, arms, scales, points, weights, torso, missing, out):
    """Log likelihood ratios of the colours along arms, added to `out` `(n,)`.

    Before the trunk, whose clothes are those of the arms, nothing is told.

    `joints` `(n, 8, 2)` px; `arms`: map of the log odds of a sleeve's colour; `scales` `(2,)` are its entries
    a px; `points`, `weights` `(2, k)`: places on upper arm and forearm as shares of their length, and what
    each counts; `torso` `(3,)`: share of the shoulders' distance that the trunk is broad, how far above the
    shoulders it reaches in that distance, and px over which its border is blurred; `missing`: chance that an
    arm does not look like that.
    """
    broad, above, blur = _f4(torso[0]), _f4(torso[1]), _f4(torso[2])
    across, down, hidden = _f4(scales[0]), _f4(scales[1]), _f4(missing)
    count = points.shape[1]
    worth, xs, ys, columns, rows, odds = np.empty((6, 4 * count), np.float32)
    for place in range(4 * count):
        worth[place] = weights[(place // count) % 2, place % count]
    for k in range(len(joints)):
        root_x, root_y = _f4(joints[k, 1, 0]), _f4(joints[k, 1, 1])
        axis_x, axis_y = _f4(joints[k, 2, 0] - joints[k, 5, 0]), _f4(joints[k, 2, 1] - joints[k, 5, 1])
        length = max(np.sqrt(axis_x * axis_x + axis_y * axis_y), _f4(1.0))
        axis_x, axis_y = axis_x / length, axis_y / length
        for limb in range(4):
            first = 2 + 3 * (limb // 2) + limb % 2
            x, y = _f4(joints[k, first, 0]), _f4(joints[k, first, 1])
            along_x, along_y = _f4(joints[k, first + 1, 0]) - x, _f4(joints[k, first + 1, 1]) - y
            for j in range(count):
                xs[limb * count + j] = x + _f4(points[limb % 2, j]) * along_x
                ys[limb * count + j] = y + _f4(points[limb % 2, j]) * along_y
        for place in range(len(xs)):
            columns[place] = (xs[place] + _f4(0.5)) * across - _f4(0.5)
            rows[place] = (ys[place] + _f4(0.5)) * down - _f4(0.5)
        for place in range(len(xs)):
            odds[place] = _at(arms, columns[place], rows[place])
        total = _f4(0.0)
        for place in range(len(xs)):
            off_x, off_y = xs[place] - root_x, ys[place] - root_y
            beside = abs(off_x * axis_x + off_y * axis_y) - broad * length
            over = off_x * axis_y - off_y * axis_x - above * length
            outside = min(max(max(beside, over) / blur, _f4(-20.0)), _f4(20.0))
            share = _in_picture(columns[place], rows[place], arms, blur * across)
            share /= _f4(1.0) + exponential(-outside)
            total += worth[place] * _seen_or_not(share * odds[place], hidden)
        out[k] += total


@compiled
def unexplained_terms(joints, places, costs, reach, bare, out):
    """Takes from `out` `(n,)` the `costs` `(m,)` nats of skin at `places` `(m, 2)` px that nothing explains.

    Head and hands explain what is within about `reach` `(4,)` px of them, and so do, if arms are `bare`, the
    neck, forearms, and upper arms from halfway to the elbow. `joints` `(n, 8, 2)` px.
    """
    limbs, rates = np.empty((5, 5), np.float32), np.empty(4, np.float32)
    for part in range(4):
        rates[part] = _f4(0.5) / _f4(reach[part] * reach[part])
    n_limbs = 5 if bare else 0
    for k in range(len(joints)):
        for limb in range(n_limbs):
            first = 0 if limb == 4 else 2 + 3 * (limb // 2) + limb % 2
            x, y = _f4(joints[k, first, 0]), _f4(joints[k, first, 1])
            right, below = _f4(joints[k, first + 1, 0]) - x, _f4(joints[k, first + 1, 1]) - y
            if limb == 0 or limb == 2:
                right, below = _f4(0.5) * right, _f4(0.5) * below
                x, y = x + right, y + below
            length = max(np.sqrt(right * right + below * below), _f4(1e-3))
            limbs[limb, 0], limbs[limb, 1] = x, y
            limbs[limb, 2], limbs[limb, 3], limbs[limb, 4] = right / length, below / length, length
        total = _f4(0.0)
        for j in range(len(places)):
            left = _f4(costs[j])
            for part in range(3):
                joint = 0 if part == 0 else 1 + 3 * part
                x = _f4(places[j, 0] - joints[k, joint, 0])
                y = _f4(places[j, 1] - joints[k, joint, 1])
                left *= _f4(1.0) - exponential(-rates[part] * (x * x + y * y))
            for limb in range(n_limbs):
                x, y = _f4(places[j, 0]) - limbs[limb, 0], _f4(places[j, 1]) - limbs[limb, 1]
                along = min(max(x * limbs[limb, 2] + y * limbs[limb, 3], _f4(0.0)), limbs[limb, 4])
                x -= along * limbs[limb, 2]
                y -= along * limbs[limb, 3]
                left *= _f4(1.0) - exponential(-rates[3] * (x * x + y * y))
            total += left
        out[k] -= total


@compiled
def edge_features(edges, directions, nearness, cosine, sine, steps, block, features, coarse):
    """What is to be known of the edge near each pixel, and its means over blocks of pixels.

    `edges`, `directions` `(height, width)` float32: px and rad; `nearness`, `cosine`, `sine` `(k,)` float32:
    tables over distances, and over directions; `steps` are their entries a px and a rad; `block` px: side of
    a block; `features` `(height, width, 3)` float32, written: nearness, cosine and sine; `coarse` float32,
    written: over blocks the means of nearness, nearness times cosine, nearness times sine.
    """
    height, width = edges.shape
    last = len(nearness) - 1
    by_distance, by_angle = _f4(steps[0]), _f4(steps[1])
    for row in range(coarse.shape[0]):
        top, bottom = row * block, min(row * block + block, height)
        for column in range(coarse.shape[1]):
            left, right = column * block, min(column * block + block, width)
            some, along, across = _f4(0.0), _f4(0.0), _f4(0.0)
            for y in range(top, bottom):
                for x in range(left, right):
                    near = nearness[min(np.int64(edges[y, x] * by_distance + _f4(0.5)), last)]
                    angle = min(np.int64(directions[y, x] * by_angle + _f4(0.5)), last)
                    features[y, x, 0] = near
                    features[y, x, 1] = cosine[angle]
                    features[y, x, 2] = sine[angle]
                    some += near
                    along += near * cosine[angle]
                    across += near * sine[angle]
            share = _f4(1.0) / _f4((bottom - top) * (right - left))
            coarse[row, column, 0] = some * share
            coarse[row, column, 1] = along * share
            coarse[row, column, 2] = across * share


@compiled
def over_density(features, coarse, block, least, even):
    """Divide the nearness in `features` by the density of edges of that direction thereabouts, in place.

    `coarse` are smoothed means over blocks as `edge_features` gives them; the density's first harmonic is
    some (1 + 2 <cos> cos + 2 <sin> sin), at least `least` and at least `even` times that of all directions.
    """
    height, width = features.shape[:2]
    rows, columns = coarse.shape[:2]
    scale = _f4(1.0) / _f4(block)
    floor, share = _f4(least), _f4(even)
    blended = np.empty((columns, 3), np.float32)
    for y in range(height):
        place = min(max((_f4(y) + _f4(0.5)) * scale - _f4(0.5), _f4(0.0)), _f4(rows - 1))
        above = min(np.int64(place), rows - 2)
        part = place - _f4(above)
        for column in range(columns):
            for k in range(3):
                upper = coarse[above, column, k]
                blended[column, k] = upper + part * (coarse[above + 1, column, k] - upper)
        for x in range(width):
            place = min(max((_f4(x) + _f4(0.5)) * scale - _f4(0.5), _f4(0.0)), _f4(columns - 1))
            left = min(np.int64(place), columns - 2)
            part = place - _f4(left)
            some = blended[left, 0] + part * (blended[left + 1, 0] - blended[left, 0])
            along = blended[left, 1] + part * (blended[left + 1, 1] - blended[left, 1])
            across = blended[left, 2] + part * (blended[left + 1, 2] - blended[left, 2])
            alike = some + _f4(2.0) * (along * features[y, x, 1] + across * features[y, x, 2])
            features[y, x, 0] /= max(max(alike, share * some), floor)


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
"""Points in a row, which are worked on together: rows are of one part each, and some points do not count."""


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
