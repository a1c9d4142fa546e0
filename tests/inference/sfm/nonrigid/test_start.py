"""Where EM for deforming shapes starts."""

from dataclasses import replace

import numpy as np
from rsmcm.inference.sfm.nonrigid import em
from rsmcm.inference.sfm.nonrigid import learning as start
from rsmcm.models.numerics.rotations import exponential

from ....support.deforming import MIRROR, N_POINTS


def test_a_turned_over_stretch_of_frames_is_turned_back() -> None:
    time = np.linspace(0, 1, 40)
    random = np.random.default_rng(0)
    flat = random.uniform(-1, 1, (1, N_POINTS, 3)) * [1, 1, 0.1]
    flat -= flat.mean(axis=1, keepdims=True)
    rotations = exponential(np.column_stack([0 * time, 0.3 + 1.0 * time, 0 * time]))
    positions = (flat[0] @ rotations.transpose(0, 2, 1))[..., :2]
    axis = np.linalg.eigh(flat[0].T @ flat[0])[1][:, 0]
    mirrored = np.diag(MIRROR) @ rotations @ (np.eye(3) - 2 * np.outer(axis, axis))
    stretch = slice(12, 25)
    wrong = rotations.copy()
    wrong[stretch] = mirrored[stretch]
    state = em.State(flat, wrong, np.ones(40), np.zeros((40, 2)), 1e-4, np.ones(40))
    tracks = em.Tracks.of(positions)
    found = start.with_smooth_turns(tracks, state)
    assert found is not None
    np.testing.assert_allclose(found.rotations, rotations, atol=1e-12)
    assert start.with_smooth_turns(tracks, replace(state, rotations=rotations)) is None
