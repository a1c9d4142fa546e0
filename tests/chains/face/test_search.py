"""Experts begin their search apart, some of them straight ahead."""

import numpy as np
from rsmcm.chains.face.recovery import ASIDE, FARTHEST_AHEAD, STRAIGHT, disperse
from rsmcm.models.face.morphable_model import Poses

N, BASES = 4000, 3


def test_shares_of_the_motion_and_steps_aside() -> None:
    poses = Poses.upright(np.zeros((N, 2)), np.full(N, 40.0), BASES)
    motion = np.zeros((N, poses.dimension))
    motion[:, 3] = 10.0
    walk = np.array([0.01, 0.02, 0.01, 4.0, 9.0, 1.0, 2.0, 3.0])
    changes = disperse(poses, motion, walk, np.random.default_rng(0)).changes_from(poses)
    straight = np.abs(np.delete(changes, 3, axis=1)).max(axis=1) < 1e-12
    bar = 5 / np.sqrt(N)
    assert abs(straight.mean() - STRAIGHT) < bar
    ahead = changes[straight, 3] / 10.0
    assert ahead.min() >= 0
    assert ahead.max() <= FARTHEST_AHEAD
    assert abs(ahead.mean() - FARTHEST_AHEAD / 2) < bar * FARTHEST_AHEAD
    np.testing.assert_allclose(changes[~straight, 4].std(), ASIDE * 3.0, rtol=bar)
    np.testing.assert_allclose(changes[~straight, 5:].std(axis=0), ASIDE * np.sqrt(walk[5:]), rtol=bar)
