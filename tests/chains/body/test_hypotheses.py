"""Answers of a frame: what is gathered, what is told apart, and how probable it is."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body.samples import WORTH_SAYING, BodySamples, Hypotheses, hypotheses
from rsmcm.models.body.upper_body import BodyPoses, UpperBody

from ...support.body_poses import resting

BODY = UpperBody.from_head(60.0)
SIZE = (360, 640)
STEP = BODY.hand / (BODY.upper_arm + BODY.forearm)
"""rad by which a stretched arm turns when its hand moves by its radius."""


def reaching(left: NDArray[np.float64], right: NDArray[np.float64]) -> BodyPoses:
    """Poses with stretched arms that are turned aside by so many rad from hanging."""
    n = len(left)
    poses = resting(np.tile([300.0, 150.0], (n, 1)))
    for side, (turn, sign) in enumerate(((left, 1), (right, -1))):
        way = np.stack([sign * np.sin(turn), np.cos(turn), np.zeros(n)], axis=1)
        poses.arms[:, side] = way[:, None]
    return poses


def answers(poses: BodyPoses, weights: NDArray[np.float64]) -> Hypotheses:
    random = np.random.default_rng(0)
    return hypotheses(BODY, BodySamples(poses, np.log(weights), SIZE, random), random)


def test_two_places_of_a_hand_are_two_answers() -> None:
    rng = np.random.default_rng(1)
    n = 100
    left = np.where(np.arange(n) < 70, 0.2, 1.4) + 0.1 * STEP * rng.standard_normal(n)
    weights = rng.random(n)
    weights /= weights.sum()
    poses = reaching(left, 0.1 * STEP * rng.standard_normal(n))
    found = answers(poses, weights)
    expected = sorted([weights[:70].sum(), weights[70:].sum()], reverse=True)
    np.testing.assert_allclose(found.weights, [*expected, 0, 0], atol=1e-12)
    for place, chosen in enumerate((slice(70), slice(70, n))):
        mean = np.average(BODY.joints(poses.take(chosen)), axis=0, weights=weights[chosen])
        np.testing.assert_allclose(found.joints[place], mean)
    assert np.isnan(found.joints[2:]).all()
    np.testing.assert_allclose(found.unsure, [expected[1], 0])
    assert found.second is not None
    np.testing.assert_array_equal(found.second, found.joints[1])


def test_a_region_is_one_answer() -> None:
    """However large it is, as long as steps of less than a radius lead through it."""
    left = np.arange(0, 1.4, 0.9 * STEP)
    found = answers(reaching(left, np.zeros(len(left))), np.full(len(left), 1 / len(left)))
    np.testing.assert_allclose(found.weights, [1, 0, 0, 0])
    apart = answers(reaching(1.2 * left / 0.9, np.zeros(len(left))), np.full(len(left), 1 / len(left)))
    assert (apart.weights > 0).all(), "and without them many"


@pytest.mark.parametrize(("second", "shown"), [(WORTH_SAYING + 0.01, True), (WORTH_SAYING - 0.01, False)])
def test_what_is_worth_saying(second: float, shown: bool) -> None:
    found = answers(reaching(np.array([0.2, 1.2]), np.zeros(2)), np.array([1 - second, second]))
    assert (found.second is not None) == shown
