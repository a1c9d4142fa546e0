"""Places of a hand's size in a map of skin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.image_features import SkinBlobs, skin_blobs
from scipy.ndimage import gaussian_filter

Map = NDArray[np.float32]

RADIUS = 24.0
SHAPE = (240, 320)


def odds(*ellipses: tuple[float, float, float, float], within: float = 3.0) -> Map:
    """Log odds -3 with soft ellipses (x, y, half axes) of `within`."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    covered = np.zeros(SHAPE, np.bool_)
    for x, y, across, down in ellipses:
        covered |= np.hypot((columns - x) / across, (rows - y) / down) < 1
    return gaussian_filter(np.where(covered, within, -3.0), 1.0).astype(np.float32)


def nearest(blobs: SkinBlobs, x: float, y: float) -> tuple[int, float]:
    distance = np.hypot(*(blobs.means - (x, y)).T)
    return int(distance.argmin()), float(distance.min())


@settings(max_examples=10, deadline=None)
@given(st.floats(60, 260), st.floats(60, 180), st.floats(0.6, 1.0), st.floats(0.6, 1.3))
def test_a_lone_hand(x: float, y: float, across: float, down: float) -> None:
    """Its middle is found to within a sixth of its radius, and nothing as strong elsewhere."""
    blobs = skin_blobs(odds((x, y, across * RADIUS, down * RADIUS)), RADIUS)
    assert nearest(blobs, x, y)[0] == 0
    assert nearest(blobs, x, y)[1] < RADIUS / 6
    assert (np.diff(blobs.log_weights) <= 0).all()
    assert (np.linalg.eigvalsh(blobs.covariances) > 0).all()


@pytest.mark.parametrize("apart", [1.0, 1.4, 1.8, 2.2])
def test_two_hands_that_touch(apart: float) -> None:
    x = np.array([-0.5, 0.5]) * apart * RADIUS + 160
    blobs = skin_blobs(odds(*((each, 120.0, 0.75 * RADIUS, RADIUS) for each in x)), RADIUS)
    found = [nearest(blobs, each, 120.0) for each in x]
    assert found[0][0] != found[1][0]
    assert max(found)[1] < 0.5 * RADIUS


def test_hand_below_and_in_front_of_a_face() -> None:
    """A hand under the chin is found beside a known head; one in the face is listed, with less weight."""
    head, hand = (160.0, 90.0, 32.0, 42.0), (165.0, 145.0, 18.0, 20.0)
    blobs = skin_blobs(odds(head, hand), RADIUS, np.array([head]))
    below, distance = nearest(blobs, 165, 148)
    assert distance < 0.5 * RADIUS
    within, _ = nearest(blobs, 160, 90)
    assert np.hypot(*(blobs.means[within] - (160, 90)) / (32, 42)) < 1
    assert blobs.log_weights[within] < blobs.log_weights[below]


def test_hand_on_cloth_of_nearly_its_colour() -> None:
    skin = odds((160, 200, 20, 20))
    skin[170:] = np.maximum(skin[170:], 0.5)
    blobs = skin_blobs(skin, RADIUS)
    place, distance = nearest(blobs, 160, 200)
    assert distance < 0.4 * RADIUS
    assert place == 0
