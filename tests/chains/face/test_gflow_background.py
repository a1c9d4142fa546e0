"""The background terms of G-flow: its own maps, another chain's prediction, and what it says to pixels."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import face
from rsmcm.chains.face.background import (
    NOISE,
    TRUST_TIME,
    UNSEEN,
    WANDERING,
    BackgroundContrast,
    Coverage,
    ExpertBackground,
    OccludedBackground,
    SharedBackground,
    first_trust,
    tone_densities,
    units,
)
from rsmcm.chains.face.experts import log_likelihood
from rsmcm.chains.face.gflow import GFlow
from rsmcm.chains.face.texture_likelihood import (
    UNKNOWN_VARIANCE,
    TexturedObject,
    TextureLikelihood,
    image_pyramid,
)
from rsmcm.chains.pixels.adaptive_background import AdaptiveBackground
from rsmcm.inference.engine.protocols import Incoming
from rsmcm.models.core.frame import Frame
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import Region, SurfaceTexels
from rsmcm.models.pixels.pixel_labels import PixelLabels, PixelMessage

from ...support.surfaces import bumpy, poses_near, smooth_picture

SIZE = (120, 160)
WHOLE = Region(0, 0, *SIZE)
PIXELS = PixelLabels()
DT = 1 / 25


# Units


def test_the_unit_is_the_derivative_of_the_normalisation() -> None:
    image = np.full(SIZE, 90, np.uint8)  # even, so that the local mean is known
    unit = units(image, 24.0, local_mean=True)
    values = [
        image_pyramid(np.full(SIZE, grey, np.uint8), 24.0, n_levels=1, local_mean=True) for grey in (90,)
    ]
    normalised = values[0][0].image[60, 80]
    assert normalised == pytest.approx(128 * 90 / 95, rel=1e-4)
    # the mean held, dy'/dy = 128 / (m + 5)
    np.testing.assert_allclose(unit, np.log(256 * 128 / 95), rtol=1e-5)
    np.testing.assert_allclose(units(image, 24.0, local_mean=False), np.log(256), rtol=1e-6)


def test_tones_are_a_density_over_grey_values() -> None:
    image = np.tile(np.arange(256, dtype=np.uint8), (4, 1))
    where = np.zeros(image.shape, np.bool_)
    where[:, 100:120] = True
    found = np.exp(tone_densities(image, where, Region(0, 0, 4, 256))[0].astype(float)) / 256
    assert found.sum() == pytest.approx(1, abs=0.01)
    assert found[100:120].sum() > 0.6
    assert found[200] == pytest.approx(0.2 / 256, rel=0.01)


# The likelihood


def likelihood_of(image: NDArray[np.uint8], poses: Poses, seed: int) -> TextureLikelihood:
    model = bumpy(3, seed)
    surface = TexturedObject(model, SurfaceTexels.dense(model, 3000))
    n_texels = len(surface.texels)
    levels = image_pyramid(image, 24.0, n_levels=1, local_mean=False)
    mean = np.random.default_rng(seed).uniform(90, 160, (1, 1, n_texels)).astype(np.float32)
    visible = np.ones((1, n_texels), np.bool_)
    return TextureLikelihood(surface, levels, mean, np.full((1, n_texels), 400, np.float32), visible)


def background_of(
    contrast: NDArray[np.float32], trust: float, image: NDArray[np.uint8], model: Any
) -> OccludedBackground:
    trusted = np.full((1, *SIZE), trust, np.float32)
    its_units = units(image, 24.0, local_mean=False)
    image_of_tones = np.zeros(SIZE, np.float32)
    background = BackgroundContrast.of(WHOLE, contrast[None], trusted, image_of_tones, its_units, np.zeros(1))
    return OccludedBackground(background, TexturedObject(model, SurfaceTexels.dense(model, 3000)))


def test_foreground_less_background_is_integrated_over_the_covered_pixels() -> None:
    """Eq. (18), relative to the uniform density, for poses that cover unlike areas of a linear contrast."""
    image = np.rint(smooth_picture(1)).astype(np.uint8)
    poses = poses_near(1, 3, 1)
    poses = Poses.concatenated(
        [Poses(poses.rotations, poses.translations, poses.morphs * s) for s in (0.8, 1.0, 1.2)]
    )
    likelihood = likelihood_of(image, poses, 1)
    model = likelihood.surface.model
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    background = background_of((0.5 + 0.02 * columns - 0.01 * rows).astype(np.float32), 1.0, image, model)
    background = replace(background, covering=np.ones((1, len(background.surface.texels)), np.bool_))
    owner = np.zeros(3, np.int64)
    squares, logs, area, _ = likelihood.sums(poses, owner).T
    found = log_likelihood(likelihood, poses, owner, 400, background) * np.median(area) / 400
    own = -0.5 * (squares + logs + np.log(2 * np.pi) * area)
    corners = model.project(poses)[:, model.triangles]
    edge, other = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    areas = 0.5 * np.abs(edge[..., 0] * other[..., 1] - edge[..., 1] * other[..., 0])
    middles = corners.mean(axis=2)
    hidden = (areas * (0.5 + 0.02 * middles[..., 0] - 0.01 * middles[..., 1])).sum(axis=1)
    expected = own + np.log(256) * area - hidden
    # the texels sample a linear function to a few per mille
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=6e-3)
    assert np.abs(np.diff(hidden)).min() > 50


def test_a_background_that_is_not_known_favours_no_size() -> None:
    image = np.rint(smooth_picture(2)).astype(np.uint8)
    poses = poses_near(6, 3, 3)
    likelihood = likelihood_of(image, poses, 2)
    unknown = background_of(np.full(SIZE, 2.0, np.float32), 0.0, image, likelihood.surface.model)
    background = unknown.around(poses[:1])
    owner = np.zeros(6, np.int64)
    without = log_likelihood(likelihood, poses, owner, 400)
    found = log_likelihood(likelihood, poses, owner, 400, background)
    # the mean density over the covered pixels decides in both; their areas are within a tenth of each other
    assert np.corrcoef(without, found)[0, 1] > 0.99
    assert found.argmax() == without.argmax()


# Maps of experts


def test_maps_are_kalman_filters_of_pixels() -> None:
    random = np.random.default_rng(0)
    images = random.integers(0, 256, (4, *SIZE)).astype(np.uint8)
    region = Region(10, 20, 30, 40)
    hidden = (random.random((4, 2, 30, 40)) < 0.5).astype(np.uint8)
    maps = ExpertBackground.unknown(2, SIZE)
    mean, variance = np.zeros((2, *SIZE)), np.full((2, *SIZE), UNKNOWN_VARIANCE)
    for image, covers in zip(images, hidden, strict=True):
        parents = np.array([1, 0])
        maps = maps.updated(image, parents, covers, region, DT)
        variance = np.minimum(variance[parents] + WANDERING * DT, UNKNOWN_VARIANCE)
        gain = variance / (variance + NOISE)
        gain[:, 10:40, 20:60] *= 1 - covers
        mean = mean[parents] + gain * (image - mean[parents])
        variance = (1 - gain) * variance
    np.testing.assert_allclose(maps.mean, mean, rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(maps.variance, variance, rtol=1e-4)


def test_what_an_expert_never_saw_says_nothing_and_the_rest_is_a_density() -> None:
    random = np.random.default_rng(1)
    image = random.integers(60, 200, SIZE).astype(np.uint8)
    region = Region(30, 40, 50, 60)
    hidden = np.zeros((2, 50, 60), np.uint8)
    hidden[1, 10:40, 10:50] = 1
    maps = ExpertBackground.unknown(2, SIZE).updated(image, np.arange(2), hidden, region, 0.0)
    flat = np.zeros((50, 60), np.float32)
    found = maps.contrast(image, region, flat, units(image, 24.0, local_mean=True), DT)
    assert np.abs(found.log_ratio[1, 10:40, 10:50]).max() < 1e-5
    assert (found.trust[0] > 0.98).all()
    predicted = np.minimum(maps.variance.astype(float) + WANDERING * DT, UNKNOWN_VARIANCE)
    variance = predicted + NOISE
    nats = np.log(256) - 0.5 * (
        np.log(2 * np.pi * variance) + (image - maps.mean.astype(float)) ** 2 / variance
    )
    trust = 1 - predicted / UNKNOWN_VARIANCE
    np.testing.assert_allclose(found.everywhere, (trust * nats).sum(axis=(1, 2)), rtol=1e-4)
    np.testing.assert_allclose(found.log_ratio, (trust * nats)[:, 30:80, 40:100], atol=1e-3)


# A background that is shared


def test_trust_grows_where_predictions_come_true_and_the_object_is_not() -> None:
    scene = np.full(SIZE, 100, np.uint8)
    chain = AdaptiveBackground(follow_light=False)
    state = chain.initial(Frame(scene, 0.0, 1))
    region, hidden = Region(40, 60, 20, 20), np.ones((20, 20), np.bool_)
    trust = first_trust(hidden, region, SIZE)
    changed = scene.copy()
    changed[:20] = 200
    for image, visible in ((scene, ~hidden), (changed, hidden)):
        message = chain.message(state, PIXELS, Incoming({PIXELS: PixelMessage(image=image)}))
        trust = SharedBackground(message * PixelMessage(image=image)).trust_after(trust, ~visible, region, DT)
    left = np.exp(-DT / TRUST_TIME)
    assert (trust[45, 65], trust[60, 5]) == (UNSEEN, pytest.approx(1 - left**2))
    assert trust[5, 5] == pytest.approx((1 - left) * left)


def test_the_layer_is_what_experts_cover() -> None:
    scene = face(1, 0, (192, 128))
    poses = Poses.concatenated(
        [scene.poses, Poses(scene.poses.rotations, scene.poses.translations + 200, scene.poses.morphs)]
    )
    coverage = Coverage.of(scene.model, poses, np.array([0.75, 0.25]), (128, 192))
    (sheet,) = coverage.layers(None).factors
    (record,) = sheet.table
    (top, left), shape = (record[["top", "left"]].tolist(), record[["rows", "columns"]].tolist())
    mask = np.zeros((128, 192))
    mask[top : top + shape[0], left : left + shape[1]] = sheet.pools.masks.reshape(shape)
    inside = scene.foreground(0)
    assert mask[inside].mean() == pytest.approx(0.75, abs=0.01)
    assert not record["coloured"]
    far = cv2.dilate(inside.astype(np.uint8), np.ones((9, 9))) == 0
    assert mask[far][:1].max() == 0


def test_a_tracker_that_knows_nothing_says_nothing() -> None:
    scene = face(2, 0, (192, 128))
    chain = GFlow(scene.model, scene.poses[0], experts=2, texels=300)
    state = chain.initial(scene.frame(0))
    nothing = chain.message(state, PIXELS, Incoming({PIXELS: PixelMessage()}))
    assert not nothing.layers
    assert nothing.image is None
    lost = replace(state, trust=replace(state.trust, doubt=9.0), frames_seen=5)
    others = Incoming({PIXELS: PixelMessage(image=scene.image(0))})
    message = chain.message(lost, PIXELS, others)
    assert lost.lost
    assert not message.layers
    assert message.background is None
