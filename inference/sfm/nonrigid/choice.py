"""How many bases tracks can tell: by positions that were withheld."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .learning import learn_shape, most_bases
from .uncertainty import without_triangles

Numbers = NDArray[np.float64]

WITHHELD = 0.1
"""Share of the positions; the model is learned from the others."""
LEAST_LEFT = 5
"""Positions that a frame or a point keeps at least, where it has them: enough for a pose."""
MOST_BASES = 8
BLOCKS = 20
"""Of successive frames, whose errors are alike: what they differ by is the spread of an error."""


@dataclass(frozen=True, eq=False)
class BasesChoice:
    """Errors at positions that were withheld.

    Parameters
    ----------
    bases
        the number that was chosen.
    candidates
        `(n,)` numbers of bases that were tried.
    errors
        `(n,)` px: root mean square of a coordinate at withheld positions.
    excess
        `(n,)` px^2: by how much the mean square is above that of the best candidate.
    excess_errors
        `(n,)` px^2: standard error of this, from blocks of frames.
    """

    bases: int
    candidates: tuple[int, ...]
    errors: Numbers
    excess: Numbers
    excess_errors: Numbers


def choose_bases(
    tracks: ArrayLike,
    candidates: Sequence[int] | None = None,
    *,
    seed: int = 0,
    on_iteration: Callable[[], None] = lambda: None,
) -> BasesChoice:
    """Number of bases by cross-validation: the fewest that are no worse than the best by one standard error.

    A tenth of all positions, drawn at random once for all candidates, is withheld and predicted by shapes
    learned from the rest (the one-standard-error rule of Hastie, Tibshirani and Friedman 2009, section 7.10,
    with differences to the best candidate, paired by blocks of frames).

    Parameters
    ----------
    tracks
        as for `learn_shape`.
    candidates
        numbers of bases; 2 to 8 by default, as far as the tracks can tell so many apart.
    seed
        of which positions are withheld.
    on_iteration
        as for `learn_shape`.

    Raises
    ------
    ValueError
        as `learn_shape` does.
    """
    positions = np.array(tracks, np.float64)
    hidden = withheld(positions, seed)
    partial = positions.copy()
    partial[hidden] = np.nan
    if candidates is None:
        candidates = range(2, min(MOST_BASES, most_bases(partial)) + 1)
    squares = []
    for bases in candidates:
        learned = learn_shape(partial, bases, on_iteration=on_iteration)
        predicted = without_triangles(learned.bases).project(learned.poses)
        squares.append(np.where(hidden, np.sum((predicted - positions) ** 2, axis=2) / 2, 0.0))
    blocks = np.array_split(np.arange(len(positions)), min(BLOCKS, len(positions)))
    sums = np.array([[each[block].sum() for block in blocks] for each in squares])
    total = hidden.sum()
    means = sums.sum(axis=1) / total
    away = sums - sums[means.argmin()]
    excess = away.sum(axis=1) / total
    spread = np.sqrt(len(blocks)) * away.std(axis=1, ddof=1) / total
    chosen = int(np.flatnonzero(excess <= spread)[0])
    return BasesChoice(candidates[chosen], tuple(candidates), np.sqrt(means), excess, spread)


def withheld(positions: Numbers, seed: int) -> NDArray[np.bool_]:
    """`(n_frames, n_points)`: which positions that were seen are not to be learned from."""
    seen = ~np.isnan(positions[..., 0])
    draws = np.where(seen, np.random.default_rng(seed).random(seen.shape), 2.0)
    # those that a frame, or a point, has to keep are the ones with the largest draws among what was seen
    hidden = seen & (draws < WITHHELD)
    for axis in (0, 1):
        rank = np.argsort(np.argsort(np.where(seen, -draws, 1.0), axis=axis), axis=axis)
        hidden &= rank >= LEAST_LEFT
    return hidden
