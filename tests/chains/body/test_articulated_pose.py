import numpy as np
import pytest
from rsmcm.chains.body.articulated_pose import ArticulatedPose
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference.engine.protocols import Incoming
from rsmcm.models.body.image_features import BodyImage
from rsmcm.models.body.parts import BodyParts, PartMessage
from rsmcm.models.body.upper_body import PARTS, UpperBody
from rsmcm.models.core.frame import Frame
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures

BODY = UpperBody.from_head(90.0)
SIZE = (360, 640)
DT = 0.04
NODE = BodyParts(90.0)
NOTHING = GaussianMixtures.uniform(len(PARTS))
FRAME = Frame(np.zeros((*SIZE, 3), np.uint8), 0.0, 1)


def picture(mixtures):
    """An image that says of the parts what the mixtures say."""
    flat = np.zeros(SIZE, np.float32)
    return BodyImage(flat.shape, None, None, flat, flat, np.zeros((0, 2)), np.zeros(0), mixtures)


def seen(places, spread, chance=0.9):
    """Detections of all parts at `places` `(3, 2)`, which may have failed."""
    covariance = spread**2 * np.eye(2)[None]
    area = SIZE[0] * SIZE[1]
    return GaussianMixtures.of_parts(
        [np.full(1, np.log(chance * area))] * 3,
        list(np.asarray(places)[:, None]),
        [covariance] * 3,
        np.full(3, np.log(1 - chance)),
    )


def by_mixtures(image):
    """The image's likelihood is what its mixtures say, so that everything else can be checked."""
    return lambda poses: image.mixtures.log_values(BODY.parts(poses)).sum(axis=1)


def a_chain(samples=1000, **options):
    return ArticulatedPose(BODY, samples, likelihood=by_mixtures, **options)


def started(chain, seed=0):
    """A state after a first frame that saw the parts of a possible pose, and this pose."""
    random = np.random.default_rng(seed)
    pose = BodyDynamics(BODY).draw_anywhere(1, SIZE, random)
    pose.roots[:] = (320.0, 200.0)
    message = PartMessage(NOTHING, picture(seen(BODY.parts(pose)[0], 5.0, chance=0.9999)))
    return chain.update(chain.initial(FRAME), Incoming({NODE: message})), pose


def test_first_frame_finds_the_parts():
    chain = a_chain()
    state, pose = started(chain)
    found = body_moments(BODY, state)
    assert len(state.poses) == chain.samples
    assert found.joints[[0, 4, 7], :2] == pytest.approx(BODY.parts(pose)[0], abs=6.0)
    # seen for certain in two directions, but for the depth only the arm's length is known
    # in some poses a few samples count, or the other answer with hands exchanged, a little
    spread = np.sqrt(found.joint_covariances[[4, 7]].diagonal(axis1=1, axis2=2))
    assert (spread[:, :2] < 30).all()


def test_posterior_is_that_of_a_bootstrap_filter_with_many_samples():
    """Importance sampling in two ways: from the likelihood, and from the temporal prior."""
    chain = a_chain(6000, dynamics=BodyDynamics(BODY, jumps=0.2))  # the prior's jumps hardly ever fit
    state, _ = started(chain)
    prediction = chain.predict(state, DT)
    random = np.random.default_rng(50)
    target = BODY.parts(prediction.resample(1, random))[0]
    told = GaussianMixtures.of_parts(
        [np.zeros(1)] * 3, list((target + 3.0)[:, None]), [60.0**2 * np.eye(2)[None]] * 3
    )
    message = PartMessage(told, picture(seen(target, 15.0)))
    found = body_moments(BODY, chain.update(prediction, Incoming({NODE: message})))

    past = prediction.ancestors
    ancestors = past.poses.take(random.choice(len(past.poses), 200_000, p=past.weights))
    poses = chain.dynamics.draw(ancestors, DT, random)
    poses = poses.take(BODY.allowed(poses))
    log_weights = by_mixtures(message.image)(poses) + told.log_values(BODY.parts(poses)).sum(axis=1)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    joints = BODY.joints(poses)
    mean = np.einsum("n,njx->jx", weights, joints)
    covariance = np.einsum("n,njx,njy->jxy", weights, joints - mean, joints - mean)
    spread = np.sqrt(covariance.diagonal(axis1=1, axis2=2))
    effective = 1 / (weights**2).sum()
    assert effective > 100
    # some hundred effective samples on our side: six standard errors of the mean
    assert (np.abs(found.joints - mean) < 0.35 * spread + 0.1).all()
    ratio = found.joint_covariances[[0, 4, 7]][:, [0, 1], [0, 1]] / covariance[[0, 4, 7]][:, [0, 1], [0, 1]]
    assert ((ratio > 0.6) & (ratio < 1.6)).all()


def test_nothing_is_invented_when_all_features_fail():
    chain = a_chain()
    state, _ = started(chain)
    prediction = chain.predict(state, DT)
    for message in (PartMessage(NOTHING), PartMessage(NOTHING, picture(NOTHING))):
        after = chain.update(prediction, Incoming({NODE: message}))
        assert after.stationary
        assert np.array_equal(after.poses.roots, prediction.poses.roots)
        assert np.array_equal(after.weights, prediction.weights)
    spreads = []
    for _ in range(20):
        state = chain.update(chain.predict(state, DT), Incoming({NODE: PartMessage(NOTHING)}))
        spreads.append(np.trace(body_moments(BODY, state).joint_covariances[4]))
    assert spreads[-1] > 2 * spreads[0]  # it becomes less sure


def test_a_stationary_chain_still_hears_the_others():
    chain = a_chain()
    state, _ = started(chain)
    prediction = chain.predict(state, 0.2)
    aside = np.einsum("n,npx->px", prediction.weights, BODY.parts(prediction.poses)) + np.array([30.0, 0.0])
    told = GaussianMixtures.of_parts([np.zeros(1)] * 3, list(aside[:, None]), [400.0 * np.eye(2)[None]] * 3)
    after = chain.update(prediction, Incoming({NODE: PartMessage(told)}))
    moved = (body_moments(BODY, after).joints - body_moments(BODY, prediction).joints)[[0, 4, 7], 0]
    assert moved.mean() > 1.5


def test_where_nothing_is_possible_the_prediction_stays():
    """Nothing is known of the past, and poses are drawn from detections that no body reaches."""
    chain = a_chain()
    state = chain.initial(FRAME)
    far = seen([[20.0, 20.0], [20.0, 340.0], [620.0, 20.0]], 1.0, chance=1 - 1e-12)
    after = chain.update(state, Incoming({NODE: PartMessage(NOTHING, picture(far))}))
    assert after.stationary
    assert np.array_equal(after.poses.roots, state.poses.roots)
