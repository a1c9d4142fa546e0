"""Poses that are tried in a frame, weighted samples of the prediction: gone on from before, or begun anew."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...inference.smc import normalised
from ...models.body.poses import BodyPoses
from ...models.core.gaussian_mixtures import GaussianMixtures
from .dynamics import Ancestors, BodyDynamics
from .guided_sampling import GuidedSampler
from .likelihood_sampling import MOST_ROUNDS, LikelihoodSampler

Array = NDArray[np.float64]

ANEW = 0.1
"""Least share of candidates that do not ask the past: who comes back elsewhere must be drawn to be found."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Weighted samples of p(x_t | past), each with the pose it goes back to.

    Parameters
    ----------
    dynamics, size, elapsed
        of the body; `(height, width)` px of the picture; s since the frame before.
    poses
        n of them, all possible.
    log_weights
        `(n,)`; they sum to 1 once others have `weighed` them.
    ancestors
        n poses of the frame before; those that begin anew are their own.
    anew
        `(n,)`: which ones do.
    """

    dynamics: BodyDynamics
    size: tuple[int, int]
    elapsed: float
    poses: BodyPoses
    log_weights: Array
    ancestors: BodyPoses
    anew: NDArray[np.bool_]

    @classmethod
    def at_first(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        said: GaussianMixtures,
        n: int,
        random: np.random.Generator,
        rounds: int = MOST_ROUNDS,
    ) -> Self:
        """Of somebody of whom nothing is known, drawn from proper mixtures of head and hands."""
        proposal = LikelihoodSampler(dynamics).draw(said, n, random, rounds)
        log_weights = dynamics.log_density_anywhere(proposal.poses, size) - proposal.log_density
        log_weights -= np.log(max(proposal.tried, 1.0))
        count = len(proposal.poses)
        return cls(
            dynamics, size, np.inf, proposal.poses, log_weights, proposal.poses, np.ones(count, np.bool_)
        )

    @classmethod
    def after(
        cls,
        dynamics: BodyDynamics,
        size: tuple[int, int],
        past: Ancestors,
        guides: Sequence[tuple[GaussianMixtures, float]],
        said: GaussianMixtures,
        n: int,
        random: np.random.Generator,
    ) -> Self:
        """Of somebody who was seen before: most go on, guided (`GuidedSampler.draw`), some begin anew."""
        log_elsewhere, log_stays = dynamics.log_returns(past.elapsed)
        anew = round(max(ANEW, np.exp(log_elsewhere)) * n)
        begun = cls.at_first(dynamics, size, said, anew, random, rounds=1)
        went_on = GuidedSampler(dynamics).draw(past, guides, max(n - anew, 1), random)
        return cls(
            dynamics,
            size,
            past.elapsed,
            BodyPoses.concatenated([begun.poses, went_on.poses]),
            np.concatenate([begun.log_weights + log_elsewhere, went_on.log_weights + log_stays]),
            BodyPoses.concatenated([begun.poses, past.poses.take(went_on.ancestors)]),
            np.arange(len(begun.poses) + len(went_on.poses)) < len(begun.poses),
        )

    def weighed(self, log_factors: Array) -> Self:
        """With factors `(n,)` that others say; weights are normalised."""
        return replace(self, log_weights=normalised(self.log_weights + log_factors))

    def take(self, rows: NDArray[np.int64], log_weights: Array) -> Self:
        """Some of them, with other weights."""
        return replace(
            self,
            poses=self.poses.take(rows),
            log_weights=log_weights,
            ancestors=self.ancestors.take(rows),
            anew=self.anew[rows],
        )

    def log_prior(self, poses: BodyPoses, owners: NDArray[np.int64]) -> Array:
        """`(m,)` nats of poses that go back to what candidates `owners` `(m,)` go back to, up to a constant
        of each; minus infinity where joints forbid them."""
        dynamics, anew = self.dynamics, self.anew[owners]
        prior = np.full(len(poses), -np.inf)
        begun, gone_on = np.flatnonzero(anew), np.flatnonzero(~anew)
        if len(begun):
            prior[begun] = dynamics.log_density_anywhere(poses.take(begun), self.size)
        if len(gone_on):
            before = self.ancestors.take(owners[gone_on])
            prior[gone_on] = dynamics.log_step(poses.take(gone_on), before, self.elapsed)
        return np.where(dynamics.body.allowed(poses), prior, -np.inf)
