"""Track measures equal hand counts and an independent implementation."""

import math
from collections.abc import Callable

import motmetrics
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.evaluation.tracks import box_overlap, evaluate_tracks
from rsmcm.apps.io.ground_truth import BoxTruth, Kind, MaskTruth

from ...support.boxes import truth_of


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
    names = ["idf1", "idp", "idr", "num_objects"]  # its matches outlast gaps, unlike TrackEval's
    summary = motmetrics.metrics.create().compute(accumulator, metrics=names)
    return {name: float(summary[name].iloc[0]) for name in names}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("iou", [0.3, 0.5])
def test_identities_equal_motmetrics(seed: int, iou: float) -> None:
    rng = np.random.default_rng(seed)
    truth, tracks = scene(rng, n_frames=25, n_objects=int(rng.integers(2, 9)))
    scores = evaluate_tracks(tracks, truth, range(1, 26), iou)
    expected = by_motmetrics(truth, tracks, range(1, 26), iou)
    assert scores.n_truth == expected["num_objects"]
    # ratios of the same whole numbers
    for name in ("idf1", "idp", "idr"):
        assert getattr(scores, name) == pytest.approx(expected[name], rel=1e-15)


TRACKEVAL = [
    (0.22432683501351247, 0.41244735579237873, 0.12349521207541429),
    (0.35694594396986573, 0.48700550413194227, 0.26263651666086885),
    (0.24470339455743903, 0.44717971102244675, 0.13548475711963087),
    (0.31327583767544115, 0.4950553371085093, 0.20005978308058883),
    (0.2654421291058807, 0.46236072638177134, 0.15364505005360507),
    (0.2721019199396506, 0.444219167143533, 0.16825671573151232),
]
"""HOTA, DetA and AssA of `scene` by TrackEval 1.3.0, the authors' own program, for the first seeds."""


@pytest.mark.parametrize("seed", range(6))
def test_hota_equals_that_of_its_authors(seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    truth, tracks = scene(rng, n_frames=25, n_objects=int(rng.integers(2, 9)))
    scores = evaluate_tracks(tracks, truth)
    assert (scores.hota, scores.deta, scores.assa) == pytest.approx(TRACKEVAL[seed], rel=1e-12)


WALK = truth_of([[number, 1, 5.0 * number, 10, 20, 40, Kind.PEDESTRIAN] for number in range(1, 11)])


def rows_of(truth: BoxTruth, name: Callable[[int], int]) -> NDArray[np.float64]:
    names = [name(int(number)) for number in truth.frame]
    return np.column_stack([truth.frame, names, truth.box])


def test_ignored_boxes_neither_miss_nor_blame() -> None:
    rows = [[number, 2, 200, 10, 20, 40, Kind.IGNORED] for number in range(1, 11)]
    walk = [[number, 1, 5.0 * number, 10, 20, 40, Kind.PEDESTRIAN] for number in range(1, 11)]
    both = truth_of(rows + walk)
    perfect = evaluate_tracks(rows_of(WALK, lambda _: 4), WALK, range(1, 11))
    for tracks in (rows_of(WALK, lambda _: 4), np.column_stack([both.frame, both.identity, both.box])):
        assert evaluate_tracks(tracks, both, range(1, 11)) == perfect


def test_no_tracks_at_all() -> None:
    scores = evaluate_tracks(np.zeros((0, 6)), WALK, range(1, 11))
    assert (scores.mota, scores.idf1, scores.misses, scores.mostly_lost) == (0, 0, 10, 1)
    assert (scores.hota, scores.deta, scores.assa) == (0, 0, 0)
    assert math.isnan(scores.motp)


def test_malformed_tracks_are_refused() -> None:
    with pytest.raises(ValueError, match=r"got \(3, 5\)"):
        evaluate_tracks(np.zeros((3, 5)), WALK, range(1, 11))
    with pytest.raises(ValueError, match="identity 4 occurs twice in frame 1"):
        evaluate_tracks(np.repeat(rows_of(WALK, lambda _: 4), 2, axis=0), WALK, range(1, 11))


def test_masks_are_no_true_tracks() -> None:
    with pytest.raises(ValueError, match="got masks"):
        evaluate_tracks(np.zeros((0, 6)), MaskTruth({}, None))
