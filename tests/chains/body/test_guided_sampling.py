"""Guided draws with their weights, beside plain draws of the dynamics: both are of the prediction."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics
from rsmcm.chains.body.kernels.proposals import choose, closeness_to, guided_values
from rsmcm.chains.body.proposals import ANYWHERE, AT_ELBOWS, GUIDED, Guided, draw_guided, half_range
from rsmcm.models.body.upper_body import JOINTS, BodyPoses, UpperBody, log_volume, swivels
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm, vonmises

Array = NDArray[np.float64]
Said = list[tuple[GaussianMixtures, float]]

BODY = UpperBody.from_head(90.0)
SIZE = (360, 640)
DT = 0.04
RUNS = 24
SIGMAS = 6.0
"""Standard errors, of `RUNS` runs and of what they are compared with, that a difference may have."""
HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]
SHOULDERS = [hand - 2 for hand in HANDS]
NOTHING: Said = [(GaussianMixtures.uniform(3), 1.0)]


def past_of(seed: int, modes: int = 3, each: int = 15) -> Ancestors:
    """Somebody in the middle of the picture in some postures, each with poses about it, unevenly weighted."""
    random = np.random.default_rng(seed)
    dynamics = BodyDynamics(BODY)
    middles = dynamics.draw_anywhere(modes, SIZE, random)
    middles = replace(middles, roots=0.1 * (middles.roots - (320.0, 150.0)) + (320.0, 150.0))
    poses = dynamics.draw(middles.take(np.repeat(np.arange(modes), each)), DT, random)
    weights = random.dirichlet(np.ones(len(poses)))
    return Ancestors(poses, weights, DT)


def plain(dynamics: BodyDynamics, past: Ancestors, n: int, random: np.random.Generator) -> BodyPoses:
    """Draws of the prediction without any guide: those allowed, unusual ones as seldom as they are."""
    ancestors = past.poses.take(random.choice(len(past.poses), n, p=past.weights))
    poses = dynamics.draw(ancestors, past.elapsed, random)
    usual = random.random(n) < np.exp(dynamics.log_posture(poses, past.elapsed))
    return poses.take(BODY.allowed(poses) & usual)


def said_of(left: list[Array], right: list[Array], spread: float) -> GaussianMixtures:
    """Places `(2,)` px of either hand, half of the mass flat, and a head that must not matter."""
    means = [np.zeros((1, 2)), *(np.reshape(each, (-1, 2)) for each in (left, right))]
    return GaussianMixtures.of_parts(
        [np.linspace(0.0, 1.0, len(each)) for each in means],
        means,
        [np.tile(spread**2 * np.eye(2), (len(each), 1, 1)) for each in means],
        [0.0] * 3,
    )


def features(poses: BodyPoses) -> Array:
    """`(n, 23)`: all joints but the head's in px, and whether either hand is high."""
    joints = BODY.joints(poses)
    return np.concatenate(
        [joints[:, 1:].reshape(len(poses), -1), 100.0 * (joints[:, HANDS, 1] < 200.0)], axis=1
    )


def targets_of(case: str, past: Ancestors) -> Said:
    hands = BODY.joints(past.poses)[:, HANDS, :2]
    if case == "none":
        return NOTHING
    if case == "near":
        return [(said_of([hands[0, 0], hands[20, 0]], [hands[0, 1]], 8.0), 1.0)]
    if case == "one hand, two voices":
        flat = said_of([hands[0, 0]], [], 8.0)
        return [(flat, 0.7), (said_of([hands[20, 0]], [hands[40, 1]], 20.0), 0.3)]
    middles = hands.mean(axis=0)
    return [(said_of([middles[0] + (0.0, -150.0)], [middles[1] - (0.5 * BODY.upper_arm, 0.0)], 12.0), 1.0)]


@pytest.mark.parametrize("bare", [0.0, 0.7])
@pytest.mark.parametrize("case", ["none", "near", "one hand, two voices", "far away"])
def test_weighted_draws_are_of_the_prediction(case: str, bare: float) -> None:
    """Wherever hands are detected: means over runs against those of plain draws."""
    past, dynamics = past_of(1), BodyDynamics(BODY)
    truth = features(plain(dynamics, past, 100_000, np.random.default_rng(2)))
    said, runs, effective = targets_of(case, past), [], []
    for run in range(RUNS):
        found = draw_guided(dynamics, past, said, 3000, np.random.default_rng(run), bare)
        assert BODY.allowed(found.poses).all()
        weights = np.exp(found.log_weights)
        assert weights.sum() == pytest.approx(1.0)
        effective.append(1 / (weights**2).sum())
        runs.append(weights @ features(found.poses))
    assert np.median(effective) > 300
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(RUNS)
    bar = SIGMAS * np.hypot(error, truth.std(axis=0) / np.sqrt(len(truth)))
    assert (np.abs(np.mean(runs, axis=0) - truth.mean(axis=0)) < bar + 1e-9).all()
    assert np.median(bar) < 4.0, "px: else it would say nothing"


def density(
    draws: Guided, past: Ancestors, dynamics: BodyDynamics, target: tuple[int, Array, float], bare: float
) -> Array:
    """Of arms given their ancestors, written out for one target that a hand is drawn to."""
    side, place, spread = target
    poses, parents = draws.poses, past.poses.take(draws.ancestors)
    walks = dynamics.log_arm_steps(poses, parents, past.elapsed)
    before, after = BODY.joints(parents), BODY.joints(poses)
    offsets = after[:, HANDS[side]] - after[:, SHOULDERS[side]]
    depths = (before[:, HANDS[side]] - before[:, SHOULDERS[side]])[:, 2]
    turn = 2 * dynamics.upper_arm * np.sqrt(past.elapsed)
    step = np.hypot(BODY.upper_arm * dynamics.upper_arm, BODY.forearm * dynamics.forearm)
    angles = [swivels(side, each.arms[:, side], BODY) for each in (poses, parents)]
    near = norm.pdf(offsets[:, 2], depths, step * np.sqrt(past.elapsed))
    near *= vonmises.pdf(angles[0] - angles[1], 1 / turn**2)
    evenly = 1 / (2 * half_range(BODY, offsets)) / (2 * np.pi)
    at_place = multivariate_normal(place, spread**2)
    completed = ((1 - ANYWHERE) * near + ANYWHERE * evenly) * np.exp(log_volume(BODY, offsets))
    # an area in the picture over the solid angle of a limb, of which two directions are seen alike
    upper, fore = np.moveaxis(np.abs(poses.arms[:, side, :, 2]), 1, 0) / 2
    through = at_place.pdf(after[:, HANDS[side] - 1, :2])
    through *= upper * BODY.upper_arm**2 * fore * BODY.forearm**2
    share = AT_ELBOWS * bare
    hand = at_place.logpdf(after[:, HANDS[side], :2])
    arm = hand + np.log((1 - share) * completed + share * through)
    share = 0.5 * GUIDED
    both = np.stack([np.log(1 - share) + walks.sum(axis=1), np.log(share) + arm + walks[:, 1 - side]], axis=1)
    return logsumexp(both, axis=1)


@pytest.mark.parametrize("bare", [0.0, 0.7])
@pytest.mark.parametrize("side", [0, 1])
def test_weights_are_prediction_over_density_of_the_draw(side: int, bare: float) -> None:
    """Of one ancestor and one target, by the formula."""
    past, dynamics = past_of(6, modes=1, each=1), BodyDynamics(BODY)
    place = BODY.joints(past.poses)[0, HANDS[side], :2] + (5.0, -5.0)
    targets = [[place], []] if side == 0 else [[], [place]]
    found = draw_guided(
        dynamics, past, [(said_of(targets[0], targets[1], 6.0), 1.0)], 2000, np.random.default_rng(1), bare
    )
    walks = dynamics.log_arm_steps(found.poses, past.poses.take(found.ancestors), DT).sum(axis=1)
    expected = (
        walks
        + dynamics.log_posture(found.poses, DT)
        - density(found, past, dynamics, (side, place, 6.0), bare)
    )
    np.testing.assert_allclose(found.log_weights, expected - logsumexp(expected), atol=1e-6)


def test_kernel_is_the_sum_over_targets() -> None:
    random = np.random.default_rng(0)
    n, k, ancestors = 50, 5, 4
    hands, means = random.normal(0, 30, (n, 2, 2)), random.normal(0, 30, (k, 2))
    chosen, sides = random.integers(ancestors, size=n), random.integers(2, size=k)
    walks, completions = random.normal(-3, 30, (2, n, 2))
    closeness, shares = random.random((k, ancestors)), random.dirichlet(np.ones(k + 1))
    roots = random.normal(0, 10, (k, 2, 2))
    covariances = roots @ np.swapaxes(roots, 1, 2) + 9 * np.eye(2)
    heights = shares[:k] / (2 * np.pi * np.sqrt(np.linalg.det(covariances)))
    values = np.empty(n)
    precisions = np.linalg.inv(covariances)
    heights = np.append(heights, shares[k])
    guided_values(hands, chosen, walks, completions, sides, means, precisions, heights, closeness, values)
    terms = [np.log(shares[k]) + walks.sum(axis=1)]
    for target in range(k):
        side = sides[target]
        at = multivariate_normal(means[target], covariances[target]).logpdf(hands[:, side])
        terms.append(
            np.log(shares[target] * closeness[target, chosen])
            + at
            + completions[:, side]
            + walks[:, 1 - side]
        )
    np.testing.assert_allclose(values, logsumexp(terms, axis=0), rtol=1e-6, atol=1e-5)


def test_poses_are_chosen_for_targets_as_plain_numpy_and_systematic_resampling_have_it() -> None:
    random = np.random.default_rng(3)
    n, k = 300, 4
    hands, means = random.normal(0, 30, (n, 2, 2)), random.normal(0, 30, (k, 2))
    roots = random.normal(0, 8, (k, 2, 2))
    precisions = np.linalg.inv(roots @ np.swapaxes(roots, 1, 2) + 20 * np.eye(2))
    sides, choice = np.array([0, 1, 1, 0]), random.dirichlet(np.ones(n))
    found = np.empty((k, n))
    closeness_to(hands, sides, means, precisions, 1e-3, choice, found)
    apart = hands[:, sides] - means
    near = np.exp(-0.5 * np.einsum("nkx,kxy,nky->kn", apart, precisions, apart)) + 1e-3
    np.testing.assert_allclose(found, near / (near @ choice)[:, None], rtol=1e-9)
    counts, shifts = np.array([50, 0, 7, 200, 90]), random.random(5)
    chosen = np.empty(counts.sum(), np.int64)
    choose(choice, found, counts, shifts, chosen)
    expected = []
    for target, (count, shift) in enumerate(zip(counts, shifts, strict=True)):
        ends = np.cumsum(choice * found[target] if target < k else choice)
        points = (np.arange(count) + shift) * ends[-1] / max(count, 1)
        expected.append(np.searchsorted(ends[:-1], points, side="right"))
    np.testing.assert_array_equal(chosen, np.concatenate(expected))
