"""Compiled loops over poses and pixels: what maps of skin and edges tell of a body."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled, exponential, helper, logarithm

_f4 = np.float32

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
    heads_and_necks: NDArray[np.float64]  # `(m, 4)` px: ellipses of detected ones, whose skin is no hand's
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
    for ellipse in hand.heads_and_necks:
        away_x = (_f4(parts[k, 0, 0]) - _f4(ellipse[0])) / _f4(hand.head[0])
        away_y = (_f4(parts[k, 0, 1]) - _f4(ellipse[1])) / _f4(hand.head[1])
        if away_x * away_x + away_y * away_y < _f4(hand.own * hand.own):
            continue
        wide, high = _f4(ellipse[2]), _f4(ellipse[3])
        radius = np.sqrt(wide * high)
        off_x, off_y = (x - _f4(ellipse[0])) / wide, (y - _f4(ellipse[1])) / high
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
