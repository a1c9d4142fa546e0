"""Samples, weights and evidence of experts against closed forms, numerical integrals and counted moments."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.experts import Modes, draw_samples, log_likelihood, propagate, resample
from rsmcm.chains.face.pose_terms import PoseDynamics, PosePrior
from rsmcm.chains.face.texture_likelihood import TexturedObject, TextureLikelihood
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.face.surface import SurfaceTexels
from scipy.stats import multivariate_normal, norm

from ...support.surfaces import bilinear, bumpy, level, poses_near, smooth_picture

Array = NDArray[np.float64]

STILL = PoseDynamics(rotation=0.01, translation=0.1, size=0.05, morphs=0.1)
"""Turns so small that their tangent spaces are one."""


def precisions(n: int, d: int, seed: int) -> Array:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(n, d, 2 * d)) * np.r_[np.full(3, 200.0), np.ones(d - 3)][:, None]
    return np.asarray(roots @ np.swapaxes(roots, 1, 2))


@pytest.mark.parametrize("spread", [1.0, 0.3])
def test_samples_have_laplaces_covariance(spread: float) -> None:
    n_samples, modes = 20000, Modes(poses_near(3, 2, 0), precisions(3, 7, 0))
    proposal = draw_samples(modes, n_samples, spread, np.random.default_rng(0))
    changes = proposal.poses.changes_from(modes.poses[proposal.owner]).reshape(3, n_samples, 7)
    density = proposal.log_proposal.reshape(3, n_samples)
    for expert in range(3):
        covariance = spread * np.linalg.inv(modes.precision[expert])
        diagonal = np.diag(covariance)
        bars = np.sqrt((np.outer(diagonal, diagonal) + covariance**2) / n_samples)
        assert (np.abs(np.cov(changes[expert].T) - covariance) < 5 * bars).all()
        assert (np.abs(changes[expert].mean(axis=0)) < 5 * np.sqrt(diagonal / n_samples)).all()
        wanted = multivariate_normal(np.zeros(7), covariance).logpdf(changes[expert][:50])
        np.testing.assert_allclose(density[expert, :50], wanted, atol=1e-6)
    assert proposal.owner.tolist() == sorted(proposal.owner.tolist())


class Gaussian(NamedTuple):
    """A picture that says of translations and morphs: N(middle, inverse of precision), unnormalised."""

    middle: Array
    precision: Array

    def log_likelihood(self, poses: Poses) -> Array:
        off = np.concatenate([poses.translations, poses.morphs], axis=1) - self.middle
        return np.asarray(-0.5 * np.einsum("nd,de,ne->n", off, self.precision, off))

    def modes(self, prior: PosePrior) -> tuple[Modes, Array]:
        """Exact modes, and each expert's log evidence in closed form."""
        previous, walk = prior.mean, prior.variance
        own = np.diag(prior.precision)
        own[3:, 3:] += self.precision
        there = np.concatenate([previous.translations, previous.morphs], axis=1) / walk[3:]
        best = np.linalg.solve(own[3:, 3:], (there + self.precision @ self.middle).T).T
        peak = Poses(previous.rotations, best[:, :2], best[:, 2:])
        variance = 1 / prior.precision[3:]
        mean = variance * there
        off = mean - self.middle
        total = np.linalg.inv(self.precision) + np.diag(variance)
        evidence = -0.5 * np.einsum("nd,nd->n", off, np.linalg.solve(total, off.T).T)
        evidence -= 0.5 * np.linalg.slogdet(total @ self.precision)[1]
        return Modes(peak, np.tile(own, (len(best), 1, 1))), evidence


def toy(seed: int, n: int = 4) -> tuple[PosePrior, Gaussian, Array]:
    random = np.random.default_rng(seed)
    prior = PosePrior.after(poses_near(n, 2, seed), STILL, 24.0, 0.04)
    roots = random.normal(size=(4, 6))
    middle = np.concatenate([prior.mean.translations, prior.mean.morphs], axis=1).mean(axis=0)
    weights = random.dirichlet(np.ones(n))
    return prior, Gaussian(middle, roots @ roots.T), np.asarray(np.log(weights))


def test_going_on_is_exact_for_a_gaussian() -> None:
    prior, picture, log_weights = toy(1)
    modes, evidence = picture.modes(prior)
    found = propagate(log_weights, modes, prior, picture.log_likelihood(modes.poses))
    assert found.log_evidence == pytest.approx(np.logaddexp.reduce(log_weights + evidence), abs=1e-8)
    np.testing.assert_allclose(found.log_weights, log_weights + evidence - found.log_evidence, atol=1e-8)
    assert found.parents.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("spread", [1.0, 2.0])
def test_resampling_keeps_evidence_and_shares(spread: float) -> None:
    prior, picture, log_weights = toy(5)
    modes, evidence = picture.modes(prior)
    random = np.random.default_rng(1)
    repeats, shares, evidences = 60, np.zeros(4), []
    for _ in range(repeats):
        proposal = draw_samples(modes, 200, spread, random)
        found = resample(log_weights, proposal, prior, picture.log_likelihood(proposal.poses), random)
        evidences.append(found.log_evidence)
        shares += np.bincount(found.parents, minlength=4) / 4
        np.testing.assert_allclose(found.log_weights, np.log(0.25))
    wanted = np.logaddexp.reduce(log_weights + evidence)
    ratio = np.exp(np.array(evidences) - wanted)
    assert abs(ratio.mean() - 1) < 5 * ratio.std() / np.sqrt(repeats) + 2e-3
    # systematic resampling draws the four within one of what their weights say
    np.testing.assert_allclose(
        shares / repeats,
        np.exp(log_weights + evidence - wanted),
        atol=5 * 0.25 * 0.5 / np.sqrt(repeats) + 0.01,
    )


def test_likelihood_is_the_mean_density_of_the_effective_pixels() -> None:
    random, model = np.random.default_rng(0), bumpy(2)
    texels = SurfaceTexels.patches(model, 3)
    picture, poses, count = smooth_picture(3), poses_near(3, 2, 3), len(texels)
    likelihood = TextureLikelihood(
        TexturedObject(model, texels),
        [level(picture)],
        random.uniform(50, 200, (2, 1, count)).astype(np.float32),
        random.uniform(30, 90, (2, count)).astype(np.float32),
        random.random((2, count)) < 0.7,
    )
    owner = np.array([1, 0, 1])
    found = log_likelihood(likelihood, poses, owner, 300.0)
    for number in range(3):
        centres = model.project(poses[number])[0][texels.groups[texels.group_of_texel, 0]]
        values, _ = bilinear(picture.astype(np.float32), centres + texels.offsets)
        of = owner[number]
        density = norm(likelihood.mean[of, 0], np.sqrt(likelihood.temperature[of])).logpdf(values)
        assert found[number] == pytest.approx(300 * density[likelihood.visible[of]].mean(), rel=1e-4)
