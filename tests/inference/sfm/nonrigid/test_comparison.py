"""Errors of shapes, against sums written out."""

import numpy as np
import pytest
from rsmcm.inference.sfm.nonrigid.shape import shape_error


def test_error_is_mean_distance_over_mean_deviation_up_to_one_mirror_image() -> None:
    random = np.random.default_rng(0)
    truth = random.standard_normal((6, 9, 3)) * [3, 2, 1]
    found = truth + 0.1 * random.standard_normal(truth.shape)
    found[4] = np.nan
    distances, deviations = [], []
    for frame in (0, 1, 2, 3, 5):
        one, other = found[frame] - found[frame].mean(axis=0), truth[frame] - truth[frame].mean(axis=0)
        distances += [np.sqrt(np.sum((one[j] - other[j]) ** 2)) for j in range(9)]
        deviations += [np.sqrt(np.mean(other[:, axis] ** 2)) for axis in range(3)]
    expected = np.mean(distances) / np.mean(deviations)
    assert shape_error(found, truth) == pytest.approx(expected)
    assert shape_error(found * [1, 1, -1] + [5, 6, 7], truth) == pytest.approx(expected)
    found[:2, :, 2] *= -1  # not every frame its own
    assert shape_error(found, truth) > 2 * expected


def test_arrays_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match=r"got \(2, 5, 3\) and \(2, 4, 3\), expected"):
        shape_error(np.zeros((2, 5, 3)), np.zeros((2, 4, 3)))
    with pytest.raises(ValueError, match="no frame that is known in both"):
        shape_error(np.full((2, 5, 3), np.nan), np.zeros((2, 5, 3)))
