"""Skin colour learned from faces."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.skin import (
    BINS,
    SkinColour,
    count_colours,
    has_colour,
    look_up,
    smoothed,
)

Image = NDArray[np.uint8]

SKIN, WALL, SHIRT = np.array([90, 130, 200]), np.array([140, 110, 80]), np.array([40, 40, 40])
BOX = np.array([100.0, 40.0, 60.0, 60.0])


def picture(skin: NDArray[np.int64] = SKIN, seed: int = 0) -> Image:
    """A face in `BOX`, a hand about (50, 150), a shirt below and a wall; noise of 4 levels."""
    rows, columns = np.mgrid[:200, :260]
    image = np.broadcast_to(WALL, (200, 260, 3)).astype(np.float64)
    image[120:, 60:200] = SHIRT
    image[np.hypot((columns - 130) / 26, (rows - 71) / 36) < 1] = skin
    image[np.hypot(columns - 50, rows - 150) < 14] = skin
    image += np.random.default_rng(seed).normal(0, 4, image.shape)
    return image.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "skin", [SKIN, np.array([40, 60, 90]), np.array([170, 190, 230]), np.array([60, 200, 60])]
)
def test_the_hand_has_the_colour_of_the_face(skin: NDArray[np.int64]) -> None:
    """No skin colour is built in: dark, pale and even green ones are learned."""
    colour = SkinColour.learned([picture(skin, seed) for seed in range(2)], np.array([BOX, BOX]))
    assert colour is not None
    odds = colour.log_odds(picture(skin, 5))
    assert (odds.shape, odds.dtype) == ((200, 260), np.float32)
    assert np.median(odds[144:157, 44:57]) > 2.5
    assert np.median(odds[20:, :30]) < -3
    assert np.median(odds[150:, 100:180]) < -3
    assert np.abs(odds).max() <= 4


def test_the_ratio_is_that_of_the_counts() -> None:
    """Where a colour fills one bin of each region, its log ratio is that of the densities in closed form."""
    image = np.full((200, 260, 3), 128, np.uint8)
    image[60:] = (90, 130, 200)  # below all faces' middle: most of the face and of the rest
    skin = SkinColour.learned([image], BOX[None])
    assert skin is not None
    rows, columns = np.mgrid[:200, :260]
    face = np.hypot((columns - 130) / 19.8, (rows - 71.2) / 25.2) < 1
    rest = np.hypot((columns - 130) / 48, (rows - 70) / 57) >= 1
    coloured = rows >= 60
    expected = np.log(coloured[face].mean() / coloured[rest].mean())
    # the blur at the boundary between the colours moves a few pixels to other bins
    assert skin.log_odds(image)[150, 20] == pytest.approx(expected, abs=0.05)


def test_grey_has_no_skin() -> None:
    grey = np.random.default_rng(0).integers(0, 255, (200, 260)).astype(np.uint8)
    assert SkinColour.learned([grey], BOX[None]) is None
    compressed = grey[..., None] // 2 + np.random.default_rng(1).integers(0, 4, (200, 260, 3))
    assert SkinColour.learned([compressed.astype(np.uint8)], BOX[None]) is None
    assert has_colour(picture())


def test_errors() -> None:
    with pytest.raises(ValueError, match=r"boxes: got \(2, 4\) for 1 images"):
        SkinColour.learned([picture()], np.array([BOX, BOX]))
    with pytest.raises(ValueError, match="boxes: got"):
        SkinColour.learned([], np.zeros((0, 4)))
    skin = SkinColour.learned([picture()], BOX[None])
    assert skin is not None
    with pytest.raises(ValueError, match=r"image: got \(20, 20\), expected \(height, width, 3\)"):
        skin.log_odds(np.zeros((20, 20), np.uint8))


def test_pixels_are_counted_by_luma_and_the_two_differences_of_colour() -> None:
    """Of a picture of one colour all are in its bin, where they are asked for."""
    image = np.full((30, 40, 3), (90, 130, 200), np.uint8)
    where = np.zeros((30, 40), np.bool_)
    where[5:9, 10:20] = True
    counts = count_colours(image, where)
    assert counts.sum() == counts.max() == 40
    luma, red, blue = cv2.cvtColor(image[:1, :1], cv2.COLOR_BGR2YCrCb)[0, 0].astype(int)
    place = luma * 8 // 256, red * 64 // 256, blue * 64 // 256
    assert np.unravel_index(counts.argmax(), BINS) == place
    table = np.zeros(BINS, np.float32)
    table[place] = 2.5
    np.testing.assert_array_equal(look_up(table, smoothed(image)), np.full((30, 40), 2.5, np.float32))
