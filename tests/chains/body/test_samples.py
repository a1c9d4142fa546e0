"""Weighted poses: their moments, what they tell of parts, and where the next frame's come from."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics
from rsmcm.chains.body.samples import (
    MISTAKEN,
    SAMPLE_STD,
    START_TIME,
    BodySamples,
    body_moments,
    initial_samples,
    part_message,
    predict_samples,
)
from rsmcm.models.body.upper_body import JOINTS, BodyPoses, UpperBody

BODY = UpperBody.from_head(90.0)
DYNAMICS = BodyDynamics(BODY)
SIZE = (360, 640)
DT = 0.04
HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]


def some(n: int, seed: int = 0, place: tuple[float, float] = (320.0, 150.0)) -> BodyPoses:
    """Poses of somebody in the middle of the picture."""
    poses = DYNAMICS.draw_anywhere(n, SIZE, np.random.default_rng(seed))
    return replace(poses, roots=0.1 * (poses.roots - place) + place)


def samples(poses: BodyPoses, seed: int = 0) -> BodySamples:
    """With random weights."""
    random = np.random.default_rng(seed)
    weights = random.dirichlet(np.full(len(poses), 0.5)) + 1e-12
    log_weights = np.log(weights / weights.sum())
    return BodySamples(poses, log_weights, SIZE, random)


# --- what they tell of the parts ---


@pytest.mark.parametrize("groups", [1, 4, 7])
@pytest.mark.parametrize("n", [3, 50, 501])
def test_message_integrates_to_one_and_has_the_moments_of_the_parts(n: int, groups: int) -> None:
    """With the broad Gaussian's share, and what is added since samples may coincide."""
    state = samples(some(n))
    message = part_message(BODY, state.poses, state.weights, groups)
    assert message.image is None
    np.testing.assert_allclose(message.predicted.log_masses, 0.0, atol=1e-9)
    means, covariances = message.predicted.moments(1.0, (0.0, 0.0))
    places = BODY.parts(state.poses)
    reach = 0.5 * (BODY.upper_arm + BODY.forearm)
    for part, broad in enumerate((BODY.head_height, reach, reach)):
        own = np.cov(places[:, part].T, aweights=state.weights, ddof=0)
        expected = (1 - MISTAKEN) * (own + SAMPLE_STD**2 * np.eye(2)) + MISTAKEN * broad**2 * np.eye(2)
        np.testing.assert_allclose(means[part], state.weights @ places[:, part], rtol=1e-9)
        np.testing.assert_allclose(covariances[part], expected, rtol=1e-8, atol=1e-8)


def test_moments_are_those_of_weighted_joints_and_angles() -> None:
    state = samples(some(80))
    found = body_moments(BODY, state)
    joints = BODY.joints(state.poses)
    assert found.joints.shape == (len(JOINTS), 3)
    for joint in range(len(JOINTS)):
        np.testing.assert_allclose(found.joints[joint], state.weights @ joints[:, joint])
        np.testing.assert_allclose(
            found.joint_covariances[joint],
            np.cov(joints[:, joint].T, aweights=state.weights, ddof=0),
            atol=1e-8,
        )
    np.testing.assert_allclose(found.angles, state.weights @ state.poses.angles)
    np.testing.assert_allclose(
        found.angle_covariances, np.cov(state.poses.angles.T, aweights=state.weights, ddof=0), atol=1e-8
    )


# --- weights ---


def test_weights_after_a_look_and_the_evidence() -> None:
    state = samples(some(30))
    factors = np.random.default_rng(5).normal(-400, 3, 30)
    after = state.reweighed(factors)
    likelihood = np.exp(factors + 400)
    evidence = float(state.weights @ likelihood)
    np.testing.assert_allclose(after.weights, state.weights * likelihood / evidence)
    np.testing.assert_allclose(after.log_evidence, np.log(evidence) - 400)
    np.testing.assert_allclose(after.effective, 1 / (after.weights**2).sum())
    assert not after.stationary
    assert after.ancestors is None


# --- first frame, next frame ---


def test_first_samples_are_a_moment_from_the_start() -> None:
    """Which counts as the frame before."""
    start = some(3)
    state = initial_samples(DYNAMICS, 900, SIZE, np.random.default_rng(0), start)
    assert state.ancestors is not None
    assert state.ancestors.poses is start
    np.testing.assert_allclose(state.ancestors.weights, 1 / 3)
    assert state.ancestors.elapsed == START_TIME
    off = state.poses.roots.reshape(300, 3, 2) - start.roots
    spread = DYNAMICS.place * BODY.head_height * np.sqrt(START_TIME)
    assert off.std() == pytest.approx(spread, rel=5 / np.sqrt(2 * 1800))
    assert np.abs(off.mean(axis=0)).max() < 5 * spread / np.sqrt(300)


def test_predictions_are_draws_of_the_mixture_around_their_ancestors() -> None:
    """Moments of many draws beside those of the mixture; roots in closed form."""
    state = samples(some(60))
    after = predict_samples(DYNAMICS, state, 20_000, DT)
    past = after.ancestors
    assert past is not None
    assert past.elapsed == DT
    assert past.weights.sum() == pytest.approx(1.0, abs=1e-12)
    usual = np.where(BODY.allowed(after.poses), np.exp(DYNAMICS.log_posture(after.poses, DT)), 0.0)
    np.testing.assert_allclose(after.weights, usual / usual.sum(), atol=1e-12)
    spread = DYNAMICS.place * BODY.head_height * np.sqrt(DT)
    mean = past.weights @ past.poses.roots
    covariance = np.cov(past.poses.roots.T, aweights=past.weights, ddof=0)
    covariance = covariance + spread**2 * np.eye(2)
    bar = 5 * np.sqrt(np.diag(covariance) / 20_000)
    assert (np.abs(after.poses.roots.mean(axis=0) - mean) < bar).all()
    np.testing.assert_allclose(np.cov(after.poses.roots.T), covariance, atol=0.05 * covariance.max())


# --- hands that were taken for each other ---


@pytest.mark.parametrize("seed", range(3))
def test_exchanged_ancestors_have_each_hand_where_the_other_was(seed: int) -> None:
    """In space, for heads and roots that stay; all of them are possible, and no weight is lost."""
    poses = some(300, seed)
    weights = np.random.default_rng(seed).dirichlet(np.ones(300))
    after = DYNAMICS.with_exchanged(Ancestors(poses, weights, DT), np.random.default_rng(seed))
    both, shares = after.poses, after.weights
    assert after.elapsed == DT
    n = len(poses)
    assert n < len(both) <= 2 * n
    assert shares.shape == (len(both),)
    assert (shares >= 0).all()
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(both.take(slice(n)).angles, poses.angles)
    exchanged = both.take(slice(n, None))
    assert BODY.allowed(exchanged).all()
    # whose exchange it is shows in the place, which is another in every pose
    origin = np.argmax(poses.roots[None, :, 0] == exchanged.roots[:, None, 0], axis=1)
    np.testing.assert_array_equal(exchanged.necks, poses.necks[origin])
    before, after = BODY.joints(poses)[origin], BODY.joints(exchanged)
    np.testing.assert_allclose(after[:, HANDS], before[:, HANDS[::-1]], atol=1e-6)
    np.testing.assert_allclose(BODY.parts(exchanged), BODY.parts(poses)[origin][:, [0, 2, 1]], atol=1e-6)
    chance = 0.5 * (1 - np.exp(-2 * DYNAMICS.exchanges * DT))
    np.testing.assert_allclose(shares[n:], chance * weights[origin])
    np.testing.assert_allclose(shares[:n][origin], (1 - chance) * weights[origin])
    stays = np.setdiff1d(np.arange(n), origin)
    np.testing.assert_array_equal(shares[stays], weights[stays])
