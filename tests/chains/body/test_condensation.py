"""CONDENSATION against a Kalman filter, where all is linear and Gaussian, and its contract as a chain."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body.condensation import Condensation
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.inference.engine.protocols import Chain, Incoming, require
from rsmcm.models.body.image_features import BodyImage
from rsmcm.models.body.parts import BodyParts, PartMessage
from rsmcm.models.body.upper_body import BodyPoses, UpperBody
from rsmcm.models.core.frame import Frame
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures

from ...support.body_poses import resting

Array = NDArray[np.float64]

BODY = UpperBody.from_head(50)
FIRST = Frame(np.zeros((240, 320, 3), np.uint8), 0.0, 1)
DT = 0.04
NOISE = 4.0  # px
UNIFORM = GaussianMixtures.uniform(3)
START = replace(resting([[160.0, 120.0]]), arms=np.tile([0.0, 0.8, -0.6], (1, 2, 2, 1)))


@dataclass(frozen=True)
class Seen:
    """Stands for an image, whose likelihood is a Gaussian of the root about `place`."""

    place: Array


class RootLikelihood:
    def __call__(self, image: BodyImage) -> Callable[[BodyPoses], Array]:
        assert isinstance(image, Seen)
        place = image.place

        def of(poses: BodyPoses) -> Array:
            squares: Array = ((poses.roots - place) ** 2).sum(axis=1)
            return -0.5 * squares / NOISE**2 - np.log(2 * np.pi * NOISE**2)

        return of


def told(place: Array | None) -> Incoming:
    return Incoming({BodyParts(50.0): PartMessage(UNIFORM, None if place is None else Seen(place))})  # type: ignore[arg-type]


def chain(samples: int = 500, seed: int = 0) -> Condensation:
    return Condensation(BODY, samples, START, seed, BodyDynamics(BODY, place=2.0), RootLikelihood())


def test_what_joints_forbid_has_no_weight_and_no_children() -> None:
    condensation = chain(2000)
    state = condensation.predict(condensation.initial(FIRST), 0.3)
    allowed = BODY.allowed(state.poses)
    assert 0.02 < allowed.mean() < 0.98
    assert not state.weights[~allowed].any()
    usual = np.exp(BodyDynamics(BODY).log_posture(state.poses.take(allowed)))
    np.testing.assert_allclose(state.weights[allowed], usual / usual.sum())
    after = condensation.update(state, told(START.roots[0]))
    assert not after.weights[~allowed].any()
    assert BODY.allowed(condensation.predict(after, 1e-9).poses).mean() > 0.98


def test_message_has_the_moments_of_the_samples() -> None:
    condensation = chain()
    state = condensation.predict(condensation.initial(FIRST), DT)
    message = condensation.message(state, BodyParts(50.0), Incoming({BodyParts(50.0): PartMessage(UNIFORM)}))
    assert message.image is None
    np.testing.assert_allclose(message.predicted.log_masses, 0, atol=1e-9)
    places = BODY.parts(state.poses)
    mean, _ = message.predicted.moments(1.0, (0, 0))
    np.testing.assert_allclose(mean, np.einsum("n,npx->px", state.weights, places), atol=1e-6)


def test_hears_what_other_chains_say() -> None:
    condensation = chain()
    state = condensation.predict(condensation.initial(FIRST), DT)
    hands = BODY.parts(START)[0]
    said = GaussianMixtures.of_parts([[0.0]] * 3, hands[:, None], [[25 * np.eye(2)]] * 3)
    after = condensation.update(state, Incoming({BodyParts(50.0): PartMessage(said)}))
    factors = said.log_values(BODY.parts(state.poses)).sum(axis=1)
    both = np.isfinite(state.log_weights)
    differences = after.log_weights[both] - state.log_weights[both] - factors[both]
    np.testing.assert_allclose(differences, differences[0], atol=1e-9)
    assert after.log_evidence == pytest.approx(-differences[0])


def test_starts_anywhere_or_from_given_poses() -> None:
    require("chain", chain(), Chain)
    anywhere = replace(chain(400), start=None).initial(FIRST)
    assert len(anywhere.poses) == 400
    assert (anywhere.poses.roots.std(axis=0) > 40).all()
    three = BodyPoses.concatenated([replace(START, roots=START.roots + k) for k in range(3)])
    given = Condensation(BODY, 300, three, likelihood=RootLikelihood()).initial(FIRST)
    assert np.unique(given.poses.roots[:, 0], return_counts=True)[1].tolist() == [100] * 3
    np.testing.assert_allclose(given.weights, 1 / 300)
