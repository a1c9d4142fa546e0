"""Observations made as lists are those of a table."""

import numpy as np
from rsmcm.apps.experiments.scale.of_points import LENGTH, PIECE, PIECES, broken_tracks, turning
from rsmcm.inference.sfm.factor_analysis.em import expectation_maximisation


def test_lists_without_a_table_are_observations_like_all_others() -> None:
    observations, start = turning(3000)
    assert observations.count == 3000
    assert (np.diff(observations.by_point.edges) == LENGTH).all()
    pairs = {(f, p) for p, f in zip(observations.by_point.own, observations.by_point.other, strict=True)}
    assert pairs == set(zip(observations.by_frame.own, observations.by_frame.other, strict=True))
    assert (np.diff(observations.by_frame.own) >= 0).all()
    found, history = expectation_maximisation(observations, start, iterations=200, tolerance=1e-9)
    assert (np.diff(history) > -1e-6 * np.abs(history[:-1])).all()
    assert np.sqrt(found.noise) < 0.02  # the noise is 0.01


def test_broken_tracks_are_pieces_of_points() -> None:
    positions = broken_tracks(80)
    seen = ~np.isnan(positions).any(axis=2)
    assert positions.shape == (PIECES * PIECE, 80, 2)
    assert (seen.sum(axis=0) >= 1).all()
    assert (seen.sum(axis=0) < PIECE).all()
    of_point = seen.reshape(len(seen), PIECES, 20)
    assert (of_point.sum(axis=1) <= 1).all()  # one track of a point at a time
    assert (np.abs(np.diff(seen.astype(int), axis=0)).sum(axis=0) <= 2).all()  # in one stretch
