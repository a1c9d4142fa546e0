"""Poses from landmarks: the fit against finite differences, closed forms and known poses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.face.landmark_fit import fit_landmarks
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel, SurfacePoints

from ...support.surfaces import random_poses

Array = NDArray[np.float64]


def known() -> MorphableModel:
    """The built-in face with landmarks, the first two of its deformations said to be identity."""
    return replace(
        face_model(), identity=2, landmarks=np.array([3, -1, 8, 15, 20, 28, 33, 41, -1, 50, 57, 62])
    )


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_poses_are_found_from_all_vertices(seed: int) -> None:
    model = face_model()
    poses = random_poses(model, 4, seed)
    found = fit_landmarks(model, model.project(poses), noise=1e-5)
    np.testing.assert_allclose(model.project(found), model.project(poses), atol=1e-2)
    assert np.abs(found.changes_from(poses)[:, :3]).max() < 1e-3
    np.testing.assert_allclose(found.morphs, poses.morphs, atol=0.1)


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_the_fit_is_where_the_posterior_is_highest(seed: int) -> None:
    model, random = face_model(), np.random.default_rng(seed)
    poses = random_poses(model, 1, seed)
    points = SurfacePoints.of_vertices(random.choice(model.n_vertices, 12, replace=False))
    landmarks = points.project(model, poses)[0] + random.normal(size=(12, 2))
    found = fit_landmarks(model, landmarks, points, noise=0.02)
    # gradients of both parts of the cost point against each other, and their ratio is the noise's variance
    away = landmarks - points.project(model, found)[0]
    jacobian = model.of_points(points).jacobian(found)[0].reshape(24, -1)
    of_landmarks = jacobian.T @ away.ravel()
    shares = found.morphs[0, 1:] / found.sizes[0]
    of_prior = np.zeros_like(of_landmarks)
    of_prior[5] = (shares**2).sum() / found.sizes[0]
    of_prior[6:] = -shares / found.sizes[0]
    ratio = -(of_landmarks @ of_prior) / (of_prior @ of_prior)  # the variance of a landmark
    assert np.sqrt(ratio) / found.sizes[0] == pytest.approx(0.02, rel=0.01)
    np.testing.assert_allclose(of_landmarks, -ratio * of_prior, atol=1e-4 * np.abs(of_landmarks).max() + 1e-4)


def test_frames_are_fitted_each_for_itself() -> None:
    model = face_model()
    poses = random_poses(model, 260, 5, turn=0.3)  # more than one batch
    points = SurfacePoints.of_vertices(np.arange(0, model.n_vertices, 6))
    landmarks = points.project(model, poses)
    landmarks += np.random.default_rng(0).normal(size=landmarks.shape)
    landmarks[7, :5] = np.nan
    landmarks[8, 4, 1] = np.nan  # one coordinate alone says nothing
    found = fit_landmarks(model, landmarks, points)
    for frame in (0, 7, 8, 259):
        alone = fit_landmarks(model, landmarks[frame], points)
        np.testing.assert_allclose(found[frame].changes_from(alone), 0, atol=1e-3)
    kept = np.arange(len(points)) >= 5
    some = SurfacePoints(points.vertices[kept], points.weights[kept], points.offsets[kept])
    np.testing.assert_allclose(
        found[7].changes_from(fit_landmarks(model, landmarks[7, kept], some)), 0, atol=1e-3
    )


def test_the_models_own_landmarks() -> None:
    model = known()
    assert model.landmarks is not None
    poses = random_poses(model, 2, 4, turn=0.2)
    landmarks = np.full((2, 12, 2), 1e3)  # anything where the model has no vertex
    present = model.landmarks >= 0
    points = model.landmark_points(np.flatnonzero(present) + 1)
    np.testing.assert_array_equal(points.vertices[:, 0], model.landmarks[present])
    landmarks[:, present] = points.project(model, poses)
    np.testing.assert_allclose(
        fit_landmarks(model, landmarks).changes_from(fit_landmarks(model, landmarks[:, present], points)),
        0,
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        (np.zeros((5, 3)), r"landmarks: got \(5, 3\), expected \(n_landmarks, 2\) or"),
        (np.zeros((5, 2)), "got 5, but the model has 12 landmarks of its own and"),
        (np.zeros((12, 2)), "frame 0: got all landmarks at one place"),
        (np.full((12, 2), np.nan), "frame 0: got 0 landmarks, expected at least 4"),
        (np.full((12, 2), np.inf), "landmark 0 of frame 0: got infinity"),
    ],
)
def test_landmarks_that_do_not_match(landmarks: Array, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_landmarks(known(), landmarks)
