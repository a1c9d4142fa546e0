"""What boxes say of objects: against sums over all assignments, and at its limits."""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.association import (
    BEHIND,
    DOUBLE,
    DOUBLE_SIZE,
    NOTICED,
    OUTLIERS,
    OUTLYING,
    UNNOTICED,
    associate,
    log_anywhere,
    visible_share,
)
from rsmcm.models.objects.box_message import (
    BoxDetector,
    BoxMessage,
    ErrorPlaces,
    Errors,
    LogOdds,
    Newcomers,
    Scores,
)
from scipy.special import expit
from scipy.stats import multivariate_normal, norm

Numbers = NDArray[np.float64]

SIZE = (480, 640)
BLANK = np.zeros(SIZE, np.uint8)
WHO = np.array([[200.0, 300.0, 40.0, 100.0], [330.0, 310.0, 42.0, 104.0]])
COVARIANCE = np.diag([3.0, 4.0, 5.0, 6.0]) ** 2


def xyxy(boxes: Numbers) -> Numbers:
    x, y, width, height = np.asarray(boxes, np.float64).reshape(-1, 4).T
    return np.stack([x - width / 2, y - height, x + width / 2, y], axis=1)


def frame(boxes: Numbers, scores: Numbers | None = None) -> Frame:
    return Frame(BLANK, 0.0, 1, boxes=GivenBoxes(xyxy(boxes), scores))


def known(means: Numbers = WHO, existence: float = 2.0, noticed: float = 1.5) -> BoxMessage:
    identities = np.arange(1, len(means) + 1)
    gaussian = GaussianMessage.from_moments(identities, means, np.tile(COVARIANCE, (len(means), 1, 1)))
    odds = (LogOdds(identities, np.full(len(means), each)) for each in (existence, noticed))
    existence_, noticed_ = odds
    return BoxMessage(gaussian, existence=existence_, noticed=noticed_)


class Summed(NamedTuple):
    """Pairs, boxes that are followed, log ratios of existence and of errors, log density of all boxes."""

    pairs: Numbers
    followed: Numbers
    existence: Numbers
    errors: Numbers
    log_density: float


def summed(found: Numbers, prior: BoxMessage, detector: BoxDetector) -> Summed:
    """All of these by going through everything."""
    identities, means, covariances = prior.objects.moments
    exists = expit(prior.existence.of(identities))
    noticed = expit(prior.noticed.of(identities))
    seen = noticed * NOTICED + (1 - noticed) * UNNOTICED
    area = float(SIZE[0] * SIZE[1])
    alone = (detector.clutter * area + detector.newcomers * detector.found) * np.exp(
        log_anywhere(found, area)
    )
    for mean, covariance, is_there, share in zip(means, covariances, exists, seen, strict=True):
        larger = DOUBLE_SIZE * np.array([0.0, 0.0, *mean[2:]])
        wide = covariance + np.diag(DOUBLE**2 * detector.noise(mean[None])[0]) + np.outer(larger, larger)
        second = multivariate_normal(mean, wide).pdf(found).reshape(-1)
        alone = alone + detector.doubles * is_there * share * second
    assert prior.places is not None
    for place, rate in zip(prior.places.boxes, prior.places.rates, strict=True):
        wide = np.diag(2 * detector.noise(place[None])[0])
        alone = alone + rate * multivariate_normal(place, wide).pdf(found).reshape(-1)
    own = [np.diag(detector.noise(mean[None])[0]) for mean in means]
    new = detector.newcomers * detector.found * np.exp(log_anywhere(found, area))
    claimed = alone.copy()
    for mean, covariance, noise, weight in zip(means, covariances, own, exists * seen, strict=True):
        for share, times in ((1 - OUTLIERS, 1.0), (OUTLIERS, OUTLYING)):
            near = multivariate_normal(mean, covariance + times**2 * noise).pdf(found).reshape(-1)
            claimed += weight * share * near
    for box, here, total in zip(found, new, claimed, strict=True):
        larger = DOUBLE_SIZE * np.array([0.0, 0.0, *box[2:]])
        wide = np.diag(DOUBLE**2 * detector.noise(box[None])[0]) + np.outer(larger, larger)
        second = multivariate_normal(box, wide).pdf(found).reshape(-1)
        alone = alone + (new < here) * detector.doubles * here / total * second
    assert prior.errors is not None
    kinds, places = prior.errors.of(identities)
    again = detector.repeated * seen
    total, pairs, followed = 0.0, np.zeros((len(means), len(found))), np.zeros((len(means), len(found)))
    mass = np.zeros((len(means), 4))  # with nothing there, the object, an error that stays, one that moves
    for what in product(range(4), repeat=len(means)):
        for chosen in product(range(-1, len(found)), repeat=len(means)):
            taken = [box for box in chosen if box >= 0]
            if len(set(taken)) < len(taken) or any(
                box >= 0 and not kind for box, kind in zip(chosen, what, strict=True)
            ):
                continue
            value = float(np.prod([alone[box] for box in range(len(found)) if box not in taken]))
            for k, (box, kind) in enumerate(zip(chosen, what, strict=True)):
                rest = 1 - exists[k]
                value *= (rest * (1 - kinds[k].sum()), exists[k], rest * kinds[k, 0], rest * kinds[k, 1])[
                    kind
                ]
                shown = (0.0, seen[k], again[k], again[k])[kind]
                if box < 0:
                    value *= 1 - shown
                elif kind == 2:
                    value *= shown * multivariate_normal(
                        places[k], np.diag(detector.noise(places[k][None])[0]) + own[k]
                    ).pdf(found[box])
                else:
                    value *= shown * sum(
                        share
                        * multivariate_normal(means[k], covariances[k] + times**2 * own[k]).pdf(found[box])
                        for share, times in ((1 - OUTLIERS, 1.0), (OUTLIERS, OUTLYING))
                    )
            total += value
            for k, (box, kind) in enumerate(zip(chosen, what, strict=True)):
                mass[k, kind] += value
                if box >= 0:
                    followed[k, box] += value
                    pairs[k, box] += value * (kind == 1)
    ratio = np.log(mass[:, 1] / (mass.sum(axis=1) - mass[:, 1])) - np.log(exists / (1 - exists))
    errors = np.log(mass[:, 2:] / mass[:, :1]) - np.log(kinds / (1 - kinds.sum(axis=1, keepdims=True)))
    poisson = detector.clutter * area + (1 + detector.doubles) * detector.newcomers * detector.found
    poisson += detector.doubles * float(exists @ seen) + float(prior.places.rates.sum())
    return Summed(pairs / total, followed / total, ratio, errors, float(np.log(total)) - poisson)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 2), st.integers(0, 2), st.floats(-2, 4), st.floats(-4, 3))
def test_one_object_or_one_box_is_exact(
    seed: int, n_objects: int, n_boxes: int, existence: float, errs: float
) -> None:
    """Who is there, what else it may be, which box is whose, and how likely all boxes are."""
    if n_objects > 1:
        n_boxes = min(n_boxes, 1)
    random = np.random.default_rng(seed)
    means = WHO[:n_objects]
    found = means[random.integers(0, n_objects, n_boxes)] + random.normal(0, (6, 6, 8, 10), (n_boxes, 4))
    prior, detector = known(means, existence), BoxDetector()
    places = means + random.normal(0, (8, 8, 4, 10), means.shape)
    errors = Errors(np.arange(1, n_objects + 1), errs + np.tile([0.0, 0.7], (n_objects, 1)), places)
    steady = ErrorPlaces(WHO + random.normal(0, (8, 8, 4, 10)), random.uniform(0, 0.5, 2))
    prior = replace(prior, errors=errors, places=steady)
    message = associate(frame(found), prior, detector)
    assert message.association is not None
    oracle = summed(found, prior, detector)
    np.testing.assert_allclose(message.association.pairs, oracle.pairs, atol=1e-4)
    np.testing.assert_allclose(message.association.followed, oracle.followed, atol=1e-4)
    np.testing.assert_allclose(message.existence.values, oracle.existence, atol=1e-3)
    np.testing.assert_allclose(message.association.errors, oracle.errors, atol=1e-3)
    assert message.association.log_evidence == pytest.approx(oracle.log_density, abs=1e-3)
    np.testing.assert_allclose(message.association.boxes, found)
    # what is said of places has mass 1 with what was expected, and draws towards the boxes
    assert (prior.objects * message.objects).log_mass == pytest.approx(0, abs=1e-6)


def test_a_detector_that_did_not_run_says_nothing_and_one_that_found_nothing_doubts_everybody() -> None:
    objects, prior = ObjectBoxes(), known()
    silent = objects.evidence(Frame(BLANK, 0.0, 1), prior)
    assert silent.association is None
    assert not len(silent.existence)
    empty = objects.evidence(frame(np.zeros((0, 4))), prior)
    seen = expit(1.5) * NOTICED + expit(-1.5) * UNNOTICED
    np.testing.assert_allclose(empty.existence.values, np.log(1 - seen))
    assert not len(empty.objects)
    assert (empty.noticed.values < -1).all()


def test_who_is_hidden_or_outside_is_not_doubted() -> None:
    """Somebody behind another, and somebody who has left the picture by half."""
    behind = np.array([[200.0, 300.0, 60.0, 140.0], [200.0, 290.0, 40.0, 100.0]])
    share = visible_share(behind, np.array([1.0, 1.0]), SIZE)
    np.testing.assert_allclose(share, [1, 0], atol=1e-9)
    np.testing.assert_allclose(visible_share(behind, np.array([0.5, 1.0]), SIZE), [1, 0.5], atol=1e-9)
    np.testing.assert_allclose(
        visible_share(np.array([[0.0, 300.0, 60.0, 140.0]]), np.ones(1), SIZE), [0.5], atol=1e-9
    )
    # in one place there is one person: nobody hides a double of their own
    for off, expected in ((0.0, 1.0), (0.5, 0.5), (1.0, 0.0), (2.0, 0.0)):
        near = np.array([[200.0, 290.0 + off * BEHIND * 50.0, 40.0, 100.0], [200.0, 290.0, 40.0, 50.0]])
        np.testing.assert_allclose(visible_share(near, np.ones(2), SIZE), [1, expected], atol=1e-9)
    doubted = associate(frame(np.zeros((0, 4))), known(behind, existence=8.0), BoxDetector()).existence
    assert doubted.values[0] < -1
    assert doubted.values[1] > -0.01


def test_scores_decide_who_is_new() -> None:
    """A box far from everybody is new or false; a second one of somebody known is a double, not new."""
    two = Scores(0.8, 0.3, 0.15)
    expected = norm(0.8, 0.15).logpdf(0.6) - norm(0.3, 0.15).logpdf(0.6)
    assert two.log_ratio(np.array([0.6]))[0] == pytest.approx(expected)
    far = np.array([[500.0, 400.0, 44.0, 110.0]])
    scored = replace(BoxDetector(newcomers=0.1, clutter=1e-6), scores=two)
    sure, doubtful = (associate(frame(far, np.array([s])), known(), scored).association for s in (0.9, 0.2))
    assert sure is not None
    assert doubtful is not None
    assert sure.new[0] > 0.9
    assert doubtful.new[0] < 0.1
    for second in ([12, 8, 3, 4], [0, 10, 20, 50]):  # beside it, and half larger
        both = np.stack([WHO[0], WHO[0] + np.array(second)])
        message = associate(frame(both), known(), BoxDetector())
        assert message.association is not None
        assert message.association.pairs[0].sum() > 0.95
        assert message.association.new.max() < 0.02
        assert message.association.double.max() > 0.9


def test_an_outlying_box_counts_for_less_and_one_that_is_too_small_for_no_more() -> None:
    """Of one person's box: near, it is a whole observation; far off, in any direction, a ninth of one."""
    prior, (person, _) = known(existence=8.0), WHO
    for larger in (0.0, 0.7, -0.7):
        off = person[None] * [1, 1, 1 + larger, 1 + larger]
        message = associate(frame(off), prior, BoxDetector(clutter=1e-15, newcomers=1e-9, doubles=1e-9))
        assert message.association is not None
        assert message.association.pairs[0, 0] == pytest.approx(1, abs=1e-3)
        precision, vector = message.association.information
        expected = (1 / OUTLYING**2 if larger else 1.0) / BoxDetector().noise(person[None])[0]
        np.testing.assert_allclose(precision[0], expected, rtol=0.1)
        np.testing.assert_allclose(vector[0] / precision[0], off[0])


@pytest.mark.parametrize(("foot_x", "edge"), [(0.0, (0.0, 20.0)), (640.0, (620.0, 640.0))])
def test_what_the_border_hides_of_a_box_is_unknown(foot_x: float, edge: tuple[float, float]) -> None:
    """A person who is half outside is found by the visible half, which tells the row of the feet alone."""
    person, (left, right) = np.array([[foot_x, 300.0, 40.0, 100.0]]), edge
    half = np.array([[0.5 * (left + right), 300.0, right - left, 100.0]])
    detector = BoxDetector()
    told = [
        associate(frame(each), known(person, existence=8.0), detector).association for each in (person, half)
    ]
    assert told[0] is not None
    assert told[1] is not None
    whole, cut = (each.information[0][0] for each in told if each is not None)
    assert told[1].pairs[0, 0] > 0.9
    np.testing.assert_allclose(whole, 1 / detector.noise(person)[0], rtol=0.1)
    assert cut[1] > 0.8 * whole[1]
    assert (cut[[0, 2, 3]] < 0.15 * whole[[0, 2, 3]]).all()


def test_newcomers_are_a_density() -> None:
    """Height and width summed over a grid, in one row; times the rows and columns of the picture it is 1.

    Those who do not fit are spread over sizes of any order; they are told apart by their least share.
    """
    share = 1e-9
    new = Newcomers(SIZE, np.array([100.0, 0.3]), np.diag([25.0, 1e-4]), 0.1, 0.4, 0.1**2, share)
    heights, widths = np.arange(1.0, 300, 2), np.arange(1.0, 160, 1)
    grid = np.stack(np.meshgrid(widths, heights), axis=-1).reshape(-1, 2)
    boxes = np.column_stack([np.full((len(grid), 2), 240.0), grid])
    assert np.exp(new.log_density(boxes)).sum() * 2 * SIZE[0] * SIZE[1] == pytest.approx(1, abs=0.01)
    mean, deviation = new.height([240.0, 340.0])
    giant = np.array([[200.0, 240.0, 300.0, 400.0]])
    outlying = replace(new, outliers=0.2).log_density(giant) - log_anywhere(giant, SIZE[0] * SIZE[1])
    np.testing.assert_allclose(outlying, np.log(0.2), atol=1e-6)
    np.testing.assert_allclose(mean, [100, 130])
    np.testing.assert_allclose(deviation, np.hypot([5, np.hypot(5, 1)], [10, 13]))


def test_messages_multiply() -> None:
    """Odds add, and two factors of which there may be one are refused."""
    one, two = LogOdds(np.array([1, 3]), np.array([0.5, 1.0])), LogOdds(np.array([3, 4]), np.array([2.0, -1]))
    np.testing.assert_allclose((one * two).of([1, 2, 3, 4]), [0.5, 0, 3, -1])
    detector = BoxMessage(detector=BoxDetector())
    assert (detector * BoxMessage()).detector is detector.detector
    with pytest.raises(ValueError, match="two factors detector"):
        detector * detector
