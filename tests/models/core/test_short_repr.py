"""Everything prints itself in a line."""

from xml.etree import ElementTree

import numpy as np
import pytest
from rsmcm.models import PixelLabels
from rsmcm.models.core.short_repr import brief, html_table


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array([1.0, 0.25]), "[1. , 0.25]"),
        (np.zeros((3, 4)), "float64 (3, 4)"),
        ((1, 2), "(1, 2)"),
        (tuple(range(9)), "[9 int]"),
        ([PixelLabels()], "[1 PixelLabels]"),
        ({"one": PixelLabels()}, "{one: PixelLabels(...)}"),
        (
            dict.fromkeys(["background", "blobs", "ground"], PixelLabels()),
            "{background, blobs, ground}",
        ),
        (1 / 3, "0.333333"),
        (PixelLabels, "PixelLabels"),
        ("x" * 100, "str(...)"),
    ],
)
def test_brief(value: object, text: str) -> None:
    assert brief(value) == text


def test_a_table_is_escaped_and_brief() -> None:
    table = html_table("1 < 2", ("a", "b"), [("x & y", np.zeros((3, 4))), ("z", PixelLabels())])
    root = ElementTree.fromstring(table)
    assert root.tag == "table"
    assert [each.text for each in root.iter("caption")] == ["1 < 2"]
    assert [each.text for each in root.iter("td")] == ["x & y", "float64 (3, 4)", "z", repr(PixelLabels())]
