"""Levels of a picture: how much they smooth, where their pixels are, and what light does to them."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.texture_likelihood import DARKEST, SMOOTHING, blurred, image_pyramid

from ...support.surfaces import smooth_picture


def uint8(picture: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [24.0, 90.0])
def test_a_point_is_smeared_by_as_much_as_a_level_says(size: float) -> None:
    image = np.zeros((240, 320), np.uint8)
    image[116, 163] = 255
    for number, level in enumerate(image_pyramid(image, size, n_levels=3, local_mean=False)):
        picture = level.image.astype(np.float64)
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
        share = picture / picture.sum()
        x, y = ((there - (level.scale - 1) / 2) / level.scale for there in (x, y))
        middle = np.array([(share * x).sum(), (share * y).sum()])
        # the pixel's own 2 x 2 or 4 x 4 block: its middle may be that much off
        assert np.abs(middle - [163, 116]).max() <= (1 / level.scale - 1) / 2 + 1e-3
        # averaging blocks moves the point, not its spread
        spread = (share * (x - middle[0]) ** 2).sum()
        wanted = (SMOOTHING[number] * size) ** 2
        assert spread == pytest.approx(wanted, rel=0.12, abs=0.1)


def test_light_that_changes_slowly_is_taken_out() -> None:
    size, picture = 24.0, 40 + 0.6 * smooth_picture(2)
    lamp = 0.5 + 0.5 * np.linspace(0, 1, 160)
    even, lit = (
        image_pyramid(uint8(scene), size, n_levels=2, local_mean=True) for scene in (picture, picture * lamp)
    )
    raw, dim = (
        image_pyramid(uint8(scene), size, n_levels=2, local_mean=False) for scene in (picture, picture * lamp)
    )
    for number in range(2):
        left = np.abs(even[number].image - lit[number].image).mean()
        assert left < 0.1 * np.abs(raw[number].image - dim[number].image).mean()


def test_black_stays_black_and_an_even_picture_even() -> None:
    black, grey = (
        image_pyramid(np.full((60, 80), value, np.uint8), 24.0, n_levels=2, local_mean=True)
        for value in (0, 100)
    )
    assert not black[0].image.any()
    np.testing.assert_allclose(grey[1].image, 128 * 100 / (100 + DARKEST), rtol=1e-4)


def test_colours_count_as_their_grey() -> None:
    random = np.random.default_rng(0)
    colour = random.integers(0, 256, (60, 80, 3), np.uint8)
    found = image_pyramid(colour, 24.0, n_levels=2, local_mean=True)
    wanted = image_pyramid(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), 24.0, n_levels=2, local_mean=True)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one.image, other.image)


@pytest.mark.parametrize("deviation", [6.0, 40.0])
def test_a_wide_mean_worked_out_small_is_nearly_the_exact_one(deviation: float) -> None:
    picture = smooth_picture(3, 240, 320, 8.0).astype(np.float32)
    wanted = cv2.GaussianBlur(picture, (0, 0), deviation)
    inside = slice(40, -40)
    difference = (blurred(picture, deviation) - wanted)[inside, inside]
    assert np.abs(difference).max() < 2.0
