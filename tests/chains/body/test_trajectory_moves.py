"""Moves of poses between their past and their future, against draws from the exact density."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics
from rsmcm.chains.body.fixed_lag import ArmProposal, move_between
from rsmcm.chains.body.samples import BodySamples
from rsmcm.inference.smc import normalised, systematic
from rsmcm.models.body.upper_body import UpperBody

BODY = UpperBody.from_head(90.0)
DYNAMICS = BodyDynamics(BODY)
DT, LATER = 0.04, 0.16
SIZE = (360, 640)


def repeated(pose, n):
    return pose.take(np.zeros(n, np.int64))


def test_moves_leave_the_density_between_past_and_future_as_it_is():
    random = np.random.default_rng(0)
    start = DYNAMICS.draw_anywhere(1, SIZE, random)
    later = replace(DYNAMICS, jumps=0.0).draw(start, DT, random)
    wanted = BODY.parts(later)[0, 1] + (5.0, 3.0)

    def log_likelihood(poses):  # of a left hand that is seen
        return -0.5 * np.square((BODY.parts(poses)[:, 1] - wanted) / 20.0).sum(axis=1)

    many = DYNAMICS.draw(repeated(start, 200_000), DT, random)
    log_weights = (
        DYNAMICS.log_posture(many, DT)
        + DYNAMICS.log_step(repeated(later, len(many)), many, LATER)
        + log_likelihood(many)
    )
    log_weights = normalised(np.where(BODY.allowed(many), log_weights, -np.inf))
    n = 1500
    exact = many.take(systematic(log_weights, n, random))
    effective = 1 / np.exp(2 * log_weights).sum()
    assert effective > 300
    samples = BodySamples.even(many.take(slice(300)), SIZE, random)
    past = Ancestors(start, np.ones(1), DT)
    poses = move_between(
        DYNAMICS,
        exact,
        DYNAMICS.prediction(past),
        samples,
        repeated(later, n),
        LATER,
        log_likelihood,
        12,
        random,
    )
    before, after = (BODY.joints(each)[:, [3, 4, 6, 7]] for each in (exact, poses))
    changed = (before != after).any(axis=(1, 2))
    assert changed.mean() > 0.5
    error = before.std(axis=0) * np.sqrt(1 / effective + 1 / n)
    assert (np.abs(before.mean(axis=0) - after.mean(axis=0)) < 4.5 * error + 1e-9).all()
    np.testing.assert_allclose(after.std(axis=0), before.std(axis=0), rtol=0.25)


def test_arms_are_drawn_from_the_density_that_is_stated():
    random = np.random.default_rng(2)
    centres = DYNAMICS.draw(repeated(DYNAMICS.draw_anywhere(1, SIZE, random), 5), DT, random).arms[:, 0]
    near = DYNAMICS.draw_anywhere(1, SIZE, random).arms[:, 0]
    n = 40_000
    proposal = ArmProposal.of(DYNAMICS, 30 * DT, centres, np.repeat(near, n, axis=0))  # broad kernels
    drawn = proposal.draw(random)
    values = proposal.log_density(drawn)
    # the mean of 1 / density over draws is the volume: two spheres
    assert np.exp(-values).mean() == pytest.approx((4 * np.pi) ** 2, rel=0.1)
