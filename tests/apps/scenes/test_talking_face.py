"""The rendered face: its truth is exact, light and noise are as wanted, and the seed decides all."""

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.scenes import FaceScene, face
from rsmcm.apps.scenes.rendering_kernels import EMPTY_DEPTH, draw_mesh
from rsmcm.apps.scenes.talking_face import FINENESS, SKIN, TEXELS, skin_texels
from rsmcm.models.face.built_in_model import face_model, face_plane

from ...support.scenes import visible

Array = NDArray[np.float64]
PLAIN: dict[str, Any] = {"texture": 0, "light": 0, "noise": 0, "background": 0}


def normals(scene: FaceScene, index: int, fineness: int) -> Array:
    """Unit normals at the vertices of the scene's model, from a mesh of its own."""
    mesh = face_model(fineness, shields=scene.shields)
    corners = mesh.positions(scene.poses[index])[0][mesh.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = np.zeros((mesh.n_vertices, 3))
    for corner in range(3):
        np.add.at(unit, mesh.triangles[:, corner], cross)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return unit[: scene.model.n_vertices]


def at(picture: NDArray[Any], places: Array) -> Array:
    """The picture at `(n, 2)` px, bilinear."""
    x, y = (places[:, axis].astype(np.float32)[None] for axis in range(2))
    seen: Array = cv2.remap(picture.astype(np.float32), x, y, cv2.INTER_LINEAR)[0].astype(np.float64)
    return seen


# Truth


@pytest.mark.parametrize("axis", [0, 1])
def test_the_skin_is_drawn_where_the_truth_has_it(axis: int) -> None:
    # A skin whose grey level is the column (row) of its texel: the picture then says which texel it shows.
    scene, index = face(200, 3, **PLAIN), 60
    columns = np.indices(scene._skin.shape, dtype=np.float32)[1 - axis]
    scene.__dict__["_skin"] = columns
    picture = scene._render(index)[0]
    expected = skin_texels(face_plane(), scene._density)[:, axis]
    inside = cv2.erode(scene.foreground(index).astype(np.uint8), np.ones((7, 7))) > 0
    facing = visible(scene, index) & (normals(scene, index, 4)[:, 2] < -0.5)
    facing &= at(inside, scene.vertices[index]) == 1
    assert facing.sum() > 30
    error = at(picture, scene.vertices[index]) - expected
    # A pixel averages over a facetted, curved surface and is read between pixels: 0.4 px, mean below 0.03.
    assert np.abs(error[facing]).max() < 0.4 * TEXELS
    assert abs(error[facing].mean()) < 0.03 * TEXELS


# Drawing


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000))
def test_the_nearer_triangle_wins_whatever_the_order(seed: int) -> None:
    generator = np.random.default_rng(seed)
    places = generator.uniform(0, 30, (30, 3))
    attributes = np.column_stack([np.zeros((30, 2)), np.repeat(generator.uniform(0.1, 1, 10), 3)])
    triangles = np.arange(30).reshape(10, 3)
    texture = np.ones((2, 2, 1), np.float32)
    pictures = []
    for order in (np.arange(10), generator.permutation(10)):
        grey, depth = np.zeros((30, 30), np.float32), np.full((30, 30), EMPTY_DEPTH, np.float32)
        draw_mesh(grey[..., None], depth, places, attributes, triangles[order], texture)
        pictures.append(grey)
        for row, column in generator.integers(0, 30, (40, 2)):
            nearest, light = EMPTY_DEPTH, 0.0
            for a, b, c in triangles:  # the plain way: solve for barycentric coordinates
                matrix = np.vstack([places[[a, b, c], :2].T, np.ones(3)])
                shares = np.linalg.solve(matrix, [column, row, 1])
                if shares.min() >= 0 and shares @ places[[a, b, c], 2] < nearest:
                    nearest, light = shares @ places[[a, b, c], 2], attributes[a, 2]
            assert grey[row, column] == pytest.approx(light, rel=1e-5)
    np.testing.assert_array_equal(*pictures)


# Light, texture, noise


def test_light_follows_lamberts_law_on_the_true_surface() -> None:
    scene = face(150, 2, **{**PLAIN, "light": 1})
    for index in (0, 70, 149):
        # normals of a mesh twice as fine as the renderer's
        normal = normals(scene, index, 2 * FINENESS)
        direction, gain = scene._lights[0][index], scene._lights[1][index]
        expected = SKIN * gain * (0.4 + 0.75 * np.maximum(normal @ direction, 0))
        inside = cv2.erode(scene.foreground(index).astype(np.uint8), np.ones((7, 7))) > 0
        chosen = visible(scene, index) & (at(inside, scene.vertices[index]) == 1)
        error = at(scene._render(index)[0], scene.vertices[index]) - expected
        # facets turn by up to 20 degrees about the nose: a few grey levels there, less than 2 on average
        assert np.abs(error[chosen]).mean() < 2
    directions, gains = scene._lights
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions[:, 2] < 0).all()  # the lamp is on the viewer's side
    assert np.abs(np.diff(gains)).max() < 0.05
    assert np.ptp(gains) > 0.1


def test_noise_has_the_wanted_deviation_and_is_new_in_every_frame() -> None:
    noise = 5.0
    scene = face(2, 0, noise=noise)
    clean = [scene._render(index)[0] for index in range(2)]
    errors = np.stack([scene.image(index) - clean[index] for index in range(2)])
    # rounding adds 1/12; standard error of the deviation is 1 / sqrt(2 n) of it: 5 of these
    assert errors.std() == pytest.approx(np.sqrt(noise**2 + 1 / 12), rel=5 / np.sqrt(2 * errors.size))
    correlation = np.corrcoef(errors[0].ravel(), errors[1].ravel())[0, 1]
    assert abs(correlation) < 5 / np.sqrt(errors[0].size)


def test_texture_scales_contrast_and_change_moves_it() -> None:
    full, weak = face(3, 0), face(3, 0, texture=0.2)
    assert weak._skin.std() == pytest.approx(0.2 * full._skin.std(), rel=0.02)  # but for clipping
    still, changing = face(300, 0, texture=0.5), face(300, 0, texture=0.5, change=12)
    np.testing.assert_array_equal(still._albedo(0), still._albedo(250))
    drift = np.stack([changing._albedo(index) - still._skin for index in range(0, 300, 10)])
    # eight sines of unequal periods over 12 s: their mean square comes within a quarter
    assert drift.std() == pytest.approx(12, rel=0.25)
    steps = changing._albedo(51) - changing._albedo(50)
    assert 0.2 < steps.std() < 3  # it changes slowly


# Motion


@pytest.mark.parametrize("max_yaw", [35.0, 60.0])
def test_it_turns_as_far_as_wanted(max_yaw: float) -> None:
    turned = [
        np.degrees(np.arcsin(face(200, seed, max_yaw=max_yaw).poses.rotations[:, 2, 0])) for seed in range(8)
    ]
    most = np.abs(turned).max(axis=1)
    assert (most <= max_yaw + 3).all(), "nodding adds a little"
    assert most.max() > 0.8 * max_yaw
