"""Compiled loops over poses: draws that are guided by what is seen, arms that are drawn again, moves."""

import numpy as np

from ....models.body.kernels import arm_to, elbow_of, is_within, leant_from, rotation
from ....models.numerics.compiled import compiled, falling, helper
from .dynamics import von_mises_fisher


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
