"""Zones are drawn where they are, and lines with an arrow to their right."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.events import Line, Zone, Zones
from rsmcm.apps.view.overlay import ZONES as COLOUR
from rsmcm.apps.view.overlay import draw_zones

SIZE = (320, 240)
SQUARE = np.array([[100.0, 100], [200, 100], [200, 200], [100, 200]])


def amber(zones: Zones, scale: float = 1.0) -> NDArray[np.bool_]:
    """Where it is drawn, but for soft edges."""
    picture = np.full((round(240 * scale), round(320 * scale), 3), 90, np.uint8)
    draw_zones(picture, zones, scale)
    return like_amber(picture)


def like_amber(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((np.abs(picture.astype(int) - COLOUR) < 70).all(axis=2))


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_a_zone_is_drawn_on_its_border(scale: float) -> None:
    drawn = amber(Zones((Zone("", SQUARE, SIZE),), ()), scale)
    rows, columns = np.nonzero(drawn)
    for found in (rows, columns):
        assert (found.min(), found.max()) == pytest.approx((100 * scale, 200 * scale), abs=3)
    inner = slice(round(110 * scale), round(190 * scale))
    assert not drawn[inner, inner].any()
    assert drawn[round(150 * scale)].any()


def test_the_arrow_goes_to_the_right_of_the_line() -> None:
    line = Line("", (100.0, 120.0), (200.0, 120.0))
    drawn = amber(Zones((), (line,)))
    rows, _ = np.nonzero(drawn)
    assert rows.max() > 126, "a line that goes to the right has its right below"
    assert rows.min() >= 117
    assert all(line.distance((float(x), float(y))) > -3 for y, x in np.argwhere(drawn))
