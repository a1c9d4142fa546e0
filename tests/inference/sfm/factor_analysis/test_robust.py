"""Positions of which some are wrong: nothing changes where none is, and little where some are."""

import numpy as np
import pytest
from rsmcm.apps.scenes import cylinder
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise, factorise_robustly, predicted
from rsmcm.inference.sfm.factor_analysis.observations import ENOUGH, covering

SCENE = cylinder(n_points=60, n_frames=24, p_loose=0.1, p_drift=0.0, seed=3)


@pytest.mark.parametrize("coherence", [False, True])
def test_without_outliers_it_is_factorise(coherence: bool) -> None:
    found = factorise_robustly(SCENE.observed, coherence=coherence)
    plain = factorise(SCENE.observed, coherence=coherence)
    seen = SCENE.visible
    assert found.trusted[seen].mean() > 0.995
    assert not found.right[~seen].any()
    assert found.consistent.all()
    off = predicted(found.factorisation)[0] - predicted(plain)[0]
    # a tenth of the noise
    assert np.sqrt(np.square(off).mean()) < 0.001
    assert found.factorisation.noise_variance == pytest.approx(plain.noise_variance, rel=0.05)


def test_of_many_points_each_frame_shows_enough_of_the_longest() -> None:
    seen = np.random.default_rng(0).random((24, 1500)) < np.linspace(0.02, 0.9, 1500)
    seen[5, 60:] = False
    some = covering(seen)
    shown = np.count_nonzero(seen & some, axis=1)
    assert (shown >= np.minimum(np.count_nonzero(seen, axis=1), ENOUGH)).all()
    assert np.count_nonzero(some) < 400
    assert covering(SCENE.visible).all()


@pytest.mark.parametrize("coherence", [False, True])
def test_outliers_are_told_from_right_positions(coherence: bool) -> None:
    random = np.random.default_rng(0)
    positions = SCENE.observed.copy()
    wrong = SCENE.visible & (random.random(SCENE.visible.shape) < 0.08)
    positions[wrong] += random.uniform(0.2, 1.0, (wrong.sum(), 1)) * _directions(random, wrong.sum())
    found = factorise_robustly(positions, coherence=coherence)
    assert not (found.trusted & wrong).any()
    assert found.trusted[SCENE.visible & ~wrong].mean() > 0.99
    knowing = positions.copy()
    knowing[wrong] = np.nan
    oracle = factorise(knowing, coherence=coherence)
    off, least, most = (
        np.sqrt(np.square(predicted(fit)[0] - SCENE.positions).sum(axis=2).mean())
        for fit in (found.factorisation, oracle, factorise(positions, coherence=coherence))
    )
    assert off < 1.1 * least
    assert most > 3 * least
    again = factorise_robustly(positions[:, ::-1], coherence=coherence, start=oracle)
    np.testing.assert_array_equal(again.trusted[:, ::-1], found.trusted)


def test_a_mismatch_in_two_frames_is_seen() -> None:
    """Three of its four numbers go into the point: what is left is judged by what that leaves free.

    The second one shows the point that is farthest from the first one's epipolar line.
    """
    positions = np.full((*SCENE.positions.shape[:2], 2), np.nan)
    positions[:] = SCENE.observed
    positions = np.concatenate([positions, np.full((24, 8, 2), np.nan)], axis=1)
    for k in range(8):
        one, other = SCENE.positions[3 * k : 3 * k + 2]
        pairs = np.concatenate([one - one.mean(axis=0), other - other.mean(axis=0)], axis=1)
        line = np.linalg.svd(pairs)[2][3]  # affine views of one point are in a plane
        farthest = np.abs(pairs[k, :2] @ line[:2] + pairs[:, 2:] @ line[2:]).argmax()
        positions[3 * k, 60 + k], positions[3 * k + 1, 60 + k] = one[k], other[farthest if k < 4 else k]
    found = factorise_robustly(positions, coherence=True)
    right = found.consistent[60:]
    assert right[4:].all()
    assert not right[:4].any()
    assert found.consistent[:60].all()


def _directions(random: np.random.Generator, n: int) -> np.ndarray:
    angle = random.uniform(0, 2 * np.pi, n)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_an_outlier_of_one_coordinate_is_told() -> None:
    positions = SCENE.observed.copy()
    frames, points = np.nonzero(SCENE.visible & (np.random.default_rng(0).random(SCENE.visible.shape) < 0.2))
    positions[frames, points, 0] = np.nan
    positions[frames[::10], points[::10], 1] += 0.5
    found = factorise_robustly(positions)
    assert not found.trusted[frames[::10], points[::10]].any()
    assert found.trusted[SCENE.visible].mean() > 0.97
