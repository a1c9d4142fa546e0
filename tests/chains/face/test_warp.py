"""Fused loops over texels against plain numpy with a Jacobian a texel, in float64, and finite differences."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.kernels import OFF_PICTURE
from rsmcm.chains.face.texture_likelihood import TexturedObject, TextureLikelihood, image_pyramid
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import SurfaceTexels

from ...support.surfaces import bilinear, bumpy, level, poses_near, row_of_texel, smooth_picture, used_on

Array = NDArray[np.float64]

FLOAT32 = 1e-4
"""Of the largest entry: float32 sums over some hundred texels, of places that are good to 1e-5 px."""


class Case(NamedTuple):
    """A picture and textures of two experts, and poses that belong to one or the other."""

    surface: TexturedObject
    likelihood: TextureLikelihood
    poses: Poses
    owner: NDArray[np.int64]
    picture: Array


def case(kind: str, seed: int, scale: float = 1.0) -> Case:
    random = np.random.default_rng(seed)
    model = bumpy(4, seed)
    texels = SurfaceTexels.dense(model, 600) if kind == "dense" else SurfaceTexels.patches(model, 4)
    surface = TexturedObject(model, texels)
    picture = smooth_picture(seed, int(120 * scale), int(160 * scale))
    count = len(texels)
    likelihood = TextureLikelihood(
        surface,
        [level(picture, scale)],
        random.uniform(80, 180, (2, 1, count)).astype(np.float32),
        random.uniform(20, 400, (2, count)).astype(np.float32),
        random.random((2, count)) < 0.8,
    )
    return Case(surface, likelihood, poses_near(3, 4, seed), np.array([0, 1, 1]), picture)


class Explicit(NamedTuple):
    """One pose's sums, texel by texel."""

    matrix: Array
    vector: Array
    sums: Array


def explicit(one: Case, number: int, changed: Poses | None = None, share: int = 1) -> Explicit:
    """What the kernel has to give for pose `number` (or `changed` in its stead)."""
    pose = one.poses[number] if changed is None else changed
    owner, texels = one.owner[number], one.surface.texels
    group = texels.group_of_texel
    corners = one.surface.model.project(pose)[0][texels.groups]
    moves = one.surface.model.jacobian(pose)[0][texels.groups]
    counts = texels.counts
    used = row_of_texel(texels) < -(-counts // share)[group]
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = 0.5 * np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
    areas = np.where(texels.areas > 0, texels.areas * counts, areas) / -(-counts // share)
    places = np.einsum("nc,nca->na", texels.weights, corners[group]) + texels.offsets
    jacobian = np.einsum("nc,ncad->nad", texels.weights, moves[group])
    scale = one.likelihood.levels[0].scale
    values, slopes = bilinear(one.picture.astype(np.float32), places * scale + (scale - 1) / 2)
    rows = np.einsum("na,nad->nd", slopes * scale, jacobian)
    tau = one.likelihood.temperature[owner].astype(np.float64)
    area = areas[group] * one.likelihood.visible[owner] * used
    error = values - one.likelihood.mean[owner, 0]
    weight = area / tau
    return Explicit(
        np.einsum("n,nd,ne->de", weight, rows, rows),
        (weight * error) @ rows,
        np.array([weight @ error**2, area @ np.log(tau), area.sum()]),
    )


def close(found: Array, wanted: Array) -> None:
    np.testing.assert_allclose(found, wanted, atol=FLOAT32 * np.abs(wanted).max(), rtol=FLOAT32)


@pytest.mark.parametrize("kind", ["dense", "patches"])
@pytest.mark.parametrize(("scale", "seed"), [(1.0, 0), (0.5, 1)])
def test_normal_equations_equal_those_of_explicit_jacobians(kind: str, scale: float, seed: int) -> None:
    one = case(kind, seed, scale)
    found = one.likelihood.equations(0, one.poses, one.owner)
    for number in range(3):
        wanted = explicit(one, number)
        unit = 1 / np.sqrt(np.diag(wanted.matrix))  # radians stand beside px
        close(found.matrices[number] * unit * unit[:, None], wanted.matrix * unit * unit[:, None])
        close(found.vectors[number] * unit, wanted.vector * unit)
        np.testing.assert_allclose(found.sums[number], wanted.sums, rtol=FLOAT32)


@pytest.mark.parametrize("kind", ["dense", "patches"])
def test_densities_are_the_sums_of_the_normal_equations(kind: str) -> None:
    one = case(kind, 4)
    background = smooth_picture(5)
    sums = one.likelihood.sums(one.poses, one.owner, background.astype(np.float32))
    np.testing.assert_allclose(sums[:, :3], one.likelihood.equations(0, one.poses, one.owner).sums, rtol=1e-5)
    swapped = one._replace(
        picture=background,
        likelihood=TextureLikelihood(
            one.surface,
            [level(background)],
            np.zeros_like(one.likelihood.mean),
            np.ones_like(one.likelihood.temperature),
            one.likelihood.visible,
        ),
    )
    # the sum of a b is the gradient of the sum of a (b - v)^2 / 2 in a common v
    for number in range(3):
        squares = []
        for lift in (-1.0, 1.0):
            shifted = swapped._replace(picture=background + lift)
            squares.append(explicit(shifted, number).sums[0])
        assert sums[number, 3] == pytest.approx((squares[1] - squares[0]) / 4, rel=FLOAT32)


def test_a_coarse_level_takes_an_even_part_of_every_group() -> None:
    one = case("dense", 1, 0.5)
    coarse = one.likelihood.levels[0]
    mean = np.repeat(one.likelihood.mean, 2, axis=1)
    both = TextureLikelihood(
        one.surface, [coarse, coarse], mean, one.likelihood.temperature, one.likelihood.visible
    )
    found = both.equations(1, one.poses, one.owner)
    for number in range(3):
        wanted = explicit(one, number, share=4)
        np.testing.assert_allclose(found.sums[number], wanted.sums, rtol=FLOAT32)
        unit = 1 / np.sqrt(np.diag(wanted.matrix))
        close(found.vectors[number] * unit, wanted.vector * unit)


@pytest.mark.parametrize(("height", "width"), [(121, 163)])
def test_a_ramp_is_the_same_on_every_level(height: int, width: int) -> None:
    ramp = np.tile(np.arange(width, dtype=np.uint8), (height, 1))
    model = bumpy(2)
    surface = TexturedObject(model, SurfaceTexels.dense(model, 300))
    pose = Poses.upright(np.array([[79.3, 60.2]]), np.array([11.0]), 2)
    for image, axis in ((ramp, 0), (np.arange(height, dtype=np.uint8)[:, None].repeat(width, 1), 1)):
        levels = image_pyramid(image, 11.0, n_levels=3, local_mean=False)
        looks, seen = surface.observe(levels, pose, np.ones((1, len(surface.texels)), np.bool_))
        places = np.einsum(
            "nc,nca->na",
            surface.texels.weights,
            model.project(pose)[0][surface.texels.groups][surface.texels.group_of_texel],
        )
        assert seen.all()
        for number in range(3):
            used = used_on(surface.texels, number)
            np.testing.assert_allclose(looks[0, number, used], places[used, axis], atol=2e-3)


def test_leaving_the_picture_does_not_pay() -> None:
    one = case("patches", 2)
    sums = one.likelihood.equations(0, one.poses, one.owner).sums
    far = Poses(one.poses.rotations, one.poses.translations + np.array([1e4, -1e4]), one.poses.morphs)
    gone = one.likelihood.equations(0, far, one.owner)
    assert not gone.matrices.any()
    assert not gone.vectors.any()
    np.testing.assert_allclose(gone.sums[:, 0], OFF_PICTURE * gone.sums[:, 2], rtol=1e-5)
    np.testing.assert_allclose(gone.sums[:, 1:], sums[:, 1:], rtol=1e-5)  # the same texels, elsewhere
    half = Poses(one.poses.rotations, one.poses.translations + np.array([90.0, 0.0]), one.poses.morphs)
    there = one.likelihood.sums(half, one.owner)
    np.testing.assert_allclose(there[:, 2], sums[:, 2], rtol=1e-5)
    model, texels = one.surface.model, one.surface.texels
    for number in range(3):
        places = model.project(half[number])[0][texels.groups[texels.group_of_texel, 0]] + texels.offsets
        inside = ((places >= 0) & (places <= [159, 119])).all(axis=1)
        off = (~inside & one.likelihood.visible[one.owner[number]]).sum()
        assert off > 0
        assert there[number, 0] > OFF_PICTURE * off


def test_the_last_row_and_column_can_be_sampled() -> None:
    model = bumpy(1, closed=False)
    surface = TexturedObject(model, SurfaceTexels.patches(model, 1))
    picture = smooth_picture(0, 30, 40)
    pose = Poses.upright(np.zeros((1, 2)), np.array([1.0]), 1)
    shift = np.array([39.0, 29.0]) - 1e-4 - model.project(pose)[0][7]
    pose = Poses(pose.rotations, shift[None], pose.morphs)
    looks, seen = surface.observe([level(picture)], pose, np.ones((1, len(surface.texels)), np.bool_))
    own = surface.texels.group_of_texel == 7
    middle = np.flatnonzero((surface.texels.offsets[own] == 0).all(axis=1))
    assert seen[0, own][middle].all()
    assert not seen[0, own][(surface.texels.offsets[own] > 0).any(axis=1)].any()
    assert looks[0, 0, own][middle] == pytest.approx(picture[29, 39], abs=0.1)
