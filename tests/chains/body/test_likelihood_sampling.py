import numpy as np
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.proposals import draw_from_likelihood
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures

BODY = UpperBody.from_head(90.0)


def weighted(values, log_weights):
    """Mean, its standard error, and the effective number of samples."""
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    mean = np.tensordot(weights, values, 1)
    error = np.sqrt(np.tensordot(weights**2, (values - mean) ** 2, 1))
    return mean, error, 1 / (weights**2).sum()


def mixtures_about(places, spread):
    n_parts = places.shape[1]
    means = places.mean(axis=0)
    covariances = [np.cov(places[:, part].T) + spread**2 * np.eye(2) for part in range(n_parts)]
    return GaussianMixtures.of_parts(
        [np.zeros(1)] * n_parts, list(means[:, None]), [each[None] for each in covariances]
    )


def test_weighted_proposals_are_draws_of_the_static_prior():
    random = np.random.default_rng(7)
    dynamics = BodyDynamics(BODY)
    size = (400, 400)
    direct = dynamics.draw_anywhere(20_000, size, random)
    direct = direct.take(random.random(20_000) < np.exp(dynamics.log_posture(direct)))
    mixtures = mixtures_about(BODY.parts(direct), 60.0)
    proposal = draw_from_likelihood(dynamics, mixtures, 60_000, random)
    prior = dynamics.log_density_anywhere(proposal.poses, size)
    inside = ((proposal.poses.roots >= 0) & (proposal.poses.roots <= 400)).all(axis=1)
    hands = (BODY.joints(proposal.poses)[:, [4, 7]] - BODY.joints(proposal.poses)[:, [1]]).reshape(-1, 6)
    mean, error, effective = weighted(hands[inside], (prior - proposal.log_density)[inside])
    assert effective > 400
    truth = (BODY.joints(direct)[:, [4, 7]] - BODY.joints(direct)[:, [1]]).reshape(-1, 6)
    assert (
        np.abs(mean - truth.mean(axis=0)) < 5 * np.hypot(error, truth.std(axis=0) / np.sqrt(len(truth)))
    ).all()


def test_out_of_reach_there_are_no_poses():
    random = np.random.default_rng(9)
    places = np.array([[[320.0, 90.0], [900.0, 200.0], [270.0, 220.0]]])
    mixtures = mixtures_about(np.repeat(places, 3, axis=0), 2.0)
    proposal = draw_from_likelihood(BodyDynamics(BODY), mixtures, 100, random)
    assert len(proposal.poses) == 0
    assert proposal.log_density.shape == (0,)
