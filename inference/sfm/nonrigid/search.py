"""Which of many starts leads to the likeliest shape, and how fine its deformations are modelled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .comparison import shape_error
from .em import State, Tracks, WeightPosterior, e_step, log_likelihood, point_sums, run_em
from .orthonormality import rotations_of_rank
from .start import TOLERANCE, rigid_states, shape_seen_from, with_modes, without_modes

Numbers = NDArray[np.float64]

MOST_BASES = 12
"""That poses are looked for with, if fewer are asked for: what bases leave of a deformation is then not
explained by turns that the object never made. More gain little, and take longer."""

FIRST_ROUND, SECOND_ROUND, PRUNING_ROUND = 40, 100, 40
"""Iterations of all starts, of the best ones, and of a shape after modes were taken away."""
KEPT = 3
"""Starts that go on to the second round."""
SAME = 0.01
"""Shapes that differ by so little, as `shape_error` measures, are one optimum."""
NEARLY = 0.05
"""Optima are as good as each other if their noise differs by no more than this share: so much is left to
chance by what the model leaves out."""

RANKS = (6, 9, 15, 24)
"""Of the factorisations whose rotations are tried, beside three times the numbers of bases."""


@dataclass(frozen=True, eq=False)
class Found:
    """The likeliest state, and others that are nearly as likely.

    Parameters
    ----------
    state
        with as many modes as the tracks tell.
    history
        of its last climb.
    others
        log likelihoods below that of the best after as many iterations, and states.
    """

    state: State
    history: list[float]
    others: tuple[tuple[float, State], ...]


def search(
    tracks: Tracks,
    positions: Numbers,
    bases: int,
    most: int,
    iterations: int,
    tolerance: float,
    on_iteration: Callable[[], None],
) -> Found:
    """Climb from many starts, with more modes than are asked for, and go on with the best.

    A model with few modes explains finer deformations by turns of the object; the likelihood then prefers
    wrong poses to true ones. With more modes it does not. Those that do not pay by the criterion of Hannan
    and Quinn (1979) are taken away at the end.

    Parameters
    ----------
    tracks, positions
        the same, `positions` `(n_frames, n_points, 2)` with NaN where not seen.
    bases
        number of bases that there will be at least.
    most
        number of bases that the tracks can tell apart.
    iterations, tolerance
        of the last climb, for `run_em`.
    """

    def climbed(state: State, rounds: int) -> State:
        return run_em(tracks, state, rounds, TOLERANCE, on_iteration)[0]

    size = max(bases, min(MOST_BASES, most))
    rigid = rigid_states(tracks, positions, on_iteration)
    first = [climbed(with_modes(tracks, each, size - 1), FIRST_ROUND) for each in rigid]
    filled = _filled(tracks, _best_first(tracks, first)[0][1])
    ranks = {rank for rank in (*RANKS, 3 * bases, 3 * size) if rank <= 3 * size}
    for rotations in rotations_of_rank(filled, ranks):
        start = with_modes(tracks, shape_seen_from(filled, rotations), size - 1)
        first.append(climbed(start, FIRST_ROUND))
    second = [climbed(state, SECOND_ROUND) for _, state in _best_first(tracks, first)[:KEPT]]
    (likelihood, best), *rest = _best_first(tracks, second)
    nearly = -tracks.count * float(np.log1p(-NEARLY))
    others = tuple((likelihood - other, state) for other, state in rest if likelihood - other < nearly)
    best = _pruned(tracks, best, bases, climbed)
    state, history = run_em(tracks, best, iterations, tolerance, on_iteration)
    return Found(state, history, others)


def _pruned(tracks: Tracks, state: State, bases: int, climbed: Callable[[State, int], State]) -> State:
    """The state without modes that do not pay; half of those beyond `bases` are tried at a time."""
    likelihood = log_likelihood(tracks, state)
    while len(state.bases) > bases:
        fewer = bases + (len(state.bases) - bases) // 2
        tried = climbed(without_modes(state, fewer), PRUNING_ROUND)
        reached = log_likelihood(tracks, tried)
        saved = _free_numbers(state) - _free_numbers(tried)
        if likelihood - reached > saved * np.log(np.log(tracks.n_frames)):
            return state
        state, likelihood = tried, reached
    return state


def _free_numbers(state: State) -> float:
    """Of the bases; modes may be turned among each other."""
    modes = len(state.bases) - 1
    return state.bases.size - modes * (modes - 1) / 2


def _filled(tracks: Tracks, state: State) -> Numbers:
    """Positions about the middles of all points, those that were not seen as the state has them."""
    predicted = whole_shapes(tracks, state)[..., :2] + state.translations[:, None]
    complete = np.where(tracks.seen[..., None] > 0, tracks.positions, predicted)
    centred: Numbers = complete - complete.mean(axis=1, keepdims=True)
    return centred


def whole_shapes(tracks: Tracks, state: State) -> Numbers:
    """`(n_frames, n_points, 3)` in the camera's axes, with all modes, from the object's origin."""
    return shapes_of(state, e_step(state, point_sums(tracks, state.bases)))


def shapes_of(state: State, found: WeightPosterior) -> Numbers:
    """The same for weights that are known."""
    shapes = np.tensordot(found.extended, state.bases, 1) @ state.rotations.transpose(0, 2, 1)
    scaled: Numbers = state.scales[:, None, None] * shapes
    return scaled


def _best_first(tracks: Tracks, states: Sequence[State]) -> list[tuple[float, State]]:
    """States with their log likelihoods, the likeliest first, each optimum only once."""
    different: list[tuple[float, State]] = []
    shapes: list[Numbers] = []
    ranked = sorted(((log_likelihood(tracks, each), each) for each in states), key=lambda each: -each[0])
    for likelihood, state in ranked:
        shape = whole_shapes(tracks, state)
        if all(shape_error(shape, other) > SAME for other in shapes):
            different.append((likelihood, state))
            shapes.append(shape)
    return different
