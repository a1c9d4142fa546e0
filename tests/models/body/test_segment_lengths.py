"""Segment lengths from joints of bodies of known lengths, seen from the front with noise and gaps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.upper_body import BodyPoses, UpperBody

Array = NDArray[np.float64]

SEGMENTS = ("neck", "shoulder_width", "upper_arm", "forearm")
seeds = st.integers(0, 10**6)


def seen(body: UpperBody, n_frames: int, noise: float, seed: int, lean: float = 0.0) -> Array:
    """`(n_frames, 8, 2)`: joints in the picture of allowed poses, which are equally frequent."""
    random = np.random.default_rng(seed)
    n = 100 * n_frames
    arms = random.normal(size=(n, 2, 2, 3))
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    roots, necks = random.normal(size=(n, 2)), 0.15 * random.normal(size=(n, 3))
    torsos = lean * np.array([1.0, 2.0, 1.0]) * random.normal(size=(n, 3)) if lean else np.zeros((n, 3))
    poses = BodyPoses(roots, torsos, necks, arms)
    poses = poses.take(np.flatnonzero(body.allowed(poses))[:n_frames])
    assert len(poses) == n_frames
    joints = body.joints(poses)[:, :, :2]
    return joints + noise * random.normal(size=joints.shape)


def unusual(seed: int) -> UpperBody:
    """A body whose lengths differ from the usual ones by about a tenth."""
    factors = np.exp(0.1 * np.random.default_rng(seed).normal(size=4))
    usual = UpperBody.from_head(90)
    lengths = {name: getattr(usual, name) * f for name, f in zip(SEGMENTS, factors, strict=True)}
    return replace(usual, **lengths)


def test_lengths_are_found_from_30_noisy_frames() -> None:
    errors = []
    for seed in range(12):
        body = unusual(seed)
        fitted = UpperBody.fit(seen(body, 30, 2.0, seed), np.full(30, 90.0))
        errors.append([np.log(getattr(fitted, name) / getattr(body, name)) for name in SEGMENTS])
    assert np.quantile(np.abs(errors), 0.95) < 0.05
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.03


@settings(max_examples=8, deadline=None)
@given(seeds)
def test_gaps_and_wrong_joints_do_little(seed: int) -> None:
    body, random = unusual(seed), np.random.default_rng(seed + 1)
    joints = seen(body, 40, 2.0, seed)
    joints[random.random((40, 8)) < 0.25] = np.nan
    joints[random.random((40, 8)) < 0.02] += 300
    fitted = UpperBody.fit(joints, np.full(40, 90.0))
    for name in SEGMENTS:
        assert getattr(fitted, name) == pytest.approx(getattr(body, name), rel=0.1)


def test_what_is_never_seen_has_usual_proportions() -> None:
    body = UpperBody.from_head(80)
    joints = seen(body, 20, 0.0, 2)
    joints[:, 2:] = np.nan
    fitted = UpperBody.fit(joints)
    scale = fitted.neck / body.neck
    assert scale == pytest.approx(1, abs=0.05)
    for name in ("head_height", "shoulder_width", "upper_arm", "forearm", "hand", "torso_height"):
        assert getattr(fitted, name) == pytest.approx(scale * getattr(body, name))


def test_head_heights_come_first() -> None:
    joints = seen(UpperBody.from_head(80), 10, 0.5, 5)
    heights = np.full(10, np.nan)
    heights[3:6] = [95, 96, 400]
    assert UpperBody.fit(joints, heights).head_height == 96


def test_joints_that_tell_nothing_are_refused() -> None:
    nothing = np.full((4, 8, 2), np.nan)
    nothing[:, 4] = 7.0
    with pytest.raises(ValueError, match="got no length"):
        UpperBody.fit(nothing)
    with pytest.raises(ValueError, match="infinity"):
        UpperBody.fit(np.full((4, 8, 2), np.inf))
    with pytest.raises(ValueError, match="got a head of 0 px, expected a positive height"):
        UpperBody.fit(np.zeros((4, 8, 2)))
    with pytest.raises(ValueError, match="head of -5 px"):
        UpperBody.fit(nothing, np.full(4, -5.0))


def test_joints_that_no_person_has_are_refused() -> None:
    joints = seen(UpperBody.from_head(90), 30, 1.0, 6)
    for shoulder in (2, 5):
        joints[:, shoulder + 1 : shoulder + 3] += 10 * (joints[:, [shoulder + 1]] - joints[:, [shoulder]])
    with pytest.raises(ValueError, match="upper_arm: got"):
        UpperBody.fit(joints)
