"""What is drawn of a tracked body."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.view.overlay import BEHIND, IN_FRONT, LEFT, RIGHT, BodyOverlay, TrackedBody
from rsmcm.models.body.upper_body import JOINTS, UpperBody

from ...support.body_poses import from_angles

GREY = 90
BODY = UpperBody.from_head(90.0)
REACH = BODY.upper_arm + BODY.forearm
SIZE = (360, 640)
PANEL = round(REACH * (IN_FRONT + BEHIND))
ROOT = PANEL * IN_FRONT / (IN_FRONT + BEHIND)
LEFT_HAND = JOINTS.index("left_hand")


def blank(height: int = SIZE[0], width: int = SIZE[1]) -> NDArray[np.uint8]:
    return np.full((height, width, 3), GREY, np.uint8)


def joints_of(**angles: float) -> NDArray[np.float64]:
    """Of a body in the middle: its left arm reaches towards the viewer, the right one is stretched aside."""
    vector = np.zeros((1, 16))
    vector[0, :2] = 300, 140
    vector[0, 8], vector[0, 10], vector[0, 11] = -0.6, -0.2, angles.get("elbow", 0.9)
    vector[0, 14] = 1.2
    joints: NDArray[np.float64] = BODY.joints(from_angles(vector))[0]
    return joints


def tracked(joints: NDArray[np.float64], spread: float = 5.0, n: int = 40, state: str = "") -> TrackedBody:
    steps = spread * np.random.default_rng(0).standard_normal((n, 8, 3))
    return TrackedBody(joints + steps, joints, np.tile(spread**2 * np.eye(3), (8, 1, 1)), state)


def is_colour(picture: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = (np.abs(picture.astype(int) - colour) <= 12).all(axis=2)
    return found


def test_arms_in_both_views() -> None:
    """Each arm's colour lies along it, in x and y on the frame, and in z and y beside it."""
    joints = joints_of()
    picture = BodyOverlay(REACH).draw(blank(), tracked(joints), "frame 1")
    assert picture.shape == (SIZE[0], SIZE[1] + PANEL, 3)
    for colour, side in ((LEFT, "left"), (RIGHT, "right")):
        there = is_colour(picture, colour)
        for start, end in (("shoulder", "elbow"), ("elbow", "hand")):
            first, second = (joints[JOINTS.index(f"{side}_{name}")] for name in (start, end))
            for share in (0.3, 0.5, 0.7):
                place = first + share * (second - first)
                if side == "left":  # in the side view, the left arm is not below the other
                    assert there[round(place[1]), round(SIZE[1] + ROOT + place[2])]
                column, row = np.rint(place[:2]).astype(int)
                assert there[row - 1 : row + 2, column - 1 : column + 2].any()


def test_regions_hold_90_percent() -> None:
    """Of draws of a Gaussian, by where the ellipse is drawn; one sample far away draws no lines there."""
    joints = joints_of()
    joints[LEFT_HAND, :2] = 520, 250
    covariance = np.array([[400.0, 200.0, 0], [200, 250, 0], [0, 0, 1]])
    covariances = np.tile(np.eye(3), (8, 1, 1))
    covariances[LEFT_HAND] = covariance
    body = TrackedBody(joints[None] + 5000, joints, covariances)
    with_region = BodyOverlay(REACH).draw(blank(), body, "")[:, : SIZE[1]]
    covariances = covariances.copy()
    covariances[LEFT_HAND] = 1e-6 * np.eye(3)
    without = BodyOverlay(REACH).draw(blank(), TrackedBody(joints[None] + 5000, joints, covariances), "")
    outline = (with_region != without[:, : SIZE[1]]).any(axis=2)
    draws = np.random.default_rng(1).multivariate_normal(joints[LEFT_HAND, :2], covariance[:2, :2], 4000)
    angle = np.arctan2(*(np.argwhere(outline) - joints[LEFT_HAND, 1::-1]).T)
    radius = np.hypot(*(np.argwhere(outline) - joints[LEFT_HAND, 1::-1]).T)
    apart = draws - joints[LEFT_HAND, :2]
    edge = np.interp(np.arctan2(apart[:, 1], apart[:, 0]), np.sort(angle), radius[np.argsort(angle)])
    inside = np.mean(np.hypot(*apart.T) < edge)
    assert inside == pytest.approx(0.9, abs=0.03)  # 3 errors of 4000 draws are 0.014; a line has its width


def test_a_body_far_outside_or_unknown() -> None:
    for wrong in (1e5, -1e300, np.nan):
        joints = joints_of() + wrong
        body = TrackedBody(np.tile(joints, (3, 1, 1)), joints, np.full((8, 3, 3), min(abs(wrong), 1e300)))
        picture = BodyOverlay(REACH).draw(blank(), body, "frame 1")
        assert picture.shape[0] == SIZE[0]
