"""What tracks show of depth: against cameras and scenes that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.inference.sfm.depth import far_pairs, motion_of, stands_still, variance_over_shape

from ...support.fruitless import tracks_in_depth, tracks_on_wall, wall

KINDS = {"still": "still", "zoom": "similarity", "rotation": "rotation", "plane": "plane"}


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_motion(kind: str) -> None:
    tracks = tracks_on_wall(kind)
    assert motion_of(tracks).kind == KINDS[kind]
    tracks[:, ::7] += np.random.default_rng(0).normal(0, 20, tracks[:, ::7].shape)  # some are wrong
    assert motion_of(tracks).kind == KINDS[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_a_wall_has_no_parallax(kind: str) -> None:
    """Homographies leave the noise of two pictures, less what lies in the tails of the points left out."""
    on_wall, deep = motion_of(tracks_on_wall(kind, n_points=300)), motion_of(tracks_in_depth())
    assert 0.25 < on_wall.parallax < 0.4
    assert deep.parallax > 2
    assert motion_of(tracks_on_wall(kind, noise=0.0)).parallax < 1e-6


def test_figures_of_tracks() -> None:
    tracks = np.full((6, 3, 2), np.nan)
    tracks[:, 0] = np.arange(6)[:, None] * (3, 4)
    tracks[2:4, 1] = (7, 7)
    motion = motion_of(tracks)
    assert (motion.tracks, motion.life, motion.per_frame) == (2, 4, 5)
    assert motion.kind == "unknown"
    assert np.isnan(motion.parallax)
    nothing = motion_of(np.full((3, 0, 2), np.nan))
    assert (nothing.tracks, nothing.life) == (0, 0)
    assert np.isnan(nothing.per_frame)


@settings(max_examples=20)
@given(st.integers(2, 20), st.integers(1, 30), st.integers(0, 100))
def test_pairs_share_tracks(n_frames: int, n_tracks: int, seed: int) -> None:
    seen = np.random.default_rng(seed).random((n_frames, n_tracks)) < 0.8
    for one, other in far_pairs(seen):
        assert 0 <= one < other < n_frames
        assert np.count_nonzero(seen[one] & seen[other]) >= 8


def test_a_shape_that_is_no_better_than_homographies() -> None:
    wall, deep = tracks_on_wall("rotation"), tracks_in_depth()
    noise = 0.2 * np.random.default_rng(1).standard_normal(wall.shape)
    assert variance_over_shape(wall, 5 * noise) == pytest.approx(1 / 25, rel=0.4)
    assert variance_over_shape(wall, noise, 1.0) == pytest.approx(1, rel=0.4)
    assert variance_over_shape(deep, 5 * noise) > 3
    assert np.isnan(variance_over_shape(wall[:, :5], noise[:, :5]))


def test_a_camera_that_stands() -> None:
    """In spite of noise, and of somebody who walks by; one picture from elsewhere is motion."""
    scene = wall()[100:340, 100:420]
    for seed in range(4):
        random = np.random.default_rng(seed)
        film = [np.clip(scene + random.normal(0, 3, scene.shape), 0, 255).astype(np.uint8) for _ in range(8)]
        for number, picture in enumerate(film):
            picture[60:220, 30 * number : 30 * number + 60] = 255 - scene[60:220, :60]
        assert stands_still(film)
        column = int(random.integers(3, 40))
        elsewhere = wall()[100:340, 100 + column : 420 + column]
        place = int(random.integers(8))
        assert not stands_still([*film[:place], elsewhere, *film[place + 1 :]])
    assert not stands_still([np.full((240, 320), 90, np.uint8)] * 8), "nothing is seen"
