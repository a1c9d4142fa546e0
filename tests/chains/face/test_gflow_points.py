"""G-flow and a tracker of single points over one feature node: vertices that somebody else has found, too."""

import numpy as np
import pytest
from rsmcm.chains.face.pose_terms import PoseDynamics, PosePrior, measured_points, predicted_points
from rsmcm.models.core.gaussian_message import GaussianMessage

from ...support.surfaces import bumpy, poses_near


def test_predicted_points_have_the_moments_of_the_mixture() -> None:
    model, previous = bumpy(3, 1), poses_near(3, 3, 2)
    prior = PosePrior.after(previous, PoseDynamics(), 24.0, 1e-4)
    weights, chosen = np.array([0.5, 0.3, 0.2]), np.array([2, 7, 11])
    identities, means, covariances = predicted_points(model, prior, weights, chosen).moments
    random = np.random.default_rng(0)
    n = 200_000
    owner = random.choice(3, n, p=weights)
    changes = random.normal(size=(n, previous.dimension)) * np.sqrt(prior.variance)
    samples = model.project(prior.mean[owner].moved(changes))[:, chosen]
    np.testing.assert_array_equal(identities, chosen)
    np.testing.assert_allclose(means, samples.mean(axis=0), atol=0.05)
    for k in range(3):
        np.testing.assert_allclose(covariances[k], np.cov(samples[:, k].T), rtol=0.03, atol=0.1)


def test_measured_points_are_those_of_the_message_that_were_chosen() -> None:
    model, pose = bumpy(3, 1), poses_near(1, 3, 2)
    random = np.random.default_rng(1)
    numbers = np.array([1, 4, 9])
    means, covariances = random.uniform(50, 90, (3, 2)), np.array([[[2.0, 0.5], [0.5, 1.0]]] * 3)
    message = GaussianMessage.from_moments(numbers, means, covariances)
    terms = measured_points(model, message, np.array([4, 9, 13]))
    off = model.project(pose)[0][[4, 9]] - means[1:]
    expected = 0.5 * np.einsum("na,ab,nb", off, np.linalg.inv(covariances[0]), off)
    assert terms.equations(pose, np.zeros(1, np.int64))[0] == pytest.approx(expected)
