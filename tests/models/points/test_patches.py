"""Sub-pixel alignment of patches in pictures of exact motion, and corners."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.points.patches import (
    BORDER,
    PlacePrior,
    align_patches,
    find_corners,
    match_light,
    ncc,
    sample_patches,
)
from scipy.spatial.distance import cdist, pdist

from ...support.pictures import HEIGHT, WIDTH, Pose, Texture, picture

Array = NDArray[np.float64]

SHIFT = np.array([2.37, -1.81])


def places(n: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(15, [WIDTH - 15, HEIGHT - 15], (n, 2))


def shifted(
    noise: float, gain: float = 1.0, offset: float = 0.0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The same plane before and after `SHIFT`, half as contrasty as usual so that nothing is cut off."""
    texture = Texture(3)
    before = picture(texture, Pose(np.eye(2), np.zeros(2)), noise, 1, 0.5)
    after = picture(texture, Pose(np.eye(2), SHIFT), noise, 2, 0.5 * gain, 128 + offset)
    return before, after


def test_samples_of_a_parabola_are_exact() -> None:
    rows, columns = np.mgrid[:40, :50].astype(np.float64)

    def parabola(x: Array, y: Array) -> Array:
        return 20 + 0.05 * x**2 - 0.03 * x * y + 0.04 * y**2

    grey = np.rint(parabola(columns, rows)).astype(np.uint8)
    where = np.array([[20.0, 15.0], [21.3, 17.8], [30.5, 22.5]])
    patches = sample_patches(grey, where, 5)
    assert patches.shape == (3, 5, 5)
    np.testing.assert_array_equal(patches[0], grey[13:18, 18:23])
    steps = np.arange(-2, 3)
    expected = parabola(where[:, 0, None, None] + steps, where[:, 1, None, None] + steps[:, None])
    np.testing.assert_allclose(patches, expected, atol=0.8)  # grey values are rounded


def test_beyond_the_edge_the_edge_goes_on() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (20, 30)).astype(np.uint8)
    corner = sample_patches(grey, np.array([[0.0, 0.0], [29.0, 19.0]]), 5)
    np.testing.assert_array_equal(corner[0], np.pad(grey, 2, mode="edge")[:5, :5])
    np.testing.assert_array_equal(corner[1], np.pad(grey, 2, mode="edge")[-5:, -5:])


@pytest.mark.parametrize(("noise", "error"), [(0.0, 0.05), (1.0, 0.15), (3.0, 0.4)])
def test_errors_are_small_and_as_large_as_stated(noise: float, error: float) -> None:
    before, after = shifted(noise)
    start = places(400)
    patches = sample_patches(before, start, 5)
    off = np.random.default_rng(1).uniform(-0.5, 0.5, start.shape)
    found = align_patches(after, patches, start + SHIFT + off, 1.0)
    clear = np.trace(found.covariance, axis1=1, axis2=2) < 2 * 0.5**2
    clear &= found.ncc > 0.8
    assert clear.mean() > 0.5
    errors = (found.position - start - SHIFT)[clear]
    assert np.sqrt((errors**2).mean()) < error
    squares = (errors * np.linalg.solve(found.covariance[clear], errors[:, :, None])[:, :, 0]).sum(axis=1)
    # a half and 95 % would be exact; with much noise, what is stated is a little too small
    assert (squares < 2 * np.log(2)).mean() > 0.33
    assert np.quantile(squares, 0.95) < 2.5 * -2 * np.log(0.05)


def test_what_has_no_texture_or_is_too_far_is_like_nothing() -> None:
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    before, after = shifted(0.0)
    start = places(20)
    patches = sample_patches(before, start, 5)
    for grey, some in ((flat, patches), (after, np.full_like(patches, 7.0))):
        found = align_patches(grey, some, start, 1.0)
        np.testing.assert_array_equal(found.ncc, -1)
        assert np.isfinite(found.covariance).all()
    far = align_patches(after, patches, start + SHIFT + 0.4, 0.1)
    assert (far.ncc == -1).mean() > 0.8


def test_ncc_is_the_correlation_and_light_makes_no_difference() -> None:
    random = np.random.default_rng(0)
    one, other = random.uniform(0, 255, (2, 8, 5, 5)).astype(np.float32)
    expected = [np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(one, other, strict=True)]
    np.testing.assert_allclose(ncc(one, other), expected, atol=1e-6)
    np.testing.assert_allclose(ncc(2 * one + 30, one), 1, atol=1e-6)
    assert ncc(one[:1], np.full((1, 5, 5), 3, np.float32)) == 0
    np.testing.assert_allclose(match_light(one, 0.5 * one + 20), 0.5 * one + 20, rtol=1e-5)


def test_what_is_expected_holds_a_patch_on_an_edge() -> None:
    """Along a straight edge the picture says next to nothing, across it nearly all."""
    random = np.random.default_rng(6)
    across = np.array([np.cos(0.4), np.sin(0.4)])
    y, x = np.mgrid[:60, :60].astype(float)
    edge = 128 + 60 * np.tanh((x - 30) * across[0] + (y - 30) * across[1])
    one, other = (
        np.clip(np.rint(edge + random.normal(0, 2, edge.shape)), 0, 255).astype(np.uint8) for _ in range(2)
    )
    along = np.array([-across[1], across[0]])
    places = np.array([30.0, 30.0]) + random.uniform(-12, 12, (200, 1)) * along
    patches, wrong = sample_patches(one, places, 5), 0.3 * across
    free = align_patches(other, patches, places + wrong, 2.0)
    expected = PlacePrior(places + wrong, np.tile(np.eye(2) / 0.3**2, (200, 1, 1)))
    held = align_patches(other, patches, places + wrong, 2.0, expected)
    errors = held.position - places
    # with a picture of error s an error of 0.09 s / (0.09 + s^2) stays, 0.15 at the most
    assert np.sqrt(np.square(errors @ along).mean()) < 0.15 * (1 + 4 / np.sqrt(400))
    assert (np.abs((free.position - places) @ along) > 0.5).mean() > 0.3
    assert np.sqrt(np.square(errors @ across).mean()) < 0.1
    # what is expected is no part of what the picture says
    assert np.median(along @ held.covariance @ along) > 0.3**2


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
