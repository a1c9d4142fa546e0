"""Loops over texels against plain numpy with a Jacobian a texel, in float64; levels of a picture."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.kernels import OFF_PICTURE
from rsmcm.chains.face.texture_likelihood import (
    SMOOTHING,
    TexturedObject,
    TextureLikelihood,
    blurred,
    image_pyramid,
)
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import SurfaceTexels
from rsmcm.models.numerics.threads import set_threads, thread_count

from ...support.surfaces import bilinear, bumpy, level, poses_near, row_of_texel, smooth_picture, used_on


def uint8(picture: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [24.0, 90.0])
def test_a_point_is_smeared_by_as_much_as_a_level_says(size: float) -> None:
    image = np.zeros((240, 320), np.uint8)
    image[116, 163] = 255
    for number, one in enumerate(image_pyramid(image, size, n_levels=3, local_mean=False)):
        picture = one.image.astype(np.float64)
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
        share = picture / picture.sum()
        x, y = ((there - (one.scale - 1) / 2) / one.scale for there in (x, y))
        middle = np.array([(share * x).sum(), (share * y).sum()])
        # the pixel's own 2 x 2 or 4 x 4 block: its middle may be that much off
        assert np.abs(middle - [163, 116]).max() <= (1 / one.scale - 1) / 2 + 1e-3
        # averaging blocks moves the point, not its spread
        spread = (share * (x - middle[0]) ** 2).sum()
        wanted = (SMOOTHING[number] * size) ** 2
        assert spread == pytest.approx(wanted, rel=0.12, abs=0.1)


def test_light_that_changes_slowly_is_taken_out() -> None:
    size, picture = 24.0, 40 + 0.6 * smooth_picture(2)
    lamp = 0.5 + 0.5 * np.linspace(0, 1, 160)
    even, lit = (
        image_pyramid(uint8(scene), size, n_levels=2, local_mean=True) for scene in (picture, picture * lamp)
    )
    raw, dim = (
        image_pyramid(uint8(scene), size, n_levels=2, local_mean=False) for scene in (picture, picture * lamp)
    )
    for number in range(2):
        left = np.abs(even[number].image - lit[number].image).mean()
        assert left < 0.1 * np.abs(raw[number].image - dim[number].image).mean()


@pytest.mark.parametrize("deviation", [6.0, 40.0])
def test_a_wide_mean_worked_out_small_is_nearly_the_exact_one(deviation: float) -> None:
    picture = smooth_picture(3, 240, 320, 8.0).astype(np.float32)
    wanted = cv2.GaussianBlur(picture, (0, 0), deviation)
    inside = slice(40, -40)
    difference = (blurred(picture, deviation) - wanted)[inside, inside]
    assert np.abs(difference).max() < 2.0


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
