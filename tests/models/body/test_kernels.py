"""Compiled loops over poses against the same formulas in plain numpy, and against closed forms."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.kernels import lean
from rsmcm.models.body.upper_body import LIMITS, REFERENCE, BodyPoses, UpperBody, arm_at, swivels
from scipy.spatial.transform import Rotation

from ...support.body_poses import twists

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BODY = UpperBody.from_head(90.0)
SEEDS = st.integers(0, 2**32 - 1)


def units(shape: tuple[int, ...], random: np.random.Generator) -> Array:
    vectors = random.normal(size=(*shape, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def poses(seed: int, n: int = 200) -> BodyPoses:
    """Half of them anyhow, half with arms before the body, most of which are possible."""
    random = np.random.default_rng(seed)
    arms = random.normal(size=(n, 2, 2, 3))
    near = np.array([[0.3, 0.7, -0.4], [-0.1, 0.1, -0.7]]) * np.array([[[1, 1, 1]], [[-1, 1, 1]]])
    arms[::2] = near + 0.35 * arms[::2]
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    necks = 0.4 * random.normal(size=(n, 3))
    return BodyPoses(random.normal(300, 50, (n, 2)), 0.25 * random.normal(size=(n, 3)), necks, arms)


def torsos_of(given_ones: BodyPoses) -> Array:
    """`(n, 3, 3)`: columns are the axes of the torsos."""
    return np.asarray(Rotation.from_rotvec(given_ones.torsos).as_matrix())


def plain_joints(given_ones: BodyPoses) -> Array:
    vectors = given_ones.necks
    angle = np.sqrt((vectors**2).sum(-1))
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    x, y, z = vectors.T
    down = (versine * y)[:, None] * vectors + np.stack([-sine * z, np.cos(angle), sine * x], axis=1)
    joints = np.zeros((len(given_ones), 8, 3))
    joints[:, :, :2] = given_ones.roots[:, None]
    joints[:, 0] -= BODY.neck * down
    for side in (0, 1):
        shoulder = 2 + 3 * side
        joints[:, shoulder] += (0.5 - side) * BODY.shoulder_width * torsos_of(given_ones)[:, :, 0]
        joints[:, shoulder + 1] = joints[:, shoulder] + BODY.upper_arm * given_ones.arms[:, side, 0]
        joints[:, shoulder + 2] = joints[:, shoulder + 1] + BODY.forearm * given_ones.arms[:, side, 1]
    return joints


def plain_allowed(given_ones: BodyPoses) -> Mask:
    torsos = torsos_of(given_ones)
    heads = torsos.swapaxes(1, 2) @ Rotation.from_rotvec(given_ones.necks).as_matrix()
    allowed = (given_ones.torsos**2).sum(-1) <= LIMITS.torso**2
    allowed &= Rotation.from_matrix(heads).magnitude() <= LIMITS.neck
    arms = np.einsum("nyx,nspy->nspx", torsos, given_ones.arms)
    upper, forearm = arms[:, :, 0], arms[:, :, 1]
    bend = (upper * forearm).sum(-1)
    centre = np.array(LIMITS.swing_centre) / np.linalg.norm(LIMITS.swing_centre)
    centres = np.stack([centre, centre * [-1, 1, 1]])
    allowed &= ((upper * centres).sum(-1) >= np.cos(LIMITS.swing)).all(1)
    allowed &= (bend >= np.cos(LIMITS.elbow)).all(1)
    inwards = twists(arms) * [1, -1]
    within = (inwards >= LIMITS.outwards) & (inwards <= LIMITS.inwards)
    allowed &= (within | (bend > np.cos(LIMITS.straight))).all(1)
    joints = plain_joints(given_ones)[:, [3, 4, 6, 7]]
    joints[:, :, :2] -= given_ones.roots[:, None]
    x, y, z = np.moveaxis(np.einsum("nyx,njy->njx", torsos, joints), -1, 0)
    share = np.clip(y / BODY.torso_height, 0, 1)
    half = 0.5 * (BODY.shoulder_width + share * (BODY.torso_width - BODY.shoulder_width))
    inside = (np.abs(x) < 0.8 * half) & (y > 0) & (y < BODY.torso_height)
    return np.asarray(allowed & ~(inside & (z > -0.45 * BODY.head_height)).any(1))


def plain_circle(side: int, along: Array) -> tuple[Array, Array]:
    """Unit vectors across `along`: to the elbow at swivel 0 and at swivel pi/2."""
    sign = 1 - 2 * side
    reference = REFERENCE * [sign, 1, 1]
    outwards = reference - (along @ reference)[:, None] * along
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    return outwards, sign * np.cross(along, outwards)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_joints_and_parts_are_those_of_plain_arrays(seed: int) -> None:
    given_ones = poses(seed)
    given_ones.necks[:3] = [[0, 0, 0], [1e-10, 0, 0], [3.0, -2.0, 1.0]]
    expected = plain_joints(given_ones)
    np.testing.assert_allclose(BODY.joints(given_ones), expected, atol=1e-11)
    np.testing.assert_allclose(BODY.parts(given_ones), expected[:, [0, 4, 7], :2], atol=1e-11)
    np.testing.assert_allclose(BODY.shoulders(given_ones), expected[:, [2, 5]], atol=1e-11)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_the_same_poses_are_allowed_as_by_plain_arrays(seed: int) -> None:
    given_ones = poses(seed)
    expected = plain_allowed(given_ones)
    assert 5 < expected.sum() < 190
    np.testing.assert_array_equal(BODY.allowed(given_ones), expected)


def test_limits_hold_for_arms_that_point_straight_up() -> None:
    given_ones = poses(0, 8)
    given_ones.torsos[:] = 0.0  # or else they do not point along the torso
    given_ones.arms[:, :, 0] = [0.0, -1.0, 0.0]
    given_ones.arms[:4, 0, 0] = [1e-15, -1.0, 1e-15]
    np.testing.assert_array_equal(BODY.allowed(given_ones), plain_allowed(given_ones))


@given(SEEDS, st.sampled_from([0, 1]))
@settings(max_examples=10, deadline=None)
def test_arms_and_swivels_are_those_of_plain_arrays(seed: int, side: int) -> None:
    random = np.random.default_rng(seed)
    offsets = units((100,), random) * random.uniform(10, 330, (100, 1))
    turns = random.uniform(-20, 20, 100)
    upper, fore = BODY.upper_arm, BODY.forearm
    distance = np.linalg.norm(offsets, axis=1)
    along = offsets / distance[:, None]
    cosine = np.clip((upper**2 + distance**2 - fore**2) / (2 * upper * distance), -1, 1)[:, None]
    outwards, sideways = plain_circle(side, along)
    across = np.cos(turns)[:, None] * outwards + np.sin(turns)[:, None] * sideways
    uppers = cosine * along + np.sqrt(1 - cosine**2) * across
    forearms = offsets - upper * uppers
    forearms /= np.linalg.norm(forearms, axis=1, keepdims=True)
    arms, reachable = arm_at(BODY, side, offsets, turns)
    # near the reference axis the circle's beginning turns fast
    np.testing.assert_allclose(arms, np.stack([uppers, forearms], axis=1), atol=1e-10)
    np.testing.assert_array_equal(reachable, (distance <= upper + fore) & (distance >= abs(upper - fore)))

    arms = units((100, 2), random)
    along = upper * arms[:, 0] + fore * arms[:, 1]
    outwards, sideways = plain_circle(side, along / np.linalg.norm(along, axis=1, keepdims=True))
    expected = np.arctan2((arms[:, 0] * sideways).sum(1), (arms[:, 0] * outwards).sum(1))
    apart = np.exp(1j * swivels(side, arms, BODY)) - np.exp(1j * expected)
    np.testing.assert_allclose(apart, 0, atol=1e-9)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_leaning_vectors_have_the_given_angle_and_go_round(seed: int) -> None:
    random = np.random.default_rng(seed)
    directions, cosines = units((100,), random), random.uniform(-1, 1, 100)
    directions[:2] = [[0, 0, 1], [0, 0, -1]]
    turns = random.uniform(-10, 10, 100)
    leant, further = np.empty((2, 100, 3))
    lean(directions, cosines, turns, leant)
    lean(directions, cosines, turns + 0.5 * np.pi, further)
    np.testing.assert_allclose(np.linalg.norm(leant, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose((leant * directions).sum(1), cosines, atol=1e-11)
    # a quarter of a turn further on is at right angles, across the direction
    sides = [each - cosines[:, None] * directions for each in (leant, further)]
    np.testing.assert_allclose((sides[0] * sides[1]).sum(1), 0, atol=1e-11)
