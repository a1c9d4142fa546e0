"""Points on the surface: they are where vertices say, and are attached where they are seen."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel, Poses, SurfacePoints

Array = NDArray[np.float64]


def random_poses(model: MorphableModel, n: int, seed: int, turn: float = 0.4) -> Poses:
    random = np.random.default_rng(seed)
    poses = Poses.upright(random.uniform(50, 200, (n, 2)), random.uniform(30, 90, n), model.n_bases)
    changes = np.zeros((n, poses.dimension))
    changes[:, :3] = turn * random.normal(size=(n, 3))
    changes[:, 6:] = 0.5 * poses.sizes[:, None] * random.normal(size=(n, model.n_bases - 1))
    return poses.moved(changes)


@given(st.integers(0, 10**6))
def test_points_are_weighted_means_of_their_vertices_and_offsets_turn_along(seed: int) -> None:
    model, random = face_model(), np.random.default_rng(seed)
    vertices = random.integers(model.n_vertices, size=(7, 3))
    weights, offsets = random.dirichlet(np.ones(3), 7), random.normal(size=(7, 3))
    points, poses = SurfacePoints(vertices, weights, offsets), random_poses(model, 3, seed)
    on_surface = np.einsum("ja,njac->njc", weights, model.positions(poses)[:, vertices])
    off = np.einsum("n,nab,jb->nja", poses.sizes, poses.rotations, offsets)
    np.testing.assert_allclose(model.of_points(points).positions(poses), on_surface + off, atol=1e-9)
    np.testing.assert_allclose(points.project(model, poses), (on_surface + off)[..., :2], atol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_attached_points_are_where_they_were_seen(seed: int) -> None:
    model, random = face_model(), np.random.default_rng(seed)
    pose = random_poses(model, 1, seed, turn=0.7)
    # on the object and far beside it
    places = pose.translations + 1.5 * pose.sizes[0] * random.normal(size=(60, 2))
    points = SurfacePoints.attached(model, pose, places)
    np.testing.assert_allclose(points.project(model, pose)[0], places, atol=1e-8)
    np.testing.assert_allclose(points.weights.sum(axis=1), 1)
    assert points.weights.min() >= -1e-12
    # what is missing lies in the plane of the picture
    np.testing.assert_allclose((points.offsets @ pose.rotations[0].T)[:, 2], 0, atol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_beside_the_silhouette_nothing_of_the_surface_is_nearer(seed: int) -> None:
    model, random = face_model(), np.random.default_rng(seed)
    pose = random_poses(model, 1, seed)
    places = pose.translations + 2 * pose.sizes[0] * random.normal(size=(40, 2))
    points = SurfacePoints.attached(model, pose, places)
    distance = pose.sizes[0] * np.linalg.norm(points.offsets, axis=1)
    weights = random.dirichlet(0.5 * np.ones(3), (20, len(model.triangles)))
    surface = np.einsum("sta,tac->stc", weights, model.project(pose)[0][model.triangles]).reshape(-1, 2)
    nearest = np.linalg.norm(places[:, None] - surface, axis=2).min(axis=1)
    assert (distance <= nearest + 1e-9).all()


def test_the_front_most_surface_is_taken() -> None:
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    shape = np.concatenate([square, 0.3 * square - [0, 0, 0.5]])
    halves = np.array([[0, 2, 1], [0, 3, 2]])
    model = MorphableModel(shape[None], np.concatenate([halves, halves + 4]))
    pose = Poses.upright(np.array([[50.0, 60.0]]), np.array([20.0]), 1)
    places = np.array([[51.0, 62.0], [45.0, 57.0], [58.0, 62.0], [80.0, 60.0]])
    points = SurfacePoints.attached(model, pose, places)
    np.testing.assert_allclose(model.of_points(points).positions(pose)[0, :, 2], [-10, -10, 0, 0], atol=1e-9)
    np.testing.assert_allclose(points.offsets, [[0, 0, 0]] * 3 + [[0.5, 0, 0]], atol=1e-12)


def test_attached_refuses() -> None:
    model = face_model()
    poses, places = random_poses(model, 2, 0), np.full((3, 2), 70.0)
    with pytest.raises(ValueError, match="one pose"):
        SurfacePoints.attached(model, poses, places)
    with pytest.raises(ValueError, match="a model with triangles"):
        SurfacePoints.attached(model.of_points(SurfacePoints.of_vertices([1, 2])), poses[0], places)
    with pytest.raises(ValueError, match=r"places: got \(3,\)"):
        SurfacePoints.attached(model, poses[0], places[:, 0])
    places[1, 0] = np.nan
    with pytest.raises(ValueError, match=r"place 1: got \[nan, 70.0\], expected finite px"):
        SurfacePoints.attached(model, poses[0], places)
