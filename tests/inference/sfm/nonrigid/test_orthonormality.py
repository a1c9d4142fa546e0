"""Rotations of a deforming shape that are known."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference.sfm.nonrigid.learning import rotations_of_rank
from rsmcm.models.numerics.rotations import exponential, logarithm, nearest_rotation

from ....support.deforming import MIRROR

Numbers = NDArray[np.float64]


def away(found: Numbers, truth: Numbers) -> float:
    """Largest angle rad, up to a rotation of the object and a mirror image in depth."""
    angles = []
    for image in (found, MIRROR[:, None] * found * MIRROR):
        turn = nearest_rotation((image.transpose(0, 2, 1) @ truth).mean(axis=0))
        angles.append(np.linalg.norm(logarithm(image @ turn @ truth.transpose(0, 2, 1)), axis=1).max())
    return float(min(angles))


@pytest.mark.parametrize("n_bases", [1, 2])
def test_rotations_are_those_of_the_object(n_bases: int) -> None:
    random = np.random.default_rng(0)
    n_frames, n_points = 80, 30
    truth = exponential(1.5 * random.standard_normal((n_frames, 3)))
    bases = random.standard_normal((n_bases, n_points, 3))
    bases[1:] *= 0.4
    weights = random.standard_normal((n_frames, n_bases))
    weights[:, 0] = 1
    shapes = np.tensordot(weights, bases, 1)
    positions = (shapes @ truth.transpose(0, 2, 1))[..., :2]
    positions -= positions.mean(axis=1, keepdims=True)
    found = rotations_of_rank(positions, {3 * n_bases})
    np.testing.assert_allclose(np.linalg.det(found), 1)
    assert min(away(each, truth) for each in found) < 1e-3


def test_points_that_do_not_turn_have_no_rotations() -> None:
    still = np.random.default_rng(0).standard_normal((1, 9, 2))
    assert rotations_of_rank(np.repeat(still - still.mean(axis=1), 12, axis=0), {6, 9}) == []
