"""Distances from borders, against OpenCV's; no border at the picture's edge."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.events import Line, Zone

SIZE = (320, 240)
STAR = np.array(
    [[160, 20], [190, 110], [280, 120], [190, 140], [160, 220], [130, 140], [40, 120], [130, 110]]
)


@given(st.floats(1, 319), st.floats(1, 239), st.booleans())
def test_distance_is_that_of_opencv(x: float, y: float, turned: bool) -> None:
    corners = (STAR[::-1] if turned else STAR).astype(np.float64)
    place = float(np.float32(x)), float(np.float32(y))
    expected = cv2.pointPolygonTest(corners.astype(np.float32), place, True)
    assert Zone("star", corners, SIZE).distance(place) == pytest.approx(expected, abs=1e-4)


def test_there_is_no_border_at_the_edge_of_the_picture() -> None:
    """Feet are on the picture's edge, or out of it, where its lower edge cuts people off."""
    zone = Zone("below", np.array([[100.0, 160], [220, 160], [220, 238.5], [100, 240]]), SIZE)
    for y in (230.0, 239.0, 240.0, 250.0):
        assert zone.distance((160.0, y)) == pytest.approx(60.0)
    assert zone.distance((110.0, 250.0)) == pytest.approx(10.0)
    assert zone.distance((90.0, 250.0)) == pytest.approx(-10.0)
    whole = Zone("all", np.array([[0.0, 0], [320, 0], [320, 240], [0, 240]]), SIZE)
    assert whole.distance((3.0, 4.0)) == np.inf
    assert whole.distance((-30.0, 4.0)) == np.inf


def test_a_corner_at_the_edge_leaves_both_borders() -> None:
    triangle = Zone("triangle", np.array([[0.0, 120], [100, 60], [100, 180]]), SIZE)
    assert triangle.distance((50.0, 120.0)) == pytest.approx(50 * 60 / np.hypot(100, 60))
    assert triangle.distance((110.0, 120.0)) == pytest.approx(-10)


def test_right_is_the_right_of_who_looks_along_the_line() -> None:
    line = Line("line", (10.0, 100.0), (110.0, 100.0))  # to the right: its right is below
    assert line.distance((50.0, 130.0)) == pytest.approx(30)
    assert line.distance((500.0, 60.0)) == pytest.approx(-40)
    assert line.is_beside((10.0, 100.0))
    assert line.is_beside((110.0, 100.0))
    assert not line.is_beside((9.0, 100.0))
    assert not line.is_beside((111.0, 100.0))


def test_a_line_that_reaches_the_edge_goes_on_beyond() -> None:
    """Feet are below the picture where its lower edge cuts people off."""
    below = Line("line", (160.0, 100.0), (150.0, 239.0), size=SIZE)
    assert below.is_beside((149.0, 260.0))
    assert not below.is_beside((161.0, 90.0))
    assert not Line("line", (160.0, 100.0), (150.0, 230.0), size=SIZE).is_beside((149.0, 260.0))
    along = Line(
        "line", (10.0, 240.0), (60.0, 240.0), size=SIZE
    )  # the edge itself, which goes on in the picture
    assert not along.is_beside((70.0, 240.0))
    across = Line("line", (0.0, 120.0), (320.0, 120.0), size=SIZE)
    assert across.is_beside((-9.0, 120.0))
    assert across.is_beside((330.0, 120.0))
