"""Chains that are made of matrices or functions: a Kalman filter, a hidden Markov model, a particle filter.

    door = DiscreteChain(transition, message_of, log_likelihood, features=PixelLabels, name="door")
    walkers = LinearGaussianChain(F, Q, H, R, features=ObjectBoxes, initial_covariance=P)
    cloud = ParticleChain(transition, message_of, log_likelihood, draw, features=PointTracks)

Dynamics are functions of the step `dt`, s; a matrix in place of a function is one step from frame to frame,
however long it takes.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from math import inf, log
from typing import Annotated, Any, Protocol, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.categorical import Categorical, CategoricalMessage
from ...models.core.checks import Count, CountFrom0, PositiveOrInfinite, Shape, between, checked
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.identities import Identities, Turnover, find, places_of
from ...models.core.short_repr import short_repr
from ..kalman import LinearMotion
from ..smc import copied, log_sum, normalised, systematic
from .protocols import FeatureNode, Incoming, Message, Named, Port

Array = NDArray[np.float64]
Dynamics = ArrayLike | Callable[[float], ArrayLike]
"""A matrix of one step, or a function of its length in seconds."""


def _at(dynamics: Dynamics, dt: float, name: str, size: int | None = None) -> Array:
    """Return the square matrix of a step of `dt` s."""
    matrix = np.asarray(dynamics(dt) if callable(dynamics) else dynamics, np.float64)
    wanted = "(n, n)" if size is None else f"({size}, {size})"
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or size not in (None, len(matrix)):
        raise ValueError(f"{name}: got shape {matrix.shape}, expected {wanted}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name}: got NaN or infinity, expected finite numbers")
    return matrix


def _ports(features: type | tuple[type, ...], many: bool) -> tuple[Port, ...]:
    kinds = features if isinstance(features, tuple) else (features,)
    if not kinds or not all(isinstance(kind, type) for kind in kinds):
        raise TypeError(f"features: got {features!r}, expected a class of feature nodes, or a tuple of them")
    return tuple(Port(kind, many=many) for kind in kinds)


class GaussianFactor(Message, Protocol):
    """A message with Gaussians by identity: `GaussianMessage`, or one of which they are a factor."""

    @property
    def gaussians(self) -> GaussianMessage:
        """The Gaussians."""
        ...

    def with_gaussians(self, gaussians: GaussianMessage, /) -> Self:
        """Return the message with these Gaussians in place of its own."""
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class LinearGaussianState:
    """Gaussian states of things by identity, each on its own."""

    identities: Annotated[Identities, Shape("k")]  # increasing
    mean: Annotated[Array, Shape("k", "n")]
    covariance: Annotated[Array, Shape("k", "n", "n")]
    unseen: Annotated[Array, Shape("k")]  # s since there was information about it


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class LinearGaussianChain:
    """Kalman filter for each identity of a feature: objects, points, or one vector.

    For a state x and its feature z after a step of dt seconds:

        p(x' | x) = N(x'; F(dt) x, Q(dt)),    p(z | x) = N(z; H x, R)
        mu_{X -> F} = N(z; H m, H P H' + R)

    An identity begins with the first message that has information about it, and ends after `max_coast_time`
    without information.

    Parameters
    ----------
    F, Q
        `(n, n)` transition and process noise covariance, for one step or as functions of `dt`.
    H, R
        `(d, n)` observation matrix and `(d, d)` covariance of the feature given the state; `None` for the
        identity and for 0.
    features
        class of the feature node, whose messages have `gaussians`: `ObjectBoxes` (foot x, foot y, width,
        height), `PointTracks` (x, y), `GaussianFeature`.
    initial_mean, initial_covariance
        `(n,)` and `(n, n)`, of a new identity; 0 and the unit matrix if `None`.
    identities
        identities that exist from the first frame on and do not end.
    max_coast_time
        s without information after which other identities end.

    Raises
    ------
    ValueError
        if the matrices do not fit.
    """

    F: Any
    Q: Any
    H: Any
    R: Any
    _: KW_ONLY
    features: type
    initial_mean: Any = None
    initial_covariance: Any = None
    identities: tuple[int, ...] = ()
    max_coast_time: PositiveOrInfinite = 3.0
    name: str = "kalman"

    def __post_init__(self) -> None:
        transition = _at(self.F, 1.0, "F")
        size = len(transition)
        _at(self.Q, 1.0, "Q", size)
        if self._design is not None and (self._design.ndim != 2 or self._design.shape[1] != size):
            raise ValueError(f"H: got shape {self._design.shape}, expected (d, {size})")
        dimension = size if self._design is None else len(self._design)
        if self.R is not None:
            _at(self.R, 0.0, "R", dimension)
        mean, _ = self._prior(size)
        if mean.shape != (size,):
            raise ValueError(f"initial_mean: got shape {mean.shape}, expected ({size},)")
        _ports(self.features, many=False)

    @property
    def ports(self) -> tuple[Port, ...]:
        """One node of the features."""
        return _ports(self.features, many=False)

    @cached_property
    def _design(self) -> Array | None:
        return None if self.H is None else np.asarray(self.H, np.float64)

    def _prior(self, size: int) -> tuple[Array, Array]:
        mean = np.zeros(size) if self.initial_mean is None else np.asarray(self.initial_mean, np.float64)
        covariance = np.eye(size) if self.initial_covariance is None else self.initial_covariance
        return mean, _at(covariance, 0.0, "initial_covariance", size)

    def initial(self, frame: Frame) -> LinearGaussianState:
        """Return the initial state of the `identities`."""
        identities = np.unique(np.asarray(self.identities, np.int64))
        mean, covariance = self._prior(len(_at(self.F, 1.0, "F")))
        count = len(identities)
        return LinearGaussianState(
            identities,
            np.broadcast_to(mean, (count, *mean.shape)),
            np.broadcast_to(covariance, (count, *covariance.shape)),
            np.zeros(count),
        )

    def predict(self, state: LinearGaussianState, dt: float) -> LinearGaussianState:
        """Return the states `dt` seconds on."""
        size = state.mean.shape[1]
        step = LinearMotion(_at(self.F, dt, "F", size), _at(self.Q, dt, "Q", size))
        mean, covariance = step.moved(state.mean, state.covariance, 1.0)
        return LinearGaussianState(state.identities, mean, covariance, state.unseen + dt)

    def gaussians(self, state: LinearGaussianState) -> GaussianMessage:
        """Return the densities of the features of all identities."""
        means, covariances = self._features_of(state)
        return GaussianMessage.from_moments(state.identities, means, covariances)

    def message(self, state: LinearGaussianState, feature: FeatureNode[Any], incoming: Incoming) -> Any:
        """Return the densities of the features of all identities (mu_{X -> F})."""
        uniform = cast(GaussianFactor, feature.uniform())
        return uniform.with_gaussians(self.gaussians(state)) if len(state.identities) else uniform

    def update(self, state: LinearGaussianState, incoming: Incoming) -> LinearGaussianState:
        """Return the states given all of `incoming`, with new identities and without those that end."""
        return self.condition(state, incoming[self.features].gaussians)

    def condition(self, state: LinearGaussianState, measured: GaussianMessage) -> LinearGaussianState:
        """Return the states given a factor of their features, which may be uniform in some directions.

        Covariances are updated in Joseph's form, and stay positive definite.
        """
        measured = measured.only(np.asarray(measured.information.any(axis=(1, 2))))
        state = self._with_born(state, measured.identities)
        place = places_of(state.identities, measured.identities)
        if not len(place):
            return state
        prior = replace(state, mean=state.mean[place], covariance=state.covariance[place])
        means, spreads = self._features_of(prior)
        size, information = prior.mean.shape[1], measured.information
        observed = np.eye(size) if self._design is None else self._design
        # (I + L S)^-1 of the information L and the prediction's covariance S
        damped = np.linalg.inv(np.eye(len(observed)) + information @ spreads)
        to_state = prior.covariance @ observed.T @ damped
        off = measured.vector - (information @ means[:, :, None])[:, :, 0]
        gain = to_state @ information
        rest = np.eye(size) - gain @ observed
        covariance = rest @ prior.covariance @ rest.swapaxes(1, 2) + gain @ to_state.swapaxes(1, 2)
        if self.R is not None:
            covariance += gain @ np.asarray(self.R, np.float64) @ gain.swapaxes(1, 2)
        mean_after, covariance_after, unseen = state.mean.copy(), state.covariance.copy(), state.unseen.copy()
        mean_after[place] += (to_state @ off[:, :, None])[:, :, 0]
        covariance_after[place] = 0.5 * (covariance + covariance.swapaxes(1, 2))
        unseen[place] = 0.0
        return LinearGaussianState(state.identities, mean_after, covariance_after, unseen)

    def _features_of(self, state: LinearGaussianState) -> tuple[Array, Array]:
        """Return means `(k, d)` and covariances `(k, d, d)` of the features."""
        mean, covariance = state.mean, state.covariance
        if self._design is not None:
            mean, covariance = mean @ self._design.T, self._design @ covariance @ self._design.T
        return mean, covariance if self.R is None else covariance + np.asarray(self.R, np.float64)

    def _with_born(self, state: LinearGaussianState, mentioned: Identities) -> LinearGaussianState:
        """Return the state with mentioned things, and without those that ended."""
        place, is_there = find(state.identities, mentioned)
        stays = (state.unseen <= self.max_coast_time) | np.isin(state.identities, self.identities)
        stays[place[is_there]] = True
        if stays.all() and is_there.all():
            return state
        turnover = Turnover.between(state.identities, stays, mentioned[~is_there])
        mean, covariance = self._prior(state.mean.shape[1])
        return LinearGaussianState(
            turnover.identities,
            turnover.rows(state.mean, mean),
            turnover.rows(state.covariance, covariance),
            turnover.rows(state.unseen, 0.0),
        )


@short_repr
@dataclass(frozen=True, eq=False)
class DiscreteState:
    """Probabilities of a few states, with sum 1."""

    probabilities: Annotated[Array, Shape("k")]


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class DiscreteChain:
    """Hidden Markov model with a few states, filtered by the forward algorithm.

        p(X' = j | X = i) = transition(dt)[i, j],    mu_{X -> F} = sum over i of p(X = i) p(F | X = i)

    Parameters
    ----------
    transition
        `(k, k)`, rows of sum 1, of a step or as a function of `dt`, as `lambda dt: expm(dt * rates)`.
    message_of
        message to a feature node for probabilities `(k,)` of the states: `message_of(probabilities,
        feature)`. `None` for `Categorical` nodes, with tables p(F | X) by `emission`.
    log_likelihood
        nats `(k,)`: log of the integral of p(F | X) times a message at a feature node, for each state:
        `log_likelihood(message, feature)`. `None` for `Categorical` nodes.
    features
        class of the feature nodes, or a tuple of classes.
    initial_probabilities
        `(k,)`; equal where `None`.
    emission
        `(k, size)` tables p(F | X) of categorical nodes: one for all, or by name of the node; `None` if the
        feature is the state.
    many
        whether there may be several nodes of a class.

    Raises
    ------
    ValueError
        if tables do not fit, or are no probabilities.
    """

    transition: Any
    message_of: Any = None
    log_likelihood: Any = None
    _: KW_ONLY
    features: Any = Categorical
    initial_probabilities: Any = None
    emission: Any = None
    many: bool = False
    name: str = "discrete"

    def __post_init__(self) -> None:
        size = len(self._transition(1.0))
        _probabilities(self._prior(size), "initial_probabilities", (size,))
        _ports(self.features, self.many)
        for name, table in self._tables.items():
            _probabilities(table, f"emission{name and f' of {name!r}'}", (size, table.shape[-1]))

    @property
    def ports(self) -> tuple[Port, ...]:
        """Nodes of the features."""
        return _ports(self.features, self.many)

    @cached_property
    def _tables(self) -> dict[str, Array]:
        """Emissions by name of the node; by "" that of all."""
        if self.emission is None:
            return {}
        tables = self.emission if isinstance(self.emission, Mapping) else {"": self.emission}
        return {name: np.asarray(table, np.float64) for name, table in tables.items()}

    def _prior(self, size: int) -> Array:
        prior = self.initial_probabilities
        return np.full(size, 1 / size) if prior is None else np.asarray(prior, np.float64)

    def _transition(self, dt: float) -> Array:
        matrix = _at(self.transition, dt, "transition")
        return _probabilities(matrix, "transition", matrix.shape)

    def initial(self, frame: Frame) -> DiscreteState:
        """Return the initial probabilities."""
        return DiscreteState(self._prior(len(self._transition(1.0))))

    def predict(self, state: DiscreteState, dt: float) -> DiscreteState:
        """Return the probabilities `dt` seconds on."""
        return DiscreteState(state.probabilities @ self._transition(dt))

    def message(self, state: DiscreteState, feature: FeatureNode[Any], incoming: Incoming) -> Any:
        """Return the message of the prediction, given the other features (mu_{X -> F}).

        For features that are not categorical it has the integral 1.
        """
        weights, log_scale = self._weighted(state, incoming, without=feature)
        if self.message_of is not None:
            return self.message_of(weights, feature)
        with np.errstate(divide="ignore"):
            return CategoricalMessage(np.log(self._emitted(weights, feature)) + log_scale)

    def update(self, state: DiscreteState, incoming: Incoming) -> DiscreteState:
        """Return the probabilities given all of `incoming`; unchanged if all likelihoods are 0."""
        return DiscreteState(self._weighted(state, incoming)[0])

    def _emitted(self, weights: Array, feature: Named) -> Array:
        table = self._table(feature)
        return weights if table is None else weights @ table

    def _table(self, feature: Named) -> Array | None:
        return self._tables.get(feature.name, self._tables.get(""))

    def _weighted(
        self, state: DiscreteState, incoming: Incoming, without: Named | None = None
    ) -> tuple[Array, float]:
        """Return probabilities given the features, and the log of their likelihood."""
        log_factors = np.zeros(len(state.probabilities))
        for feature, message in _messages(incoming):
            if without is None or feature.name != without.name:
                log_factors = log_factors + self._log_factors(message, feature)
        peak = float(log_factors.max())
        weights = state.probabilities * np.exp(log_factors - (peak if np.isfinite(peak) else 0.0))
        total = float(weights.sum())
        if not total > 0:
            return state.probabilities, -inf
        return weights / total, log(total) + peak

    def _log_factors(self, message: Any, feature: Named) -> Array:
        size = len(self._transition(1.0))
        if self.log_likelihood is not None:
            factors = np.asarray(self.log_likelihood(message, feature), np.float64)
        else:
            peak = message.log_weights.max()
            table = self._table(feature)
            if not np.isfinite(peak):
                return np.full(size, -inf)
            values = np.exp(message.log_weights - peak)
            with np.errstate(divide="ignore"):
                factors = peak + np.log(values if table is None else table @ values)
        if factors.shape != (size,) or np.isnan(factors).any():
            raise ValueError(f"log_likelihood: got {factors} at {feature.name!r}, expected {size} numbers")
        return factors


def _messages(incoming: Incoming) -> Iterator[tuple[Named, Any]]:
    return ((feature, incoming[cast(FeatureNode[Any], feature)]) for feature in incoming)


def _probabilities(table: Array, name: str, shape: tuple[int, ...]) -> Array:
    """Return a table, rows of which are probabilities with sum 1; else a `ValueError`."""
    if table.shape != shape:
        raise ValueError(f"{name}: got shape {table.shape}, expected {shape}")
    if not ((table >= -1e-12).all() and np.allclose(table.sum(axis=-1), 1, rtol=0, atol=1e-6)):
        raise ValueError(f"{name}: got rows {table.tolist()}, expected probabilities of sum 1")
    return table


@short_repr
@dataclass(frozen=True, eq=False)
class ParticleState:
    """Weighted particles."""

    particles: Array  # (n, ...); within a process also an object with rows, as poses
    log_weights: Annotated[Array, Shape("n", finite=False)]  # of weights that sum to 1
    random: np.random.Generator  # of the draws to come
    log_evidence: float = 0.0  # nats: log of the mean likelihood of the last update

    @cached_property
    def weights(self) -> Array:
        """`(n,)`, with sum 1."""
        return np.exp(normalised(self.log_weights))

    @property
    def effective(self) -> float:
        """Number of particles of equal weight that would be as exact."""
        return float(1 / (self.weights**2).sum())

    @property
    def moments(self) -> tuple[Array, Array]:
        """Mean `(d,)` and covariance `(d, d)` of particles `(n, d)`."""
        mean = self.weights @ self.particles
        apart = self.particles - mean
        return mean, (self.weights * apart.T) @ apart

    def reweighed(self, log_factors: Array) -> Self:
        """Return the samples with weights times factors; the mean factor is the evidence.

        If all factors are 0, weights do not change, and the log evidence is 0.
        """
        log_weights = self.log_weights + log_factors
        evidence = log_sum(log_weights)
        if not np.isfinite(evidence):
            log_weights, evidence = self.log_weights, 0.0
        return replace(self, log_weights=log_weights - evidence, log_evidence=evidence)


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class ParticleChain:
    """Bootstrap particle filter: particles are drawn from the dynamics, and weighted by the likelihood.

    N. Gordon, D. Salmond, A. Smith, *Novel approach to nonlinear/non-Gaussian Bayesian state estimation*
    (1993), with systematic resampling. Particles are an array with a row for each, or an object with a length
    and a method `take(indices)`.

    Parameters
    ----------
    transition
        draws of p(X' | X): `transition(particles, dt, random)` returns particles, or particles and `(n,)` log
        factors of their weights.
    message_of
        message of particles with weights `(n,)` of sum 1 to a feature node, of integral 1:
        `message_of(particles, weights, feature)`.
    log_likelihood
        nats `(n,)`: log of the integral of p(F | X) times a message at a feature node, for each particle:
        `log_likelihood(particles, message, feature)`.
    draw_initial
        draws of the prior: `draw_initial(count, frame, random)` returns `count` particles.
    features
        class of the feature nodes, or a tuple of classes.
    count
        number of particles.
    resampling_share
        particles are resampled before a step if the effective sample size is below this share; 1 for always.
    seed
        of the random numbers.
    """

    transition: Callable[..., Any]
    message_of: Callable[..., Any]
    log_likelihood: Callable[..., Any]
    draw_initial: Callable[..., Any]
    _: KW_ONLY
    features: Any
    count: Count = 1000
    resampling_share: Annotated[float, between(0, 1)] = 0.5
    seed: CountFrom0 = 0
    name: str = "particles"

    def __post_init__(self) -> None:
        _ports(self.features, many=False)

    @property
    def ports(self) -> tuple[Port, ...]:
        """A node of each of the features."""
        return _ports(self.features, many=False)

    def initial(self, frame: Frame) -> ParticleState:
        """Return particles of equal weight, drawn from the prior."""
        random = np.random.Generator(np.random.SFC64(self.seed))  # numpy's fastest
        particles = self.draw_initial(self.count, frame, random)
        if len(particles) != self.count:
            raise ValueError(f"draw_initial: got {len(particles)} particles, expected {self.count}")
        return ParticleState(particles, np.full(self.count, -log(self.count)), random)

    def predict(self, state: ParticleState, dt: float) -> ParticleState:
        """Return particles `dt` s ahead, after resampling if needed."""
        random, particles, log_weights = copied(state.random), state.particles, state.log_weights
        if self.resampling_share == 1 or state.effective < self.resampling_share * self.count:
            places = systematic(log_weights, self.count, random)
            particles = particles[places] if isinstance(particles, np.ndarray) else particles.take(places)
            log_weights = np.full(self.count, -log(self.count))
        moved = self.transition(particles, dt, random)
        if isinstance(moved, tuple):
            moved, log_factors = moved
            log_weights = normalised(log_weights + log_factors)
        if len(moved) != self.count:
            raise ValueError(f"transition: got {len(moved)} particles, expected {self.count}")
        return ParticleState(moved, log_weights, random)

    def message(self, state: ParticleState, feature: FeatureNode[Any], incoming: Incoming) -> Any:
        """Return the message of the particles, weighted by the other features (mu_{X -> F})."""
        others = [(node, message) for node, message in _messages(incoming) if node.name != feature.name]
        if others:
            state = state.reweighed(self._log_factors(state, others))
        return self.message_of(state.particles, state.weights, feature)

    def update(self, state: ParticleState, incoming: Incoming) -> ParticleState:
        """Return the particles weighted by all of `incoming`."""
        return state.reweighed(self._log_factors(state, _messages(incoming)))

    def _log_factors(self, state: ParticleState, messages: Iterable[tuple[Named, Any]]) -> Array:
        log_factors = np.zeros(len(state.log_weights))
        for feature, message in messages:
            nats = np.asarray(self.log_likelihood(state.particles, message, feature), np.float64)
            if nats.shape != log_factors.shape or np.isnan(nats).any():
                came = "NaN" if nats.shape == log_factors.shape else f"shape {nats.shape}"
                raise ValueError(f"log_likelihood: got {came}, expected {len(log_factors)} numbers")
            log_factors = log_factors + nats
        return log_factors
