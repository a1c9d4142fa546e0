"""Forward kinematics against a chain of rotations, joint limits against poses that one can imagine."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.models.body.upper_body import PROPORTIONS, BodyPoses, UpperBody

from ...support.body_poses import resting

Direction = tuple[float, float, float]

BODY = UpperBody.from_head(90)


def posed(upper: Direction, forearm: Direction) -> BodyPoses:
    """Two bodies: one with its left arm like this, one with its right arm as in a mirror; the other hangs."""
    arm = np.array([upper, forearm], np.float64)
    arm /= np.linalg.norm(arm, axis=1, keepdims=True)
    poses = resting(np.full((2, 2), 200.0))
    poses.arms[0, 0], poses.arms[1, 1] = arm, arm * [-1, 1, 1]
    return poses


@pytest.mark.parametrize(
    ("upper", "forearm"),
    [
        pytest.param((0.05, 1, 0), (0.05, 1, -0.1), id="hanging"),
        pytest.param((0.15, 0.9, -0.3), (-0.5, 0.5, -0.7), id="hand in the lap"),
        pytest.param((0.1, 0.98, -0.1), (-0.9, 0.2, -0.4), id="hand on the belly"),
        pytest.param((0.1, 0.85, -0.5), (-0.9, -0.1, -0.4), id="arms folded"),
        pytest.param((-0.2, 0.5, -0.8), (-0.85, -0.5, 0.1), id="hand on the other shoulder"),
        pytest.param((0.2, 0.7, -0.6), (-0.4, -0.85, -0.1), id="hand at the mouth"),
        pytest.param((0.8, -0.4, -0.4), (-0.8, -0.6, 0.3), id="hand on the head"),
        pytest.param((0.75, -0.6, -0.2), (-0.7, -0.7, 0), id="hand above the head"),
        pytest.param((0.5, 0.7, -0.4), (0, -0.98, -0.1), id="hand raised beside the head"),
        pytest.param((0.95, 0.1, -0.1), (0.1, -1, -0.1), id="hands up"),
        pytest.param((0.7, -0.6, -0.3), (0.3, -0.9, -0.3), id="up and out"),
        pytest.param((0, 0, -1), (0, 0, -1), id="straight forward"),
        pytest.param((1, 0, 0), (1, 0, 0), id="straight to the side"),
        pytest.param((0.2, 0.9, -0.1), (0.6, 0.1, -0.7), id="open palm"),
        pytest.param((0.8, 0.4, -0.4), (-0.85, 0, -0.5), id="hand before the chest, elbow out"),
        pytest.param((0.6, 0.7, 0.35), (-0.5, 0.6, -0.5), id="hand on the hip"),
        pytest.param((-0.4, 0, -0.9), (-0.8, -0.3, -0.3), id="across the body"),
    ],
)
def test_what_people_do_is_allowed(upper: Direction, forearm: Direction) -> None:
    assert BODY.allowed(posed(upper, forearm)).all()


@pytest.mark.parametrize(
    ("upper", "forearm"),
    [
        pytest.param((-0.8, 0.6, 0.1), (0, 0.5, -0.8), id="elbow inside the torso"),
        pytest.param((0.2, 0.9, -0.1), (-0.95, 0.2, 0.1), id="hand inside the torso"),
        pytest.param((0.2, 0.9, 0.4), (-0.8, 0.3, 0.5), id="hand behind the torso"),
        pytest.param((0, 0.4, 0.9), (0, 0.4, 0.9), id="arm far behind"),
        pytest.param((0.05, 1, 0), (0, 0.3, 0.9), id="forearm bent backwards"),
        pytest.param((1, 0, 0), (0, 0, 1), id="forearm of a raised arm bent backwards"),
        pytest.param((0, 0, -1), (0, 1, 0), id="forearm of a forward arm bent down"),
        pytest.param((0.1, 1, 0), (0.9, 0, 0.4), id="turned too far outwards"),
        pytest.param((0.05, 1, 0), (0, -1, -0.05), id="folded through itself"),
    ],
)
def test_what_nobody_does_is_not_allowed(upper: Direction, forearm: Direction) -> None:
    assert not BODY.allowed(posed(upper, forearm)).any()


def test_necks_turn_half_way_to_the_shoulder() -> None:
    poses = resting(np.zeros((3, 2)))
    poses.necks[:, 1] = np.radians([49, -49, 51])
    np.testing.assert_array_equal(BODY.allowed(poses), [True, True, False])


def test_torsos_lean_half_way_to_the_side_and_heads_go_with_them() -> None:
    poses = resting(np.zeros((4, 2)))
    poses.torsos[:, 1] = np.radians([44, -44, 46, 44])
    poses.necks[:, 1] = np.radians([44, -44, 46, -10])  # the last looks back over the shoulder
    np.testing.assert_array_equal(BODY.allowed(poses), [True, True, False, False])


@pytest.mark.parametrize(
    ("name", "length"),
    [
        ("head_height", 0.0),
        ("neck", -1.0),
        ("hand", np.nan),
        ("forearm", np.inf),
        *zip(PROPORTIONS, [900.0, 1.0] * 6, strict=False),
    ],
)
def test_lengths_that_no_person_has_are_one_line(name: str, length: float) -> None:
    with pytest.raises(ValueError, match=f"^{name}.*{length:g}"):
        replace(BODY, **{name: length})
