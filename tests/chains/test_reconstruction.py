"""A film's structure in one call: from tracks or frames, before affine and perspective cameras."""

import numpy as np
import pytest
from rsmcm.apps.evaluation.structure import score_structure
from rsmcm.apps.scenes import cylinder
from rsmcm.chains import reconstruct
from rsmcm.chains.reconstruction import UNKNOWN_CAMERAS, lens_of
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise, predicted
from rsmcm.inference.sfm.perspective.structure import Lens
from rsmcm.models import Frame, frames_of_tracks
from rsmcm.models.numerics.rotations import logarithm

from ..support.perspective_films import turning

PX = 100.0


def test_tracks_of_a_cylinder_become_its_points() -> None:
    truth = cylinder(n_frames=30, p_loose=0.1, p_drift=0.0, seed=0)
    rounds: list[None] = []
    found = reconstruct(PX * truth.tracks(), camera="affine", after_round=lambda: rounds.append(None))
    assert found.geometry == "euclidean"
    assert len(rounds) == len(found.objective)
    scores = score_structure(found.positions / PX, found.shape, found.point_of_track, truth)
    assert scores.n_missing == 0
    assert scores.shape_error < 0.02


def test_tracked_positions_are_explained_or_dropped() -> None:
    truth = cylinder(n_points=20, n_frames=15, p_loose=0.02, p_drift=0.0, seed=3)
    tracks = 100 * truth.tracks()
    wrong = tracks.copy()
    wrong[4, :3] += 40.0
    for given, n_wrong in ((tracks, 0), (wrong, np.count_nonzero(~np.isnan(wrong[4, :3, 0])))):
        found = reconstruct(given)
        assert found.dropped is not None
        point, seen = found.point_of_track, ~np.isnan(given[..., 0])
        explained = found.observed[:, point] & (point >= 0)
        np.testing.assert_array_equal(found.dropped, np.count_nonzero(seen & ~explained, axis=1))
        assert found.dropped[4] >= n_wrong
        assert found.dropped.sum() < n_wrong + 0.05 * seen.sum()


def test_frames_with_points_are_as_good_as_tracks() -> None:
    tracks = PX * cylinder(n_frames=12, n_points=15, p_loose=0.0, p_drift=0.0, seed=1).tracks()
    of_tracks = reconstruct(tracks, association="none", camera="affine")
    of_frames = reconstruct(frames_of_tracks(tracks), association="none", camera="affine")
    np.testing.assert_array_equal(of_frames.shape, of_tracks.shape)


def test_without_outliers_it_is_least_squares() -> None:
    """As `factorise` has it; one wrong position then spoils the fit, which it else does not."""
    truth = cylinder(n_frames=12, n_points=15, p_loose=0.0, p_drift=0.0, seed=1)
    tracks = PX * truth.tracks()
    tracks[5, 3] += 30.0
    plain, robust = (
        reconstruct(tracks, association="none", camera="affine", coherence="none", robust=each)
        for each in ("none", "outliers")
    )
    expected, _ = predicted(factorise(tracks))
    np.testing.assert_allclose(plain.positions, expected, atol=1e-3)
    assert plain.dropped is not None
    assert not plain.dropped.any()
    exact = PX * truth.positions[:, truth.point_of_track]
    assert np.abs(plain.positions - exact).max() > 2 * np.abs(robust.positions - exact).max()


def test_a_near_thing_has_a_perspective_camera() -> None:
    film = turning(0, n_points=50, n_frames=24)
    found = reconstruct(film.tracks, association="none", lens=Lens(film.size))
    assert found.perspective is not None
    assert found.perspective.cameras.focal == pytest.approx(film.cameras.focal, rel=0.1)


@pytest.mark.parametrize("seed", range(2))
def test_what_hangs_on_one_camera_bends_nothing(seed: int) -> None:
    """Of two pieces that share only one camera, the larger one's cameras are known, and right."""
    film = turning(seed, n_frames=18, n_points=160, missing=0.2)
    tracks, first = film.tracks.copy(), np.arange(film.tracks.shape[1]) % 2 == 0
    tracks[11:, first] = tracks[:10, ~first] = np.nan
    found = reconstruct(tracks, association="none", camera="perspective", lens=Lens(film.size)).perspective
    assert found is not None
    assert np.count_nonzero(found.frame_determined[:11]) >= 9
    assert not found.frame_determined[11:].any()
    known = np.flatnonzero(found.frame_determined)
    off = film.cameras.rotations[known].transpose(0, 2, 1) @ found.cameras.rotations[known]
    off = off @ off[0].T
    assert np.degrees(np.linalg.norm(logarithm(off), axis=1)).max() < 2
    assert abs(found.cameras.focal - film.cameras.focal) < 4 * found.focal_deviation


def test_sides_that_look_alike_are_no_structure() -> None:
    """Some points are seen as by a camera that is a third of a turn farther."""
    film = turning(0, n_points=160, missing=0.6, n_frames=24)
    places, _ = film.cameras.seen(film.shape)
    tracks = film.tracks.copy()
    seen = np.flatnonzero(np.isfinite(tracks[15, :, 0]))[:10]
    tracks[15, seen] = places[3, seen]
    found = reconstruct(tracks, association="none", camera="perspective", lens=Lens(film.size))
    assert (found.geometry, found.reason, found.perspective) == ("none", UNKNOWN_CAMERAS, None)


def test_pictures_without_points_are_no_structure() -> None:
    empty = Frame(np.full((40, 60), 128, np.uint8), 0.0, 1)
    with pytest.raises(ValueError, match="expected"):
        reconstruct([empty] * 3)


def test_the_picture_of_tracks_ends_where_they_do() -> None:
    frames = frames_of_tracks(np.array([[[10.0, 20.0], [90.0, 60.0]]]))
    assert lens_of(frames, 50.0) == Lens((61, 91), 50.0)
