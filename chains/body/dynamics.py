"""How a person's upper body moves from frame to frame: p(x_t | x_t-1), to draw from and to evaluate."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.body.kernels import lean
from ...models.body.upper_body import BodyPoses, UpperBody, arm_at
from ...models.core.short_repr import short_repr
from .kernels import draw_terms, least_squares_to_rows, mixture_values

Array = NDArray[np.float64]

SPHERE = 4 * np.pi

USUAL_UPPER_ARMS = np.array([[0.2, 0.9, -0.35], [-0.2, 0.9, -0.35]])
USUAL_UPPER_ARMS /= np.linalg.norm(USUAL_UPPER_ARMS, axis=1, keepdims=True)
USUAL = 2.0  # concentration of a person's upper arms about these: mostly they hang down

CROSSED, CROSSED_TIME = 37.5, 0.1
"""Nats a second by which it grows less probable that hands are on the other's side by a head's height, and s
after which it does no more: hands change places seldom and not for long."""

LEAST_FLOOR = 1e-15  # of an arm's density by its peak: two of them are still a number of single precision
LEAST_EXPONENT = -700.0  # whose exponential is a number: without jumps, an arm's density has this floor
LEAST_COSINE = 1e-3  # mean cosine to where a direction was, below which it is as good as anywhere
MOST_JUMPS = 1 - 1e-6  # chance in however long a time: densities are relative to arms that have not jumped


@short_repr
@dataclass(frozen=True, eq=False)
class Ancestors:
    """Weighted poses of the frame before."""

    # k of them; `(k,)`, with sum 1
    poses: BodyPoses
    weights: Array
    elapsed: float  # s since then


@short_repr
@dataclass(frozen=True)
class BodyDynamics:
    """A random walk of the place and of the direction of every segment, in which an arm may also jump.

    With the root r, the rotations o of the torso and n of the neck and the directions of upper arms and
    forearms, after dt seconds

        p(r | r') = N(r; r', place^2 dt)
        p(n | n') = N(n; k n', neck^2 (1 - k^2)),    k = exp(-dt / neck_time)
        p(o | o') = N(o; l o', s^2 (1 - l^2)),       l = exp(-dt / torso_time),  s = (lean, turn, lean)
        p(arm | arm') = (1 - j) vMF(upper; upper', K) vMF(fore; fore', K') + j usual(arm),
                        j = 1 - exp(-jumps dt)

    A direction's mean is that of a Brownian motion on the sphere, in any number of steps: von Mises and
    Fisher's density, of the concentration K that has it, is taken for that motion's, so that there is no pole
    at which a rotation's angles jump, and samples are drawn from exactly the density that is evaluated. Now
    and then an arm goes anywhere, more often than arms do: that is how often one has to be found again of
    which the tracker was mistaken.

    Densities count unusual postures for less (`log_posture`), which draws do not. What the joints do not
    allow is drawn and has a density all the same: who asks has to leave it out (`UpperBody.allowed`). What is
    lost in both ways is not made up for.

    Parameters
    ----------
    body
        whose lengths give the scale.
    place
        head heights after one second, standard deviation of each coordinate.
    lean, turn
        rad, standard deviations in the long run of the torso's lean, forwards and sideways, and of its turn.
        Who sits and talks seldom leans by more than 17 degrees or turns by more than 34.
    torso_time
        s, in which they are forgotten: a torso moves slower than a head.
    neck
        rad, standard deviation of each rotation in the long run.
    neck_time
        s, in which a rotation of the neck is forgotten.
    upper_arm, forearm
        rad after one second, standard deviation of a direction about each of two axes.
    jumps
        of an arm, in one second.
    exchanges
        in one second, of left and right hand: how often they turn out to have been taken for each other.
    returns
        in one second, of the whole body to another place: how often somebody turns out to be elsewhere.
    """

    body: UpperBody
    place: float = 0.3
    lean: float = 0.15
    turn: float = 0.3
    torso_time: float = 2.0
    neck: float = 0.25
    neck_time: float = 1.0
    upper_arm: float = 0.6
    forearm: float = 1.0
    jumps: float = 2.0
    exchanges: float = 0.05
    returns: float = 0.02

    def __post_init__(self) -> None:
        for name in ("place", "lean", "turn", "torso_time", "neck", "neck_time", "upper_arm", "forearm"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"{name}: got {value}, expected more than 0")
        for name in ("jumps", "exchanges", "returns"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name}: got {getattr(self, name)} a second, expected 0 or more")

    def draw(self, poses: BodyPoses, dt: float, random: np.random.Generator) -> BodyPoses:
        """Move every pose by `dt` seconds at random."""
        n = len(poses)
        place, concentrations, jump = self._rates(dt)
        kept, spread = self.turn_step(dt)
        roots = poses.roots + place * random.standard_normal((n, 2))
        torsos = kept[:3] * poses.torsos + spread[:3] * random.standard_normal((n, 3))
        necks = kept[3:] * poses.necks + spread[3:] * random.standard_normal((n, 3))
        arms = np.stack(
            [around(poses.arms[:, :, part], concentrations[part], random) for part in (0, 1)], axis=2
        )
        jumping = np.nonzero(random.random((n, 2)) < jump)
        arms[jumping] = usual_arms(jumping[1], random)
        return BodyPoses(roots, torsos, necks, arms)

    def log_density(self, poses: BodyPoses, ancestors: Ancestors) -> Array:
        """`(n,)` nats: log of the mixture of p(x | ancestor) over ancestors, with `log_posture`.

        Density in px^2 of the place, rad^3 each of the rotations of torso and neck and solid angle of the
        four directions.
        The sum is taken relative to its largest place, and an arm's factor has a floor, so that nothing
        underflows. The cost is the number of poses times that of ancestors.
        """
        terms, log_scales = self._terms(poses, ancestors)
        values = np.empty(len(poses), np.float32)
        mixture_values(*terms, values)
        return np.asarray(
            log_scales + np.log(values.astype(np.float64)) + self.log_posture(poses, ancestors.elapsed)
        )

    def log_step(self, poses: BodyPoses, before: BodyPoses, dt: float) -> Array:
        """`(n,)` nats: log of p(x | x') of each pose and its own `dt` seconds before, as `log_density`."""
        place = self._rates(dt)[0]
        kept, spread = self.turn_step(dt)
        steps = [(poses.roots - before.roots) / place, (poses.turns - kept * before.turns) / spread]
        squares = np.square(np.concatenate(steps, axis=1)).sum(axis=1)
        gaussian = -4 * np.log(2 * np.pi) - 2 * np.log(place) - np.log(spread).sum()
        arms = self.log_arm_steps(poses, before, dt).sum(axis=1)
        return np.asarray(gaussian - 0.5 * squares + arms + self.log_posture(poses, dt))

    def log_arm_steps(self, poses: BodyPoses, before: BodyPoses, dt: float) -> Array:
        """`(n, 2)` nats: the factors of left and right arm in `log_step`."""
        _, concentrations, jump = self._rates(dt)
        peak = (1 - jump) * _peak(concentrations).prod()
        turned = (((poses.arms * before.arms).sum(axis=3) - 1) * concentrations).sum(axis=2)
        turned = np.maximum(turned, LEAST_EXPONENT)
        return np.asarray(np.log(peak * np.exp(turned) + jump * np.exp(_log_usual(poses.arms))))

    def log_returns(self, dt: float) -> tuple[float, float]:
        """Logs of the probabilities that after `dt` s a body is anywhere, and that it went on from before."""
        stays = max(-self.returns * dt, np.log1p(-MOST_JUMPS))
        return float(np.log(-np.expm1(stays))) if stays else -np.inf, float(stays)

    def draw_ancestors(
        self, poses: BodyPoses, ancestors: Ancestors, random: np.random.Generator
    ) -> NDArray[np.int64]:
        """`(n,)` indices: for each pose one of the ancestors, drawn from p(ancestor | pose), in proportion to
        its weight times p(x | ancestor). The cost is that of `log_density`."""
        chosen = np.empty(len(poses), np.int64)
        draw_terms(*self._terms(poses, ancestors)[0], random.random(len(poses)), chosen)
        return chosen

    def _terms(self, poses: BodyPoses, ancestors: Ancestors) -> tuple[tuple[Any, ...], Array]:
        """What `mixture_values` takes, and `(n,)` nats: by what its values are too small."""
        place, concentrations, jump = self._rates(ancestors.elapsed)
        kept, spread = self.turn_step(ancestors.elapsed)
        past = ancestors.poses
        origin = past.roots.mean(axis=0)
        here = np.concatenate([(poses.roots - origin) / place, poses.turns / spread], axis=1)
        there = np.concatenate([(past.roots - origin) / place, kept * past.turns / spread], axis=1)
        peak = (1 - jump) * _peak(concentrations).prod()
        jumped = jump * np.exp(_log_usual(poses.arms))
        floors = np.maximum(jumped / peak, LEAST_FLOOR).astype(np.float32)
        body, rows = here.astype(np.float32), np.ascontiguousarray(there.T, np.float32)
        least = np.empty(len(poses), np.float32)
        least_squares_to_rows(body, rows, least)
        terms = (
            body, rows, least,
            poses.arms.reshape(-1, 12).astype(np.float32),
            np.ascontiguousarray(past.arms.reshape(-1, 12).T, np.float32),
            ancestors.weights.astype(np.float32), concentrations.astype(np.float32), floors,
        )  # fmt: skip
        gaussian = -4 * np.log(2 * np.pi) - 2 * np.log(place) - np.log(spread).sum()
        return terms, gaussian + 2 * np.log(peak) - 0.5 * least

    def log_posture(self, poses: BodyPoses, dt: float = CROSSED_TIME) -> Array:
        """`(n,)` nats, at most 0: how much less usual a posture is than one with each hand on its own side.

        It counts once for `dt` seconds. Where hands cannot be told apart, this decides.
        """
        hands = self.body.parts(poses)[:, 1:, 0]
        across = (hands[:, 1] - hands[:, 0]) / self.body.head_height
        return np.asarray(-CROSSED * min(dt, CROSSED_TIME) * np.clip(across, 0, 1))

    def with_exchanged(self, ancestors: Ancestors, random: np.random.Generator) -> Ancestors:
        """Weighted poses, and the same with each hand where the other one was, as far as that is possible.

        An exchanged arm has its elbow anywhere on the circle on which it can be. The weight of a pose is
        divided between the two.
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
        """`n` poses of somebody of whom only is known that the picture of `size` (height, width) shows them.

        Poses are drawn again until the joints allow them.
        """
        height, width = size
        roots = random.random((n, 2)) * (width, height)
        poses = BodyPoses(roots, np.zeros((n, 3)), np.zeros((n, 3)), np.empty((n, 2, 2, 3)))
        wrong = np.arange(n)
        while len(wrong):
            turns = self.turn_spreads * random.standard_normal((len(wrong), 6))
            poses.torsos[wrong], poses.necks[wrong] = turns[:, :3], turns[:, 3:]
            poses.arms[wrong] = usual_arms(np.tile([0, 1], (len(wrong), 1)), random)
            wrong = wrong[~self.body.allowed(poses.take(wrong))]
        return poses

    def log_density_anywhere(self, poses: BodyPoses, size: tuple[int, int]) -> Array:
        """`(n,)` log density of `draw_anywhere` times that of the posture, but for a constant factor."""
        height, width = size
        place = -np.log(float(height) * width)
        turns = -3 * np.log(2 * np.pi) - np.log(self.turn_spreads).sum()
        turns -= 0.5 * ((poses.turns / self.turn_spreads) ** 2).sum(axis=1)
        return np.asarray(place + turns + _log_usual(poses.arms).sum(axis=1) + self.log_posture(poses))

    @property
    def turn_spreads(self) -> Array:
        """`(6,)` rad: standard deviations of `BodyPoses.turns` in the long run."""
        return np.array([self.lean, self.turn, self.lean, self.neck, self.neck, self.neck])

    def turn_step(self, dt: float) -> tuple[Array, Array]:
        """Shares of `BodyPoses.turns` left after `dt` s, standard deviations of what comes; each `(6,)`."""
        times = np.repeat([self.torso_time, self.neck_time], 3)
        return np.exp(-dt / times), self.turn_spreads * np.sqrt(-np.expm1(-2 * dt / times))

    def _rates(self, dt: float) -> tuple[float, Array, float]:
        """Standard deviation of place (px), concentrations of the arms' directions, chance of a jump."""
        place = self.place * self.body.head_height * float(np.sqrt(dt))
        concentrations = _concentrations(self.upper_arm, self.forearm, dt)
        jump = min(float(-np.expm1(-self.jumps * dt)), MOST_JUMPS)
        return place, concentrations, jump


def concentration(elapsed: Array) -> Array:
    """Of von Mises and Fisher's density whose mean cosine is exp(-elapsed), by Newton's method.

    That is the mean of a Brownian motion on the unit sphere, `elapsed` being its variance about each axis.
    """
    gap = -np.expm1(-np.minimum(elapsed, -np.log(LEAST_COSINE)))
    mean = 1 - gap
    kappa = mean * (3 - mean**2) / (gap * (1 + mean))
    for _ in range(6):
        rest = 2 / np.expm1(np.minimum(2 * kappa, 700.0))  # the mean cosine is 1 + rest - 1 / kappa
        kappa += (1 / kappa - rest - gap) / (1 / kappa**2 - rest * (rest + 2))
    return np.asarray(kappa)


@lru_cache(maxsize=64)
def _concentrations(upper_arm: float, forearm: float, dt: float) -> Array:
    """`(2,)` of both segments' directions after `dt` s: films have few different steps, which all ask for."""
    concentrations = concentration(np.array([upper_arm, forearm]) ** 2 * dt)
    concentrations.flags.writeable = False
    return concentrations


def around(directions: Array, concentration: Array | float, random: np.random.Generator) -> Array:
    """Draw unit vectors from von Mises and Fisher's density about `directions`, `(..., 3)`.

    On the sphere the cosine to the middle has an inverse distribution in closed form.
    """
    shape = directions.shape[:-1]
    share = random.random(shape)
    cosine = 1 + np.log(share + (1 - share) * np.exp(-2 * concentration)) / concentration
    turns = 2 * np.pi * random.random(shape)
    drawn = np.empty((*shape, 3))
    lean(directions.reshape(-1, 3), cosine.reshape(-1), turns.reshape(-1), drawn.reshape(-1, 3))
    return drawn


def usual_arms(sides: NDArray[np.int64], random: np.random.Generator) -> Array:
    """`(..., 2, 3)`: arms of `sides`, 0 for the left, of which nothing is known but that upper arms mostly
    hang down."""
    return np.stack([around(USUAL_UPPER_ARMS[sides], USUAL, random), anywhere(sides.shape, random)], axis=-2)


def _log_usual(arms: Array) -> Array:
    """`(n, 2)`: log density of each arm of `usual_arms`."""
    cosines = (arms[:, :, 0] * USUAL_UPPER_ARMS).sum(axis=2)
    return np.asarray(USUAL * (cosines - 1) + np.log(_peak(USUAL)) - np.log(SPHERE))


def _peak(concentrations: Array | float) -> Array:
    """Von Mises and Fisher's density at its middle."""
    return np.asarray(concentrations / (2 * np.pi * -np.expm1(-2 * np.asarray(concentrations))))


def anywhere(shape: tuple[int, ...], random: np.random.Generator) -> Array:
    """Unit vectors `(*shape, 3)`, evenly over the sphere."""
    drawn = random.standard_normal((*shape, 3))
    drawn /= np.sqrt(np.einsum("...x,...x->...", drawn, drawn))[..., None]
    return drawn
