"""Errors and counts of reconstructions whose faults are known."""

import numpy as np
import pytest
from rsmcm.apps.evaluation.structure import score_structure
from rsmcm.apps.scenes import cylinder


def test_the_truth_itself_is_without_error() -> None:
    truth = cylinder(seed=3)
    scores = score_structure(truth.positions, truth.shape, truth.point_of_track, truth)
    assert scores.reprojection_error == 0
    assert scores.shape_error < 1e-12
    assert (scores.n_points, scores.n_spurious, scores.n_missing, scores.n_rejected) == (40, 0, 0, 0)
    assert scores.purity == 1


def test_errors_have_their_size() -> None:
    truth = cylinder(n_points=2000, n_frames=20, seed=3)
    generator = np.random.default_rng(0)
    positions = truth.positions + generator.normal(0, 0.02, truth.positions.shape)
    shape = truth.shape + generator.normal(0, 0.02, truth.shape.shape)
    scores = score_structure(positions, shape, truth.point_of_track, truth)
    # 80,000 and 6,000 normal values; the affine map takes up 12 of these, and shrinks the noisy shape a bit
    assert scores.reprojection_error == pytest.approx(0.02 * np.sqrt(2), rel=0.02)
    assert scores.shape_error == pytest.approx(0.02 * np.sqrt(3), rel=0.05)


def test_points_that_were_mixed_up_missed_and_made_up() -> None:
    truth = cylinder(n_points=6, p_loose=0.2, seed=4)
    points = truth.point_of_track.copy()
    lengths = (~np.isnan(truth.tracks()[:, :, 0])).sum(axis=0)
    # the shortest track of point 1 goes to point 0; point 5 is rejected as a whole
    wrong = min(np.flatnonzero(points == 1), key=lambda track: lengths[track])
    points[wrong] = 0
    points[truth.point_of_track == 5] = -1
    positions = np.concatenate([truth.positions[:, :5], np.full((60, 1, 2), 99.0)], axis=1)
    scores = score_structure(positions, None, points, truth)
    assert scores.purity == pytest.approx(4 / 6), "0 is mixed; what nothing was assigned to is not pure"
    assert scores.reprojection_error == 0, "it still stands for what most of its observations are"
    assert (scores.n_points, scores.n_spurious, scores.n_missing) == (6, 1, 1)
    assert scores.n_rejected == np.count_nonzero(truth.point_of_track == 5)
    assert np.isnan(scores.shape_error)


def test_nothing_found() -> None:
    truth = cylinder(seed=1)
    scores = score_structure(
        np.zeros((60, 0, 2)), np.zeros((0, 3)), np.full(len(truth.point_of_track), -1), truth
    )
    assert np.isnan([scores.reprojection_error, scores.shape_error, scores.purity]).all()
    assert (scores.n_points, scores.n_missing) == (0, 40)
