"""Morphable model, poses and surface points against definitions, finite differences and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel, Poses, SurfacePoints, rms_radius
from rsmcm.models.numerics.rotations import exponential
from scipy.spatial.transform import Rotation

from ...support.surfaces import random_poses

Array = NDArray[np.float64]


def known() -> MorphableModel:
    """The built-in face with landmarks, the first two of its deformations said to be identity."""
    return replace(
        face_model(), identity=2, landmarks=np.array([3, -1, 8, 15, 20, 28, 33, 41, -1, 50, 57, 62])
    )


@given(st.integers(0, 10**6))
def test_vertices_are_where_the_paper_has_them(seed: int) -> None:
    model = face_model()
    poses = random_poses(model, 3, seed)
    positions = model.positions(poses)
    np.testing.assert_array_equal(model.project(poses), positions[..., :2])
    for n, i in ((0, 0), (1, 7), (2, model.n_vertices - 1)):
        camera = poses.rotations[n] @ (model.bases[:, i].T @ poses.morphs[n])  # r h_i c
        np.testing.assert_allclose(positions[n, i], camera + np.append(poses.translations[n], 0), atol=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_jacobian_is_the_slope_of_the_projection(seed: int) -> None:
    model = face_model()
    poses = random_poses(model, 2, seed)
    jacobian = model.jacobian(poses)
    assert jacobian.shape == (2, model.n_vertices, 2, poses.dimension)
    for axis, change in enumerate(1e-5 * np.eye(poses.dimension)):
        slope = (model.project(poses.moved(change[None])) - model.project(poses.moved(-change[None]))) / 2e-5
        np.testing.assert_allclose(jacobian[..., axis], slope, atol=2e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"bases": np.zeros((2, 5))},
            r"bases: got shape \(2, 5\), expected shape \(n_bases, n_vertices, 3\)",
        ),
        ({"bases": np.zeros((0, 5, 3))}, r"bases: got \(0, 5, 3\)"),
        ({"bases": np.full((1, 4, 3), np.nan)}, "not finite in basis 0 at vertex 0"),
        ({"triangles": np.array([[0, 1, 2], [0, 1, 4]])}, "triangle 1: got vertex 4, expected 0 to 3"),
        ({"triangles": np.array([[0, 1, -1]])}, "triangle 0: got vertex -1"),
        ({"triangles": np.array([0, 1, 2])}, r"triangles: got shape \(3,\)"),
        ({"triangles": np.zeros((1, 3))}, "triangles: got an array of float64"),
        ({"identity": 2}, "identity: got 2, expected 0 to 1"),
        ({"names": ("one",)}, "names: got 1, expected one for each of 2 bases"),
        ({"landmarks": np.array([0, -1, 4])}, "landmark 2: got vertex 4, expected -1 to 3"),
        ({"landmarks": np.zeros((2, 2), np.int64)}, r"landmarks: got shape \(2, 2\)"),
    ],
)
def test_no_model(changes: dict[str, object], message: str) -> None:
    good = MorphableModel(np.ones((2, 4, 3)), np.array([[0, 1, 2]]))
    with pytest.raises((TypeError, ValueError), match=message):
        replace(good, **changes)


def test_a_persons_model_is_the_model_with_its_identity_held() -> None:
    model = known()
    pose = random_poses(model, 1, 6)
    person = model.personalised(pose.morphs[0])
    assert (person.n_bases, person.identity) == (model.n_bases - 2, 0)
    assert person.names == model.names[:1] + model.names[3:]
    assert rms_radius(person.bases[0]) == pytest.approx(1)
    # the same shapes, in the scale of the person
    held = model.bases[0] + np.einsum("k,kvc->vc", pose.morphs[0, 1:3] / pose.sizes[0], model.bases[1:3])
    expressions = pose.morphs[:, 3:] / pose.sizes[:, None]
    morphs = rms_radius(held) * pose.sizes[:, None] * np.append(np.ones((1, 1)), expressions, axis=1)
    same = Poses(pose.rotations, pose.translations, morphs)
    np.testing.assert_allclose(person.positions(same), model.positions(pose), atol=1e-9)
    with pytest.raises(ValueError, match=r"morphs: got \(2,\)"):
        model.personalised(np.ones(2))


Array = NDArray[np.float64]

seeds = st.integers(0, 10**6)


def turned_poses(n: int, n_bases: int, seed: int) -> Poses:
    random = np.random.default_rng(seed)
    rotations = Rotation.random(n, random_state=seed).as_matrix()
    morphs = 40 * random.normal(size=(n, n_bases))
    morphs[:, 0] = random.uniform(20, 90, n)
    return Poses(rotations, 100 * random.normal(size=(n, 2)), morphs)


@given(seeds, st.integers(1, 4))
def test_changes_lead_from_one_pose_to_the_other(seed: int, n_bases: int) -> None:
    first, second = turned_poses(6, n_bases, seed), turned_poses(6, n_bases, seed + 1)
    changes = second.changes_from(first)
    assert changes.shape == (6, first.dimension) == (6, 5 + n_bases)
    reached = first.moved(changes)
    np.testing.assert_allclose(reached.rotations, second.rotations, atol=1e-12)
    np.testing.assert_allclose(reached.translations, second.translations, atol=1e-9)
    np.testing.assert_allclose(reached.morphs, second.morphs, atol=1e-9)


@given(seeds)
def test_mean_rotation_minimises_the_chordal_distance(seed: int) -> None:
    random = np.random.default_rng(seed)
    middle = Rotation.random(random_state=seed).as_matrix()
    poses = turned_poses(8, 2, seed)
    poses = Poses(exponential(0.4 * random.normal(size=(8, 3))) @ middle, poses.translations, poses.morphs)
    weights = random.uniform(0, 3, 8)
    mean = poses.mean(weights)
    # scipy's mean of unit quaternions is the same optimum
    expected = Rotation.from_matrix(poses.rotations).mean(weights).as_matrix()
    np.testing.assert_allclose(mean.rotations[0], expected, atol=1e-9)
    np.testing.assert_allclose(mean.translations[0], np.average(poses.translations, axis=0, weights=weights))
    np.testing.assert_allclose(mean.morphs[0], np.average(poses.morphs, axis=0, weights=weights))


Array = NDArray[np.float64]


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
