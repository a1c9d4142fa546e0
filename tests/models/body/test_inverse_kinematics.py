"""Inverse kinematics of an arm against forward kinematics and finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.upper_body import REFERENCE, UpperBody, arm_at, log_volume, swivels

Array = NDArray[np.float64]

BODY = UpperBody.from_head(90)
seeds = st.integers(0, 10**6)
sides = st.sampled_from([0, 1])


def units(shape: tuple[int, ...], seed: int) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def hands(arms: Array) -> Array:
    return BODY.upper_arm * arms[:, 0] + BODY.forearm * arms[:, 1]


@given(seeds, sides)
def test_the_hand_gets_there_with_every_swivel(seed: int, side: int) -> None:
    random = np.random.default_rng(seed)
    lengths = random.uniform(abs(BODY.upper_arm - BODY.forearm), BODY.upper_arm + BODY.forearm, 50)
    offsets, wanted = units((50,), seed) * lengths[:, None], random.uniform(-np.pi, np.pi, 50)
    arms, reachable = arm_at(BODY, side, offsets, wanted)
    assert reachable.all()
    np.testing.assert_allclose(np.linalg.norm(arms, axis=-1), 1, atol=1e-9)
    np.testing.assert_allclose(hands(arms), offsets, atol=1e-9 * BODY.forearm)
    # at the ends of the range the elbow's circle shrinks to a point, and the swivel fades
    inner = (lengths > 20) & (lengths < BODY.upper_arm + BODY.forearm - 1)
    np.testing.assert_allclose(swivels(side, arms, BODY)[inner], wanted[inner], atol=1e-9)


@given(seeds, sides)
def test_volume_is_that_of_finite_differences(seed: int, side: int) -> None:
    arms = units((1, 2), seed)
    step = 1e-6
    # two directions across the upper arm, two across the forearm
    across = [np.linalg.svd(arms[0, k][None])[2][1:] for k in range(2)]
    moved = np.tile(arms, (8, 1, 1))
    for number in range(4):
        for sign in (0, 1):
            row = moved[2 * number + sign, number // 2]
            row += (2 * sign - 1) * step * across[number // 2][number % 2]
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    reached = np.column_stack([hands(moved), swivels(side, moved, BODY)])
    change = reached[1::2] - reached[::2]
    change[:, 3] = (change[:, 3] + np.pi) % (2 * np.pi) - np.pi
    volume = abs(np.linalg.det(change / (2 * step)))
    offset = hands(arms)
    # where the swivel turns fast (hand near the shoulder, on the reference axis) differences are too coarse
    along = offset[0] / np.linalg.norm(offset)
    bend = np.linalg.norm(np.cross(arms[0, 0], along))
    if min(np.linalg.norm(offset) / 50, bend, np.linalg.norm(np.cross(along, _axis(side)))) > 0.1:
        np.testing.assert_allclose(np.log(volume), log_volume(BODY, offset)[0], atol=1e-5)


def _axis(side: int) -> Array:
    return REFERENCE * [1 - 2 * side, 1, 1]


@pytest.mark.parametrize("length", [0.0, 1.0, BODY.upper_arm + BODY.forearm + 1, 1e6])
def test_places_out_of_reach_are_told_and_stay_finite(length: float) -> None:
    offsets = length * units((20,), 1)
    arms, reachable = arm_at(BODY, 0, offsets, np.zeros(20))
    assert not reachable.any()
    np.testing.assert_allclose(np.linalg.norm(arms, axis=-1), 1, atol=1e-9)
    assert np.isfinite(log_volume(BODY, offsets)).all()
