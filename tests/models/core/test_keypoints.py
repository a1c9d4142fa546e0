"""Points of persons as other libraries give them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models import GivenKeypoints
from rsmcm.models.body.upper_body import JOINTS
from rsmcm.models.core.frame import COCO, KEYPOINTS, POINTS, SKELETONS

Array = NDArray[np.float64]

WRIST = KEYPOINTS.index("left_wrist")


def test_joints_are_those_of_the_body() -> None:
    assert KEYPOINTS[: len(JOINTS)] == JOINTS
    assert list(SKELETONS) == [8, 10, 17, 18, 25, 33]
    assert all(len(set(names)) == len(names) for names in SKELETONS.values())


def of_skeleton(names: tuple[str, ...]) -> Array:
    """Two persons; point k of person p is at (10 k + 5, 100 p + 7), with the score 0.5."""
    rows = np.full((2, len(names), 3), 0.5)
    rows[..., 0] = 10 * np.arange(len(names)) + 5
    rows[..., 1] = 100 * np.arange(2)[:, None] + 7
    return rows


@pytest.mark.parametrize("n_points", list(SKELETONS))
def test_points_are_told_by_how_many_there_are(n_points: int) -> None:
    names = SKELETONS[n_points]
    found = GivenKeypoints.of(of_skeleton(names))
    for place, name in enumerate(KEYPOINTS):
        if name in names:
            np.testing.assert_array_equal(found.positions[:, place, 0], 10 * names.index(name) + 5)
            np.testing.assert_array_equal(found.positions[:, place, 1], [7, 107])
            np.testing.assert_array_equal(found.scores[:, place], 0.5)
        elif name != "head":
            assert np.isnan(found.positions[:, place]).all()
            assert not found.scores[:, place].any()


def face(**places: tuple[float, float]) -> tuple[list[float], float]:
    """Where the head is made of points of the face, and its score; each point has the score 0.8."""
    points = np.full((1, len(POINTS), 3), np.nan)
    for name, place in places.items():
        points[0, POINTS.index(name)] = *place, 0.8
    found = GivenKeypoints.named(points)
    return found.positions[0, 0].tolist(), found.scores[0, 0]


def test_the_head_is_between_eyes_and_ears() -> None:
    eyes = {"left_eye": (12.0, 10.0), "right_eye": (8.0, 10.0)}
    ears = {"left_ear": (14.0, 12.0), "right_ear": (4.0, 12.0)}
    assert face(**eyes, **ears, nose=(3.0, 30.0)) == ([9.5, 11.0], pytest.approx(0.8))
    assert face(**eyes)[0] == [10, 10]
    assert face(left_eye=(12.0, 10.0), left_ear=(20.0, 14.0))[0] == [16, 12], "seen from the side"
    assert face(nose=(3.0, 30.0))[0] == [3, 30]
    assert face(head=(1.0, 2.0), **eyes)[0] == [1, 2], "who finds the head knows better"
    place, score = face(left_wrist=(1.0, 1.0))
    assert np.isnan(place).all()
    assert score == 0


ROWS = of_skeleton(COCO)
XY = ROWS[..., :2].astype(np.float32)  # as supervision and Ultralytics have them


@pytest.mark.parametrize(
    ("found", "n_persons", "score"),
    [
        (ROWS, 2, 0.5),
        (ROWS.tolist(), 2, 0.5),
        (ROWS[0], 1, 0.5),
        (ROWS[..., :2], 2, 1),
        (SimpleNamespace(xy=XY, confidence=ROWS[..., 2].astype(np.float32)), 2, 0.5),
        (SimpleNamespace(xy=XY, confidence=None), 2, 1),
        (SimpleNamespace(xy=XY[:1], conf=ROWS[:1, :, 2].astype(np.float32)), 1, 0.5),
        (SimpleNamespace(xy=np.zeros((0, 17, 2), np.float32)), 0, None),
        (np.zeros((0, 17, 3)), 0, None),
        ([], 0, None),
        ({"left_wrist": (95, 7, 0.5), "left_knee": (1, 1)}, 1, 0.5),
    ],
)
def test_points_come_in_many_forms(found: Any, n_persons: int, score: float | None) -> None:
    taken = GivenKeypoints.of(found)
    assert len(taken) == n_persons
    assert GivenKeypoints.of(taken) is taken
    if n_persons:
        assert taken.positions[0, WRIST].tolist() == [95, 7]
        assert taken.scores[0, WRIST] == score


def test_what_was_not_found() -> None:
    """At 0, 0, without a score, or not a number."""
    rows = ROWS.copy()
    rows[0, 9, :2], rows[0, 10, 2], rows[1, 9, 0] = 0, 0, np.nan
    found = GivenKeypoints.of(rows)
    assert (found.scores[:, WRIST:] > 0).tolist() == [[False, False], [False, True]]
    np.testing.assert_array_equal(np.isnan(found.positions[..., 0]), found.scores == 0)


@pytest.mark.parametrize(
    ("found", "complaint"),
    [
        (np.zeros((2, 16, 3)), r"got \(2, 16, 3\), expected \(n, m, 2\) or \(n, m, 3\), m among 8, 10, 17"),
        (np.ones((17, 4)), r"got \(1, 17, 4\)"),
        ("points", "got str"),
        ({"left_paw": (1, 2)}, "got 'left_paw', expected names such as head, neck"),
        ({"neck": (1,)}, "got a neck that is not x, y"),
        ({"neck": (1, 2, 3, 4)}, "got a neck that is not x, y"),
        (np.full((1, 17, 3), np.inf), "got infinity"),
    ],
)
def test_what_are_no_points(found: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        GivenKeypoints.of(found)
