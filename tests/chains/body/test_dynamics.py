import numpy as np
import pytest
from rsmcm.chains.body.dynamics import (
    USUAL_UPPER_ARMS,
    Ancestors,
    BodyDynamics,
    concentration,
    draw_any_directions,
    draw_directions,
)
from rsmcm.models.body.upper_body import UpperBody
from scipy.optimize import brentq

BODY = UpperBody.from_head(90.0)
DT = 0.04


def some_poses(n, random):
    dynamics = BodyDynamics(BODY)
    return dynamics.draw_anywhere(n, (360, 640), random)


def plain_log_density(dynamics, poses, ancestors, weights, dt):
    """Entry by entry, in double precision."""
    place = dynamics.place * dynamics.body.head_height * np.sqrt(dt)
    kept = np.exp(-dt / dynamics.neck_time)
    neck = dynamics.neck * np.sqrt(1 - kept**2)
    held = np.exp(-dt / dynamics.torso_time)
    torso = np.array([dynamics.lean, dynamics.turn, dynamics.lean]) * np.sqrt(1 - held**2)
    jump = 1 - np.exp(-dynamics.jumps * dt)
    total = np.zeros((len(poses), len(ancestors)))
    for name, spread, share in (("roots", place, 1.0), ("torsos", torso, held), ("necks", neck, kept)):
        step = getattr(poses, name)[:, None] - share * getattr(ancestors, name)[None]
        total += (-0.5 * (step / spread) ** 2 - 0.5 * np.log(2 * np.pi * spread**2)).sum(axis=2)
    for side in (0, 1):
        smooth = 0.0
        for part, rate in enumerate((dynamics.upper_arm, dynamics.forearm)):
            kappa = brentq(lambda k, r=rate: 1 / np.tanh(k) - 1 / k - np.exp(-(r**2) * dt), 1e-3, 300.0)
            cosine = poses.arms[:, side, part] @ ancestors.arms[:, side, part].T
            smooth = (
                smooth
                + kappa * cosine
                + np.log(kappa / (4 * np.pi))
                - (kappa + np.log(-np.expm1(-2 * kappa) / 2))
            )
        usual = 2 * poses.arms[:, side, 0] @ USUAL_UPPER_ARMS[side] + np.log(2 / (4 * np.pi * np.sinh(2)))
        jumped = np.log(jump) + usual - np.log(4 * np.pi)
        total += np.logaddexp(np.log1p(-jump) + smooth, jumped[:, None])
    return np.log(np.exp(total - total.max(axis=1, keepdims=True)) @ weights) + total.max(axis=1)


def test_mixture_is_that_of_the_plain_formula():
    random = np.random.default_rng(1)
    dynamics = BodyDynamics(BODY)
    ancestors = some_poses(60, random)
    weights = random.dirichlet(np.ones(60))
    near = dynamics.draw(ancestors.take(random.integers(60, size=150)), DT, random)
    far = some_poses(50, random)
    for poses in (near, far):
        found = dynamics.log_density(poses, Ancestors(ancestors, weights, DT)) - dynamics.log_posture(
            poses, DT
        )
        assert found == pytest.approx(plain_log_density(dynamics, poses, ancestors, weights, DT), abs=2e-3)


def test_draws_have_the_density_that_is_evaluated():
    """By importance: the mean of any other density over ours is 1."""
    random = np.random.default_rng(3)
    dynamics = BodyDynamics(BODY, jumps=4.0)
    other = BodyDynamics(
        BODY, place=0.22, lean=0.12, turn=0.25, neck=0.2, upper_arm=0.5, forearm=0.8, jumps=2.0
    )
    start = some_poses(2, random)
    weights = np.array([0.3, 0.7])
    n = 40_000
    poses = dynamics.draw(start.take(random.choice(2, n, p=weights)), DT, random)
    past = Ancestors(start, weights, DT)
    ratio = np.exp(other.log_density(poses, past) - dynamics.log_density(poses, past))
    assert ratio.mean() == pytest.approx(1.0, abs=5 * ratio.std() / np.sqrt(n))
    assert ratio.std() < 5  # so that the bar above means something


@pytest.mark.parametrize("concentration", [0.5, 20.0, 2000.0])
def test_directions_around_another_have_the_known_mean_cosine(concentration):
    random = np.random.default_rng(4)
    middle = draw_any_directions((1,), random)
    drawn = draw_directions(np.repeat(middle, 20_000, axis=0), concentration, random)
    cosine = drawn @ middle[0]
    expected = 1 / np.tanh(concentration) - 1 / concentration
    assert cosine.mean() == pytest.approx(expected, abs=5 * cosine.std() / np.sqrt(len(drawn)))
    assert np.linalg.norm(drawn, axis=1) == pytest.approx(1.0, abs=1e-12)
    across = drawn - cosine[:, None] * middle
    assert np.abs(across.mean(axis=0)).max() < 5 * across.std() / np.sqrt(len(drawn))


@pytest.mark.parametrize("elapsed", [1e-9, 1e-3, 0.04, 1.0, 6.0])
def test_concentrations_have_the_mean_of_a_brownian_motion(elapsed):
    """Whose mean cosine is exp(-elapsed); beyond any memory a direction is draw_any_directions."""
    kappa = concentration(np.array([elapsed]))[0]
    assert 1 / np.tanh(kappa) - 1 / kappa == pytest.approx(np.exp(-elapsed), abs=1e-9)
    assert concentration(np.array([1e3]))[0] < 0.01


def test_ten_steps_have_the_moments_of_one():
    """Positions, necks and directions of arms that do not jump: means and covariances, to six errors.

    Second moments of directions are nearly the same: von Mises-Fisher densities, folded, are not one.
    """
    random = np.random.default_rng(11)
    dynamics = BodyDynamics(BODY, jumps=0.0)
    n, start = 20_000, some_poses(1, random)
    start.torsos[0], start.necks[0] = (-0.1, 0.4, 0.2), (0.2, -0.3, 0.1)
    once = stepwise = start.take(np.zeros(n, np.int64))
    once = dynamics.draw(once, 0.4, random)
    for _ in range(10):
        stepwise = dynamics.draw(stepwise, DT, random)
    directions = start.arms[0] * np.exp(-0.4 * np.array([0.6, 1.0]) ** 2)[:, None]
    for name, systematic in (("roots", 0.0), ("torsos", 0.0), ("necks", 0.0), ("arms", 0.04)):
        one, ten = (getattr(each, name).reshape(n, -1) for each in (once, stepwise))
        bar = 6 * np.hypot(one.std(axis=0), ten.std(axis=0)) / np.sqrt(n)
        assert (np.abs(one.mean(axis=0) - ten.mean(axis=0)) < bar).all()
        products = [
            np.einsum("ni,nj->nij", each - each.mean(axis=0), each - each.mean(axis=0)) for each in (one, ten)
        ]
        covariances = [each.mean(axis=0) for each in products]
        bar = 6 * np.hypot(*(each.std(axis=0) for each in products)) / np.sqrt(n)
        bar += systematic * covariances[0].max()
        assert (np.abs(covariances[0] - covariances[1]) < bar).all()
    for each in (once, stepwise):
        assert each.arms.mean(axis=0) == pytest.approx(directions, abs=6 * 0.6 / np.sqrt(n))


def test_ancestors_are_drawn_in_proportion_to_their_terms():
    random = np.random.default_rng(5)
    dynamics = BodyDynamics(BODY)
    ancestors = dynamics.draw(some_poses(1, random).take(np.zeros(8, np.int64)), DT, random)
    weights = random.dirichlet(np.ones(8))
    pose = dynamics.draw(ancestors.take([3]), DT, random)
    terms = np.array(
        [dynamics.log_density(pose, Ancestors(ancestors.take([k]), np.ones(1), DT))[0] for k in range(8)]
    )
    shares = weights * np.exp(terms - terms.max())
    n = 20_000
    drawn = dynamics.draw_ancestors(
        pose.take(np.zeros(n, np.int64)), Ancestors(ancestors, weights, DT), random
    )
    counted = np.bincount(drawn, minlength=8) / n
    np.testing.assert_allclose(counted, shares / shares.sum(), atol=4 * 0.5 / np.sqrt(n))


def test_one_step_is_a_mixture_of_one_ancestor():
    random = np.random.default_rng(6)
    dynamics = BodyDynamics(BODY)
    before = some_poses(30, random)
    poses = dynamics.draw(before, DT, random)
    each = [
        dynamics.log_density(poses.take([k]), Ancestors(before.take([k]), np.ones(1), DT))[0]
        for k in range(30)
    ]
    np.testing.assert_allclose(dynamics.log_step(poses, before, DT), each, atol=1e-3)


def test_arms_that_do_not_jump_have_a_density_everywhere():
    random = np.random.default_rng(8)
    dynamics = BodyDynamics(BODY, jumps=0.0)
    before, poses = some_poses(30, random), some_poses(30, random)
    assert np.isfinite(dynamics.log_step(poses, before, 1e-4)).all()
