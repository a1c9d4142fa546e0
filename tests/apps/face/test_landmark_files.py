"""Landmarks as people give them."""

import numpy as np
from rsmcm.apps.face.application import GivenLandmarks


def test_which_row_belongs_to_which_frame() -> None:
    rows = np.arange(3 * 4 * 2).reshape(3, 4, 2).astype(float)
    landmarks = GivenLandmarks(rows, start=11, step=5)
    found = [landmarks.of_frame(number) for number in (11, 16, 21, 26)]
    for row, of_frame in zip(rows, found, strict=False):
        np.testing.assert_array_equal(of_frame, row)
    assert found[3] is None
    assert landmarks.of_frame(6) is None


def test_error_is_the_mean_over_what_is_there() -> None:
    rows = np.zeros((2, 3, 2))
    rows[1, 2] = np.nan
    landmarks = GivenLandmarks(rows)
    assert landmarks.error(2, np.array([[3.0, 4.0], [np.nan, np.nan], [9.0, 9.0]])) == 5
    assert np.isnan(landmarks.error(2, np.full((3, 2), np.nan)))
    assert np.isnan(landmarks.error(3, np.zeros((3, 2)))), "no row"
    assert np.isnan(GivenLandmarks(rows[:1]).error(1, np.ones((3, 2)))), "a start is no truth"


def test_size_is_that_of_the_box() -> None:
    assert GivenLandmarks(np.array([[[0, 0], [8, 1], [4, 2], [np.nan, np.nan]]])).size == 4
