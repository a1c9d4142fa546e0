"""Generic chains through the engine: against filterpy, a sum over all paths, and a Kalman filter."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from rsmcm.chains import DiscreteChain, LinearGaussianChain, ParticleChain
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import Categorical, Frame, GaussianFeature, GaussianMessage, PointTracks

Numbers = NDArray[np.float64]
DT = 0.04
TIMES = np.array([0.0, 0.04, 0.08, 0.2, 0.24, 0.28, 0.4])
MISSING = 3


def frames(values: NDArray[Any]) -> list[Frame]:
    """A frame of one pixel each; one is missing."""
    return [
        Frame(None if k == MISSING else np.full((1, 1), value, np.uint8), time, k + 1)
        for k, (value, time) in enumerate(zip(values, TIMES, strict=True))
    ]


def transition_of(dt: float) -> Numbers:
    return np.array([[1, dt], [0, 1]])


def noise_of(dt: float) -> Numbers:
    return 50.0 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


H, R, NOISE = np.array([[1.0, 0.3]]), np.array([[2.0]]), 3.0
MEAN, COVARIANCE = np.array([100.0, -20.0]), np.array([[400.0, 30.0], [30.0, 900.0]])


def level(noise: float = NOISE) -> GaussianFeature:
    """A feature whose value is the grey of the picture, with a variance of `noise`."""

    def measure(frame: Frame) -> GaussianMessage:
        assert frame.image is not None
        value = float(frame.image[0, 0])
        scale = np.array([-0.5 * (value**2 / noise + np.log(2 * np.pi * noise))])
        return GaussianMessage(
            np.zeros(1, np.int64), np.full((1, 1, 1), 1 / noise), np.full((1, 1), value / noise), scale
        )

    return GaussianFeature("level", 1, measure)


def kalman(values: NDArray[Any]) -> list[tuple[Numbers, Numbers, float]]:
    """Mean, covariance and log likelihood after each frame, by filterpy."""
    one = KalmanFilter(2, 1)
    one.x, one.P, one.H, one.R = MEAN[:, None], COVARIANCE.copy(), H, R + NOISE
    found = []
    for k, value in enumerate(values):
        if k:
            dt = TIMES[k] - TIMES[k - 1]
            one.predict(F=transition_of(dt), Q=noise_of(dt))
        log_likelihood = 0.0
        if k != MISSING:
            one.update(np.array([[float(value)]]))
            log_likelihood = one.log_likelihood
        found.append((one.x[:, 0].copy(), one.P.copy(), log_likelihood))
    return found


def levels(seed: int) -> NDArray[Any]:
    return np.random.default_rng(seed).integers(60, 140, len(TIMES))


def linear(**options: Any) -> LinearGaussianChain:
    prior: dict[str, Any] = {"initial_mean": MEAN, "initial_covariance": COVARIANCE, "identities": (0,)}
    return LinearGaussianChain(transition_of, noise_of, H, R, features=GaussianFeature, **prior | options)


@pytest.mark.parametrize("seed", range(3))
def test_linear_gaussian_chain_is_the_kalman_filter(seed: int) -> None:
    values = levels(seed)
    engine = RecursiveBP(MultiChain().connect(linear(), level()))
    for belief, (mean, covariance, log_likelihood) in zip(
        engine.run(frames(values)), kalman(values), strict=True
    ):
        np.testing.assert_allclose(belief["kalman"].mean[0], mean, rtol=1e-9)
        np.testing.assert_allclose(belief["kalman"].covariance[0], covariance, rtol=1e-9)
        assert belief.log_evidence == pytest.approx(log_likelihood, abs=1e-9)


def test_things_begin_and_end_and_keep_apart() -> None:
    chain = linear(identities=(), max_coast_time=0.1)
    state = chain.initial(Frame(None, 0.0, 1))
    mean, spread = np.array([[5.0], [9.0]]), np.full((2, 1, 1), NOISE)
    state = chain.condition(state, GaussianMessage.from_moments([7, 3], mean, spread))
    alone = chain.condition(
        chain.initial(Frame(None, 0.0, 1)), GaussianMessage.from_moments([3], mean[1:], spread[1:])
    )
    assert state.identities.tolist() == [3, 7]
    np.testing.assert_allclose(state.mean[0], alone.mean[0])
    np.testing.assert_allclose(state.covariance[0], alone.covariance[0])
    again = GaussianMessage.from_moments([7], mean[:1], spread[:1])
    for _ in range(3):
        state = chain.condition(chain.predict(state, DT), again)
    assert state.identities.tolist() == [7]
    # a feature that is known in one direction only: the same as a measurement of that direction
    plane = LinearGaussianChain(
        np.eye(2),
        np.eye(2),
        None,
        None,
        features=PointTracks,
        initial_mean=MEAN,
        initial_covariance=COVARIANCE,
    )
    flat = GaussianMessage(np.array([0]), np.diag([0.5, 0.0])[None], np.array([[60.0, 0.0]]), np.zeros(1))
    after = plane.condition(plane.initial(Frame(None, 0.0, 1)), flat)
    gain = COVARIANCE[:, 0] / (COVARIANCE[0, 0] + 2)
    np.testing.assert_allclose(after.mean[0], MEAN + gain * (120 - MEAN[0]))
    np.testing.assert_allclose(after.covariance[0], COVARIANCE - np.outer(gain, COVARIANCE[0]))


def table(random: np.random.Generator, *shape: int) -> Numbers:
    rows = random.random(shape) + 0.05
    return rows / rows.sum(axis=-1, keepdims=True)


@pytest.mark.parametrize("seed", range(3))
def test_discrete_chain_is_the_forward_pass(seed: int) -> None:
    """Sums over all paths of states and values of the feature, through the engine."""
    random = np.random.default_rng(seed)
    prior, rates, emission, shown = (
        table(random, 3),
        table(random, 3, 3),
        table(random, 3, 2),
        table(random, 2, 4),
    )
    values = random.integers(0, 4, len(TIMES))

    def transition(dt: float) -> Numbers:
        return np.exp(-dt) * np.eye(3) + (1 - np.exp(-dt)) * rates

    def look(frame: Frame) -> Numbers:
        assert frame.image is not None
        return np.log(shown[:, frame.image[0, 0]])

    chain = DiscreteChain(transition, initial_probabilities=prior, emission=emission)
    beliefs = list(RecursiveBP(MultiChain().connect(chain, Categorical("f", 2, look))).run(frames(values)))
    total_before = 1.0
    for n in range(1, 5):
        weights = np.zeros(3)
        for path in product(range(3), repeat=n):
            weight = prior[path[0]]
            for k in range(1, n):
                weight *= transition(TIMES[k] - TIMES[k - 1])[path[k - 1], path[k]]
            for k in range(n):
                weight *= 1.0 if k == MISSING else emission[path[k]] @ shown[:, values[k]]
            weights[path[-1]] += weight
        belief = beliefs[n - 1]
        np.testing.assert_allclose(belief["discrete"].probabilities, weights / weights.sum(), rtol=1e-12)
        assert belief.log_evidence == pytest.approx(np.log(weights.sum() / total_before), abs=1e-12)
        total_before = weights.sum()


def test_discrete_chain_of_functions_speaks_to_any_feature() -> None:
    def message_of(probabilities: Numbers, feature: GaussianFeature) -> GaussianMessage:
        mean = 100 * probabilities[1:]
        return GaussianMessage.from_moments([0], [mean], [[[1e4 * probabilities[1] * probabilities[0] + 1]]])

    def log_likelihood(message: GaussianMessage, feature: GaussianFeature) -> Numbers:
        at = np.array([0.0, 100.0])
        if not len(message):
            return np.zeros(2)
        return message.vector[0] * at - 0.5 * message.information[0, 0] * at**2

    stays = np.array([[0.9, 0.1], [0.2, 0.8]])
    chain = DiscreteChain(stays, message_of, log_likelihood, features=GaussianFeature)
    values = np.array([100, 90, 110, 0, 100, 100, 100])
    *_, last = RecursiveBP(MultiChain().connect(chain, level(2000.0))).run(frames(values))
    expected = np.full(2, 0.5)
    for k, value in enumerate(values):
        expected = (expected if not k else expected @ stays) * (
            1.0 if k == MISSING else np.exp(-0.5 * (value - np.array([0, 100])) ** 2 / 2000)
        )
        expected /= expected.sum()
    np.testing.assert_allclose(last["discrete"].probabilities, expected, rtol=1e-12)


def particles(count: int, seed: int, **options: Any) -> ParticleChain:
    def transition(states: Numbers, dt: float, random: np.random.Generator) -> Numbers:
        return (
            states @ transition_of(dt).T
            + random.standard_normal(states.shape) @ np.linalg.cholesky(noise_of(dt)).T
        )

    def message_of(states: Numbers, weights: Numbers, feature: GaussianFeature) -> GaussianMessage:
        values = (states @ H.T)[:, 0]
        mean = weights @ values
        return GaussianMessage.from_moments([0], [[mean]], weights @ (values - mean) ** 2 + R[None])

    def log_likelihood(states: Numbers, message: GaussianMessage, feature: GaussianFeature) -> Numbers:
        if not len(message):
            return np.zeros(len(states))
        _, seen, noise = message.moments
        total = R[0, 0] + noise[0, 0, 0]
        return -0.5 * ((seen[0] - states @ H.T)[:, 0] ** 2 / total + np.log(2 * np.pi * total))

    def draw(count: int, frame: Frame, random: np.random.Generator) -> Numbers:
        return MEAN + random.standard_normal((count, 2)) @ np.linalg.cholesky(COVARIANCE).T

    return ParticleChain(
        transition,
        message_of,
        log_likelihood,
        draw,
        features=GaussianFeature,
        count=count,
        seed=seed,
        **options,
    )


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_particle_chain_is_the_kalman_filter_within_its_error(share: float) -> None:
    """Of n effective particles a mean is off by root(P / n), a variance by P root(2 / n); those of the frames
    before add up to less than as many such errors. 4 standard errors are allowed."""
    values = MEAN[0] + 0.3 * MEAN[1] + np.array([3, 1, -2, 0, -4, -6, -9])
    engine = RecursiveBP(MultiChain().connect(particles(100_000, 0, resampling_share=share), level()))
    for belief, (mean, covariance, log_likelihood) in zip(
        engine.run(frames(values)), kalman(np.asarray(values, np.uint8)), strict=True
    ):
        state = belief["particles"]
        found_mean, found_covariance = state.moments
        error = np.sqrt(len(TIMES) / state.effective)
        deviation = np.sqrt(np.diag(covariance))
        assert (np.abs(found_mean - mean) < 4 * error * deviation).all()
        np.testing.assert_array_less(
            np.abs(found_covariance - covariance), 4 * np.sqrt(2) * error * np.outer(deviation, deviation)
        )
        assert state.log_evidence == pytest.approx(log_likelihood, abs=4 * error)
        # that of the messages, which are Gaussians with the particles' moments
        assert belief.log_evidence == pytest.approx(log_likelihood, abs=4 * error)


POINTS = PointTracks
Linear = LinearGaussianChain
eye = np.eye(2)
WRONG: list[tuple[Any, type[Exception], str]] = [
    (lambda: Linear(np.ones((2, 3)), eye, H, R, features=POINTS), ValueError, r"F: got shape \(2, 3\)"),
    (lambda: Linear(eye, np.eye(3), H, R, features=POINTS), ValueError, r"Q: .* expected \(2, 2\)"),
    (lambda: Linear(eye, eye, np.eye(3), R, features=POINTS), ValueError, r"H: .* expected \(d, 2\)"),
    (lambda: Linear(eye, eye, H, np.eye(2), features=POINTS), ValueError, r"R: .* expected \(1, 1\)"),
    (lambda: Linear(eye, np.nan * np.eye(2), H, R, features=POINTS), ValueError, "Q: got NaN"),
    (lambda: linear(initial_mean=[1.0]), ValueError, r"initial_mean: got shape \(1,\)"),
    (lambda: linear(max_coast_time=0.0), ValueError, "max_coast_time: got 0.0"),
    (lambda: linear(identities=("a",)), TypeError, "identities"),
    (lambda: DiscreteChain([[0.5, 0.6], [0, 1]]), ValueError, "transition: .* of sum 1"),
    (lambda: DiscreteChain(np.eye(2), initial_probabilities=[1.0]), ValueError, "initial_probabilities"),
    (lambda: DiscreteChain(np.eye(2), emission=np.eye(3)), ValueError, "emission"),
    (lambda: DiscreteChain(np.eye(2), features="pixels"), TypeError, "features: got 'pixels'"),
    (lambda: particles(0, 1), ValueError, "count: got 0"),
    (lambda: particles(5, 1, resampling_share=2.0), ValueError, "resampling_share: got 2.0"),
    (lambda: ParticleChain(1, 2, 3, 4, features=POINTS), TypeError, "transition: got 1"),  # type: ignore[arg-type]
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "message"), WRONG, ids=[message for _, _, message in WRONG])
def test_wrong_arguments_are_named(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
