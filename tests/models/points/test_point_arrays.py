"""Points that are neither positions nor missing are refused by name and place."""

import numpy as np
import pytest
from rsmcm.models.points.point_tracks import MAX_COORDINATE, check_points


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((np.inf, 0.0), "finite px"),
        ((0.0, -1.01 * MAX_COORDINATE), "finite px"),
        ((np.nan, 1.0), "both coordinates or none"),
        ((1.0, np.nan), "both coordinates or none"),
    ],
)
def test_damaged_points_are_named(place: tuple[float, float], expected: str) -> None:
    points = np.zeros((3, 4, 2))
    points[0, 0], points[1, 1] = np.nan, MAX_COORDINATE
    check_points("some.npy", points)
    points[2, 3] = place
    if "both" in expected:
        check_points("some.npy", points, allow_single=True)
    else:
        with pytest.raises(ValueError, match=expected):
            check_points("some.npy", points, allow_single=True)
    with pytest.raises(ValueError, match=f"some.npy: got .* at point 3 of frame 2 .*, expected {expected}"):
        check_points("some.npy", points)
