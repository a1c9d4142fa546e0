"""Forward kinematics against a chain of rotations, joint limits against poses that one can imagine."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.models.body.upper_body import JOINTS, PROPORTIONS, BodyPoses, UpperBody
from scipy.spatial.transform import Rotation

from ...support.body_poses import from_angles, resting

Direction = tuple[float, float, float]

BODY = UpperBody.from_head(90)
seeds = st.integers(0, 10**6)


def posed(upper: Direction, forearm: Direction) -> BodyPoses:
    """Two bodies: one with its left arm like this, one with its right arm as in a mirror; the other hangs."""
    arm = np.array([upper, forearm], np.float64)
    arm /= np.linalg.norm(arm, axis=1, keepdims=True)
    poses = resting(np.full((2, 2), 200.0))
    poses.arms[0, 0], poses.arms[1, 1] = arm, arm * [-1, 1, 1]
    return poses


@given(seeds)
def test_joints_are_where_a_chain_of_rotations_leads(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-1.5, 1.5, (1, 16))
    joints = BODY.joints(from_angles(angles))[0]
    root = np.array([*angles[0, :2], 0.0])
    torso, neck = (Rotation.from_rotvec(angles[0, run]) for run in (slice(2, 5), slice(5, 8)))
    head = root + neck.apply([0, -BODY.neck, 0])
    expected = [head, root]
    for first, sign in ((8, 1), (12, -1)):
        shoulder = Rotation.from_rotvec(angles[0, first : first + 3])
        elbow = shoulder * Rotation.from_rotvec([-angles[0, first + 3], 0, 0])
        expected.append(root + torso.apply([sign * BODY.shoulder_width / 2, 0, 0]))
        expected.append(expected[-1] + shoulder.apply([0, BODY.upper_arm, 0]))
        expected.append(expected[-1] + elbow.apply([0, BODY.forearm, 0]))
    np.testing.assert_allclose(joints, expected, atol=1e-10)
    assert len(JOINTS) == len(expected)


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


@given(seeds)
def test_limits_do_not_depend_on_side_nor_place_nor_size(seed: int) -> None:
    random = np.random.default_rng(seed)
    arms = random.normal(size=(50, 2, 2, 3))
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    turns = random.normal(size=(2, 50, 3)) * [[[0.2]], [[0.4]]]
    poses = BodyPoses(np.zeros((50, 2)), turns[0], turns[1], arms)
    mirrored = BodyPoses(poses.roots + 70, *(turns * [1, -1, -1]), arms[:, ::-1] * [-1, 1, 1])
    allowed = BODY.allowed(poses)
    np.testing.assert_array_equal(BODY.allowed(mirrored), allowed)
    np.testing.assert_array_equal(UpperBody.from_head(33).allowed(poses), allowed)


def test_torsos_lean_half_way_to_the_side_and_heads_go_with_them() -> None:
    poses = resting(np.zeros((4, 2)))
    poses.torsos[:, 1] = np.radians([44, -44, 46, 44])
    poses.necks[:, 1] = np.radians([44, -44, 46, -10])  # the last looks back over the shoulder
    np.testing.assert_array_equal(BODY.allowed(poses), [True, True, False, False])


@given(seeds)
def test_the_turn_of_a_straight_arm_is_not_judged(seed: int) -> None:
    upper = np.array([0.4, 0.5, -0.7]) / np.linalg.norm([0.4, 0.5, -0.7])
    forearm = upper + 0.02 * np.random.default_rng(seed).normal(size=3)
    assert BODY.allowed(posed((upper[0], upper[1], upper[2]), (forearm[0], forearm[1], forearm[2]))).all()


@pytest.mark.parametrize("name", ["head_height", *PROPORTIONS])
@pytest.mark.parametrize("length", [0, -1, float("nan"), float("inf")])
def test_segments_without_a_length_are_refused(name: str, length: float) -> None:
    with pytest.raises(ValueError, match=f"{name} must be a positive length in px, got"):
        replace(BODY, **{name: length})


@pytest.mark.parametrize("factor", [10, 0.1])
@pytest.mark.parametrize("name", list(PROPORTIONS))
def test_lengths_that_no_person_has_are_refused(name: str, factor: float) -> None:
    with pytest.raises(ValueError, match=f"{name} is impossible: .* px beside a head of 90 px"):
        replace(BODY, **{name: getattr(BODY, name) * factor})
