"""Dynamics of an upper body's pose, p(x_t | x_t-1): drawing and densities."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...models.body.kernels import lean
from ...models.body.upper_body import BodyPoses, UpperBody, arm_at
from ...models.core.checks import NotNegative, Positive, Shape, checked
from ...models.core.short_repr import short_repr
from .kernels.dynamics import (
    RAISED,
    arm_steps,
    crossings,
    draw_terms,
    least_squares_to_rows,
    mixture_values,
    scaled_poses,
    squared_steps,
    walk,
)

Array = NDArray[np.float64]

SPHERE = 4 * np.pi

USUAL_UPPER_ARMS = np.array([[0.2, 0.9, -0.35], [-0.2, 0.9, -0.35]])
USUAL_UPPER_ARMS /= np.linalg.norm(USUAL_UPPER_ARMS, axis=1, keepdims=True)
USUAL = 2.0  # von Mises-Fisher concentration of upper arms about these: mostly they hang down

CROSSED, CROSSED_TIME = 37.5, 0.1
"""Penalty of crossed hands, nats per second and head height across, and s after which it grows no more: hands
change sides seldom and not for long."""

LEAST_FLOOR = 1e-15  # of an arm's density, over the peak of one without a jump: its square is a float32
LEAST_EXPONENT = -700.0  # its exponential is a float64: the floor of an arm's density without jumps
LEAST_COSINE = 1e-3  # mean cosine with the earlier direction below which a direction is uniform
MOST_JUMPS = 1 - 1e-6  # probability of a jump at most: densities are relative to arms that have not jumped


@short_repr
@dataclass(frozen=True, eq=False)
class Ancestors:
    """k weighted poses of the frame before."""

    poses: BodyPoses
    weights: Annotated[Array, Shape("k")]  # with sum 1
    elapsed: NotNegative  # s since then


@checked
@short_repr
@dataclass(frozen=True)
class BodyDynamics:
    """Random walk of the position and of the direction of every segment, in which an arm may jump.

    With the root r, the rotations o of the torso and n of the neck and the directions of upper arms and
    forearms, after dt seconds

        p(r | r') = N(r; r', place^2 dt)
        p(n | n') = N(n; k n', neck^2 (1 - k^2)),    k = exp(-dt / neck_time)
        p(o | o') = N(o; l o', s^2 (1 - l^2)),       l = exp(-dt / torso_time),  s = (lean, turn, lean)
        p(arm | arm') = (1 - j) vMF(upper; upper', K) vMF(fore; fore', K') + j prior(arm)
        j = 1 - exp(-jumps dt)

    Directions approximate Brownian motion on the sphere, in any number of steps, by the von Mises-Fisher
    density with the same mean. Jumps are more frequent than those of real arms, since the tracker also needs
    them to recover from errors.

    Densities include `log_posture`, draws do not. Neither excludes poses beyond the limits of the joints
    (`UpperBody.allowed`), and densities are not normalised for either.

    Parameters
    ----------
    body
        whose lengths give the scale.
    place
        head heights after one second, standard deviation of each coordinate.
    lean, turn
        rad, stationary standard deviations of the torso's lean, forwards and sideways, and of its turn.
    torso_time
        s, time constant of the torso's rotation.
    neck
        rad, stationary standard deviation of each rotation of the head.
    neck_time
        s, time constant of the head's rotation.
    upper_arm, forearm
        rad after one second, standard deviation of a direction about each of two axes.
    jumps
        rate of an arm's jumps, 1/s.
    exchanges
        1/s, rate at which left and right hand are found to be exchanged.
    returns
        1/s, rate at which the whole body is found to be elsewhere.
    """

    body: UpperBody
    place: Positive = 0.3
    lean: Positive = 0.15
    turn: Positive = 0.3
    torso_time: Positive = 2.0
    neck: Positive = 0.25
    neck_time: Positive = 1.0
    upper_arm: Positive = 0.6
    forearm: Positive = 1.0
    jumps: NotNegative = 2.0
    exchanges: NotNegative = 0.05
    returns: NotNegative = 0.02

    def draw(self, poses: BodyPoses, dt: float, random: np.random.Generator) -> BodyPoses:
        """Draw each pose `dt` seconds ahead."""
        n = len(poses)
        place, concentrations, jump = self._rates(dt)
        drawn = BodyPoses.made(each.copy() for each in poses.arrays)
        evens, normals = random.random((n, 8)), random.standard_normal((n, 8))
        walk(*drawn.arrays, normals, evens, place, *self.turn_step(dt), concentrations)
        jumping = np.nonzero(random.random((n, 2)) < jump)
        drawn.arms[jumping] = draw_usual_arms(jumping[1], random)
        return drawn

    def log_density(self, poses: BodyPoses, ancestors: Ancestors) -> Array:
        """`(n,)` nats: log of the mixture of p(x | ancestor) over ancestors, plus `log_posture`.

        The density is per px^2 of the position, rad^3 each of torso and neck, and solid angle of the four
        directions. Terms are relative to the largest Gaussian, and an arm's factor has a floor, so that
        nothing underflows. The cost is the number of poses times that of ancestors.
        """
        return self.prediction(ancestors).log_density(poses)

    def prediction(self, ancestors: Ancestors) -> "Prediction":
        """Return the mixture over ancestors, whose densities at several sets of poses are wanted."""
        place, concentrations, _ = self._rates(ancestors.elapsed)
        std, origin = self.turn_step(ancestors.elapsed)[1], ancestors.poses.roots.mean(axis=0)
        gaussian = -4 * np.log(2 * np.pi) - 2 * np.log(place) - np.log(std).sum()
        rows, arms, _ = self._scaled(ancestors.poses, ancestors.elapsed, origin, past=True)
        peak = np.log(self._heights(ancestors.elapsed)[0])
        return Prediction(
            self, ancestors, origin, float(gaussian + 2 * peak),
            np.ascontiguousarray(rows.T), np.ascontiguousarray(arms.T),
            ancestors.weights.astype(np.float32), concentrations.astype(np.float32),
        )  # fmt: skip

    def _scaled(self, poses: BodyPoses, elapsed: float, origin: Array, *, past: bool) -> tuple[Any, Any, Any]:
        """Return poses as `mixture_values` takes them; those of the `past` turn back meanwhile."""
        n, (decay, std) = len(poses), self.turn_step(elapsed)
        scaled = np.empty((n, 8), np.float32), np.empty((n, 12), np.float32), np.empty((n, 2), np.float32)
        peak, jump, _ = self._heights(elapsed)
        stds = np.append(self._rates(elapsed)[0], std)
        scaled_poses(
            *poses.arrays, origin, stds, decay if past else np.ones(6), peak, jump, LEAST_FLOOR, USUAL_ARM,
            *scaled,
        )  # fmt: skip
        return scaled

    def _heights(self, dt: float) -> Array:
        """`(3,)`: peak of an arm's density without a jump, probability of one, least exponent."""
        return self._step(dt)[2]

    def log_step(self, poses: BodyPoses, before: BodyPoses, dt: float) -> Array:
        """`(n,)` nats: log p(x | x') of each pose given its own one `dt` seconds before, as `log_density`."""
        place = self._rates(dt)[0]
        decay, std = self.turn_step(dt)
        squares = np.empty(len(poses))
        squared_steps(*poses.arrays[:3], *before.arrays[:3], place, decay, std, squares)
        gaussian = -4 * np.log(2 * np.pi) - 2 * np.log(place) - np.log(std).sum()
        arms = self.log_arm_steps(poses, before, dt).sum(axis=1)
        return np.asarray(gaussian - 0.5 * squares + arms + self.log_posture(poses, dt))

    def log_arm_steps(self, poses: BodyPoses, before: BodyPoses, dt: float) -> Array:
        """`(n, 2)` nats: the factors of left and right arm in `log_step`."""
        steps = np.empty((len(poses), 2))
        arm_steps(poses.arms, before.arms, self._rates(dt)[1], self._heights(dt), USUAL_ARM, steps)
        return steps

    def log_returns(self, dt: float) -> tuple[float, float]:
        """Return the log probabilities that after `dt` s the body is anywhere, or near its prediction."""
        stays = max(-self.returns * dt, np.log1p(-MOST_JUMPS))
        return float(np.log(-np.expm1(stays))) if stays else -np.inf, float(stays)

    def draw_ancestors(
        self, poses: BodyPoses, ancestors: Ancestors, random: np.random.Generator
    ) -> NDArray[np.int64]:
        """Draw an ancestor of each pose, `(n,)` indices, from p(ancestor | pose) ~ weight p(x | ancestor)."""
        return self.prediction(ancestors).draw_ancestors(poses, random)

    def log_posture(self, poses: BodyPoses, dt: float = CROSSED_TIME) -> Array:
        """`(n,)` nats, at most 0: penalty of `dt` seconds with crossed hands."""
        body, across = self.body, np.empty(len(poses))
        lengths = np.array([body.shoulder_width / 2, body.upper_arm, body.forearm])
        crossings(poses.torsos, poses.arms, lengths, across)
        return np.asarray(-CROSSED * min(dt, CROSSED_TIME) * np.clip(across / body.head_height, 0, 1))

    def with_exchanged(self, ancestors: Ancestors, random: np.random.Generator) -> Ancestors:
        """Add a copy of each pose with exchanged hands, if that is possible; both share its weight.

        The elbows of exchanged arms are drawn uniformly on their circles of possible positions.
        """
        if not self.exchanges:
            return ancestors
        poses, weights = ancestors.poses, ancestors.weights
        joints = self.body.joints(poses)
        arms = np.empty_like(poses.arms)
        within = np.ones(len(poses), np.bool_)
        for side in (0, 1):
            offsets = joints[:, 7 - 3 * side] - joints[:, 2 + 3 * side]
            arms[:, side], reached = arm_at(
                self.body, side, offsets, random.uniform(-np.pi, np.pi, len(poses))
            )
            within &= reached
        exchanged = BodyPoses(poses.roots, poses.torsos, poses.necks, arms)
        chosen = np.flatnonzero(within)
        chosen = chosen[self.body.allowed(exchanged.take(chosen))]
        share = float(-0.5 * np.expm1(-2 * self.exchanges * ancestors.elapsed))  # or exchanged back
        own = weights.copy()
        own[chosen] *= 1 - share
        return Ancestors(
            BodyPoses.concatenated([poses, exchanged.take(chosen)]),
            np.concatenate([own, share * weights[chosen]]),
            ancestors.elapsed,
        )

    def draw_anywhere(self, n: int, size: tuple[int, int], random: np.random.Generator) -> BodyPoses:
        """Draw `n` poses from the prior in an image of `size` (height, width), all within joint limits."""
        height, width = size
        roots = random.random((n, 2)) * (width, height)
        poses = BodyPoses(roots, np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2, 2, 3)))
        wrong = np.arange(n)
        while len(wrong):
            turns = self.turn_stds * random.standard_normal((len(wrong), 6))
            poses.torsos[wrong], poses.necks[wrong] = turns[:, :3], turns[:, 3:]
            poses.arms[wrong] = draw_usual_arms(np.tile([0, 1], (len(wrong), 1)), random)
            wrong = wrong[~self.body.allowed(poses.take(wrong))]
        return poses

    def log_density_anywhere(self, poses: BodyPoses, size: tuple[int, int]) -> Array:
        """`(n,)` nats: log density of `draw_anywhere` plus `log_posture`, up to a constant."""
        height, width = size
        place = -np.log(float(height) * width)
        turns = -3 * np.log(2 * np.pi) - np.log(self.turn_stds).sum()
        turns -= 0.5 * ((poses.turns / self.turn_stds) ** 2).sum(axis=1)
        return np.asarray(place + turns + _log_usual(poses.arms).sum(axis=1) + self.log_posture(poses))

    @property
    def turn_stds(self) -> Array:
        """`(6,)` rad: stationary standard deviations of `BodyPoses.turns`."""
        return np.array([self.lean, self.turn, self.lean, self.neck, self.neck, self.neck])

    def turn_step(self, dt: float) -> tuple[Array, Array]:
        """Return decay factors and noise standard deviations `(6,)` of `BodyPoses.turns` after `dt` s."""
        return self._step(dt)[:2]

    @lru_cache(maxsize=64)  # noqa: B019 - films have few different steps
    def _step(self, dt: float) -> tuple[Array, Array, Array]:
        """Return what `turn_step` and `_heights` do."""
        times = np.repeat([self.torso_time, self.neck_time], 3)
        decay, stds = np.exp(-dt / times), self.turn_stds * np.sqrt(-np.expm1(-2 * dt / times))
        _, concentrations, jump = self._rates(dt)
        heights = np.array([(1 - jump) * _peak(concentrations).prod(), jump, LEAST_EXPONENT])
        return decay, stds, heights

    def _rates(self, dt: float) -> tuple[float, Array, float]:
        """Return standard deviation of the position (px), concentrations of the arms, jump probability."""
        place = self.place * self.body.head_height * float(np.sqrt(dt))
        concentrations = arm_concentrations(self.upper_arm, self.forearm, dt)
        jump = min(float(-np.expm1(-self.jumps * dt)), MOST_JUMPS)
        return place, concentrations, jump


@dataclass(frozen=True, eq=False)
class Prediction:
    """Mixture of p(x | ancestor) over weighted ancestors."""

    dynamics: BodyDynamics
    ancestors: Ancestors
    origin: Array  # `(2,)` px: of the roots below
    log_peak: float  # nats: of the density of a pose whose arms have not jumped
    # of the k ancestors, as of `mixture_values`
    rows: NDArray[np.float32]
    arms: NDArray[np.float32]
    weights: NDArray[np.float32]
    concentrations: NDArray[np.float32]

    def log_density(self, poses: BodyPoses) -> Array:
        """`(n,)` nats, as `BodyDynamics.log_density`."""
        terms, least = self._terms(poses)
        values = np.empty(len(poses), np.float32)
        mixture_values(*terms, values)
        posture = self.dynamics.log_posture(poses, self.ancestors.elapsed)
        log_values = np.log(values.astype(np.float64)) - 0.5 * least.astype(np.float64)
        return np.asarray(self.log_peak - RAISED + log_values + posture)

    def draw_ancestors(self, poses: BodyPoses, random: np.random.Generator) -> NDArray[np.int64]:
        """`(n,)` indices, as `BodyDynamics.draw_ancestors`."""
        chosen = np.empty(len(poses), np.int64)
        draw_terms(*self._terms(poses)[0], random.random(len(poses)), chosen)
        return chosen

    def _terms(self, poses: BodyPoses) -> tuple[tuple[Any, ...], NDArray[np.float32]]:
        """Return the arguments of `mixture_values`, and the least squared distances `(n,)`."""
        body, arms, floors = self.dynamics._scaled(poses, self.ancestors.elapsed, self.origin, past=False)
        least = np.empty(len(poses), np.float32)
        least_squares_to_rows(body, self.rows, least)
        return (body, self.rows, least, arms, self.arms, self.weights, self.concentrations, floors), least


def concentration(elapsed: Array) -> Array:
    """Return the von Mises-Fisher concentrations with mean cosine exp(-elapsed), by Newton's method.

    That is the mean of a Brownian motion on the unit sphere, `elapsed` being its variance about each axis.
    """
    gap = -np.expm1(-np.minimum(elapsed, -np.log(LEAST_COSINE)))
    mean = 1 - gap
    kappa = mean * (3 - mean**2) / (gap * (1 + mean))
    for _ in range(6):
        rest = 2 / np.expm1(np.minimum(2 * kappa, 700.0))  # the mean cosine is 1 + rest - 1 / kappa
        kappa += (1 / kappa - rest - gap) / (1 / kappa**2 - rest * (rest + 2))
    return np.asarray(kappa)


@lru_cache(maxsize=256)
def arm_concentrations(upper_arm: float, forearm: float, dt: float) -> Array:
    """`(2,)` of both segments after `dt` s; cached, since films have few different steps."""
    concentrations = concentration(np.array([upper_arm, forearm]) ** 2 * dt)
    concentrations.flags.writeable = False
    return concentrations


def draw_directions(means: Array, concentration: Array | float, random: np.random.Generator) -> Array:
    """Draw unit vectors from von Mises-Fisher densities about unit vectors `means` `(..., 3)`.

    The cosine with the mean is drawn by its inverse distribution function, which is in closed form.
    """
    shape = means.shape[:-1]
    share = random.random(shape)
    cosine = 1 + np.log(share + (1 - share) * np.exp(-2 * concentration)) / concentration
    turns = 2 * np.pi * random.random(shape)
    drawn = np.empty((*shape, 3))
    lean(means.reshape(-1, 3), cosine.reshape(-1), turns.reshape(-1), drawn.reshape(-1, 3))
    return drawn


def draw_usual_arms(sides: NDArray[np.int64], random: np.random.Generator) -> Array:
    """Draw arms `(..., 2, 3)` of `sides`, 0 for the left, from their prior: upper arms mostly hang down."""
    upper = draw_directions(USUAL_UPPER_ARMS[sides], USUAL, random)
    return np.stack([upper, draw_any_directions(sides.shape, random)], axis=-2)


def _log_usual(arms: Array) -> Array:
    """`(n, 2)` nats: log density of `draw_usual_arms` of each arm."""
    cosines = (arms[:, :, 0] * USUAL_UPPER_ARMS).sum(axis=2)
    return np.asarray(USUAL * (cosines - 1) + np.log(_peak(USUAL)) - np.log(SPHERE))


def _peak(concentrations: Array | float) -> Array:
    """Von Mises-Fisher density at its mean."""
    return np.asarray(concentrations / (2 * np.pi * -np.expm1(-2 * np.asarray(concentrations))))


def draw_any_directions(shape: tuple[int, ...], random: np.random.Generator) -> Array:
    """Draw unit vectors `(*shape, 3)` uniformly on the sphere."""
    drawn = random.standard_normal((*shape, 3))
    drawn /= np.sqrt(np.einsum("...x,...x->...", drawn, drawn))[..., None]
    return drawn


USUAL_ARM = np.array([*USUAL_UPPER_ARMS[0], USUAL, float(np.log(_peak(USUAL)) - np.log(SPHERE))])
"""The same density as of a left arm, for compiled loops."""
