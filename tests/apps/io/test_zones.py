"""Distances from borders, against OpenCV's; no border at the picture's edge."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.events import Line, Zone, read_zones

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


GOOD = """
units = "relative"
still_after = 3
max_coast_time = 1.5

[[zone]]
name = "door, left"
polygon = [[0, 0], [0.5, 0], [0.5, 0.5], [0, 0]]

[[line]]
name = "gate"
from = [0.25, 1]
to = [0.25, 0.5]
left_to_right = "in"
right_to_left = "out"

[[line]]
name = "road"
from = [0, 0.1]
to = [1, 0.1]
"""


def written(folder: Path, text: str, name: str = "zones.toml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_all_that_a_file_may_say(tmp_path: Path) -> None:
    zones = read_zones(written(tmp_path, GOOD), SIZE)
    (door,) = zones.zones
    gate, road = zones.lines
    assert door.name == "door, left"
    assert door.polygon.tolist() == [[0, 0], [160, 0], [160, 120]], "in px, and not closed"
    assert (gate.start, gate.end, gate.left_to_right, gate.right_to_left) == (
        (80, 240),
        (80, 120),
        "in",
        "out",
    )
    assert (road.left_to_right, road.right_to_left) == ("left to right", "right to left")
    assert (zones.still_after, zones.max_coast_time) == (3.0, 1.5)


def test_labelme(tmp_path: Path) -> None:
    """Places are those of a picture twice as large; what is neither polygon nor line is left out."""
    content = {
        "imageWidth": 640,
        "imageHeight": 480,
        "shapes": [
            {"label": "a", "shape_type": "polygon", "points": [[0, 0], [64, 0], [64, 48]]},
            {"label": "b", "shape_type": "line", "points": [[0, 480], [640, 0]]},
            {"label": "c", "shape_type": "circle", "points": [[1, 1], [2, 2]]},
        ],
    }
    zones = read_zones(written(tmp_path, json.dumps(content), "frame.json"), SIZE)
    np.testing.assert_allclose(zones.zones[0].polygon, [[0, 0], [32, 0], [32, 24]])
    assert (zones.lines[0].start, zones.lines[0].end) == ((0, 240), (320, 0))
    with pytest.raises(ValueError, match=r"frame\.json: got something else, expected LabelMe's JSON"):
        read_zones(written(tmp_path, '{"shapes": []}', "frame.json"), SIZE)


def zone(*corners: tuple[float, float], name: str = "a") -> str:
    return f'[[zone]]\nname = "{name}"\npolygon = {[list(corner) for corner in corners]}\n'


def line(start: str, end: str, more: str = "") -> str:
    return f'[[line]]\nname = "a"\nfrom = {start}\nto = {end}\n{more}\n'


TRIANGLE = zone((1, 1), (9, 1), (9, 9))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got neither [[zone]] nor [[line]], expected one at least"),
        ("patience = 2.0\n[[zone]]", "unknown key 'patience', it is max_coast_time now"),
        ("[[zoone]]", "unknown key 'zoone', expected zone, line, units, still_after, max_coast_time, did"),
        ('units = "cm"\n' + TRIANGLE, "units: got 'cm', expected px or relative"),
        ("still_after = 0\n" + TRIANGLE, "still_after: got 0, expected seconds, more than 0"),
        ("[[zone]]\npolygon = []", "zone 1: name: got '', expected a text on one line"),
        ('[[zone]]\nname = "a"\npolygon = 3', "(a): polygon: got 3, expected a list of corners [x, y]"),
        (zone((1, 1), (2, 2)), "zone 1 (a): polygon: got 2 corners, expected 3 to 1000"),
        ('[[zone]]\nname = "a"\npolygon = [[1, 2, 3]]', "corner 1: got [1, 2, 3], expected two numbers"),
        (zone((1, 1), (321, 2)), "got [321, 2], expected a place in the picture, from 0, 0 to 320, 240"),
        (zone((1, 1), (9, 9), (9, 1), (1, 9)), "polygon: got edges that cross, 1 and 3, expected a border"),
        (zone((1, 1), (1, 1), (9, 1), (5, 5)), "polygon: got corner 1 twice, expected corners that differ"),
        (zone((1, 1), (5, 5), (9, 9)), "polygon: got corners on one straight line, expected an area"),
        (TRIANGLE + TRIANGLE, "zone 2: name: got 'a' again, expected one that no other has"),
        ('[[line]]\nname = "a"\nfrom = [1, 1]', "line 1 (a): got no 'to', expected a point [x, y]"),
        (line("[1, 1]", "[1, 1]"), "line 1 (a): got one place as both ends, expected a line with a length"),
        (line("[1, 1]", "[2, 2]", 'left_to_right = "right to left"'), "got 'right to left' for both"),
        ("[[zone", "not a TOML file"),
    ],
)  # fmt: skip
def test_whatever_is_wrong_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=r"^--zones: ") as error:
        read_zones(path, SIZE)
    assert str(error.value).startswith(f"--zones: {path}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["=HYPERLINK(1)", "+1", "-1", "@SUM(1)", " =1"])
def test_no_name_is_a_formula_of_a_spreadsheet(name: str, tmp_path: Path) -> None:
    path = tmp_path / "zones.toml"
    path.write_text(f'[[zone]]\nname = "{name}"\npolygon = [[1, 1], [50, 1], [50, 40]]\n')
    with pytest.raises(ValueError, match="takes for a formula"):
        read_zones(path, (64, 48))
