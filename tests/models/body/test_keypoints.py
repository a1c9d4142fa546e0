"""Points of a detector as evidence: ratios against plain numpy, whose they are, and which side."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import signer
from rsmcm.chains.body.likelihood import BodyLikelihood
from rsmcm.models import BodyParts, Frame, GivenKeypoints
from rsmcm.models.body.keypoints import (
    AROUND,
    BEYOND,
    DEVIATIONS,
    EXCHANGED,
    OTHER_PERSON,
    SURE,
    SeenKeypoints,
    joints_of,
)
from rsmcm.models.core.frame import KEYPOINTS

from ...support.keypoints import ELBOWS, HANDS, MIRRORED, WRISTS, points_of

Array = NDArray[np.float64]

SCENE = signer(12, 3, 0.0, 0.0, (320, 180))
BODY, POSES, UNIT = SCENE.body, SCENE.poses, SCENE.body.head_height
JOINTS_2D = SCENE.joints[..., :2]
POINTS = points_of(JOINTS_2D, BODY)
SHOULDERS = [KEYPOINTS.index(f"{side}_shoulder") for side in ("left", "right")]
NOBODY = np.zeros((0, 2))


def given_of(places: Array, score: float = 1.0) -> GivenKeypoints:
    """One person, all of whose points that are not NaN were found."""
    return GivenKeypoints(places[None], np.where(np.isnan(places[:, 0]), 0.0, score)[None])


def seen(places: Array, score: float = 1.0) -> SeenKeypoints:
    found = SeenKeypoints.of(given_of(places, score), NOBODY, UNIT)
    assert found is not None
    return found


def without(places: Array, rows: list[int]) -> Array:
    fewer = places.copy()
    fewer[rows] = np.nan
    return fewer


def plain_ratios(places: Array, probability: float) -> Array:
    """By the formula: of neck, shoulders, elbows and wrists."""
    arms = [*ELBOWS, *WRISTS]
    orders = [list(range(len(KEYPOINTS))), list(range(len(KEYPOINTS))), MIRRORED]
    for row in arms:
        orders[1] = [MIRRORED[row] if place == row else old for place, old in enumerate(orders[1])]
    ratios = np.full(len(POINTS), OTHER_PERSON)
    for chance, order in zip(EXCHANGED, orders, strict=True):
        product = np.full(len(POINTS), chance * (1 - OTHER_PERSON))
        for row in (1, *SHOULDERS, *arms):
            if not np.isnan(places[row, 0]):
                deviation = UNIT * DEVIATIONS[KEYPOINTS[row].rpartition("_")[2]]
                square = ((POINTS[:, order[row]] - places[row]) ** 2).sum(axis=1)
                density = np.exp(-square / (2 * deviation**2)) / (2 * np.pi * deviation**2)
                product *= probability * density * (AROUND * UNIT) ** 2 + 1 - probability
        ratios += product
    return np.log(ratios)


@pytest.mark.parametrize("score", [1.0, 0.3])
def test_ratios_are_those_of_the_formula(score: float) -> None:
    random = np.random.default_rng(0)
    places = without(POINTS[4] + 0.1 * UNIT * random.standard_normal(POINTS[4].shape), HANDS)
    for fewer in ([], [1], [WRISTS[0], ELBOWS[1]], SHOULDERS):
        found = without(places, fewer)
        ratios = seen(found, score).log_ratios(BODY, SCENE.joints)
        np.testing.assert_allclose(ratios, plain_ratios(found, SURE * score), atol=1e-3)


def test_a_point_far_off_costs_no_more_than_one_that_was_not_found() -> None:
    """Of many points one is false: as if it were missing, but for the chance of that; all: another person."""
    places = without(POINTS[2], HANDS)
    off = places.copy()
    off[WRISTS[0]] += 5 * UNIT
    apart = seen(off).log_ratios(BODY, SCENE.joints) - seen(without(places, WRISTS[:1])).log_ratios(
        BODY, SCENE.joints
    )
    assert (apart >= np.log(1 - SURE) - 1e-3).all()
    assert (apart <= 1e-3).all()
    everything = seen(places + 9 * UNIT).log_ratios(BODY, SCENE.joints)
    np.testing.assert_allclose(everything, np.log(OTHER_PERSON), atol=1e-3)


def values(found: SeenKeypoints, places: Array) -> Array:
    """`(3,)` ratios of head, left and right hand at `places` `(3, 2)`."""
    return np.asarray(np.exp(found.mixtures(NOBODY, NOBODY).log_values(places[None])[0]))


def test_mixtures_are_ratios_of_probabilities() -> None:
    """Over the square in which false points are, each averages 1: true ones and false ones are as many."""
    mixtures = seen(POINTS[3], 0.8).mixtures(NOBODY, NOBODY)
    np.testing.assert_array_equal(mixtures.informative, True)
    steps = UNIT * (np.arange(-60, 60) + 0.5) * AROUND / 120
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 1, 2)
    head = grid + POINTS[3, 0]
    average = np.exp(mixtures.take([0]).log_values(head)).mean()
    assert average == pytest.approx(1, abs=0.01)
    assert set(mixtures.labels[~mixtures.flat & np.isfinite(mixtures.log_weights)]) == {0, 1, 2}


def test_a_point_on_something_else_in_the_picture_is_that_thing() -> None:
    left, right = POINTS[3, HANDS]
    hands = np.array([left + 9 * UNIT, right + 0.1 * UNIT])
    mixtures = seen(POINTS[3]).mixtures(hands, POINTS[3, :1])
    labels = [
        set(row[~flat & np.isfinite(weights)].tolist())
        for row, flat, weights in zip(mixtures.labels, mixtures.flat, mixtures.log_weights, strict=True)
    ]
    assert labels == [{2}, {1, 4}, {1, 4}], "the face, the right hand's blob, and a left hand without any"


def test_a_hand_is_beyond_its_wrist_by_half_a_hand() -> None:
    """Along the forearm, from whichever side that is seen; less surely without the elbow."""
    usual = replace(BODY, forearm=1.5 * UNIT, hand=0.3 * UNIT)
    joints = usual.joints(POSES)[..., :2]
    places = without(points_of(joints, usual)[5], HANDS)
    for side in (0, 1):
        hand = joints[5, HANDS[side]]
        np.testing.assert_allclose(joints_of(given_of(places))[0, HANDS[side]], hand, atol=1e-9)
        at = np.broadcast_to(hand, (3, 2))
        off = at + 0.6 * UNIT
        sure, vague = (values(seen(without(places, gone)), at)[1 + side] for gone in ([], [ELBOWS[side]]))
        assert sure > vague > 1 > values(seen(places), off)[1 + side]
    assert pytest.approx(0.25) == BEYOND


def test_shoulders_tell_whether_sides_are_exchanged() -> None:
    """A hand is hardly the other's point; as well so as not, if the left shoulder is on the left."""
    left = np.broadcast_to(JOINTS_2D[0, HANDS[0]], (3, 2))
    others = [*range(2, 8)]
    hands_only = without(POINTS[0], [row for row in others if row not in HANDS])
    all_points, without_shoulders, exchanged = (
        np.subtract(*np.log(values(seen(places), left)[1:]))
        for places in (POINTS[0], hands_only, POINTS[0][MIRRORED])
    )
    assert all_points > without_shoulders > 2
    assert abs(exchanged) < 1


def test_the_person_nearest_to_the_head_counts() -> None:
    both = GivenKeypoints(np.stack([POINTS[0] + (3 * UNIT, 0), POINTS[0]]), np.ones((2, len(KEYPOINTS))))
    head = POINTS[0, :1]
    for near, person in ((head, 1), (head + np.array([2.7, 0.2]) * UNIT, 0)):
        found = SeenKeypoints.of(both, near, UNIT)
        assert found is not None
        np.testing.assert_array_equal(found.positions, both.positions[person])
    assert SeenKeypoints.of(both, head + 9 * UNIT, UNIT) is None
    assert SeenKeypoints.of(GivenKeypoints.of([]), head, UNIT) is None
    larger = GivenKeypoints(np.stack([POINTS[0], 2 * POINTS[0]]), both.scores)
    found = SeenKeypoints.of(larger, NOBODY, UNIT)
    assert found is not None
    np.testing.assert_array_equal(found.positions, 2 * POINTS[0])


def test_evidence_of_an_image_holds_them() -> None:
    """As a factor of the mixtures, and as a term of the likelihood; other persons' say nothing."""
    frame = SCENE.frame(0)
    node = replace(BodyParts.learned(list(SCENE.images()), SCENE.detector), head_height=UNIT)
    plain, known, foreign = (
        node.evidence(replace(frame, keypoints=points), node.uniform()).image
        for points in (None, given_of(POINTS[0]), given_of(POINTS[0] + (4 * UNIT, 0)))
    )
    assert plain is not None
    assert known is not None
    assert foreign is not None
    assert plain.keypoints is foreign.keypoints is None
    assert known.keypoints is not None
    at = JOINTS_2D[:1, [0, *HANDS]]
    added = known.mixtures.log_values(at) - plain.mixtures.log_values(at)
    np.testing.assert_allclose(added, known.keypoints.mixtures(NOBODY, NOBODY).log_values(at), atol=1e-4)
    np.testing.assert_array_equal(foreign.mixtures.log_values(at), plain.mixtures.log_values(at))
    likelihood = BodyLikelihood(BODY)
    np.testing.assert_allclose(
        (likelihood(known).inner_terms(POSES) - likelihood(plain).inner_terms(POSES))[1:],
        [np.zeros(12), known.keypoints.log_ratios(BODY, SCENE.joints), np.zeros(12)],
    )
    np.testing.assert_array_equal(likelihood(known).rest(POSES), likelihood(plain).rest(POSES))
    assert node.evidence(Frame(None, 0.0, 1, keypoints=given_of(POINTS[0])), node.uniform()).image is None
