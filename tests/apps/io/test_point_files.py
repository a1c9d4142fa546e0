"""Files of points: what is read, and what is refused in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.io.point_files import frames_of_tracks, read_points, read_track_file
from rsmcm.apps.io.sources.open_source import Selection

POINTS = np.arange(60, dtype=np.float64).reshape(5, 6, 2)
POINTS[1, 2] = POINTS[:, 4] = np.nan


def archive(folder: Path, **arrays: Any) -> Path:
    path = folder / "points.npz"
    np.savez(path, **arrays)
    return path


def single(folder: Path, array: Any) -> Path:
    path = folder / "points.npy"
    np.save(path, array)
    return path


def changed(index: Any, value: float) -> np.ndarray[Any, Any]:
    points = POINTS.copy()
    points[index] = value
    return points


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16, np.int32, np.uint8, ">f8"])
@pytest.mark.parametrize("shape", [(5, 6, 2), (1, 30, 2), (30, 2)])
def test_any_real_type_in_any_of_the_files(kind: Any, shape: tuple[int, ...], tmp_path: Path) -> None:
    whole = np.nan_to_num(POINTS).astype(kind).reshape(shape)
    for path in (
        single(tmp_path, whole),
        archive(tmp_path, some=whole),
        archive(tmp_path, tracks=whole, other=[1]),
        single(tmp_path, np.asfortranarray(whole)),
    ):
        points = read_points(path)
        assert points.dtype == np.float64
        np.testing.assert_array_equal(points, whole.reshape(-1, *shape[-2:]))


def test_missing_points_stay_missing(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read_points(single(tmp_path, POINTS)), POINTS)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((5, 6, 3)), "(5, 6, 3) float64, expected (n_frames, n_points, 2) px"),
        (np.zeros(6), "(6,) float64"),
        (np.zeros((1, 0, 2)), "(1, 0, 2)"),
        (POINTS.astype(complex), "(5, 6, 2) complex128"),
        (POINTS.astype(str), "(5, 6, 2) <U"),
        (POINTS > 3, "(5, 6, 2) bool"),
        (np.array([None]), "of objects"),
        (
            changed((3, 0, 1), np.inf),
            "got [36.0, inf] at point 0 of frame 3 (both from 0), expected finite",
        ),
        (changed((3, 0, 1), 1e300), "1e+300] at point 0 of frame 3 (both from 0), expected finite px up to"),
        (changed((0, 5, 0), np.nan), "got [nan, 11.0] at point 5 of frame 0 (both from 0), expected both"),
    ],
)
def test_what_is_refused(array: Any, words: str, tmp_path: Path) -> None:
    for path in (single(tmp_path, array), archive(tmp_path, tracks=array)):
        with pytest.raises(ValueError, match=rf"^{path}: got [^\n]*$") as raised:
            read_points(path)
        assert words in str(raised.value)


VISIBLE = ~np.isnan(POINTS[:, :, 0])
TRACKED = np.where(np.isnan(POINTS), 7.0, POINTS)  # point trackers guess where they see nothing
SIZE = np.array([200.0, 100.0])  # width, height
SHARES = (TRACKED.swapaxes(0, 1) + 0.5) / SIZE
VIDEO = np.zeros((5, 100, 200, 3), np.uint8)


@pytest.mark.parametrize(
    "arrays",
    [
        {"tracks": TRACKED, "visibility": VISIBLE},
        {"pred_tracks": TRACKED[None].astype(np.float32), "pred_visibility": VISIBLE[None]},
        {"tracks": TRACKED[None], "visibility": np.where(VISIBLE, 0.9, 0.2)[None, :, :, None]},
        {"tracks": np.where(VISIBLE[..., None], POINTS, np.inf), "visibility": VISIBLE.astype(np.uint8)},
        {"points": SHARES, "occluded": ~VISIBLE.T, "video": VIDEO},
        {"points": SHARES[None], "occluded": ~VISIBLE.T[None], "video": VIDEO[None]},
    ],
)
def test_point_trackers_say_where_points_are_and_which_they_see(
    arrays: dict[str, Any], tmp_path: Path
) -> None:
    np.testing.assert_allclose(read_points(archive(tmp_path, **arrays)), POINTS, atol=1e-12)
    np.testing.assert_array_equal(read_points(single(tmp_path, TRACKED[None])), TRACKED)


def test_a_point_at_the_edges_is_half_a_pixel_beyond_the_middles(tmp_path: Path) -> None:
    shares = np.array([[[0.0, 0.0]], [[1.0, 1.0]], [[0.5 / 200, 0.5 / 100]]])
    path = archive(tmp_path, points=shares, occluded=np.zeros((3, 1), bool), video=VIDEO[:1])
    np.testing.assert_allclose(read_points(path)[0], [[-0.5, -0.5], [199.5, 99.5], [0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (
            {"tracks": TRACKED, "visibility": VISIBLE.T},
            "got visibility (6, 5) bool, expected (5, 6)",
        ),
        (
            {"tracks": np.stack([TRACKED] * 2), "visibility": VISIBLE},
            "got tracks (2, 5, 6, 2) float64",
        ),
        ({"tracks": TRACKED, "visibility": VISIBLE.astype(str)}, "got visibility (5, 6) <U5"),
        (
            {"points": SHARES, "occluded": ~VISIBLE.T},
            "got points from 0 to 1 without 'video'",
        ),
        ({"points": 100 * SHARES, "occluded": ~VISIBLE.T, "video": VIDEO}, "got points beyond 0 to 1"),
        ({"points": SHARES, "occluded": ~VISIBLE.T, "video": VIDEO[:3]}, "got video (3, 100, 200, 3) uint8"),
        (
            {"points": SHARES, "occluded": ~VISIBLE, "video": VIDEO},
            "got occluded (5, 6) bool, expected",
        ),
        ({"points": SHARES, "occluded": ~VISIBLE.T, "video": np.array([None])}, "of objects"),
    ],
)
def test_what_no_point_tracker_writes_is_refused(arrays: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = archive(tmp_path, **arrays)
    with pytest.raises(ValueError, match=rf"^{path}: got [^\n]*$") as raised:
        read_points(path)
    assert words in str(raised.value)


def test_selected_frames_as_frames(tmp_path: Path) -> None:
    tracks, numbers = read_track_file(archive(tmp_path, tracks=POINTS), Selection(2, 5, 3))
    np.testing.assert_array_equal(tracks, POINTS[[1, 4]])
    first, last = frames_of_tracks(tracks, numbers)
    assert (first.number, last.number) == (2, 5)
    assert (first.time, last.time) == (1 / 25, 4 / 25)
    assert first.points is not None
    assert last.points is not None
    assert first.points.identities.tolist() == [0, 1, 3, 5]
    assert last.points.identities.tolist() == [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(first.points.positions, POINTS[1, [0, 1, 3, 5]])


def test_a_selection_beyond_the_end(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"start: got 6, but .*points\.npz has only 5 frames"):
        read_track_file(archive(tmp_path, tracks=POINTS), Selection(6))
