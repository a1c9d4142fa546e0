"""Does it pay to combine two chains whose predictions are no Gaussians? An answer from their densities.

Where a chain predicts what is seen by any density, what counts is the logarithm of that density at what is
then observed, a proper score: nobody gains by stating another one than the right one. Combining pays if the
normalised product scores better than either chain.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .estimate import FEWEST_GROUPS, Interval, Verdict, group_sums, interval_of

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScoreComparison:
    """What recorded log densities of two chains and of their product say about combining them.

    Parameters
    ----------
    count, groups
        how many rows, in how many independent groups.
    first, second, product
        mean log densities of what was observed, nats.
    gain
        that of the product less the larger one of the chains'; positive means that combining pays.
    verdict, reason
        for the user, in a word and in a sentence.
    """

    count: int
    groups: int
    first: Interval[float]
    second: Interval[float]
    product: Interval[float]
    gain: Interval[float]
    verdict: Verdict = field(init=False)
    reason: str = field(init=False)

    def __post_init__(self) -> None:
        found = f"the product scores {self.gain:.2g} nats above the better chain"
        verdict: Verdict = "not sure"
        if self.groups < FEWEST_GROUPS:
            found += f", but only from {self.groups} independent groups"
        elif self.gain.low > 0:
            verdict = "helps"
        elif self.gain.high < 0:
            verdict = "does not help"
        object.__setattr__(self, "verdict", verdict)
        object.__setattr__(self, "reason", found[0].upper() + found[1:])


def compare_scores(
    scores: Numbers,
    groups: ArrayLike,
    random: np.random.Generator | None = None,
    resamples: int = 1000,
) -> ScoreComparison:
    """Judge from log densities whether combining two chains pays.

    Parameters
    ----------
    scores
        `(n, 3)` nats: of what was observed under the first chain's prediction, the second's, their product.
    groups
        `(n,)` integers: rows of one group may be related, different groups are taken for independent.
    random
        for the bootstrap; seeded with 0 if not given.
    resamples
        of the bootstrap.

    Raises
    ------
    ValueError
        if the shapes do not fit, a score is not finite, or there are fewer than two groups.
    """
    labels = np.asarray(groups)
    if scores.ndim != 2 or scores.shape[1] != 3 or labels.shape != scores.shape[:1]:
        raise ValueError(f"scores: got {scores.shape} and {labels.shape} groups, expected (n, 3) and (n,)")
    if not np.isfinite(scores).all():
        raise ValueError("scores: got one that is not finite, expected finite ones")
    sums = group_sums(scores, labels)
    means = sums.resampled(np.random.default_rng(0) if random is None else random, resamples)
    gain = means[:, 2] - np.maximum(means[:, 0], means[:, 1])
    first, second, product = (interval_of(each) for each in means.T)
    return ScoreComparison(len(scores), sums.count, first, second, product, interval_of(gain))
