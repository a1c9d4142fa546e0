"""Search for patches against OpenCV's correlation, against known shifts, and back again."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.points.patches import find_corners, sample_patches
from rsmcm.models.points.search import (
    GRID,
    LEAST_NCC,
    REACH,
    UNLIKE,
    Candidates,
    PreviousView,
    Windows,
    find_candidates,
    find_points,
    is_found_back,
    least_ncc,
    odds_over_chance,
)

from ...support.pictures import HEIGHT, WIDTH, Pose, film

Grey = NDArray[np.uint8]
Array = NDArray[np.float64]

SHIFT = np.array([3.4, -1.7])


def noise_picture(seed: int, height: int, width: int) -> Grey:
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


def rounded(picture: Array) -> Grey:
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def before_and_after() -> list[Grey]:
    return film([Pose(np.eye(2), np.zeros(2)), Pose(np.eye(2), SHIFT)], noise=0.0)


def alike(deviation: float, n: int) -> Array:
    return np.tile(deviation**2 * np.eye(2), (n, 1, 1))


# --- correlation, pixel by pixel ---


def windows(mean: Array, covariance: Array, search_radius: float, *, prior: bool = True) -> Windows:
    return Windows(mean, covariance + GRID**2 * np.eye(2), prior, REACH, search_radius)


def likeliest(
    grey: Grey,
    patches: NDArray[np.float32],
    mean: Array,
    covariance: Array,
    search_radius: float,
    **prior: bool,
) -> Candidates:
    return find_candidates(
        grey, patches, windows(mean, covariance, search_radius, **prior), np.arange(len(patches))
    )


def opencv_peaks(image: Grey, patch: NDArray[np.float32], x: int, y: int, radius: int) -> Array:
    """Score, column and row `(n, 3)` of the peaks within `radius` px of a place, the best first."""
    half = len(patch) // 2
    scores = np.full(image.shape, -2.0)
    scores[half:-half, half:-half] = cv2.matchTemplate(image.astype(np.float32), patch, cv2.TM_CCOEFF_NORMED)
    peaks = (scores > 0) & (scores == cv2.dilate(scores, np.ones((3, 3), np.uint8)))
    peaks[[half, -half - 1]] = peaks[:, [half, -half - 1]] = False  # nothing tells whether it falls off there
    rows, columns = np.nonzero(peaks)
    near = (np.abs(columns - x) <= radius) & (np.abs(rows - y) <= radius)
    found = np.column_stack([scores[rows, columns], columns, rows])[near]
    return np.asarray(found[np.argsort(-found[:, 0])], np.float64)


@settings(max_examples=20)
@given(
    st.integers(0, 2**32),
    st.sampled_from([3, 5, 7]),
    st.tuples(st.integers(-3, 48), st.integers(-3, 38)),
    st.floats(0.3, 2.5),
)
def test_without_a_prior_the_best_two_places_are_opencvs(
    seed: int, side: int, middle: tuple[int, int], deviation: float
) -> None:
    """On noise, so that there are many peaks."""
    image = cv2.GaussianBlur(noise_picture(seed, 35, 45), (0, 0), 1.0)
    image = np.asarray(cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX), np.uint8)  # type: ignore[call-overload]
    patches = sample_patches(image, np.random.default_rng(seed).uniform(8, 26, (1, 2)), side)
    mean = np.array([middle], np.float64)
    found = likeliest(image, patches, mean, alike(deviation, 1), 9.0, prior=False)
    radius = min(int(np.ceil(3 * np.hypot(deviation, 0.5) + 0.5)), 9)
    peaks = opencv_peaks(image, patches[0], *middle, radius)
    if (np.abs(peaks[:, 0] - LEAST_NCC) < 1e-4).any() or (np.abs(np.diff(peaks[:, 0])) < 1e-4).any():
        return  # rounding decides
    peaks = peaks[peaks[:, 0] >= LEAST_NCC]
    assert (found.ncc[0] > 0).sum() == min(2, len(peaks))
    for place, score in zip(found.position[0], found.ncc[0], strict=True):
        if score > 0:  # which of them are the best two is decided by fractions of a pixel
            nearest = np.abs(peaks[:, 0] - score).argmin()
            assert score == pytest.approx(peaks[nearest, 0], abs=1e-4)
            np.testing.assert_allclose(place, peaks[nearest, 1:], atol=0.5)
    if len(peaks) and (np.diff(peaks[:3, 0]) < -0.25).all():
        np.testing.assert_allclose(found.ncc[0][: len(peaks)], peaks[:2, 0], atol=1e-4)


def test_where_nothing_can_be_there_is_nothing() -> None:
    image, flat = noise_picture(9, 40, 50), np.full((40, 50), 90, np.uint8)
    patches = np.repeat(sample_patches(image, np.array([[20.0, 20.0]]), 5), 5, axis=0)
    outside = np.array([[-30.0, 3.0], [90.0, 39.0], [1e9, -1e9], [3.0, 200.0], [20.0, -9.0]])
    inside = np.full((5, 2), 20.0)
    for grey, some, mean in (
        (image, patches, outside),
        (flat, patches, inside),
        (image, 0 * patches, inside),
    ):
        places = likeliest(grey, some, mean, alike(2.0, 5), 24.0)
        np.testing.assert_array_equal(places.ncc, -1)
        assert not find_points(grey, some, mean, alike(2.0, 5), 0.05, 24.0).seen.any()
    assert len(likeliest(image, patches[:0], outside[:0], alike(1.0, 0), 24.0).ncc) == 0


# --- points ---


def test_among_equals_the_prior_decides_or_nobody_does() -> None:
    tile = np.random.default_rng(4).integers(0, 256, (12, 12)).astype(np.uint8)
    grey = np.tile(tile, (10, 12))
    points = np.array([[66.0, 54.0], [42.0, 66.0]])
    patches = sample_patches(grey, points, 5)
    narrow, between, wide = (alike(deviation, 2) for deviation in (2.5, 4.0, 8.0))
    assert find_points(grey, patches, points, narrow, 0.05, 24.0).seen.all()
    np.testing.assert_allclose(
        find_points(grey, patches, points, between, 0.05, 24.0).position, points, atol=0.05
    )
    assert not find_points(grey, patches, points + np.array([6.0, 0.0]), wide, 0.05, 24.0).seen.any()


def test_what_leads_back_elsewhere_is_refused() -> None:
    before, after = before_and_after()
    points = find_corners(before, 60, np.zeros((0, 2)), 8, 5)
    points = points[((points > 15) & (points < [WIDTH - 15, HEIGHT - 15])).all(axis=1)]
    for off, share in ((0.0, 1.0), (3.0, 0.0)):
        there = points + SHIFT + [off, 0.0]
        where = windows(points, alike(2.0, len(points)), 24.0, prior=False)
        back = is_found_back(after, there, before, where, np.arange(len(points)), 5)
        assert back.mean() == pytest.approx(share, abs=0.05)


# --- covariances ---


# --- points that may be hidden ---


def test_lost_points_are_found_where_they_are_and_rarely_where_they_are_not() -> None:
    """Patches of one plane in pictures of it that moved on, and in pictures of other planes."""
    before, after = before_and_after()
    points = find_corners(before, 80, np.zeros((0, 2)), 8, 5)
    points = points[((points > 15) & (points < [WIDTH - 15, HEIGHT - 15])).all(axis=1)]
    patches, prior = sample_patches(before, points, 5), alike(0.7, len(points))
    shares = []
    for lost in (np.zeros(len(points), bool), np.ones(len(points), bool)):
        seen_before = None if not lost.any() else PreviousView(before, ~lost, points)
        there = find_points(after, patches, points + SHIFT, prior, 0.05, 24.0, seen_before).seen.mean()
        others = [film([Pose(np.eye(2), np.zeros(2))], seed=seed, noise=0.0)[0] for seed in range(1, 31)]
        wrong = [find_points(other, patches, points, prior, 0.05, 24.0, seen_before).seen for other in others]
        shares.append((there, np.mean(wrong)))
    (there, wrong), (there_again, rarely) = shares
    assert there_again > there - 0.03
    assert wrong > 0.01
    assert rarely < 0.6 * wrong  # waves are more alike than pictures, for which the density is


def test_odds_over_chance_are_a_ratio_of_densities() -> None:
    """Both densities over correlation and place integrate to one point, and to the number that `least_ncc`
    states."""
    area, side, determinant = 100.0, 5, 0.5**2
    ncc = np.linspace(0.7, 0.999, 3000)
    odds = np.array([odds_over_chance(one, 0.0, determinant, area, side) for one in ncc])
    of_point = np.exp(-(1 - ncc) / UNLIKE) / UNLIKE / (2 * np.pi * 0.5)
    by_chance = of_point * np.exp(-odds) * area  # of the whole window
    expected = np.trapezoid(by_chance[ncc >= 0.9], ncc[ncc >= 0.9])
    # as `least_ncc` has it: at that correlation so many places are expected by chance
    assert least_ncc(1 - np.exp(-expected), area, side) == pytest.approx(0.9, abs=0.01)
    farther = np.array([odds_over_chance(one, 4.0, determinant, area, side) for one in ncc])
    np.testing.assert_allclose(odds - farther, 2.0)
