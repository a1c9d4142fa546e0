"""The baselines do what their names say."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.baselines import (
    CleanUp,
    KalmanHungarian,
    Setting,
)


def square(number: int, size: int = 12) -> tuple[slice, slice]:
    left = max(2 * (number - 20), 0)
    return slice(20, 20 + size), slice(left, left + size)


def frames() -> Iterator[tuple[int, NDArray[np.uint8]]]:
    rng = np.random.default_rng(0)
    for number in range(1, 41):
        image = rng.normal(100, 2, (60, 80, 3)).astype(np.uint8)
        if number > 20:
            image[square(number)] = 220
        yield number, image


@pytest.mark.parametrize("method", ["MOG2", "KNN"])
def test_subtractors_find_a_moving_square(method: str) -> None:
    subtractor = Setting(method, 100, 16 if method == "MOG2" else 400).make()
    masks = {number: subtractor.apply(image) for number, image in frames()}
    mask = masks[40]
    assert set(np.unique(mask)) <= {0, 127, 255}
    cleaned = CleanUp(opening=3, min_area=50).apply(mask)
    inside = cleaned[square(40)]
    assert inside.mean() > 0.9 * 255
    assert cleaned.sum() == inside.sum()


def test_clean_up_by_hand() -> None:
    mask = np.zeros((40, 60), np.uint8)
    mask[5:15, 5:15] = 255
    mask[5:15, 15:25] = 127
    mask[30, 30] = 255
    mask[20:24, 40:44] = 255
    assert np.count_nonzero(CleanUp().apply(mask)) == 100 + 1 + 16
    assert np.count_nonzero(CleanUp(keep_shadows=True).apply(mask)) == 200 + 1 + 16
    assert np.count_nonzero(CleanUp(min_area=16).apply(mask)) == 100 + 16
    assert np.count_nonzero(CleanUp(min_area=17).apply(mask)) == 100
    assert CleanUp(median=5).apply(mask)[30, 30] == 0
    assert CleanUp(opening=3).apply(mask)[30, 30] == 0
    gap = mask.copy()
    gap[10, :] = 0
    assert CleanUp(closing=5).apply(gap)[10, 10] == 255


def walk(number: int) -> NDArray[np.float64]:
    return np.array([[10.0 + 3 * number, 20, 20, 40], [300.0 - 4 * number, 100, 20, 40]])


def test_tracker_follows_two_boxes_through_a_gap() -> None:
    tracker = KalmanHungarian(min_hits=3, max_age=10)
    results = [tracker.update(np.zeros((0, 4)) if 20 <= n < 25 else walk(n)) for n in range(1, 41)]
    assert [len(result) for result in results] == [0] * 2 + [2] * 17 + [0] * 5 + [2] * 16
    assert {identity for result in results for identity in result[:, 0]} == {1, 2}
    # Within a fraction of a pixel: the filter trusts a constant velocity and there is no noise.
    np.testing.assert_allclose(results[-1][:, 1:], walk(40), atol=0.5)


def test_tracker_ends_and_begins_tracks() -> None:
    tracker = KalmanHungarian(min_hits=1, max_age=2)
    assert tracker.update(walk(0))[:, 0].tolist() == [1, 2]
    for _ in range(4):
        assert tracker.update(np.zeros((0, 4))).shape == (0, 5)
    assert tracker.update(walk(0))[:, 0].tolist() == [3, 4]
