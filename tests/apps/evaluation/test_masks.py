"""Measures of masks equal hand counts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.evaluation.masks import ErrorClasses, PixelScore, error_classes, mask_error_classes
from rsmcm.apps.io.ground_truth import FOREGROUND, OUTSIDE, SHADOW, UNKNOWN, Kind

from ...support.boxes import truth_of

LABELS = np.array([[0, SHADOW, OUTSIDE, UNKNOWN, FOREGROUND]] * 2, np.uint8)


def picture(*boxes: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    mask = np.zeros((200, 300), np.uint8)
    for x, y, width, height in boxes:
        mask[y : y + height, x : x + width] = 255
    return mask


# --- pixels


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_pixels_equal_a_plain_count_and_blocks_add_up(seed: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    score = PixelScore()
    true, guessed = [], []
    for number in range(1, 8):
        labels = rng.choice(LABELS[0], (5, 6))
        found = rng.choice(np.array([0, 255], np.uint8), (5, 6))
        score.add(number, found, labels)
        counted = (labels != OUTSIDE) & (labels != UNKNOWN)
        true.append(labels[counted] == 255)
        guessed.append(found[counted] > 0)
    positive, found_flat = np.concatenate(true), np.concatenate(guessed)
    total = score.total()
    assert total.true_positives == (positive & found_flat).sum()
    assert total.false_positives == (~positive & found_flat).sum()
    assert total.false_negatives == (positive & ~found_flat).sum()
    assert total.true_negatives == (~positive & ~found_flat).sum()
    blocks = score.blocks(length)
    assert sum(block.true_positives for _, block in blocks) == total.true_positives
    assert [first for first, _ in blocks] == list(range(1, 8, length))


def test_pixels_without_foreground_have_no_f() -> None:
    score = PixelScore()
    assert math.isnan(score.total().f_measure)
    score.add(1, np.zeros((2, 2), np.uint8), np.zeros((2, 2), np.uint8))
    assert math.isnan(score.total().f_measure)
    assert score.total().specificity == 1


# --- error classes

PERSON = [1, 1, 100, 50, 30, 80, Kind.PEDESTRIAN]
CAR = [1, 2, 200, 100, 80, 40, Kind.VEHICLE]
REFLECTION = [1, 3, 10, 10, 40, 40, Kind.IGNORED]


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        (picture(), ErrorClasses(missed_pedestrians=1, missed_vehicles=1, missed_by_pixels=2, objects=2)),
        (picture((100, 50, 30, 80), (200, 100, 80, 40)), ErrorClasses(objects=2)),
        # half of the person is enough, less is not
        (picture((100, 50, 30, 40), (200, 100, 80, 40)), ErrorClasses(objects=2)),
        (
            picture((100, 50, 30, 39), (200, 100, 80, 40)),
            ErrorClasses(missed_pedestrians=1, missed_by_pixels=1, objects=2),
        ),
        # an L covers the box by its bounding box, not by its pixels
        (
            picture((100, 50, 5, 80), (100, 125, 30, 5), (200, 100, 80, 40)),
            ErrorClasses(missed_by_pixels=1, objects=2),
        ),
        (picture((100, 50, 30, 80), (200, 100, 80, 40), (20, 150, 9, 9)), ErrorClasses(ghosts=1, objects=2)),
        # too small for a component
        (picture((100, 50, 30, 80), (200, 100, 80, 40), (20, 150, 7, 7)), ErrorClasses(objects=2)),
        # where it is to be ignored, and a little beside a person
        (
            picture((100, 50, 30, 80), (200, 100, 80, 40), (12, 12, 20, 20), (131, 60, 9, 9)),
            ErrorClasses(objects=2),
        ),
    ],
)
def test_error_classes_by_hand(mask: NDArray[np.uint8], expected: ErrorClasses) -> None:
    small = truth_of([PERSON, CAR, REFLECTION])
    assert error_classes(mask, small) == expected


def test_one_component_over_everything_finds_nobody() -> None:
    expected = ErrorClasses(missed_pedestrians=1, ghosts=1, objects=1)
    assert error_classes(picture((0, 0, 300, 200)), truth_of([PERSON])) == expected


def test_error_classes_of_masks() -> None:
    labels = picture((10, 10, 20, 20), (100, 100, 20, 20), (3, 190, 4, 4))
    labels[150:160, 200:220] = UNKNOWN
    found = picture((10, 10, 20, 9), (100, 100, 20, 10), (205, 150, 10, 10), (250, 20, 10, 10))
    expected = ErrorClasses(missed_objects=1, ghosts=1, missed_by_pixels=1, objects=2)
    assert mask_error_classes(found, labels) == expected
