"""Which box of a detector is of which object: all assignments, weighed by belief propagation."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.frame import Frame, GivenBoxes
from ..core.gaussian_message import GaussianMessage
from .box_message import (
    BOX,
    Association,
    BoxDetector,
    BoxMessage,
    ErrorPlaces,
    Errors,
    LogOdds,
    log_anywhere,
)

Numbers = NDArray[np.float64]

MOST_ROUNDS = 50  # of belief propagation; a few are usual
TOLERANCE = 1e-6  # belief propagation for assignments ends when no message changes by more

NOTICED, UNNOTICED = 0.98, 0.05
"""Probability of finding an object in full sight: in phases in which it is noticed, and in others.

Misses come in bursts: what a detector does not find in one frame it hardly finds in the next.
"""

BEHIND = 0.05
"""Heights by which the feet of who hides another wholly are lower: two people are not in one place.

So one of two tracks of the same person, which share a box, is doubted in time. At eye level, 20 m away, it is
somebody 1 m further away.
"""

DOUBLE = np.array([3.0, 3.0, 1.0, 1.0])
"""So many times as far off as its first box may the second one of an object be, in place and size."""

DOUBLE_SIZE = 0.3
"""Deviation of how much larger or smaller it is besides, in both sides alike.

Measured of ACF and DPM on four sequences: root mean squares of log ratios of 0.08 to 0.41.
"""

OUTLIERS, OUTLYING = 0.1, 3.0
"""Share of an object's boxes that are outlying, and so many times as far off, in place and size.

Measured of ACF and DPM on four sequences: errors deviate 1.1 to 1.5 times as far as their median says.
"""

HIDDEN, AT_BORDER = 0.5, 0.03
"""Heights: deviation of what the border hides of a box, and how near to it such a box ends; guesses."""

NO_ERRORS = Errors(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, BOX)))
NO_PLACES = ErrorPlaces(np.zeros((0, BOX)), np.zeros(0))
SURELY_NOT = 1e-4  # probability of a pair below which nothing is learned from it


def feet(xyxy: Numbers) -> Numbers:
    """Return boxes `(n, 4)` of left, top, right, bottom edge as foot x, foot y, width, height."""
    left, top, right, bottom = xyxy.T
    return np.stack([0.5 * (left + right), bottom, right - left, bottom - top], axis=1)


class Marginals(NamedTuple):
    """Marginal probabilities of an assignment.

    `pairs` `(n_objects, n_boxes)`, `missed` `(n_objects,)`, `alone` `(n_boxes,)`; `open` `(n_objects,
    n_boxes)` is how far a box is free for an object given all others (1: no other object may have it), and
    `log_sum` the log of the sum over all assignments, by Bethe's approximation.
    """

    pairs: Numbers
    missed: Numbers
    alone: Numbers
    open: Numbers
    log_sum: float


def assignment_marginals(weights: Numbers, missed: Numbers) -> Marginals:
    """Return the marginals of p(assignment) ~ product of the weights of its pairs and of missed objects.

    J. Williams, R. Lau, *Approximate evaluation of marginal association probabilities with belief
    propagation* (2014), eq. 29-33; exact where the pairs that are possible form no loop. `weights`
    `(n_objects, n_boxes)` are of an object with a box, over the box alone, `missed` `(n_objects,)` of an
    object without a box; 0 or more.
    """
    free = np.ones_like(weights)
    claimed = np.zeros_like(weights)
    for _ in range(MOST_ROUNDS):
        wanted = weights * free
        rest = missed[:, None] + wanted.sum(axis=1, keepdims=True) - wanted
        claimed = weights / np.maximum(rest, 1e-300)
        before, free = free, 1 / (1 + claimed.sum(axis=0) - claimed)
        if np.abs(free - before).max(initial=0.0) < TOLERANCE:
            break
    wanted = weights * free
    whole = missed + wanted.sum(axis=1)
    asked = 1 + claimed.sum(axis=0)
    log_sum = np.log(whole).sum() + np.log(asked).sum() - np.log1p(claimed * free).sum()
    return Marginals(wanted / whole[:, None], missed / whole, 1 / asked, free, float(log_sum))


def associate(frame: Frame, prior: BoxMessage, detector: BoxDetector) -> BoxMessage:
    """Return the likelihood of a frame's boxes: place, size and existence of each object in `prior`.

    Every box is one of an expected object, of a new one, a second box of an object, or false; no object has
    two. A candidate that does not exist may be an error that is made again, at the same place or where the
    object would be (see `Errors`). Marginals over all such assignments (see `assignment_marginals`) weigh how
    much of which box each object gets: the likelihood's logarithm is their mean, a Gaussian, so that an
    object between two boxes is drawn to neither of them wholly, and one that was not found is told nothing
    of its place.
    """
    given = _given_boxes(frame, prior, detector)
    objects = _expected_objects(prior, detector, given.size)
    exists, expected, kinds = objects.exists, objects.expected, objects.kinds
    near = (1 - OUTLIERS) * np.exp(_log_densities(given, objects.means, objects.covariances, objects.noise))
    wide = OUTLYING**2 * objects.noise
    far = OUTLIERS * np.exp(_log_densities(given, objects.means, objects.covariances, wide))
    others = _other_origins(given, objects, near + far, prior, detector)

    own_box = (near + far) / others.any
    weights = expected[:, None] * own_box * given.worth
    again = detector.repeated * expected
    noise = detector.noise(objects.places)
    staying = _log_densities(given, objects.places, noise[:, None] * np.eye(BOX), objects.noise)
    errors = again[:, None, None] * np.stack([np.exp(staying) / others.any, own_box], axis=1)
    is_error = (1 - exists)[:, None] * kinds
    true, wrong = exists[:, None] * weights, (is_error[:, :, None] * errors).sum(axis=1)
    nothing = (1 - exists) * (1 - kinds.sum(axis=1))
    hidden = exists * (1 - expected) + is_error.sum(axis=1) * (1 - again)
    found = assignment_marginals(true + wrong, hidden + nothing)

    support = (weights * found.open).sum(axis=1) / np.maximum(expected, 1e-12)
    ratio = np.maximum(1 - expected + expected * support, 1e-30)
    by_error = (1 - again)[:, None] + (errors * found.open[:, None]).sum(axis=2)
    otherwise = 1 - kinds.sum(axis=1) + (kinds * by_error).sum(axis=1)
    by_phase = np.log(np.maximum(1 - objects.phases + objects.phases * support, 1e-30))
    association = Association(
        boxes=given.boxes,
        noise=given.noise,
        scores=given.scores,
        identities=objects.identities,
        pairs=found.pairs * true / np.maximum(true + wrong, 1e-300),
        followed=found.pairs,
        unfollowed=found.missed * hidden / np.maximum(hidden + nothing, 1e-300),
        own_noise=objects.noise[:, None] + given.cut,
        worth=(near + far / OUTLYING**2) / np.maximum(near + far, 1e-300),
        errors=np.log(by_error),
        expected=expected,
        missed=exists * (1 - expected) / ((1 - exists) * otherwise + exists * ratio),
        visible=objects.visible,
        new=found.alone * others.new / others.any,
        double=found.alone * others.double / others.any,
        false=found.alone * others.false / others.any,
        log_evidence=found.log_sum + float(np.log(others.any).sum()) - others.number,
        outlines=given.outlines,
    )
    order = np.argsort(objects.identities)
    return BoxMessage(
        _box_likelihood(association, objects.means, objects.covariances),
        existence=LogOdds(objects.identities[order], np.log(ratio / otherwise)[order]),
        noticed=LogOdds(objects.identities[order], (by_phase[0] - by_phase[1])[order]),
        association=association,
    )


class _Given(NamedTuple):
    """The detector's boxes in the scene, by box; `size` `(height, width)` px is that of the picture.

    `noise` and `cut` `(n_boxes, 4)` px^2 are the errors' variances and what the border adds to them; `worth`
    `(n_boxes,)` is how many times as often true boxes have such `scores` as false ones.
    """

    size: tuple[int, int]
    boxes: Numbers
    noise: Numbers
    cut: Numbers
    scores: Numbers
    worth: Numbers
    outlines: NDArray[np.bool_] | None


def _given_boxes(frame: Frame, prior: BoxMessage, detector: BoxDetector) -> _Given:
    given = frame.boxes
    assert given is not None
    in_frame = feet(given.xyxy)
    boxes, size = prior.in_scene(in_frame), _picture(frame, prior, given)
    cut = _cut_variances(in_frame, size, boxes[:, 3])
    scores = np.ones(len(boxes)) if given.confidence is None else given.confidence
    worth = np.ones(len(boxes))
    if detector.scores is not None and given.confidence is not None:
        worth = np.exp(np.clip(detector.scores.log_ratio(scores), -20, 20))
    return _Given(
        size=size,
        boxes=boxes,
        noise=detector.noise(boxes) + cut + prior.variances_by_view(boxes),
        cut=cut,
        scores=scores,
        worth=worth,
        outlines=None if given.masks is None else prior.outlines_in_scene(given.masks),
    )


class _Objects(NamedTuple):
    """The objects before their boxes are known, by object.

    `noise` `(n, 4)` px^2 is that of a box of theirs. `phases` `(2, n)` is the probability of being found in
    either phase (see `NOTICED`), `expected` `(n,)` in the present one. `kinds` and `places` are those of
    `Errors.of`.
    """

    identities: NDArray[np.int64]
    means: Numbers
    covariances: Numbers
    noise: Numbers
    exists: Numbers
    visible: Numbers
    phases: Numbers
    expected: Numbers
    kinds: Numbers
    places: Numbers


def _expected_objects(prior: BoxMessage, detector: BoxDetector, size: tuple[int, int]) -> _Objects:
    from scipy.special import expit  # slow to import, and only detectors need it

    tracked = prior.expected
    tracked = tracked.only(np.isin(tracked.identities, prior.existence.identities))
    identities, means, covariances = tracked.moments
    exists, noticed = (expit(odds.of(identities)) for odds in (prior.existence, prior.noticed))
    visible = visible_share(prior.in_frame(means), exists, size)
    phases = np.array([[NOTICED], [UNNOTICED]]) * visible
    kinds, places = (prior.errors or NO_ERRORS).of(identities)
    return _Objects(
        identities=identities,
        means=means,
        covariances=covariances,
        noise=detector.noise(means) + prior.variances_by_view(means),
        exists=exists,
        visible=visible,
        phases=phases,
        expected=noticed * phases[0] + (1 - noticed) * phases[1],
        kinds=kinds,
        places=places,
    )


class _Origins(NamedTuple):
    """Densities of each box `(n_boxes,)` if it is no object's first one, and how many such boxes to expect.

    `any` also contains false boxes at places where the detector errs.
    """

    new: Numbers
    false: Numbers
    double: Numbers
    any: Numbers
    number: float


def _other_origins(
    given: _Given, objects: _Objects, own: Numbers, prior: BoxMessage, detector: BoxDetector
) -> _Origins:
    """`own` `(n_objects, n_boxes)` is the density of each box as an object's first one."""
    boxes, area = given.boxes, float(given.size[0] * given.size[1])
    anywhere = log_anywhere(boxes, area)
    entering = anywhere if prior.newcomers is None else prior.newcomers.log_density(boxes, given.noise)
    new = detector.newcomers * detector.found * np.exp(entering) * given.worth
    false = detector.clutter * area * np.exp(anywhere)
    known = prior.places or NO_PLACES
    usual = detector.noise(known.boxes)
    there = _log_densities(given, known.boxes, usual[:, None] * np.eye(BOX), usual)

    present = objects.exists * objects.expected
    larger = objects.covariances + _of_other_size(objects.means)
    double = (
        detector.doubles
        * present
        @ np.exp(_log_densities(given, objects.means, larger, DOUBLE**2 * objects.noise))
    )
    alone = np.maximum(new + false + double + known.rates @ np.exp(there), 1e-300)
    # who is new may have a second box, too: of two boxes that which is less likely to be anybody new
    first = new / (alone + present @ own * given.worth)
    beside = _log_densities(given, boxes, _of_other_size(boxes), DOUBLE**2 * given.noise)
    second = detector.doubles * first @ (np.exp(beside) * (new[:, None] > new))

    number = (1 + detector.doubles) * detector.newcomers * detector.found
    number += detector.clutter * area + float(known.rates.sum())
    number += float(detector.doubles * objects.exists @ objects.expected)
    return _Origins(new, false, double + second, alone + second, number)


def visible_share(boxes: Numbers, exists: Numbers, size: tuple[int, int]) -> Numbers:
    """Return `(n,)` share of each box `(n, 4)` that is in the picture and not covered by one in front.

    The less one stands in front, by the rows of the feet, the less it covers (see `BEHIND`).
    """
    x, y, width, height = boxes.T
    left, right, top = x - 0.5 * width, x + 0.5 * width, y - height
    in_x = np.minimum(right, size[1]) - np.maximum(left, 0.0)
    in_y = np.minimum(y, size[0]) - np.maximum(top, 0.0)
    whole = np.maximum(width * height, 1.0)
    inside = np.maximum(in_x, 0.0) * np.maximum(in_y, 0.0) / whole
    across = np.minimum(right[:, None], right) - np.maximum(left[:, None], left)
    down = np.minimum(y[:, None], y) - np.maximum(top[:, None], top)
    covered = np.maximum(across, 0.0) * np.maximum(down, 0.0) / whole[:, None]
    in_front = np.clip((y - y[:, None]) / (BEHIND * np.maximum(height[:, None], 1.0)), 0, 1) * exists
    return np.asarray(np.clip(inside, 0, 1) * np.prod(1 - np.minimum(covered, 1.0) * in_front, axis=1))


def _cut_variances(boxes: Numbers, size: tuple[int, int], heights: Numbers) -> Numbers:
    """`(n, 4)` px^2: what is unsure of boxes in the frame that end at its border: all that lies behind it.

    Boxes that reach beyond the border are whole. `heights` `(n,)` are those in the scene, in whose px it is.
    """
    x, y, width, height = boxes.T
    ends = np.abs([x - 0.5 * width, size[1] - x - 0.5 * width, y - height, size[0] - y])
    left, right, above, below = ends < AT_BORDER * height
    across = left | right
    cut = np.stack([0.5 * across, below, across, across | below | above], axis=1)
    return np.asarray((HIDDEN * heights[:, None] * cut) ** 2)


def _picture(frame: Frame, prior: BoxMessage, given: GivenBoxes) -> tuple[int, int]:
    """`(height, width)` px; without an image or a plane, as far as the boxes reach."""
    if frame.image is not None:
        return frame.image.shape[0], frame.image.shape[1]
    if prior.newcomers is not None:
        return prior.newcomers.size
    right, bottom = np.ceil(given.xyxy[:, 2:].max(axis=0, initial=1.0)).astype(int).tolist()
    return bottom, right


def _of_other_size(boxes: Numbers) -> Numbers:
    """Covariances of how much larger or smaller second boxes are than `boxes` `(n, 4)`, `(n, 4, 4)` px^2."""
    larger = boxes * [0, 0, DOUBLE_SIZE, DOUBLE_SIZE]
    covariances: Numbers = larger[:, :, None] * larger[:, None]
    return covariances


def _log_densities(given: _Given, means: Numbers, covariances: Numbers, noise: Numbers) -> Numbers:
    """`(n_objects, n_boxes)` nats: log N(box; mean, covariance + noise of the object + `cut` of the box)."""
    densities = np.empty((len(means), len(given.boxes)))
    alike, kinds = np.unique(given.cut, axis=0, return_inverse=True)  # most boxes are not cut
    for kind, more in enumerate(alike):
        which = kinds.reshape(-1) == kind
        root = np.linalg.cholesky(covariances + (noise + more)[:, :, None] * np.eye(BOX))
        off = np.linalg.inv(root) @ (given.boxes[which] - means[:, None]).swapaxes(1, 2)
        scale = np.log(root.diagonal(axis1=1, axis2=2)).sum(axis=1) + 2 * np.log(2 * np.pi)
        densities[:, which] = -0.5 * (off**2).sum(axis=1) - scale[:, None]
    return densities


def _box_likelihood(association: Association, means: Numbers, covariances: Numbers) -> GaussianMessage:
    """Gaussian likelihood of each object's box, of mass 1 with the prediction."""
    precision, vector = association.information
    told = np.flatnonzero(association.followed.sum(axis=1) > SURELY_NOT)
    order = told[np.argsort(association.identities[told])]
    precision, vector, means, covariances = precision[order], vector[order], means[order], covariances[order]
    information = precision[:, :, None] * np.eye(BOX)
    places = vector / precision
    root = np.linalg.cholesky(covariances + (1 / precision)[:, :, None] * np.eye(BOX))
    off = np.linalg.solve(root, (places - means)[:, :, None])[:, :, 0]
    grown = np.log(root.diagonal(axis1=1, axis2=2)).sum(axis=1) + 0.5 * np.log(precision).sum(axis=1)
    log_scale = grown + 0.5 * (off**2).sum(axis=1) - 0.5 * (vector * places).sum(axis=1)
    return GaussianMessage(association.identities[order], information, vector, log_scale)
