"""Bare forearms are told from sleeves by how much skin hangs together."""

import cv2
import numpy as np
import pytest
from rsmcm.models.body.person import IN_SLEEVE, WITH_FOREARM, bare_probability, hand_area
from scipy.stats import norm

HEAD_HEIGHT, RADIUS = 80.0, 24.0
HEADS = np.array([[160.0, 70.0, 30.0, 39.0], [160.0, 120.0, 21.0, 26.0]])


def test_the_probability_is_that_of_two_gaussians() -> None:
    deviation = np.hypot(0.2, 0.4 / np.sqrt(3))
    for middle in (0.9, 1.1, 1.3, 1.5):
        low, high = (norm.pdf(np.log(middle), np.log(mean), deviation) for mean in (IN_SLEEVE, WITH_FOREARM))
        assert bare_probability([0.3, middle, 4.0]) == pytest.approx(high / (low + high))
        # frames in which there is no patch of a hand's size tell nothing
        assert bare_probability([0.3, middle, 4.0, *[0.05] * 20]) == bare_probability([0.3, middle, 4.0])


def test_the_area_is_that_of_the_largest_patch_beside_the_head() -> None:
    skin = np.full((400, 640), -4, np.float32)
    for x, y, across, down in HEADS:
        cv2.ellipse(skin, ((x, y), (2 * across, 2 * down), 0.0), 4.0, cv2.FILLED)
    assert hand_area(skin, HEADS, RADIUS, HEAD_HEIGHT) == 0
    cv2.circle(skin, (230, 200), round(RADIUS), 4.0, cv2.FILLED)
    alone = hand_area(skin, HEADS, RADIUS, HEAD_HEIGHT)
    assert alone == pytest.approx(1, abs=0.05)
    cv2.circle(skin, (80, 180), 15, 4.0, cv2.FILLED)  # the other hand is a patch of its own
    cv2.circle(skin, (600, 60), 60, 4.0, cv2.FILLED)  # and what is out of reach is none
    assert hand_area(skin, HEADS, RADIUS, HEAD_HEIGHT) == alone
    cv2.line(skin, (230, 200), (300, 290), 4.0, 22)
    assert 2 < hand_area(skin, HEADS, RADIUS, HEAD_HEIGHT) < 3
