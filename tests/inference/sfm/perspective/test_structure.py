"""Perspective structures of films whose truth is known, and the choice of the camera."""

import numpy as np
import pytest
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise
from rsmcm.inference.sfm.perspective.structure import (
    Lens,
    PerspectiveStructure,
    affine_fit,
    perspective_structure,
    tied_frames,
)
from rsmcm.models.numerics.rotations import logarithm
from scipy.spatial.transform import Rotation

from ....support.perspective_films import PerspectiveFilm, turning


def structure_of(film: PerspectiveFilm, focal: float | None = None) -> tuple[PerspectiveStructure, bool]:
    """The structure, and whether it explains the film better than affine cameras."""
    fit = factorise(film.tracks, film.weights, coherence=True)
    affine = affine_fit(film.tracks, film.weights, fit.cameras, fit.shape)
    found = perspective_structure(film.tracks, film.weights, affine, Lens(film.size, focal))
    assert found is not None
    return found, found.better_than(affine)


def shape_error(found: PerspectiveStructure, film: PerspectiveFilm) -> float:
    """Median distance of points after the best similarity, in spreads of the true shape."""
    near = np.arange(len(found.shape))
    for _ in range(5):  # badly known points must not move all others
        one, other = (each - each[near].mean(axis=0) for each in (found.shape, film.shape))
        turn, _ = Rotation.align_vectors(other[near], one[near])
        size = np.sum(turn.apply(one[near]) * other[near]) / np.sum(one[near] ** 2)
        distances = np.linalg.norm(size * turn.apply(one) - other, axis=1)
        near = np.flatnonzero(distances <= 2 * np.median(distances))
    return float(np.median(distances) / other.std())


def steps(found: PerspectiveStructure) -> np.ndarray:
    turns = found.cameras.rotations
    return np.degrees(np.linalg.norm(logarithm(turns[1:] @ turns[:-1].transpose(0, 2, 1)), axis=1))


def test_turntable() -> None:
    film = turning(0, outliers=0.05)
    found, better = structure_of(film)
    assert better
    assert abs(found.cameras.focal - film.cameras.focal) < 4 * found.focal_deviation
    assert found.focal_deviation < 0.02 * film.cameras.focal
    assert np.median(steps(found)) == pytest.approx(10, abs=0.1)
    assert np.all((steps(found) > 9) & (steps(found) < 11))
    assert shape_error(found, film) < 0.02


def test_from_far_away_the_focal_length_is_said_to_be_unknown() -> None:
    film = turning(1, widths=1000.0, distance=3000.0)
    found, better = structure_of(film)
    assert not better
    assert not found.focal_determined
    assert np.isinf(found.focal_deviation)
    assert abs(found.cameras.curvature) < 4 * found.curvature_deviation


def test_a_given_focal_length_is_kept() -> None:
    film = turning(1)
    found, better = structure_of(film, focal=film.cameras.focal)
    assert better
    assert found.cameras.focal == pytest.approx(film.cameras.focal)
    assert found.focal_deviation == 0


def test_frames_without_points_lie_between_others() -> None:
    film = turning(1, n_frames=18, missing=0.3)
    tracks = film.tracks.copy()
    tracks[7:9] = np.nan
    tracks = tracks[:, np.count_nonzero(~np.isnan(tracks[..., 0]), axis=0) >= 2]
    found, _ = structure_of(PerspectiveFilm(film.cameras, film.shape, tracks, film.size))
    assert found.frame_determined.tolist() == [t not in (7, 8) for t in range(18)]
    assert np.all((steps(found) > 9) & (steps(found) < 11))
    spread = np.median(np.trace(found.covariances, axis1=2, axis2=3), axis=1)
    assert np.all(spread[7:9] > 10 * np.median(spread[found.frame_determined]))


def test_frames_are_tied_by_points_of_three_views() -> None:
    """Two sets of frames: many points of two views alone, or a few of three, do not tie one to the other."""
    agreeing = np.zeros((8, 60), bool)
    agreeing[:5, :30] = True
    agreeing[5:, 30:50] = True
    agreeing[4:6, 50:] = True
    agreeing[4, 30:35] = True
    np.testing.assert_array_equal(tied_frames(agreeing), [True] * 5 + [False] * 3)
    agreeing[4, 30:36] = True
    assert tied_frames(agreeing).all()
    few = np.ones((4, 5), bool)
    assert tied_frames(few).all()
    few[3, 4:] = False
    np.testing.assert_array_equal(tied_frames(few), [True, True, True, False])
