"""Modes of beliefs: where texture and prior say, with their curvature, from afar, in any batch."""

import numpy as np
from numpy.typing import NDArray
from rsmcm.chains.face.experts import find_modes
from rsmcm.chains.face.pose_terms import PoseDynamics, PosePrior
from rsmcm.chains.face.texture_likelihood import TexturedObject, TextureLikelihood, image_pyramid
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import SurfaceTexels

from ...support.surfaces import bumpy, poses_near, smooth_picture

Array = NDArray[np.float64]

EFFECTIVE = 400.0
WEAK = PoseDynamics(rotation=50, translation=50, size=50, morphs=50, size_range=50, morph_range=50)


def learned_at(truth: Poses, n_levels: int = 3, seed: int = 0) -> TextureLikelihood:
    """A picture, and textures that are exactly what it shows at the true poses, one an expert."""
    model = bumpy(truth.morphs.shape[1], seed)
    surface = TexturedObject(model, SurfaceTexels.dense(model, 900))
    image = np.rint(smooth_picture(seed)).astype(np.uint8)
    levels = image_pyramid(image, 24.0, n_levels=n_levels, local_mean=False)
    visible = surface.visible(truth)
    looks, _ = surface.observe(levels, truth, visible)
    return TextureLikelihood(surface, levels, looks, np.full(visible.shape, 36, np.float32), visible)


def vertex_error(likelihood: TextureLikelihood, poses: Poses, truth: Poses) -> Array:
    model = likelihood.surface.model
    off = np.linalg.norm(model.project(poses) - model.project(truth), axis=2)
    return np.asarray(off.mean(axis=1))


def moved_by(poses: Poses, distance: float, seed: int) -> Poses:
    """Poses whose vertices lie about `distance` px away."""
    random = np.random.default_rng(seed)
    change = random.normal(size=(len(poses), poses.dimension))
    change[:, :3] *= 0.02 * distance
    change[:, 3:] *= 0.5 * distance
    return poses.moved(change)


def test_the_true_pose_is_found_from_near() -> None:
    truth = poses_near(6, 3, 1)
    likelihood = learned_at(truth)
    start = moved_by(truth, 1.5, 2)
    prior = PosePrior.after(start, WEAK, 24.0, 1.0)
    modes = find_modes(likelihood, prior, start, EFFECTIVE, 2)
    assert vertex_error(likelihood, start, truth).min() > 0.3
    assert vertex_error(likelihood, modes.poses, truth).max() < 0.05


def test_precision_is_that_of_texture_and_prior_at_the_peak() -> None:
    truth = poses_near(3, 3, 4)
    likelihood = learned_at(truth, 1)
    start = moved_by(truth, 0.7, 5)
    prior = PosePrior.after(start, PoseDynamics(), 24.0, 0.04)
    modes = find_modes(likelihood, prior, start, EFFECTIVE, 0)
    every = np.arange(3)
    there = likelihood.equations(0, modes.poses, every)
    beta = EFFECTIVE / there.sums[:, 2]
    wanted = beta[:, None, None] * there.matrices + np.diag(prior.precision)
    # single precision sums are not quite symmetric, precisions are
    np.testing.assert_allclose(modes.precision, wanted, rtol=1e-5, atol=1e-5 * wanted.max())
    gradient = beta[:, None] * there.vectors + prior.energy(modes.poses, every)[1]
    newton = np.linalg.solve(modes.precision, gradient[..., None])[..., 0]
    left = np.einsum("nvad,nd->nva", there.rows[..., : newton.shape[1]], newton)
    assert np.abs(left).max() < 0.1  # px that are left to go


def test_the_prior_decides_where_there_is_nothing_to_see() -> None:
    truth = poses_near(3, 3, 6)
    likelihood = learned_at(truth)
    blank = [type(one)(np.full_like(one.image, 90), one.scale) for one in likelihood.levels]
    nothing = TextureLikelihood(
        likelihood.surface,
        blank,
        np.full_like(likelihood.mean, 90),
        likelihood.temperature,
        likelihood.visible,
    )
    start = moved_by(truth, 1.0, 7)
    prior = PosePrior.after(truth, PoseDynamics(), 24.0, 0.04)
    modes = find_modes(nothing, prior, start, EFFECTIVE, 2)
    assert vertex_error(likelihood, modes.poses, prior.mean).max() < 0.03
    np.testing.assert_allclose(modes.precision, np.tile(np.diag(prior.precision), (3, 1, 1)), rtol=1e-6)
