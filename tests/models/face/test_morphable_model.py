"""The morphable model against definitions and finite differences; fits to landmarks that are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel, Poses, rms_radius

Array = NDArray[np.float64]


def random_poses(model: MorphableModel, n: int, seed: int, turn: float = 0.4, morphs: float = 0.7) -> Poses:
    random = np.random.default_rng(seed)
    poses = Poses.upright(random.uniform(50, 200, (n, 2)), random.uniform(20, 90, n), model.n_bases)
    changes = np.zeros((n, poses.dimension))
    changes[:, :3] = turn * random.normal(size=(n, 3))
    changes[:, 6:] = morphs * poses.sizes[:, None] * random.normal(size=(n, model.n_bases - 1))
    return poses.moved(changes)


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
        ({"bases": np.zeros((2, 5))}, r"bases: got \(2, 5\), expected \(n_bases, n_vertices, 3\)"),
        ({"bases": np.zeros((0, 5, 3))}, r"bases: got \(0, 5, 3\)"),
        ({"bases": np.full((1, 4, 3), np.nan)}, "not finite in basis 0 at vertex 0"),
        ({"triangles": np.array([[0, 1, 2], [0, 1, 4]])}, "triangle 1: got vertex 4, expected 0 to 3"),
        ({"triangles": np.array([[0, 1, -1]])}, "triangle 0: got vertex -1"),
        ({"triangles": np.array([0, 1, 2])}, r"triangles: got \(3,\)"),
        ({"triangles": np.zeros((1, 3))}, "triangles: got float64, expected whole numbers"),
        ({"identity": 2}, "identity: got 2, expected 0 to 1"),
        ({"names": ("one",)}, "names: got 1, expected one for each of 2 bases"),
        ({"landmarks": np.array([0, -1, 4])}, "landmark 2: got vertex 4, expected -1 to 3"),
        ({"landmarks": np.zeros((2, 2), np.int64)}, r"landmarks: got \(2, 2\)"),
    ],
)
def test_no_model(changes: dict[str, object], message: str) -> None:
    good = MorphableModel(np.ones((2, 4, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match=message):
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
