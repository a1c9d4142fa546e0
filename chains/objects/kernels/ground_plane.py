"""Loops over objects on a ground plane: what a frame teaches of them, and where they are expected."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....models.numerics.compiled import compiled, inlined
from ....models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH

Numbers = NDArray[np.float64]

LEAST_SPREAD = 0.05
"""Of a width, in heights: what remains uncertain about it, however alike the observations were."""

HALF_HIDDEN = 0.5
"""Heights: standard deviation of what an observation is off by that does not show an object wholly."""

LEAST_WORTH = 1e-9
"""Of an observation that says nothing: it is left out as if its noise were that much greater."""


class Objects(NamedTuple):
    """What is known of each object; see `GroundState`."""

    feet: Numbers
    feet_covariance: Numbers
    heights: Numbers
    aspects: Numbers
    aspect_variances: Numbers
    trust: Numbers
    unseen: Numbers


class Observed(NamedTuple):
    """Boxes of a frame: places `(n,)` of their objects, `(n, 4)` px, `(n, 4, 4)` px^2, P(exists) `(n,)`."""

    places: NDArray[np.intp]
    boxes: Numbers
    covariances: Numbers
    existence: Numbers


class GroundModel(NamedTuple):
    """Numbers that all objects share: the picture's `(height, width)` px, and parameters of `GroundPlane`."""

    rows: float
    columns: float
    spread: float
    foot_spread: float
    outliers: float
    observation_time: float
    most_trust: float


@inlined
def _good_over_bad(square, variance, more):
    """Likelihood ratio of two Gaussians about the same mean, the second one with `more` variance."""
    bad = variance + more
    ratio = math.sqrt(bad / variance) * math.exp(-0.5 * square * (1 / variance - 1 / bad))
    return max(ratio, 1e-30)


@inlined
def _probability_of_good(ratio, outliers):
    odds = ratio * (1 / outliers - 1)
    return odds / (1 + odds)


@inlined
def _plane(below, scene, covariance):
    """Mean px and variance px^2 of the height of somebody of average stature, `below` the middle row."""
    variance = covariance[0, 0] + 2 * below * covariance[0, 1] + below * below * covariance[1, 1]
    return scene[0] + scene[1] * below, variance


@inlined
def _usual_height(below, height, scene, covariance):
    """px: what the plane says of the height of anybody there; before it is known, the measured one.

    An object's own share and all noise are scaled with it. The measured height comes in as little as can be:
    shares of hidden people's heights would let the plane sink while the shares grow.
    """
    mean, variance = _plane(below, scene, covariance)
    height = max(height, 1.0)
    share = 1 / (1 + variance / (HALF_HIDDEN * height) ** 2)
    return max(height + share * (mean - height), 0.25 * height)


@inlined
def _height(below, place, own, scene, covariance):
    """Mean px and variance px^2 of an object's height, whose own share is of `own` px."""
    mean, variance = _plane(below, scene, covariance)
    k = 2 + place
    variance += 2 * own * (covariance[0, k] + below * covariance[1, k]) + own * own * covariance[k, k]
    return mean + own * scene[k], variance


@inlined
def _is_whole(box, model):
    """Whether the picture's edge does not cut off a box."""
    x, y, half = box[FOOT_X], box[FOOT_Y], 0.5 * box[WIDTH]
    inside = y - box[HEIGHT] > 1 and y < model.rows - 1
    return inside and x - half > 1 and x + half < model.columns - 1


@inlined
def _walk(place, box, covariance, height, reliable, worth, model, objects):
    """Feet after an observation that shows them as likely as `reliable`.

    What hides feet does so for a while: of their row such observations are `worth` a part of a new one.
    """
    sway = (model.foot_spread * height) ** 2
    noise_x = covariance[FOOT_X, FOOT_X] + sway + (1 - reliable) * (HALF_HIDDEN * box[WIDTH]) ** 2
    noise_y = covariance[FOOT_Y, FOOT_Y] + sway + (1 - reliable) / worth * (HALF_HIDDEN * box[HEIGHT]) ** 2
    before, spread = objects.feet[place], objects.feet_covariance[place]
    off_x, off_y = box[FOOT_X] - before[0, 0], box[FOOT_Y] - before[1, 0]
    variance_x, variance_y = spread[0, 0, 0] + noise_x, spread[1, 0, 0] + noise_y
    # People do not jump: a box that does has lost its object, or part of it.
    ratio = _good_over_bad(off_x * off_x, variance_x, height * height)
    ratio *= _good_over_bad(off_y * off_y, variance_y, height * height)
    doubt = 1 / max(_probability_of_good(ratio, model.outliers), 1e-3) - 1
    for axis in range(2):
        off = off_y if axis else off_x
        variance = variance_y + noise_y * doubt if axis else variance_x + noise_x * doubt
        position, both, speed = spread[axis, 0, 0], spread[axis, 1, 0], spread[axis, 1, 1]
        gain, speed_gain = position / variance, both / variance
        before[axis, 0] += gain * off
        before[axis, 1] += speed_gain * off
        spread[axis, 0, 0] = position - gain * position
        spread[axis, 0, 1] = spread[axis, 1, 0] = both - speed_gain * position
        spread[axis, 1, 1] = speed - speed_gain * both


@inlined
def _learn_height(below, place, own, height, noise, scene, covariance):
    """The regression of heights after one of them: a Kalman update."""
    k, size = 2 + place, scene.size
    mean, variance = _height(below, place, own, scene, covariance)
    gain = np.empty(size)
    for i in range(size):
        gain[i] = covariance[0, i] + below * covariance[1, i] + own * covariance[k, i]
    total, off = variance + noise, height - mean
    for i in range(size):
        share, row = gain[i] / total, covariance[i]
        scene[i] += share * off
        for j in range(size):
            row[j] -= share * gain[j]


@compiled
def observe(observed, model, mean_aspect, scene, covariance, objects):
    """What boxes teach, of the plane (`scene` and its `covariance`) and of `objects`, which are changed.

    Boxes are judged by what was known before all of them; they are independent then, so that the joint update
    is that by one after the other.

    Returns
    -------
    weight, first, second
        sum of the boxes' weights, and of their weighted differences in width over height from `mean_aspect`,
        and of those squared.
    """
    count = observed.places.size
    noises = np.empty(count)
    weight = first = second = 0.0
    for n in range(count):
        place, box, spread = observed.places[n], observed.boxes[n], observed.covariances[n]
        below, height, slope = box[FOOT_Y] - 0.5 * model.rows, box[HEIGHT], scene[1]
        own = _usual_height(below, height, scene, covariance)
        # variance of the height less what an error of the foot's row would change it by along the plane
        noise = spread[HEIGHT, HEIGHT] + slope * (slope * spread[FOOT_Y, FOOT_Y] - 2 * spread[FOOT_Y, HEIGHT])
        noise += (model.spread * own) ** 2
        mean, variance = _height(below, place, own, scene, covariance)
        ratio = _good_over_bad((height - mean) ** 2, variance + noise, (HALF_HIDDEN * own) ** 2)
        good = _probability_of_good(ratio, model.outliers)
        whole = 1.0 if _is_whole(box, model) else 0.0
        on_plane = observed.existence[n] / (1 + math.exp(-objects.trust[place]))
        worth = min(max(objects.unseen[place], 1e-6) / model.observation_time, 1.0)
        noises[n] = noise / max(whole * on_plane * good * worth, LEAST_WORTH)

        surprise = math.log((1 - model.outliers) * ratio + model.outliers)
        trust = objects.trust[place] + whole * worth * surprise
        objects.trust[place] = min(max(trust, -model.most_trust), model.most_trust)
        objects.heights[place] = own
        objects.unseen[place] = 0.0
        aspect = box[WIDTH] / max(height, 1.0)
        rate, change = 0.3 * whole * good * worth, aspect - objects.aspects[place]
        objects.aspects[place] += rate * change
        variance = objects.aspect_variances[place]
        objects.aspect_variances[place] = (1 - rate) * (variance + rate * change * change)
        shown, off = whole * on_plane * good * worth, aspect - mean_aspect
        weight += shown
        first += shown * off
        second += shown * off * off
        _walk(place, box, spread, own, whole * (1 - on_plane * (1 - good)), worth, model, objects)
    for n in range(count):
        place, box = observed.places[n], observed.boxes[n]
        below, own = box[FOOT_Y] - 0.5 * model.rows, objects.heights[place]
        _learn_height(below, place, own, box[HEIGHT], noises[n], scene, covariance)
    return weight, first, second


@compiled
def box_densities(middle, spread, foot_spread, scene, covariance, objects, information, vector, log_scale):
    """Density of every object's box in information form (see `GroundState.boxes`), into the last three."""
    slope = scene[1]
    information[:] = 0.0
    vector[:] = 0.0
    for k in range(objects.heights.size):
        x, y, own = objects.feet[k, 0, 0], objects.feet[k, 1, 0], objects.heights[k]
        mean, variance = _height(y - middle, k, own, scene, covariance)
        upright, square, aspect = mean - slope * y, own * own, objects.aspects[k]
        trusted = 1 / (1 + math.exp(-objects.trust[k]))
        of_x = 1 / (objects.feet_covariance[k, 0, 0, 0] + foot_spread * foot_spread * square)
        of_y = 1 / (objects.feet_covariance[k, 1, 0, 0] + foot_spread * foot_spread * square)
        of_width = 1 / ((objects.aspect_variances[k] + LEAST_SPREAD**2) * square)
        of_height = trusted / (variance + spread * spread * square)
        own_information, own_vector = information[k], vector[k]
        own_information[FOOT_X, FOOT_X] = of_x
        own_information[FOOT_Y, FOOT_Y] = of_y + slope * slope * of_height
        own_information[FOOT_Y, HEIGHT] = own_information[HEIGHT, FOOT_Y] = -slope * of_height
        own_information[WIDTH, WIDTH] = of_width
        own_information[WIDTH, HEIGHT] = own_information[HEIGHT, WIDTH] = -aspect * of_width
        own_information[HEIGHT, HEIGHT] = of_height + aspect * aspect * of_width
        own_vector[FOOT_X] = of_x * x
        own_vector[FOOT_Y] = of_y * y - slope * of_height * upright
        own_vector[HEIGHT] = of_height * upright
        peak = math.log(of_x) + math.log(of_y) + math.log(of_width) + math.log(of_height)
        quadratic = of_x * x * x + of_y * y * y + of_height * upright * upright
        log_scale[k] = 0.5 * (peak - 4 * math.log(2 * math.pi) - quadratic)
