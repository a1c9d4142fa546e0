"""Correlation of patches against OpenCV's, places against known shifts, covariances against real errors."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.points.patch_search import PatchMatches, reaches_of, sample_patches, search_patches

Grey = NDArray[np.uint8]
Numbers = NDArray[np.float64]


def texture(
    shift: tuple[float, float] = (0.0, 0.0), size: tuple[int, int] = (90, 120), seed: int = 0
) -> Numbers:
    """A picture of waves, none shorter than 6 px, whose content is moved by `shift` px right and down."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    picture = np.full(size, 128.0)
    for angle, length, phase in zip(
        random.uniform(0, np.pi, 12), random.uniform(6, 25, 12), random.uniform(0, 6, 12), strict=True
    ):
        along = (x - shift[0]) * np.cos(angle) + (y - shift[1]) * np.sin(angle)
        picture += 14 * np.sin(2 * np.pi * along / length + phase)
    return np.clip(picture, 0, 255)


def rounded(picture: Numbers) -> Grey:
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def noise_picture(seed: int, height: int, width: int) -> Grey:
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


# --- sampling -----------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(st.integers(0, 2**32), st.sampled_from([3, 5, 7, 9]), st.floats(0, 29), st.floats(0, 39))
def test_patches_are_interpolated_linearly(seed: int, side: int, y: float, x: float) -> None:
    image = noise_picture(seed, 30, 40)
    (patch,) = sample_patches(image, [[x, y]], side)
    half = side // 2
    if not (half <= x <= 39 - half and half <= y <= 29 - half):
        assert not patch.any()
        return
    rows, columns = y + np.arange(-half, half + 1), x + np.arange(-half, half + 1)
    along = [np.interp(columns, np.arange(40), row) for row in image]
    expected = np.array([np.interp(rows, np.arange(30), column) for column in np.array(along).T]).T
    np.testing.assert_allclose(patch, expected, atol=1e-3)  # float32
    (unit,) = sample_patches(image, [[x, y]], side, unit=True)
    centred = expected - expected.mean()
    np.testing.assert_allclose(unit, centred / np.linalg.norm(centred), atol=1e-5)


def test_patches_up_to_the_edge() -> None:
    image = noise_picture(0, 5, 5)
    np.testing.assert_array_equal(sample_patches(image, [[2, 2]])[0], image)
    assert not sample_patches(image, [[2, 2.01], [1.99, 2], [-5, 2], [1e12, 2]]).any()
    assert sample_patches(image, np.zeros((0, 2))).shape == (0, 5, 5)


def test_patches_without_contrast_are_zero() -> None:
    image = np.full((20, 20), 77, np.uint8)
    image[:, 10:] = np.arange(20)[:, None] % 2 + 77  # rounding of one grey
    assert not sample_patches(image, [[5, 5]], unit=True).any()
    assert not sample_patches(image, [[14.5, 5.5]], unit=True).any()
    np.testing.assert_array_equal(sample_patches(image, [[5, 5]])[0], np.full((5, 5), 77))


# --- correlation --------------------------------------------------------------------------------------------


def opencv_scores(image: Grey, patch: NDArray[np.float32], x: int, y: int, reach: int) -> Numbers:
    """Normalised correlation at whole pixels of the window, as far as it is in the picture; -2 elsewhere."""
    half = len(patch) // 2
    scores = np.full((2 * reach + 1, 2 * reach + 1), -2.0)
    # middles of patches: the part of the window that keeps half a patch from the edge
    left, right = max(x - reach, half), min(x + reach, image.shape[1] - 1 - half)
    top, bottom = max(y - reach, half), min(y + reach, image.shape[0] - 1 - half)
    if left <= right and top <= bottom:
        seen = image[top - half : bottom + half + 1, left - half : right + half + 1].astype(np.float32)
        part = slice(top - y + reach, bottom - y + reach + 1), slice(left - x + reach, right - x + reach + 1)
        scores[part] = cv2.matchTemplate(seen, patch, cv2.TM_CCOEFF_NORMED)
    return scores


def opencv_peaks(scores: Numbers) -> Iterator[tuple[float, int, int]]:
    """Scores at whole pixels, best first, with row and column, of peaks that are not on the rim."""
    inside = np.argwhere(scores > -2)
    top, left = inside.min(axis=0)
    bottom, right = inside.max(axis=0)
    found = []
    for row in range(top + 1, bottom):
        for column in range(left + 1, right):
            around = scores[row - 1 : row + 2, column - 1 : column + 2]
            if scores[row, column] == around.max():
                found.append((float(scores[row, column]), row, column))
    yield from sorted(found, reverse=True)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32),
    st.sampled_from([3, 5, 7]),
    st.integers(0, 44),
    st.integers(0, 34),
    st.integers(2, 9),
)
def test_the_best_place_is_opencvs(seed: int, side: int, x: int, y: int, reach: int) -> None:
    """On noise, so that there are many peaks; a place between pixels is at most one from its pixel."""
    image = cv2.GaussianBlur(noise_picture(seed, 35, 45), (0, 0), 1.0)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    (patch,) = sample_patches(image, [np.random.default_rng(seed).uniform(8, 26, 2)], side, unit=True)
    matches = search_patches(image, patch[None], [[x, y]], reach)
    scores = opencv_scores(image, patch, x, y, reach)
    peaks = list(opencv_peaks(scores)) if (scores > -2).any() else []
    if not peaks:
        assert matches.score[0] == matches.rival[0] == -1
        np.testing.assert_array_equal(matches.position, [[x, y]])
        assert not matches.information.any()
        return
    best, row, column = peaks[0]
    if len(peaks) > 1 and best - peaks[1][0] < 1e-4:
        return  # rounding decides
    np.testing.assert_allclose(
        matches.position[0], [x - reach + column, y - reach + row], atol=0.9991, rtol=0
    )
    others = [
        score for score, other_row, other_column in peaks[1:]
        if max(abs(other_row - row), abs(other_column - column)) > side // 2
    ]  # fmt: skip
    # a parabola is at least as high as its middle, and hardly more than a fifth above
    if others:
        assert others[0] - 1e-4 <= matches.rival[0] <= others[0] + 0.5
    else:
        assert matches.rival[0] == -1


@pytest.mark.parametrize("side", [3, 5, 7, 11])
def test_a_patch_is_found_where_it_was_taken(side: int) -> None:
    image = rounded(texture(size=(60, 80)))
    random = np.random.default_rng(side)
    positions = random.integers([12, 12], [67, 47], (40, 2)).astype(float)
    matches = search_patches(
        image,
        sample_patches(image, positions, side, unit=True),
        positions + random.integers(-4, 5, (40, 2)),
        6,
    )
    np.testing.assert_allclose(matches.position, positions, atol=0.02)
    np.testing.assert_allclose(matches.score, 1, atol=1e-4)


@given(st.floats(0.2, 1.0), st.floats(-20, 60))
@settings(max_examples=25)
def test_light_and_contrast_do_not_matter(contrast: float, brightness: float) -> None:
    picture = texture()
    image = rounded(picture)
    dimmer = np.clip(contrast * picture + brightness, 0, 255)
    positions = np.random.default_rng(1).uniform(20, 70, (30, 2))
    patches = sample_patches(image, positions, unit=True)
    matches = search_patches(rounded(dimmer), patches, positions, 5)
    unclipped = (sample_patches(rounded(dimmer), positions, 9).reshape(30, -1) % 255 != 0).all(axis=1)
    assert (matches.score[unclipped] > 0.97).all()


# --- places between pixels ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [(0.25, -0.5), (1.4, 2.3), (-2.75, 0.1)])
def test_shifts_by_parts_of_a_pixel(shift: tuple[float, float]) -> None:
    positions = np.random.default_rng(2).uniform([15, 15], [105, 75], (60, 2))
    patches = sample_patches(rounded(texture()), positions, unit=True)
    matches = search_patches(rounded(texture(shift)), patches, positions, 6)
    errors = matches.position - positions - shift
    sure = np.linalg.eigvalsh(matches.information)[:, 0] > 1 / 0.2**2
    assert sure.mean() > 0.6
    assert np.abs(errors[sure]).max() < 0.3
    assert np.sqrt(np.mean(errors[sure] ** 2)) < 0.06


def test_noise_of_waves_is_told_by_the_covariance() -> None:
    """Errors over 1200 places in their own unit: mean square 2 for two coordinates, to within a factor of 2.

    Its standard error is 0.06; what remains is the residuals' noise being estimated from 25 pixels.
    """
    random = np.random.default_rng(3)
    squares = []
    for seed in range(20):
        one, other = (
            rounded(picture + random.normal(0, 4, picture.shape))
            for picture in (texture(seed=seed), texture((0.6, -1.3), seed=seed))
        )
        positions = random.uniform([15, 15], [105, 75], (60, 2))
        matches = search_patches(other, sample_patches(one, positions, unit=True), positions, 4)
        errors = matches.position - positions - [0.6, -1.3]
        near = np.abs(errors).max(axis=1) < 1.5  # the others are taken for another place
        squares.append(mahalanobis(errors, matches)[near])
    assert 1 < np.concatenate(squares).mean() < 4


def mahalanobis(errors: Numbers, matches: PatchMatches) -> Numbers:
    squares: Numbers = np.einsum("ni,nij,nj->n", errors, matches.information, errors)
    return squares


def pictures(data_folder: Path) -> Iterator[Numbers]:
    for name in ("cmu-hotel/hotel.seq0.png", "bobot/frame_000120.jpg"):
        picture = cv2.imread(str(data_folder / name), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            pytest.skip(f"no {name} in {data_folder}")
        yield picture.astype(float)
    stream = cv2.VideoCapture(str(data_folder / "pets2009-s2l1" / "vtest.avi"))
    there, picture = stream.read()
    if not there:
        pytest.skip(f"no vtest.avi in {data_folder}")
    yield cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(float)


def seen_from(picture: Numbers, right: int, down: int) -> Numbers:
    """A camera with pixels three times as wide, moved by thirds of them."""
    picture = picture[down:, right:]
    rows, columns = picture.shape[0] // 3, picture.shape[1] // 3
    return picture[: 3 * rows, : 3 * columns].reshape(rows, 3, columns, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("deviation", [1.0, 4.0, 8.0])
def test_covariances_are_about_right_on_real_pictures(data_folder: Path, deviation: float) -> None:
    """Corners of real pictures, moved by thirds of a pixel under noise of the sensor of both.

    Mean squares of errors over covariances are 2 for two coordinates. Of about 2000 places the standard error
    is below 0.1; a factor of 2 either way is for patches being of 25 pixels, and pictures being no waves.
    """
    random = np.random.default_rng(4)
    squares, wrong = [], []
    for picture in pictures(data_folder):
        still = seen_from(picture, 0, 0)
        corners = cv2.goodFeaturesToTrack(still.astype(np.float32), 80, 0.01, 6, blockSize=5)[:, 0]
        for right in range(3):
            for down in range(3):
                moved = seen_from(picture, right, down)
                one, other = (
                    rounded(seen + random.normal(0, deviation, seen.shape)) for seen in (still, moved)
                )
                positions = corners + random.uniform(-0.5, 0.5, corners.shape)
                matches = search_patches(other, sample_patches(one, positions, unit=True), positions, 5)
                errors = matches.position - positions + np.array([right, down]) / 3
                clear = (matches.score > 0.7) & (matches.score - matches.rival > 0.1)
                near = np.abs(errors).max(axis=1) < 1.5
                squares.append(mahalanobis(errors, matches)[clear & near])
                wrong.append(~near[clear])
    assert len(np.concatenate(squares)) > 800
    assert 1 < np.concatenate(squares).mean() < 4
    assert np.concatenate(wrong).mean() < 0.05


def test_an_edge_tells_nothing_along_it() -> None:
    random = np.random.default_rng(6)
    angle = 0.4
    y, x = np.mgrid[:60, :60].astype(float)
    across = np.array([np.cos(angle), np.sin(angle)])
    edge = 128 + 60 * np.tanh((x - 30) * across[0] + (y - 30) * across[1])
    one, other = (rounded(edge + random.normal(0, 2, edge.shape)) for _ in range(2))
    along = np.array([-across[1], across[0]])
    positions = np.array([30.0, 30.0]) + random.uniform(-12, 12, (200, 1)) * along
    matches = search_patches(other, sample_patches(one, positions, unit=True), positions, 6)
    assert (across @ matches.information @ across > 1 / 0.1**2).all()
    # here and there noise is like noise
    assert (np.linalg.eigvalsh(matches.information)[:, 0] < 1e-9).mean() > 0.8


# --- nothing to find ----------------------------------------------------------------------------------------


def nothing(matches: PatchMatches) -> bool:
    return bool((matches.score == -1).all()) and not matches.information.any()


def test_flat_patches_say_nothing() -> None:
    image = noise_picture(7, 40, 40)
    assert nothing(search_patches(image, np.zeros((2, 5, 5), np.float32), [[20, 20], [5, 5]], 5))


def test_a_flat_picture_says_nothing() -> None:
    patches = sample_patches(noise_picture(8, 40, 40), [[20, 20]], unit=True)
    matches = search_patches(np.full((40, 40), 90, np.uint8), patches, [[20, 20]], 5)
    assert not matches.information.any()
    assert matches.score[0] <= 0


def test_windows_that_leave_the_picture() -> None:
    image = noise_picture(9, 40, 50)
    patches = np.repeat(sample_patches(image, [[3, 3]], unit=True), 5, axis=0)
    expected = np.array([[-3.0, -2.0], [-30.0, 3.0], [49.0, 39.0], [1e9, -1e9], [3.0, 200.0]])
    matches = search_patches(image, patches, expected, 8)
    np.testing.assert_allclose(matches.position[0], [3, 3], atol=1e-3)
    assert nothing(search_patches(image, patches[[1, 3, 4]], expected[[1, 3, 4]], 8))
    np.testing.assert_array_equal(matches.position[[1, 3, 4]], expected[[1, 3, 4]])
    assert matches.score[2] < 0.99


def test_windows_too_small_for_a_peak() -> None:
    image = noise_picture(10, 40, 40)
    patches = sample_patches(image, [[20, 20]], unit=True)
    for reaches in (0, [[0, 5]]):
        assert nothing(search_patches(image, patches, [[20, 20]], reaches))
    assert search_patches(image, patches, [[20, 20]], 1).score[0] == pytest.approx(1, abs=1e-4)
    assert nothing(search_patches(image[:6, :6].copy(), patches, [[3, 3]], 5))
    assert len(search_patches(image, patches[:0], np.zeros((0, 2)), 5).score) == 0


def test_a_twin_is_a_rival() -> None:
    image = np.full((40, 60), 100, np.uint8)
    mark = noise_picture(11, 9, 9)
    image[15:24, 10:19] = image[15:24, 26:35] = mark
    patches = sample_patches(image, [[14, 19]], unit=True)
    both = search_patches(image, patches, [[20, 19]], 15)
    one = search_patches(image, patches, [[14, 19]], 8)
    assert both.rival[0] > 0.999
    assert one.rival[0] < 0.9
    assert one.score[0] == pytest.approx(1, abs=1e-4)


def test_other_patches_do_not_matter() -> None:
    image = noise_picture(12, 60, 60)
    random = np.random.default_rng(0)
    positions, reaches = random.uniform(5, 55, (20, 2)), random.integers(1, 12, (20, 2))
    patches = sample_patches(image, positions, 7, unit=True)
    together = search_patches(image, patches, positions, reaches)
    for k in range(20):
        alone = search_patches(image, patches[k : k + 1], positions[k : k + 1], reaches[k : k + 1])
        assert alone.score[0] == together.score[k]
        assert alone.rival[0] == together.rival[k]
        np.testing.assert_array_equal(alone.position[0], together.position[k])
        np.testing.assert_array_equal(alone.information[0], together.information[k])


def test_reaches_hold_three_deviations() -> None:
    covariances = np.array([np.diag([4.0, 0.25]), [[1.0, 0.9], [0.9, 1.0]], np.diag([1e9, 1e-9])])
    np.testing.assert_array_equal(reaches_of(covariances, 12), [[8, 4], [5, 5], [12, 3]])


def test_bad_arguments_are_named() -> None:
    image, patches = noise_picture(0, 30, 30), np.zeros((2, 5, 5), np.float32)
    with pytest.raises(ValueError, match=r"image: got \(30, 30\) float64"):
        sample_patches(image.astype(float), [[5, 5]])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"image: got \(30, 30, 1\) uint8"):
        search_patches(image[:, :, None], patches, [[5, 5], [6, 6]], 5)
    with pytest.raises(ValueError, match="side: got 4"):
        sample_patches(image, [[5, 5]], 4)
    with pytest.raises(ValueError, match=r"positions: got \(1, 2\)"):
        sample_patches(image, [[5, np.nan]])
    with pytest.raises(ValueError, match=r"patches: got \(2, 5, 4\)"):
        search_patches(image, patches[:, :, 1:], [[5, 5], [6, 6]], 5)
    with pytest.raises(ValueError, match=r"expected, reaches: got \(1, 2\)"):
        search_patches(image, patches, [[5, 5]], 5)
