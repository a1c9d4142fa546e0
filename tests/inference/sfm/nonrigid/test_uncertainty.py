"""Whether shapes err as much as they say."""

import numpy as np
from rsmcm.inference.sfm.nonrigid.learning import learn_shape

from ....support.deforming import MIRROR, N_BASES, deforming, holes


def test_errors_are_as_large_as_stated() -> None:
    squares = []
    for seed in range(2):
        positions, truth = deforming(seed=seed)
        found = learn_shape(holes(positions, 0.2), N_BASES, iterations=100)
        covariances = found.shape_covariances()
        np.testing.assert_allclose(covariances, covariances.transpose(0, 1, 3, 2), atol=1e-12)
        assert np.linalg.eigvalsh(covariances).min() > 0
        depth = truth[..., 2:] - truth[..., 2:].mean(axis=1, keepdims=True)
        goal = np.concatenate([truth[..., :2], depth], axis=2)
        off = min((found.shapes() - goal * sign for sign in (1, MIRROR)), key=lambda each: np.sum(each**2))
        squares.append(np.einsum("nji,njik,njk->nj", off, np.linalg.inv(covariances), off).mean() / 3)
    # of two sequences; points of a frame, and frames of a point, err together
    assert 0.6 < np.mean(squares) < 1.7
