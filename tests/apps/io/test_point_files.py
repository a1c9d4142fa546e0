"""Files of points: what is read, and what is refused in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.io.point_files import read_points

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
        (changed((3, 0), -np.inf), "got [-inf, -inf] at point 0 of frame 3"),
        (changed((3, 0, 1), 1e300), "1e+300] at point 0 of frame 3 (both from 0), expected finite px up to"),
        (changed((0, 5, 0), np.nan), "got [nan, 11.0] at point 5 of frame 0 (both from 0), expected both"),
    ],
)
def test_what_is_refused(array: Any, words: str, tmp_path: Path) -> None:
    for path in (single(tmp_path, array), archive(tmp_path, tracks=array)):
        with pytest.raises(ValueError, match=rf"^{path}: got [^\n]*$") as raised:
            read_points(path)
        assert words in str(raised.value)


def test_archives_without_one(tmp_path: Path) -> None:
    for arrays, words in (
        ({}, "got arrays none, expected 'tracks' or a single one, (n_frames, n_points, 2) px"),
        ({"track": POINTS, "x": [1]}, "got arrays 'track', 'x', expected 'tracks'"),
    ):
        path = archive(tmp_path, **arrays)
        with pytest.raises(ValueError, match=rf"^{path}: ") as raised:
            read_points(path)
        assert words in str(raised.value)
