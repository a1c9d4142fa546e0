"""An object with texels seen in a picture: the batch against one pose, the model and bilinear values."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.texture_likelihood import TexturedObject, TextureLikelihood
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import SurfaceTexels
from rsmcm.models.numerics.threads import set_threads, thread_count

from ...support.surfaces import bilinear, bumpy, level, poses_near, smooth_picture, used_on

Array = NDArray[np.float64]


def seen_by(n_experts: int, seed: int = 0) -> TextureLikelihood:
    random = np.random.default_rng(seed)
    model = bumpy(4, seed)
    surface = TexturedObject(model, SurfaceTexels.dense(model, 500))
    picture, count = smooth_picture(seed), len(surface.texels)
    return TextureLikelihood(
        surface,
        [level(picture), level(picture[::2, ::2], 0.5)],
        random.uniform(60, 200, (n_experts, 2, count)).astype(np.float32),
        random.uniform(20, 90, (n_experts, count)).astype(np.float32),
        random.random((n_experts, count)) < 0.7,
    )


def test_vertices_and_their_rows_are_the_models() -> None:
    surface = seen_by(1).surface
    poses = poses_near(3, 4, 1, turn=0.5)
    positions, rows, write = surface.rows(poses)
    write(0, len(poses))
    used = np.unique(surface.texels.groups)
    np.testing.assert_allclose(positions, surface.model.project(poses)[:, used], rtol=1e-5)
    np.testing.assert_allclose(surface.positions(poses), positions, rtol=1e-5)
    wanted = surface.model.jacobian(poses)[:, used]
    np.testing.assert_allclose(rows[..., :9], wanted, atol=1e-4)
    assert rows.shape[-1] % 8 == 0
    assert not rows[..., 9:].any()


def test_looks_are_bilinear_values() -> None:
    likelihood = seen_by(3)
    surface, texels, poses = likelihood.surface, likelihood.surface.texels, poses_near(3, 4, 2)
    looks, seen = surface.observe(likelihood.levels, poses, likelihood.visible)
    np.testing.assert_array_equal(seen, likelihood.visible)
    corners = surface.model.project(poses)[:, texels.groups][:, texels.group_of_texel]
    places = np.einsum("nc,pnca->pna", texels.weights, corners)
    for number, one in enumerate(likelihood.levels):
        for pose in range(3):
            there = places[pose] * one.scale + (one.scale - 1) / 2
            used = used_on(texels, number)
            np.testing.assert_allclose(
                looks[pose, number, used], bilinear(one.image, there[used])[0], atol=2e-3
            )


@pytest.mark.parametrize("number", [0, 1])
def test_a_batch_is_each_pose_alone_on_any_number_of_threads(number: int) -> None:
    likelihood = seen_by(2)
    poses, owner = poses_near(7, 4, 3), np.array([0, 1, 1, 0, 1, 0, 0])
    before = thread_count()
    together = []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            together.append(likelihood.equations(number, poses, owner))
    finally:
        set_threads(before)
    for other in together[1:]:
        for name in ("matrices", "vectors", "sums", "rows"):
            np.testing.assert_array_equal(getattr(other, name), getattr(together[0], name))
    for pose in range(7):
        alone = likelihood.equations(number, poses[pose], owner[pose : pose + 1])
        np.testing.assert_array_equal(alone.matrices[0], together[0].matrices[pose])
        np.testing.assert_array_equal(alone.sums[0], together[0].sums[pose])
        alone_sums = likelihood.sums(poses[pose], owner[pose : pose + 1], level=number)
        np.testing.assert_allclose(alone_sums[0, :3], alone.sums[0], rtol=1e-5)


def test_without_triangles_everything_is_visible() -> None:
    model = bumpy(closed=False)
    surface = TexturedObject(model, SurfaceTexels.patches(model, 2))
    assert surface.visible(poses_near(2, 3, 0)).all()


def test_at_the_edge_of_the_picture_every_level_has_to_show_a_texel() -> None:
    likelihood = seen_by(2)
    poses = poses_near(2, 4, 2)
    off = likelihood.surface.positions(poses).min(axis=(0, 1)) + 3.0
    poses = Poses(poses.rotations, poses.translations - off, poses.morphs)
    looks, seen = likelihood.surface.observe(likelihood.levels, poses, likelihood.visible)
    texels = likelihood.surface.texels
    corners = likelihood.surface.model.project(poses)[:, texels.groups][:, texels.group_of_texel]
    places = np.einsum("nc,pnca->pna", texels.weights, corners)
    # pixel 0 of the half-size picture is at 0.5, and its last one at half a pixel from the end
    inside = ((places >= 0.5) & (places <= np.array([158.5, 118.5]))).all(axis=2)
    near = (np.abs(places - 0.5) < 1e-3).any(axis=2)
    np.testing.assert_array_equal(seen[~near], (likelihood.visible & inside)[~near])
    assert (likelihood.visible & ~inside).sum() > 0
    assert looks.shape == (2, 2, len(texels))
