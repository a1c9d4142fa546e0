"""The built-in face: conventions of a morphable model, one surface at any fineness, no fold anywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.built_in_model import (
    MIDDLE,
    SIDE,
    face_model,
)
from rsmcm.models.face.morphable_model import MorphableModel

Array = NDArray[np.float64]


def landmarks() -> dict[str, int]:
    """Vertex numbers by name, in a model of any fineness; "left" and "right" as the picture shows it."""
    numbers = {name: number for number, name in enumerate(MIDDLE)}
    for number, name in enumerate(SIDE):
        numbers[f"right {name}"] = len(MIDDLE) + number
        numbers[f"left {name}"] = len(MIDDLE) + len(SIDE) + number
    return numbers


def normals(model: MorphableModel, morphs: Array) -> Array:
    """Unit normals of the triangles, `(n_triangles, 3)`, in the object's axes."""
    corners = np.tensordot(morphs, model.bases, 1)[model.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit: Array = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    return unit


@pytest.mark.parametrize("fineness", [1, 2, 3, 4])
def test_a_mesh_is_one_oriented_disc(fineness: int) -> None:
    triangles = face_model(fineness).triangles
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)  # neighbours run along an edge in opposite ways
    edges, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    assert triangles.max() + 1 - len(edges) + len(triangles) == 1  # Euler: a disc
    rim = edges[uses == 1]
    assert (np.unique(rim, return_counts=True)[1] == 2).all()
    assert len(triangles) == fineness**2 * len(face_model().triangles)


@pytest.mark.parametrize("shields", [False, True])
@pytest.mark.parametrize("fineness", [1, 3])
@settings(deadline=None, max_examples=10)
@given(strengths=st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5))
def test_everything_faces_the_viewer_whatever_the_expression(
    fineness: int, shields: bool, strengths: list[float]
) -> None:
    # A height field over the picture cannot cut itself.
    model = face_model(fineness, shields=shields)
    assert normals(model, np.array([1.0, *strengths]))[:, 2].max() < 0


def test_left_mirrors_right() -> None:
    model, numbers = face_model(), landmarks()
    mirror = np.array([-1.0, 1.0, 1.0])
    pairs = [(number, numbers[f"left {name[6:]}"]) for name, number in numbers.items() if "right" in name]
    right, left = np.array(pairs).T
    even = [i for i, name in enumerate(model.names) if name != "mouth aside"]
    # "atol": 1e-15 from sums in another order
    np.testing.assert_allclose(model.bases[even][:, left], model.bases[even][:, right] * mirror, atol=1e-15)
    assert (model.bases[0, right, 0] > 0).all()
