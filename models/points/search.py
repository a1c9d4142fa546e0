"""Search for points in a picture by their patches: positions, covariances, and rejection of false matches.

A patch of 5x5 pixels has many false matches. A match has to pass four tests:

- Its correlation exceeds a threshold that grows with the search window (`least_ncc`), from the number of
  false matches counted on pairs of nine unrelated pictures.
- It has no rival: no second place is nearly as likely under correlation and prior.
- If the point was not seen in the last picture, and may be hidden, it is likelier than a chance match
  (`odds_over_chance`).
- It is found back: searched for in the last picture, it is where the point was (the forward-backward test of
  Kalal, Mikolajczyk and Matas 2010).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import compiled, logarithm
from .patches import LIGHT_MODEL, PlacePrior, align_in_place, sample_all

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


_f4 = np.float32

_at = np.uint64  # a number that is no index from the end, which loops would have to ask of each

PIXELS, SCORE, SQUARES, ACROSS, TOTAL, ENERGY = range(6)  # rows of the room for a window
USUAL = 5  # px, side of patches for which loops are written out

REGISTER = 16
"""Numbers of a vector register: of multiples of it none are left over, which would go one by one."""

SHARPNESS, NCC_NOISE = 3.5, 0.02
"""How -log(1 - correlation^2) grows into a log likelihood, and the noise that limits it."""

LEAST_NCC = 0.5  # normalised correlation from which on anything counts as like a patch
LEAST_WEIGHT = -1e30  # log weight of where a patch cannot be


class Windows(NamedTuple):
    """Search windows of n patches."""

    mean: Array  # (n, 2) px
    covariance: Array  # (n, 2, 2) px^2 about it
    prior: bool  # whether mean and covariance are also the prior of the position
    reach: float  # standard deviations to search
    search_radius: float  # px along either axis to search, at most


class Candidates(NamedTuple):
    """The two likeliest places of each of n patches, the likelier first."""

    position: Array  # (n, 2, 2) px: patch, place, x and y, by parabolas about the best pixel
    ncc: Array  # (n, 2) normalised correlation at that pixel; -1 where there is no such place
    weight: Array  # (n, 2) log of likelihood and prior, up to a constant, or `LEAST_WEIGHT`


@compiled
def find_candidates_in_place(image, windows, patches, which, candidates):
    """Write the two likeliest places of those patches of `(n, side, side)` whose numbers are in `which`.

    A place's weight is `SHARPNESS` times -log(1 - correlation^2 + `NCC_NOISE`), plus the log prior. Places
    are local maxima of a correlation of `LEAST_NCC` or more.
    """
    mean, covariance, prior, reach, search_radius = windows
    height, width = image.shape
    side = patches.shape[1]
    half = side // 2
    radii = np.empty(which.size, np.int64)
    most = 0
    for m in range(which.size):
        k = which[m]
        deviation = np.sqrt(max(covariance[k, 0, 0], covariance[k, 1, 1]))
        radii[m] = np.int64(min(np.ceil(reach * deviation + 0.5), search_radius))
        most = max(most, radii[m])
    line = 2 * most + 2 + side + REGISTER
    rooms = np.zeros((6, line * line), _f4)
    flags = np.zeros(-(-line * line // 8) * 8, np.uint8)
    eight = flags.view(np.uint64)
    template, places, weights = np.empty(side * side, _f4), np.empty((2, 3)), np.empty(2)
    for m in range(which.size):
        k, radius = which[m], radii[m]
        x0, y0 = int(np.rint(mean[k, 0])), int(np.rint(mean[k, 1]))
        # one more on all sides, to see where correlation falls off
        left, top = max(x0 - radius - 1 - half, 0), max(y0 - radius - 1 - half, 0)
        columns = min(x0 + radius + 1 + half, width - 1) - left + 2 - side
        rows = min(y0 + radius + 1 + half, height - 1) - top + 2 - side
        if columns < 3 or rows < 3:
            continue
        line = columns + side - 1
        count = -(-rows * line // REGISTER) * REGISTER
        _normalise(patches, k, template)
        _lift(image, left, top, rows + side - 1, line, rooms)
        correlate(rooms, line, count, template, side)
        _flag_peaks(rooms, line, count, flags)
        a, b, c = covariance[k, 0, 0], covariance[k, 0, 1], covariance[k, 1, 1]
        scale = (1.0 if prior else 0.0) / (a * c - b * b)
        known = scale * c, -2 * scale * b, scale * a, reach * reach
        offset = left + half - mean[k, 0], top + half - mean[k, 1]
        _keep_two(rooms[SCORE], line, rows, columns, offset, known, flags, eight, places, weights)
        for place in range(2):
            if weights[place] > LEAST_WEIGHT:
                candidates.position[k, place, 0] = mean[k, 0] + places[place, 0]
                candidates.position[k, place, 1] = mean[k, 1] + places[place, 1]
                candidates.ncc[k, place], candidates.weight[k, place] = places[place, 2], weights[place]


@compiled
def _lift(image, left, top, rows, line, rooms):
    """Copy a window's pixels less one of them, so that sums of squares have small rounding errors."""
    level = _f4(image[top + rows // 2, left + line // 2])
    filled = min(-(-line // REGISTER) * REGISTER, image.shape[1] - left)
    for y in range(rows):
        for x in range(filled):
            rooms[PIXELS, _at(y * line + x)] = _f4(image[_at(top + y), _at(left + x)]) - level


@compiled
def correlate(rooms, line, count, template, side):
    """Correlate a template of mean 0 and length 1 with a window's patches, in `rooms` `(6, enough)`."""
    for i in range(count + side * line):
        pixel = rooms[PIXELS, _at(i)]
        rooms[SQUARES, _at(i)] = pixel * pixel
    if side == USUAL:
        for i in range(count):
            upper = _five(rooms, i, template, 0) + _five(rooms, i + line, template, 5)
            lower = _five(rooms, i + 3 * line, template, 15) + _five(rooms, i + 4 * line, template, 20)
            rooms[SCORE, _at(i)] = upper + _five(rooms, i + 2 * line, template, 10) + lower
    else:
        rooms[SCORE, :count] = 0
        for y in range(side):
            for x in range(side):
                weight = template[y * side + x]
                for i in range(count):
                    rooms[SCORE, _at(i)] += weight * rooms[PIXELS, _at(i + y * line + x)]
    _box_sums(rooms, PIXELS, line, side, count, TOTAL)
    _box_sums(rooms, SQUARES, line, side, count, ENERGY)
    share, least = _f4(1 / (side * side)), _f4(0.25 * side * side)
    for i in range(count):
        total = rooms[TOTAL, _at(i)]
        rooms[SCORE, _at(i)] /= np.sqrt(max(rooms[ENERGY, _at(i)] - share * total * total, least))


@compiled
def _five(rooms, i, weights, k):
    a, b, c = rooms[PIXELS, _at(i)], rooms[PIXELS, _at(i + 1)], rooms[PIXELS, _at(i + 2)]
    d, e = rooms[PIXELS, _at(i + 3)], rooms[PIXELS, _at(i + 4)]
    return weights[k] * a + weights[k + 1] * b + weights[k + 2] * c + weights[k + 3] * d + weights[k + 4] * e


@compiled
def _box_sums(rooms, what, line, side, count, out):
    """Write sums over squares, each at its upper left pixel."""
    size = count + (side - 1) * line
    if side == USUAL:
        for i in range(size):
            left = rooms[what, _at(i)] + rooms[what, _at(i + 1)] + rooms[what, _at(i + 2)]
            rooms[ACROSS, _at(i)] = left + rooms[what, _at(i + 3)] + rooms[what, _at(i + 4)]
        for i in range(count):
            upper = rooms[ACROSS, _at(i)] + rooms[ACROSS, _at(i + line)] + rooms[ACROSS, _at(i + 2 * line)]
            rooms[out, _at(i)] = upper + rooms[ACROSS, _at(i + 3 * line)] + rooms[ACROSS, _at(i + 4 * line)]
        return
    rooms[ACROSS, :size], rooms[out, :count] = 0, 0
    for x in range(side):
        for i in range(size):
            rooms[ACROSS, _at(i)] += rooms[what, _at(i + x)]
    for y in range(side):
        for i in range(count):
            rooms[out, _at(i)] += rooms[ACROSS, _at(i + y * line)]


@compiled
def _flag_peaks(rooms, line, count, flags):
    """Flag local maxima of the correlation from `LEAST_NCC` on, but for the border."""
    for i in range(count):
        here, after, further = rooms[SCORE, _at(i)], rooms[SCORE, _at(i + 1)], rooms[SCORE, _at(i + 2)]
        rooms[ACROSS, _at(i)] = max(after, max(here, further))
    # of three in a row the middle one is where the peak may be
    for i in range(count):
        above, here, below = (
            rooms[ACROSS, _at(i)],
            rooms[ACROSS, _at(i + line)],
            rooms[ACROSS, _at(i + 2 * line)],
        )
        middle = rooms[SCORE, _at(i + line + 1)]
        flags[_at(i + line + 1)] = middle >= max(here, max(above, below)) and middle >= LEAST_NCC


@compiled
def _keep_two(score, line, rows, columns, offset, prior, flags, eight, places, weights):
    """Write the two likeliest of the flagged maxima: x, y and correlation `(2, 3)`, and weights `(2,)`."""
    left, top = offset
    xx, xy, yy, most = prior
    weights[0] = weights[1] = LEAST_WEIGHT
    for word in range(line // 8, (rows - 1) * line // 8 + 1):
        if eight[word] == 0:
            continue
        for i in range(8 * word, 8 * word + 8):
            y = i // line
            x = i - y * line
            if flags[i] == 0 or not (0 < x < columns - 1 and 0 < y < rows - 1):
                continue
            dx, dy = left + x, top + y
            square = xx * dx * dx + xy * dx * dy + yy * dy * dy
            if square > most:
                continue
            right, more_x = _parabola(score[i - 1], score[i], score[i + 1])
            down, more_y = _parabola(score[i - line], score[i], score[i + line])
            peak = min(score[i] + more_x + more_y, _f4(1))
            weight = -SHARPNESS * logarithm(_f4(1 + NCC_NOISE) - peak * peak) - 0.5 * square
            if weight <= weights[1]:
                continue
            place = 1
            if weight > weights[0]:
                place = 0
                weights[1] = weights[0]
                for m in range(3):
                    places[1, m] = places[0, m]
            weights[place] = weight
            places[place, 0], places[place, 1], places[place, 2] = dx + right, dy + down, score[i]


@compiled
def _normalise(patches, k, template):
    """Write the k-th patch with mean 0 and length 1, row after row."""
    side = patches.shape[1]
    total = squares = _f4(0)
    for y in range(side):
        for x in range(side):
            total += patches[k, y, x]
    mean = total / _f4(side * side)
    for y in range(side):
        for x in range(side):
            template[y * side + x] = patches[k, y, x] - mean
            squares += template[y * side + x] * template[y * side + x]
    scale = _f4(1) / max(np.sqrt(squares), _f4(1e-6))
    for i in range(template.size):
        template[i] *= scale


@compiled
def _parabola(before, here, after):
    """Return the peak of a parabola through three values: its distance from the middle one, and its rise."""
    bent = before - _f4(2) * here + after
    if bent >= _f4(-1e-6):
        return _f4(0), _f4(0)
    off = _f4(0.5) * (before - after) / bent
    return off, _f4(-0.25) * (before - after) * off


REACH = 3.0  # standard deviations of the prior within which a point is searched for

GRID = 0.5
"""px, standard deviation added to the prior: positions are compared pixel by pixel, and a hand-held camera
moves by half a pixel more than predicted."""

ODDS = 10.0  # least odds of a place over its rival
DOUBT = 1.0  # error of a place's log weight before sub-pixel alignment
NEAR = 1.0  # px: places nearer to each other are one; limit of the sub-pixel alignment and of the way back
WHOLE = 0.5  # px: error of a place found pixel by pixel

MAX_STD = 0.7
"""px: largest standard deviation of a found position; of a lost point, after its prior is included."""

UNLIKE = 0.045
"""Mean of 1 - correlation of a point that is seen again after it was hidden, with its last patch. Of 2900
such points in a real film the quartiles of the correlation were 0.91, 0.96 and 0.975."""


class Places(NamedTuple):
    """Two places for each of n patches, to sub-pixel accuracy."""

    position: Array
    covariance: Array
    ncc: Array


@compiled
def choose_places(
    places, mean, around, precision, hidden, false_alarm_rate, search_radius, side, better, seen
):
    """Choose the likelier of two places of n points, `better` `(n,)`, and accept it or not, `seen` `(n,)`.

    After alignment it may be the other one than before. `mean`, `around` and `precision` are the prior:
    `(n, 2)` px, `(n, 2, 2)` px^2 and its inverse. Points that may be `hidden` `(n,)` have one more rival, a
    chance match. The rest is as of `find_points`.
    """
    position, covariance, nccs = places
    log_odds = np.log(ODDS)
    for k in range(seen.size):
        a, b, c = around[k, 0, 0], around[k, 0, 1], around[k, 1, 1]
        best, rival, best_square = LEAST_WEIGHT, LEAST_WEIGHT, 0.0
        for place in range(2):
            dx, dy = position[k, place, 0] - mean[k, 0], position[k, place, 1] - mean[k, 1]
            xx, xy = a + covariance[k, place, 0, 0], b + covariance[k, place, 0, 1]
            yy = c + covariance[k, place, 1, 1]
            square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
            weight = LEAST_WEIGHT
            if nccs[k, place] > 0 and square < REACH**2:
                weight = -SHARPNESS * np.log(1 - min(nccs[k, place], 1.0) ** 2 + NCC_NOISE) - 0.5 * square
            apart_x, apart_y = (
                abs(position[k, 1, 0] - position[k, 0, 0]),
                abs(position[k, 1, 1] - position[k, 0, 1]),
            )
            if place == 1 and max(apart_x, apart_y) < NEAR:
                continue
            if weight > best:
                best, rival, best_square, better[k] = weight, best, square, place
            else:
                rival = weight
        place = better[k]
        ncc = nccs[k, place]
        xx, xy, yy = covariance[k, place, 0, 0], covariance[k, place, 0, 1], covariance[k, place, 1, 1]
        area = min(np.pi * REACH**2 * np.sqrt(a * c - b * b), (2 * search_radius + 1) ** 2)
        seen[k] = best - rival > log_odds and ncc >= least_ncc(false_alarm_rate, area, side)
        if not seen[k]:
            continue
        if not hidden[k]:
            seen[k] = 0.5 * (xx + yy) <= MAX_STD**2
            continue
        # the position of a hidden point along an edge is known by the prior only
        scale = 1 / (xx * yy - xy * xy)
        p, r = scale * yy + precision[k, 0, 0], scale * xx + precision[k, 1, 1]
        q = precision[k, 0, 1] - scale * xy
        determinant = (a + xx) * (c + yy) - (b + xy) ** 2
        odds = odds_over_chance(ncc, best_square, determinant, area, side)
        seen[k] = 0.5 * (p + r) / (p * r - q * q) <= MAX_STD**2 and odds > log_odds


@compiled
def least_ncc(false_alarm_rate, area, side):
    """Return the correlation that a share `false_alarm_rate` of windows without the point exceeds by chance.

    The expected number of places with at least this correlation with a patch of `side` px in `area` px^2 is
    0.24 (area / 1089)^0.56 (5 / side)^2.5 ((1 - ncc) / 0.1)^2.5: a fit to counts for sides from 5 to 11,
    areas from 25 to 1089 and correlations from 0.8 to 0.95, right to a third. The other tests of a place
    leave a third of these false alarms.
    """
    unlike = 0.1 * (-np.log(1 - false_alarm_rate) / _at_ten_percent(area, side)) ** 0.4
    return max(1 - unlike, LEAST_NCC)


@compiled
def odds_over_chance(ncc, square, determinant, area, side):
    """Return the log odds that a place shows the point, and not a chance match.

    Of the point, 1 - ncc is exponential with mean `UNLIKE`, and the position is normal about the prior's
    mean, at a squared distance of `square` in units of the covariance, whose `determinant` is px^4. Of a
    chance match, 1 - ncc has the density of `least_ncc`'s count, and the position is uniform in the window of
    `area` px^2.
    """
    unlike = min(max(1 - ncc, 1e-3), 1.0)
    by_chance = 2.5 / unlike * _at_ten_percent(area, side) * (unlike / 0.1) ** 2.5
    log_density = -0.5 * square - 0.5 * np.log(determinant) - np.log(2 * np.pi)
    return -unlike / UNLIKE - np.log(UNLIKE * by_chance) + log_density + np.log(max(area, 1.0))


@compiled
def _at_ten_percent(area, side):
    return 0.24 * (max(area, 1.0) / 1089) ** 0.56 * (5 / side) ** 2.5


Grey = NDArray[np.uint8]
Pixels = NDArray[np.float32]

MIN_STD = 0.05  # px, standard deviation of a found position: the least there is


class PreviousView(NamedTuple):
    """The last picture: which of the points it showed, `(n,)`, and their positions."""

    grey: Grey
    shown: Mask
    position: Array


class FoundPoints(NamedTuple):
    """Which of the points were `seen` `(n,)`, and positions (px) and covariances (px^2) of these."""

    seen: Mask
    position: Array
    covariance: Array


def find_points(
    grey: Grey,
    patches: Pixels,
    mean: Array,
    covariance: Array,
    false_alarm_rate: float,
    search_radius: float,
    before: PreviousView | None = None,
) -> FoundPoints:
    """Search for points in a picture, and back in the last one.

    Parameters
    ----------
    grey, patches
        `(height, width)`, and `(n, side, side)` grey values.
    mean, covariance
        `(n, 2)` px and `(n, 2, 2)` px^2: prior of the positions.
    false_alarms
        share of windows without the point in which another place passes the test of correlation.
    search_radius
        px, largest distance from the mean.
    before
        the last picture. A point that it showed has to be found back there; any other may be hidden, and has
        to be likelier than a chance match. Without it neither is tested.
    """
    count, side = patches.shape[:2]
    mean, around = np.ascontiguousarray(mean), covariance + GRID**2 * np.eye(2)
    precision = _inverses(around)
    places = find_candidates(
        grey, patches, Windows(mean, around, True, REACH, search_radius), np.arange(count)
    )
    aligned = _aligned(grey, patches, places, PlacePrior(mean, precision))
    hidden = np.zeros(count, np.bool_) if before is None else ~before.shown
    better, seen = np.zeros(count, np.int64), np.empty(count, np.bool_)
    choose_places(
        aligned, mean, around, precision, hidden, false_alarm_rate, search_radius, side, better, seen
    )
    position, spread = (both[np.arange(count), better] for both in aligned[:2])
    if before is not None:
        again = np.flatnonzero(seen & before.shown)
        windows = Windows(before.position, around, False, REACH, search_radius)
        seen[again] = is_found_back(grey, position, before.grey, windows, again, side)
    return FoundPoints(seen, position[seen], spread[seen] + MIN_STD**2 * np.eye(2))


def is_found_back(
    grey: Grey, position: Array, before: Grey, windows: Windows, which: NDArray[np.int64], side: int
) -> Mask:
    """Return whether points at `position` px were in the middle of their windows in the last picture."""
    patches = np.empty((len(position), side, side), np.float32)
    sample_all(grey, position, which, patches)
    places = find_candidates(before, patches, windows, which)
    off = np.abs(places.position[which, 0] - windows.mean[which]).max(axis=1, initial=0)
    back: Mask = (places.ncc[which, 0] > 0) & (off <= NEAR + WHOLE)
    return back


def find_candidates(grey: Grey, patches: Pixels, windows: Windows, which: NDArray[np.int64]) -> Candidates:
    """Return the two likeliest places of those `patches` `(n, side, side)` whose numbers are in `which`."""
    count = len(patches)
    found = Candidates(np.zeros((count, 2, 2)), np.full((count, 2), -1.0), np.full((count, 2), LEAST_WEIGHT))
    find_candidates_in_place(grey, windows, patches, which, found)
    return found


def _aligned(grey: Grey, patches: Pixels, places: Candidates, expected: PlacePrior) -> Places:
    """Align the likelier places to sub-pixel accuracy, and those that may become the likelier ones."""
    close = places.ncc > 0
    close[:, 1] &= places.weight[:, 1] > places.weight[:, 0] - np.log(ODDS) - DOUBT
    position = places.position.copy()
    covariance, ncc = np.zeros((*position.shape, 2)), np.full(close.shape, -1.0)
    lines = position.reshape(-1, 2), covariance.reshape(-1, 2, 2), ncc.reshape(-1)
    align_in_place(grey, patches, np.flatnonzero(close), lines[0], expected, LIGHT_MODEL, NEAR, *lines[1:])
    return Places(position, covariance, ncc)


def _inverses(matrices: Array) -> Array:
    """Return the inverses of symmetric matrices `(n, 2, 2)`, three times as fast as numpy's."""
    turned = matrices[:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    determinants = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
    inverses: Array = turned / determinants[:, None, None]
    return inverses
