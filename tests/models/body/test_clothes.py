"""Colours of clothes, learned from the trunk of made-up people."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.parts import BodyParts
from rsmcm.models.body.person import SHRINK, ClothesColour
from rsmcm.models.body.skin import HIGHEST, SkinColour, smoothed
from rsmcm.models.core.frame import Frame

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

HEIGHT = 60.0
HEAD = np.array([160.0, 60.0])
BOX = np.array([[137.0, 42.0, 45.0, 45.0]])
SKIN: Colour = (90, 130, 200)
WALL: Colour = (170, 150, 120)
SHIRT: Colour = (60, 120, 40)
ELBOW, WRIST = (250, 140), (290, 60)


def picture(
    shirt: Colour = SHIRT, wall: Colour = WALL, forearm: Colour | None = None, seed: int = 0
) -> Image:
    """Head, trunk with a hand before it, and one arm held out from the shoulder to `WRIST`; noise."""
    image = np.empty((240, 320, 3), np.uint8)
    image[:] = wall
    cv2.rectangle(image, (115, 105), (205, 239), shirt, cv2.FILLED)
    cv2.line(image, (200, 115), ELBOW, shirt, 22)
    cv2.line(image, ELBOW, WRIST, shirt if forearm is None else forearm, 20)
    for x, y, across, down in ((160, 60, 22, 29), (150, 160, 15, 15), (*WRIST, 15, 15)):
        cv2.ellipse(image, (x, y), (across, down), 0, 0, 360, SKIN, cv2.FILLED)
    noisy = image + np.random.default_rng(seed).normal(0, 3, image.shape)
    return noisy.clip(0, 255).astype(np.uint8)


def skin_of(image: Image) -> SkinColour:
    skin = SkinColour.learned([image], BOX)
    assert skin is not None
    return skin


def learned(image: Image) -> ClothesColour:
    clothes = ClothesColour.learned([image], HEAD[None], HEIGHT, skin_of(image))
    assert clothes is not None
    return clothes


def at(arms: NDArray[np.float32], x: float, y: float) -> float:
    """Value of a map at a pixel of the picture."""
    return float(arms[round(SHRINK * y), round(SHRINK * x)])


def arm_map(image: Image) -> NDArray[np.float32]:
    return learned(image).arm_map(smoothed(image), HEIGHT)


@pytest.mark.parametrize("shirt", [SHIRT, (40, 40, 40), (200, 200, 230), (150, 60, 160)])
def test_sleeves_have_the_colour_of_the_trunk(shirt: Colour) -> None:
    """Whatever it is; walls and skin have not."""
    arms = arm_map(picture(shirt))
    assert arms.shape == (120, 160)
    assert arms.dtype == np.float32
    for x, y in ((225, 128), (263, 114), (276, 90)):
        assert at(arms, x, y) > 1.5
    for x, y in ((40, 60), (300, 200), (60, 200)):
        assert at(arms, x, y) < -2
    assert at(arms, *HEAD) < 0
    assert np.abs(arms).max() <= HIGHEST + 1e-5


def test_of_grey_pictures_and_of_heads_without_a_trunk_nothing_is_learned() -> None:
    image = picture()
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    skin = skin_of(image)
    for one in (grey, np.repeat(grey[:, :, None], 3, axis=2)):
        assert ClothesColour.learned([one], HEAD[None], HEIGHT, skin) is None
    assert ClothesColour.learned([image], np.array([[160.0, 235.0]]), HEIGHT, skin) is None
    assert ClothesColour.learned([], np.zeros((0, 2)), HEIGHT, skin) is None


def test_the_evidence_of_an_image_holds_the_map() -> None:
    """Not where clothes or skin are unknown."""
    image = picture(forearm=SKIN)
    boxes = np.array(BOX)
    node = BodyParts.learned([image], lambda frame: boxes)
    assert node.clothes is not None
    assert node.skin is not None
    seen = node.evidence(Frame(image, 0.0, 1), node.uniform()).image
    assert seen is not None
    np.testing.assert_array_equal(seen.arms, node.clothes.arm_map(smoothed(image), node.head_height))
    for less in (replace(node, clothes=None), replace(node, skin=None)):
        seen = less.evidence(Frame(image, 0.0, 1), node.uniform()).image
        assert seen is not None
        assert seen.arms is None


def resting(where: tuple[int, int], n: int = 10) -> BodyParts:
    """Learned from a film in which one hand moves, and a patch of a hand's size stays where it is."""
    images = []
    for k in range(n):
        image = np.empty((240, 320, 3), np.uint8)
        image[:] = WALL
        cv2.rectangle(image, (115, 105), (205, 239), SHIRT, cv2.FILLED)
        moving = (40 + 12 * k, 100 + 30 * (k % 3))
        for x, y, across, down in ((160, 60, 22, 29), (*where, 16, 16), (*moving, 16, 16)):
            cv2.ellipse(image, (x, y), (across, down), 0, 0, 360, SKIN, cv2.FILLED)
        images.append(image)
    return BodyParts.learned(images, lambda frame: BOX)


def test_a_hand_that_rests_is_no_static_skin() -> None:
    """On the clothes it is a hand, since an arm may lead there; the same on the wall is a thing."""
    for (x, y), thing in (((165, 190), False), ((280, 160), True)):
        still = resting((x, y)).static_skin
        assert still is not None
        assert (still[y, x] > 1) == thing
        assert still[60, 160] > 1  # the face, which is found in every frame


def test_where_no_skin_moves_at_all_resting_hands_are_looked_for() -> None:
    parts = resting((165, 190))
    empty = np.empty((240, 320, 3), np.uint8)
    empty[:] = WALL
    cv2.rectangle(empty, (115, 105), (205, 239), SHIRT, cv2.FILLED)
    still = parts.dressed([empty] * 3, np.repeat(BOX, 3, axis=0)).static_skin
    assert still is not None
    assert np.isfinite(still).all()
