"""CONDENSATION against a Kalman filter, where all is linear and Gaussian, and its contract as a chain."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from rsmcm.chains.body.condensation import Condensation
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.samples import BodySamples
from rsmcm.inference.engine.checkpoint import load, save
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


def observed(n: int) -> list[Array | None]:
    """Looks at a root that walks; one frame is missing."""
    random = np.random.default_rng(7)
    walk = START.roots[0] + (2.0 * 50 * np.sqrt(DT)) * random.normal(size=(n, 2)).cumsum(axis=0)
    places: list[Array | None] = list(walk + NOISE * random.normal(size=(n, 2)))
    places[3] = None
    return places


def test_moments_and_evidence_are_those_of_a_kalman_filter() -> None:
    n, runs, samples = 8, 12, 1000
    means, variances, evidence = (np.zeros((runs, n, *shape)) for shape in ((2,), (2,), ()))
    for run in range(runs):
        condensation = chain(samples, seed=run)
        state = condensation.initial(FIRST)
        for t, place in enumerate(observed(n)):
            state = condensation.update(condensation.predict(state, DT), told(place))
            roots = state.poses.roots
            means[run, t] = state.weights @ roots
            variances[run, t] = state.weights @ (roots - means[run, t]) ** 2
            evidence[run, t] = state.log_evidence
    filters = [KalmanFilter(1, 1) for _ in range(2)]
    for k, one in enumerate(filters):
        one.x, one.P = START.roots[0, k : k + 1].reshape(1, 1), np.zeros((1, 1))
        one.H = np.eye(1)
        one.Q, one.R = np.array([[(2.0 * 50) ** 2 * DT]]), np.array([[NOISE**2]])
    for t, place in enumerate(observed(n)):
        expected = 0.0
        for k, one in enumerate(filters):
            one.predict()
            if place is not None:
                one.update(place[k : k + 1])
                expected += one.log_likelihood
            # five standard errors of the mean over runs, each from its own scatter
            for found, exact in ((means[:, t, k], one.x[0, 0]), (variances[:, t, k], one.P[0, 0])):
                assert abs(found.mean() - exact) < 5 * found.std(ddof=1) / np.sqrt(runs) + 1e-9
            assert variances[:, t, k].mean() == pytest.approx(one.P[0, 0], rel=0.15)
        scatter = evidence[:, t].std(ddof=1)
        assert abs(evidence[:, t].mean() - expected) < 5 * scatter / np.sqrt(runs) + scatter**2 + 1e-9


def test_a_missing_image_changes_no_weight() -> None:
    condensation = chain()
    state = condensation.predict(condensation.initial(FIRST), DT)
    after = condensation.update(state, told(None))
    np.testing.assert_array_equal(after.log_weights, state.log_weights)
    np.testing.assert_array_equal(after.poses.roots, state.poses.roots)
    assert after.stationary
    assert after.log_evidence == 0
    assert not condensation.update(after, told(START.roots[0])).stationary


def test_predicting_in_steps_is_predicting_at_once() -> None:
    condensation = chain()
    state = condensation.initial(FIRST)
    whole, steps = condensation.predict(state, 0.4), state
    for _ in range(10):
        steps = condensation.predict(steps, DT)
    np.testing.assert_allclose(steps.poses.angles, whole.poses.angles, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(steps.weights, whole.weights, rtol=1e-9)


def test_states_are_values_and_seeds_decide() -> None:
    def run(seed: int) -> tuple[BodySamples, Array]:
        condensation = chain(seed=seed)
        start = condensation.initial(FIRST)
        before = copy.deepcopy(start.random).random()
        first = condensation.predict(start, DT)
        assert copy.deepcopy(start.random).random() == before
        np.testing.assert_array_equal(condensation.predict(start, DT).poses.arms, first.poses.arms)
        state = condensation.update(first, told(START.roots[0]))
        return state, condensation.predict(state, DT).poses.arms

    np.testing.assert_array_equal(run(3)[1], run(3)[1])
    assert (run(3)[1] != run(4)[1]).any()


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


def test_goes_on_the_same_after_save_and_resume(tmp_path: Path) -> None:
    condensation = chain()
    state = condensation.update(condensation.predict(condensation.initial(FIRST), DT), told(START.roots[0]))
    save(tmp_path / "state", {"state": state}, {"state": BodySamples})
    resumed = load(tmp_path / "state", {"state": BodySamples})["state"]
    one, other = (condensation.predict(each, DT).poses.angles for each in (state, resumed))
    np.testing.assert_array_equal(one, other)


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


def test_errors_name_what_came() -> None:
    with pytest.raises(ValueError, match="samples: got 1, expected 2 or more"):
        Condensation(BODY, 1)
    with pytest.raises(ValueError, match="start: got no poses"):
        Condensation(BODY, start=START.take(slice(0)))
    with pytest.raises(ValueError, match="frame 4: got no image"):
        chain().initial(Frame(None, 0.0, 4))
