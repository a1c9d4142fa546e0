"""Where new points may begin: corners, apart from each other, from those that there are and from the edge."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.points.patches import BORDER, find_corners
from scipy.spatial.distance import cdist, pdist

Grey = NDArray[np.uint8]

NOBODY = np.zeros((0, 2))


def chequers(size: int = 20, height: int = 120, width: int = 160) -> Grey:
    rows, columns = np.indices((height, width))
    return np.where((rows // size + columns // size) % 2, 200, 50).astype(np.uint8)


def texture(seed: int) -> Grey:
    noise = np.random.default_rng(seed).normal(size=(120, 160))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128 + 40 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def test_corners_of_a_chequerboard() -> None:
    grey = chequers()
    corners = find_corners(grey, 1000, NOBODY, 8, 5)
    crossings = np.array([[x - 0.5, y - 0.5] for y in range(20, 120, 20) for x in range(20, 160, 20)])
    assert len(corners) == len(crossings)
    # the moments over 5x5 pixels are equal, but for rounding, up to two pixels about a crossing
    assert cdist(corners, crossings).min(axis=1).max() < 2.5


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(3, 30), st.integers(0, 12), st.integers(1, 60))
def test_corners_keep_their_distance(seed: int, spacing: int, n_taken: int, most: int) -> None:
    grey = texture(seed)
    taken = np.random.default_rng(seed).uniform([-20, -20], [180, 140], (n_taken, 2))
    corners = find_corners(grey, most, taken, spacing, 5)
    assert len(corners) <= most
    if len(corners) > 1:
        assert pdist(corners).min() >= spacing
    if len(corners) and n_taken:
        assert cdist(corners, taken).min() >= spacing - np.sqrt(0.5)  # these count as whole pixels
    assert (corners >= BORDER).all()
    assert (corners <= np.array([159, 119]) - BORDER).all()


@pytest.mark.parametrize(
    "grey",
    [
        np.full((60, 80), 90, np.uint8),
        np.tile(np.arange(80, dtype=np.uint8) * 3, (60, 1)),  # a slope
        np.tile(np.where(np.arange(80) < 37, 20, 220).astype(np.uint8), (60, 1)),  # an edge
    ],
    ids=["flat", "slope", "edge"],
)
def test_where_nothing_fixes_a_place_there_is_no_corner(grey: Grey) -> None:
    assert find_corners(grey, 100, NOBODY, 8, 5).shape == (0, 2)
