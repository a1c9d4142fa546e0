"""Skin that is always there, on pictures in which it is known where and how often."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.skin import AWAY, LEAST_FRAMES, LEVELS, SkinColour, static_skin

Image = NDArray[np.uint8]

SIZE = (48, 64)
SKIN, WALL = (110, 140, 200), (120, 110, 60)  # BGR
FACE = np.array([[20.0, 10.0, 24.0, 24.0]])


def picture(*patches: tuple[slice, slice]) -> Image:
    """A wall with patches of skin."""
    image = np.full((*SIZE, 3), WALL, np.uint8)
    for patch in patches:
        image[patch] = SKIN
    return image


@pytest.fixture(scope="module")
def colour() -> SkinColour:
    learned = SkinColour.learned([picture((slice(10, 34), slice(20, 44)))], FACE)
    assert learned is not None
    return learned


def test_it_is_a_quantile_of_the_log_odds(colour: SkinColour) -> None:
    """Over frames, but for rounding and where it would speak against skin."""
    random = np.random.default_rng(0)
    images = [random.integers(0, 256, (*SIZE, 3)).astype(np.uint8) for _ in range(20)]
    odds = np.sort([colour.log_odds(image) for image in images], axis=0)
    expected = np.maximum(odds[int(AWAY * 20)], 0)
    still = static_skin(colour, images)
    assert still is not None
    np.testing.assert_allclose(still, expected, atol=0.501 / LEVELS)


def test_a_few_frames_do_not_tell(colour: SkinColour) -> None:
    assert static_skin(colour, [picture()] * (LEAST_FRAMES - 1)) is None
    assert static_skin(colour, [picture()] * LEAST_FRAMES) is not None
