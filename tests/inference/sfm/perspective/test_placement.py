"""Which cameras are known: placements that are right, wrong, and as good as others."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.inference.sfm.perspective.bundle_adjustment import Bundle, StudentNoise
from rsmcm.inference.sfm.perspective.placement import TURN, WIDE, known_frames
from rsmcm.models.camera.perspective_camera import PerspectiveCameras
from scipy.spatial.transform import Rotation

from ....support.perspective_films import PerspectiveFilm, turning

NOISE = 0.3  # px
SEEDS = range(4)


def known(
    film: PerspectiveFilm,
    cameras: PerspectiveCameras,
    shape: np.ndarray,
    deviation: float = NOISE,
    within: float = TURN,
) -> np.ndarray:
    noise = StudentNoise(deviation**2, 10.0)
    off = np.sum((film.tracks - cameras.seen(shape)[0]) ** 2, axis=2)
    seen = np.isfinite(off)
    agreeing = seen & noise.agrees(np.where(seen, off, 0), film.weights)
    return known_frames(film.tracks, seen, agreeing, Bundle(cameras, shape, noise, 0.0), within)


@pytest.mark.parametrize("seed", SEEDS)
def test_true_cameras_are_known_and_turned_ones_are_not(seed: int) -> None:
    film = turning(seed, n_frames=18, n_points=250, outliers=0.1, noise=NOISE)
    assert known(film, film.cameras, film.shape).all()
    turns = np.tile(np.eye(3), (18, 1, 1))
    turns[[4, 11]] = Rotation.from_euler("y", 4, degrees=True).as_matrix()
    turned = replace(film.cameras, rotations=turns @ film.cameras.rotations)
    assert np.flatnonzero(~known(film, turned, film.shape)).tolist() == [4, 11]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_piece_that_hangs_on_one_camera_is_unknown(seed: int) -> None:
    """Two sets of points, which only frame 8 shows both of: the second may turn about that camera."""
    film = turning(seed, n_frames=16, missing=0.2, noise=NOISE)
    tracks, first = film.tracks.copy(), np.arange(film.tracks.shape[1]) < 70
    tracks[9:, first] = tracks[:8, ~first] = np.nan
    hanging = replace(film, tracks=tracks)
    np.testing.assert_array_equal(known(hanging, film.cameras, film.shape), np.arange(16) < 9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_of_few_points_is_known_as_far_as_their_noise_allows(seed: int) -> None:
    """Fifteen points place a camera within 2 degrees, and not with eight times the noise."""
    film = turning(seed, n_frames=10, missing=0.0, noise=NOISE)
    tracks = film.tracks.copy()
    rng = np.random.default_rng(seed)
    seen = rng.permutation(np.flatnonzero(np.isfinite(tracks[9, :, 0])))
    tracks[9, seen[15:]] = np.nan
    assert known(replace(film, tracks=tracks), film.cameras, film.shape)[9]
    tracks[9, seen[:15]] += rng.normal(0, 8 * NOISE, (15, 2))
    assert not known(replace(film, tracks=tracks), film.cameras, film.shape)[9]


def test_too_few_points_place_no_camera() -> None:
    film = turning(0, n_frames=6, n_points=11, missing=0.0)
    assert not known(film, film.cameras, film.shape).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_no_camera_is_known_where_sides_look_alike(seed: int) -> None:
    """Eight points of a frame are seen as by a camera that is a third of a turn farther, or anywhere."""
    film = turning(seed, n_frames=36, n_points=250, noise=NOISE)
    places, _ = film.cameras.seen(film.shape)
    shown = np.flatnonzero(np.isfinite(film.tracks[:, :, 0])[20])[:8]
    alike, wrong = film.tracks.copy(), film.tracks.copy()
    alike[20, shown] = places[8, shown]
    wrong[20, shown] = np.random.default_rng(seed).permutation(places[8, shown])
    assert not known(replace(film, tracks=alike), film.cameras, film.shape).any()
    assert known(replace(film, tracks=wrong), film.cameras, film.shape).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_what_lies_anywhere_makes_no_sides_alike(seed: int) -> None:
    """A quarter of the places are anywhere: of many, some agree with some camera where noise is large."""
    film = turning(seed, n_frames=16, n_points=120, missing=0.0, noise=NOISE)
    tracks, rng = film.tracks.copy(), np.random.default_rng(seed)
    anywhere = np.isfinite(tracks[:, :, 0]) & (rng.random(tracks.shape[:2]) < 0.25)
    ends = np.nanmin(tracks, axis=(0, 1)), np.nanmax(tracks, axis=(0, 1))
    tracks[anywhere] = rng.uniform(*ends, (np.count_nonzero(anywhere), 2))
    scattered = replace(film, tracks=tracks)
    assert known(scattered, film.cameras, film.shape, deviation=20 * NOISE, within=WIDE).all()
