"""Metrics equal hand counts and, for tracks, an independent implementation."""

import math
from collections.abc import Callable

import motmetrics
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.evaluation.metrics import (
    ErrorClasses,
    PixelScore,
    TrackScores,
    box_overlap,
    error_classes,
    evaluate_tracks,
    mask_error_classes,
)
from rsmcm.apps.io.ground_truth import FOREGROUND, OUTSIDE, SHADOW, UNKNOWN, BoxTruth, Kind

LABELS = np.array([[0, SHADOW, OUTSIDE, UNKNOWN, FOREGROUND]] * 2, np.uint8)
FOUND = np.array([[255] * 5, [0] * 5], np.uint8)


def truth_of(rows: list[list[float]]) -> BoxTruth:
    """Rows of frame, identity, x, y, width, height, kind."""
    table = np.array(rows, float).reshape(-1, 7)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    whole = table.astype(np.int64)
    return BoxTruth(whole[:, 0], whole[:, 1], table[:, 2:6], whole[:, 6])


def picture(*boxes: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    mask = np.zeros((200, 300), np.uint8)
    for x, y, width, height in boxes:
        mask[y : y + height, x : x + width] = 255
    return mask


# --- pixels


def test_pixels_by_hand() -> None:
    score = PixelScore()
    score.add(7, FOUND, LABELS)
    total = score.total()
    counts = total.true_positives, total.false_positives, total.false_negatives, total.true_negatives
    assert counts == (1, 2, 1, 2)
    assert total.precision == 1 / 3
    assert total.recall == total.specificity == 1 / 2
    assert total.f_measure == pytest.approx(2 / (3 + 2))
    assert total.wrong_percent == pytest.approx(50)


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


def test_masks_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 5\)"):
        PixelScore().add(1, np.zeros((3, 3), np.uint8), LABELS)
    with pytest.raises(ValueError, match=r"\(2, 5\)"):
        mask_error_classes(np.zeros((3, 3), np.uint8), LABELS)


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


def test_boxes_are_clipped_to_the_picture() -> None:
    truth = truth_of([[1, 1, -20, 50, 30, 80, Kind.PEDESTRIAN], [1, 2, 400, 50, 30, 80, Kind.PEDESTRIAN]])
    assert error_classes(picture((0, 50, 10, 80)), truth) == ErrorClasses(objects=1)


def test_empty_truth_makes_everything_a_ghost() -> None:
    assert error_classes(picture((10, 10, 20, 20), (50, 50, 20, 20)), truth_of([])) == ErrorClasses(ghosts=2)


def test_error_classes_add_up() -> None:
    one = ErrorClasses(1, 2, 3, 4, 5, 6)
    assert one + one == ErrorClasses(2, 4, 6, 8, 10, 12)
    assert one.errors == 10


def test_error_classes_of_masks() -> None:
    labels = picture((10, 10, 20, 20), (100, 100, 20, 20), (3, 190, 4, 4))
    labels[150:160, 200:220] = UNKNOWN
    found = picture((10, 10, 20, 9), (100, 100, 20, 10), (205, 150, 10, 10), (250, 20, 10, 10))
    expected = ErrorClasses(missed_objects=1, ghosts=1, missed_by_pixels=1, objects=2)
    assert mask_error_classes(found, labels) == expected


# --- tracks


def scene(rng: np.random.Generator, n_frames: int, n_objects: int) -> tuple[BoxTruth, NDArray[np.float64]]:
    """Objects that cross each other, and tracks of them with noise, gaps, exchanged names and false ones."""
    rows: list[list[float]] = []
    tracks: list[list[float]] = []
    start, speed = rng.uniform(0, 60, (n_objects, 2)), rng.normal(0, 3, (n_objects, 2))
    name = np.arange(n_objects)
    for number in range(1, n_frames + 1):
        if rng.random() < 0.2:
            rng.shuffle(name)
        for index in range(n_objects):
            box = [*(start[index] + speed[index] * number), 20.0, 40.0]
            if rng.random() < 0.85:
                rows.append([number, index, *box, Kind.PEDESTRIAN])
            if rng.random() < 0.8:
                tracks.append([number, name[index], *(box + rng.normal(0, 2.5, 4))])
        if rng.random() < 0.3:
            tracks.append([number, 100 + number % 3, *rng.uniform(0, 60, 2), 20, 40])
    return truth_of(rows), np.array(tracks).reshape(-1, 6)


def by_motmetrics(
    truth: BoxTruth, tracks: NDArray[np.float64], frames: range, iou: float
) -> dict[str, float]:
    accumulator = motmetrics.MOTAccumulator()
    for number in frames:
        true, found = truth.at(number), tracks[tracks[:, 0] == number]
        found = found[np.argsort(found[:, 1])]
        distance = 1 - box_overlap(true.box, found[:, 2:])
        distance[distance > 1 - iou] = np.nan
        accumulator.update(true.identity, found[:, 1].astype(int), distance, frameid=number)
    names = ["mota", "motp", "idf1", "idp", "idr", "num_switches", "num_fragmentations", "num_misses"]
    names += ["num_false_positives", "mostly_tracked", "mostly_lost", "num_objects"]
    summary = motmetrics.metrics.create().compute(accumulator, metrics=names)
    return {name: float(summary[name].iloc[0]) for name in names}


def assert_equal(scores: TrackScores, expected: dict[str, float]) -> None:
    for name, value in (
        ("num_switches", scores.switches),
        ("num_fragmentations", scores.fragmentations),
        ("num_misses", scores.misses),
        ("num_false_positives", scores.false_positives),
        ("mostly_tracked", scores.mostly_tracked),
        ("mostly_lost", scores.mostly_lost),
        ("num_objects", scores.n_truth),
    ):
        assert value == expected[name], name
    # Ratios of the same whole numbers; only the sum of overlaps is taken in another order.
    for name in ("mota", "idf1", "idp", "idr"):
        assert getattr(scores, name) == pytest.approx(expected[name], rel=1e-15)
    assert 1 - scores.motp == pytest.approx(expected["motp"], rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("iou", [0.3, 0.5])
def test_tracks_equal_motmetrics(seed: int, iou: float) -> None:
    rng = np.random.default_rng(seed)
    truth, tracks = scene(rng, n_frames=25, n_objects=int(rng.integers(2, 9)))
    frames = range(1, 26)
    assert_equal(evaluate_tracks(truth, tracks, frames, iou), by_motmetrics(truth, tracks, frames, iou))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_names_and_order_of_tracks_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, tracks = scene(rng, n_frames=10, n_objects=4)
    renamed = rng.permutation(tracks)
    renamed[:, 1] = 1000 - renamed[:, 1]
    first = evaluate_tracks(truth, tracks, range(1, 11))
    second = evaluate_tracks(truth, renamed, range(1, 11))
    assert first == second


WALK = truth_of([[number, 1, 5.0 * number, 10, 20, 40, Kind.PEDESTRIAN] for number in range(1, 11)])


def rows_of(truth: BoxTruth, name: Callable[[int], int]) -> NDArray[np.float64]:
    names = [name(int(number)) for number in truth.frame]
    return np.column_stack([truth.frame, names, truth.box])


def test_perfect_tracks() -> None:
    scores = evaluate_tracks(WALK, rows_of(WALK, lambda _: 4), range(1, 11))
    assert (scores.mota, scores.motp, scores.idf1, scores.switches) == (1, 1, 1, 0)
    assert (scores.mostly_tracked, scores.mostly_lost, scores.n_truth, scores.n_frames) == (1, 0, 10, 10)


def test_a_change_of_name_is_one_switch_and_halves_identity() -> None:
    scores = evaluate_tracks(WALK, rows_of(WALK, lambda number: 4 if number <= 5 else 6), range(1, 11))
    assert scores.switches == 1
    assert scores.mota == pytest.approx(0.9)
    assert scores.idf1 == pytest.approx(0.5)


def test_a_gap_is_one_fragmentation() -> None:
    tracks = rows_of(WALK, lambda _: 4)
    scores = evaluate_tracks(WALK, tracks[[0, 1, 2, 5, 6, 7]], range(1, 11))
    assert (scores.fragmentations, scores.misses, scores.switches) == (1, 4, 0)


def test_ignored_boxes_neither_miss_nor_blame() -> None:
    rows = [[number, 2, 200, 10, 20, 40, Kind.IGNORED] for number in range(1, 11)]
    walk = [[number, 1, 5.0 * number, 10, 20, 40, Kind.PEDESTRIAN] for number in range(1, 11)]
    both = truth_of(rows + walk)
    perfect = evaluate_tracks(WALK, rows_of(WALK, lambda _: 4), range(1, 11))
    for tracks in (rows_of(WALK, lambda _: 4), np.column_stack([both.frame, both.identity, both.box])):
        assert evaluate_tracks(both, tracks, range(1, 11)) == perfect


def test_only_common_frames_are_compared() -> None:
    assert evaluate_tracks(WALK, rows_of(WALK, lambda _: 4), range(3, 6)).n_truth == 3


def test_no_tracks_at_all() -> None:
    scores = evaluate_tracks(WALK, np.zeros((0, 6)), range(1, 11))
    assert (scores.mota, scores.idf1, scores.misses, scores.mostly_lost) == (0, 0, 10, 1)
    assert math.isnan(scores.motp)


def test_malformed_tracks_are_refused() -> None:
    with pytest.raises(ValueError, match=r"got \(3, 5\)"):
        evaluate_tracks(WALK, np.zeros((3, 5)), range(1, 11))
    with pytest.raises(ValueError, match="identity 4 occurs twice in frame 1"):
        evaluate_tracks(WALK, np.repeat(rows_of(WALK, lambda _: 4), 2, axis=0), range(1, 11))
