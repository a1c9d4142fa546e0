"""Coordinate ascent on chains whose joint optimum has a closed form, and on chains that misbehave."""

import weakref
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference import BatchIncoming, CoordinateAscent, MultiChain, Port, RecursiveBP, Smoothed
from rsmcm.inference.engine.protocols import LazyFrames
from rsmcm.models import Frame
from rsmcm.models.core.gaussian_message import GaussianMessage

Numbers = NDArray[np.float64]

RANDOM = np.random.default_rng(5)
N_FRAMES = 12
SEEN = np.cumsum(RANDOM.normal(size=N_FRAMES)) + RANDOM.normal(size=N_FRAMES)
NOISE = 0.5


def gaussian(mean: float, variance: float) -> GaussianMessage:
    return GaussianMessage.from_moments([1], [[mean]], [[[variance]]])


@dataclass(frozen=True)
class Level:
    """A number in each frame, seen with noise; frames tell by their number which."""

    name: str = "level"

    searches = True

    def uniform(self) -> GaussianMessage:
        return GaussianMessage.uniform(1)

    def evidence(self, frame: Frame, prior: GaussianMessage) -> GaussianMessage:
        return gaussian(SEEN[frame.number - 1], NOISE)


@dataclass(frozen=True, eq=False)
class Path:
    """Value at each time, and the log density of the chain's own dynamics there."""

    values: Numbers
    log_prior: float


@dataclass(frozen=True)
class Quadratic:
    """A chain X with log p(X) = -X . precision X / 2 + pull . X and p(F_t | X) = N(F_t; X_t, spread)."""

    name: str
    precision: Numbers
    pull: Numbers
    spread: float

    ports = (Port(Level, many=True),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Path | None = None
    ) -> Smoothed[Path]:
        information, vector = self.precision.copy(), self.pull.copy()
        for time, incoming in enumerate(incoming_over_time):
            for message in incoming.by_name(Level).values():
                if len(message):
                    (_, means, covariances) = message.moments
                    variance = covariances[0, 0, 0] + self.spread
                    information[time, time] += 1 / variance
                    vector[time] += means[0, 0] / variance
        values = np.linalg.solve(information, vector)
        return Smoothed(Path(values, float(self.pull @ values - 0.5 * values @ self.precision @ values)))

    def messages(
        self, trajectory: Path, feature: Level, incoming_over_time: Sequence[BatchIncoming] = ()
    ) -> list[GaussianMessage]:
        return [gaussian(value, self.spread) for value in trajectory.values]


def second_differences(weight: float) -> Numbers:
    rows = np.diff(np.eye(N_FRAMES), 2, axis=0)
    return weight * rows.T @ rows + 1e-3 * np.eye(N_FRAMES)


SMOOTH = Quadratic("smooth", second_differences(20.0), np.zeros(N_FRAMES), 0.3)
CALM = Quadratic("calm", 0.5 * np.eye(N_FRAMES), np.full(N_FRAMES, 0.7), 0.6)
THIRD = Quadratic("third", 0.1 * np.eye(N_FRAMES), np.zeros(N_FRAMES), 0.9)
FRAMES = [Frame(np.zeros((4, 4), np.uint8), k / 10, k + 1) for k in range(N_FRAMES)]


def joint_optimum(chains: Sequence[Quadratic], n_levels: int) -> list[Numbers]:
    """Means of all chains' values in the joint Gaussian of chains, features and observations."""
    size, count = N_FRAMES, len(chains) + n_levels
    information, vector = np.zeros((count, size, count, size)), np.zeros((count, size))
    for own, chain in enumerate(chains):
        information[own, :, own] += chain.precision
        vector[own] += chain.pull
        for level in range(len(chains), count):
            for one, other in product((own, level), repeat=2):
                information[one, :, other] += (1 if one == other else -1) * np.eye(size) / chain.spread
    for level in range(len(chains), count):
        information[level, :, level] += np.eye(size) / NOISE
        vector[level] += SEEN / NOISE
    solution = np.linalg.solve(information.reshape(count * size, -1), vector.reshape(-1))
    return list(solution.reshape(count, size)[: len(chains)])


@pytest.mark.parametrize("n_levels", [1, 2])
@pytest.mark.parametrize("chains", [(SMOOTH,), (SMOOTH, CALM), (CALM, SMOOTH, THIRD)])
def test_ascent_ends_at_the_joint_optimum(chains: tuple[Quadratic, ...], n_levels: int) -> None:
    """Also with loops: given all trajectories, features do not depend on each other."""
    model, levels = MultiChain(), [Level(f"level {number}") for number in range(n_levels)]
    for chain, level in product(chains, levels):
        model.connect(chain, level)
    assert model.has_loops == (n_levels > 1 and len(chains) > 1)
    solution = CoordinateAscent(model, most_rounds=500, tolerance=1e-15).run(FRAMES)
    assert solution.converged
    for chain, expected in zip(chains, joint_optimum(chains, n_levels), strict=True):
        np.testing.assert_allclose(solution[chain].values, expected, atol=1e-5)
    objectives = [report.objective for report in solution.rounds]
    assert (np.diff(objectives) >= -1e-9).all()
    assert solution.objective == max(objectives)
    assert len(solution[levels[0]]) == N_FRAMES
    assert [len(message) for message in solution.evidence(levels[0])] == [1] * N_FRAMES


@pytest.mark.parametrize("chains", list(permutations((SMOOTH, CALM, THIRD))))
def test_order_of_connection_changes_no_byte(chains: tuple[Quadratic, ...]) -> None:
    level = Level()
    usual, other = (
        reduce(lambda model, chain: model.connect(chain, level), order, MultiChain())
        for order in ((SMOOTH, CALM, THIRD), chains)
    )
    one, two = (CoordinateAscent(model, most_rounds=3).run(FRAMES) for model in (usual, other))
    assert [report.smoothed for report in one.rounds] == [("calm", "smooth", "third")] * 3
    assert [report.objective for report in one.rounds] == [report.objective for report in two.rounds]
    for chain in chains:
        np.testing.assert_array_equal(one[chain].values, two[chain].values)


def test_what_is_no_answer_is_refused() -> None:
    class Short(Quadratic):
        def messages(
            self, trajectory: Path, feature: Level, incoming_over_time: Sequence[BatchIncoming] = ()
        ) -> list[GaussianMessage]:
            return super().messages(trajectory, feature)[1:]

    class Mute(Quadratic):
        def messages(
            self, trajectory: Path, feature: Level, incoming_over_time: Sequence[BatchIncoming] = ()
        ) -> Any:
            return [None] * N_FRAMES

    class Bare(Quadratic):
        def smooth(self, incoming_over_time: Sequence[BatchIncoming], current: Path | None = None) -> Any:
            return super().smooth(incoming_over_time, current).trajectory

    numbers = CALM.precision, CALM.pull, CALM.spread
    for kind, expected in (
        (Short, "messages of 'x': got 11, expected 12, one a frame"),
        (Mute, "message from 'x' to 'level': got NoneType, expected GaussianMessage"),
        (Bare, "chain 'x': smooth gave Path, expected Smoothed"),
    ):
        with pytest.raises((TypeError, ValueError), match=expected):
            CoordinateAscent(MultiChain().connect(kind("x", *numbers), Level())).run(FRAMES)


def test_without_feedback_one_round_is_all() -> None:
    level = Level()
    model = MultiChain().connect(SMOOTH, level).connect(CALM, level, feedback=False)
    solution = CoordinateAscent(model).run(FRAMES)
    assert solution.converged
    assert [report.smoothed for report in solution.rounds] == [("smooth", "calm")]
    alone = CoordinateAscent(MultiChain().connect(SMOOTH, level)).run(FRAMES)
    np.testing.assert_array_equal(solution["smooth"].values, alone["smooth"].values)
    assert len(solution.messages("calm", level)) == N_FRAMES  # spoken, though nobody hears it


@dataclass(frozen=True)
class Searching:
    """Searches where others expect it, and notes how much it saw in each round."""

    seen: list[int]
    name: str = "searching"

    ports = (Port(Level),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Path | None = None
    ) -> Smoothed[Path]:
        evidence = [incoming.search(Level, incoming.others(Level)) for incoming in incoming_over_time]
        self.seen.append(sum(len(message) for message in evidence))
        return Smoothed(Path(np.zeros(N_FRAMES), 0.0), {incoming_over_time[0].node(Level): evidence})

    def messages(
        self, trajectory: Path, feature: Level, incoming_over_time: Sequence[BatchIncoming] = ()
    ) -> list[GaussianMessage]:
        return [feature.uniform() for _ in trajectory.values]


@dataclass(frozen=True)
class Narrow(Level):
    """Sees nothing beyond a distance of 1 from where it is expected."""

    def evidence(self, frame: Frame, prior: GaussianMessage) -> GaussianMessage:
        if len(prior) and abs(prior.moments[1][0, 0] - SEEN[frame.number - 1]) > 1:
            return self.uniform()
        return super().evidence(frame, prior)


def test_a_chain_that_searches_sees_anew_in_each_round_and_others_see_the_same() -> None:
    level, searching = Narrow(), Searching([])
    model = MultiChain().connect(searching, level).connect(SMOOTH, level)
    first, second = CoordinateAscent(model, most_rounds=2, tolerance=-1).rounds(FRAMES)
    near = np.abs(first["smooth"].values - SEEN) <= 1
    assert 0 < np.count_nonzero(near) < N_FRAMES
    assert searching.seen == [N_FRAMES, np.count_nonzero(near)]
    assert first.objective == first.rounds[0].objective
    assert [len(message) for message in first.evidence(level)] == [1] * N_FRAMES
    assert len(second.rounds) == 2


@dataclass(frozen=True)
class Worsening(Quadratic):
    """Gets worse each time."""

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Path | None = None
    ) -> Smoothed[Path]:
        best = super().smooth(incoming_over_time, current)
        if current is None:
            return best
        return Smoothed(Path(current.values + 1, best.trajectory.log_prior - 100))


def test_the_best_round_is_kept() -> None:
    level = Level()
    worsening = Worsening("worsening", CALM.precision, CALM.pull, CALM.spread)
    model = MultiChain().connect(worsening, level).connect(SMOOTH, level)
    solutions = list(CoordinateAscent(model).rounds(FRAMES))
    assert len(solutions) == 2
    assert solutions[1].rounds[1].objective < solutions[1].rounds[0].objective
    np.testing.assert_array_equal(solutions[1]["worsening"].values, solutions[0]["worsening"].values)


def test_rounds_that_are_not_compared_cost_no_objective() -> None:
    level = Level()
    worsening = Worsening("worsening", CALM.precision, CALM.pull, CALM.spread)
    model = MultiChain().connect(worsening, level).connect(SMOOTH, level)
    *_, last = CoordinateAscent(model, most_rounds=3, tolerance=None).rounds(FRAMES)
    assert len(last.rounds) == 3
    assert np.isnan([report.objective for report in last.rounds]).all()
    assert not last.converged
    first = CoordinateAscent(model, most_rounds=1, tolerance=None).run(FRAMES)
    # the engine went on from each round's values: each added 1, and each time a system was solved anew
    np.testing.assert_allclose(last["worsening"].values, first["worsening"].values + 2, rtol=0, atol=1e-12)


class Film(LazyFrames):
    """Frames that are made when they are asked for; `alive` are those that somebody holds."""

    def __init__(self) -> None:
        self.alive: weakref.WeakSet[Frame] = weakref.WeakSet()
        self.most = 0

    def __len__(self) -> int:
        return N_FRAMES

    def __getitem__(self, index: int) -> Frame:  # type: ignore[override]
        if not 0 <= index < N_FRAMES:
            raise IndexError(index)
        frame = replace(FRAMES[index])
        self.alive.add(frame)
        self.most = max(self.most, len(self.alive))
        return frame

    def time(self, index: int) -> float:
        return FRAMES[index].time


def test_frames_that_are_read_again_are_not_held() -> None:
    level, film = Level(), Film()
    model = MultiChain().connect(SMOOTH, level).connect(CALM, level)
    found = CoordinateAscent(model).run(film)
    assert film.most <= 3
    held = CoordinateAscent(model).run(FRAMES)
    assert found.objective == held.objective
    for chain in (SMOOTH, CALM):
        np.testing.assert_array_equal(found[chain].values, held[chain].values)


def test_bad_models_and_frames() -> None:
    level = Level()
    model = MultiChain().connect(SMOOTH, level)
    with pytest.raises(ValueError, match="got no chain"):
        CoordinateAscent(MultiChain())
    with pytest.raises(ValueError, match="most_rounds: got 0"):
        CoordinateAscent(model, most_rounds=0)
    with pytest.raises(ValueError, match="frames: got none"):
        CoordinateAscent(model).run([])
    with pytest.raises(ValueError, match=r"got time 0.0 s at frame 1, expected later than 0.1 s"):
        CoordinateAscent(model).run([FRAMES[1], FRAMES[0]])
    with pytest.raises(TypeError, match=r"'smooth': got .* a Chain \(it lacks initial, predict, message, "):
        RecursiveBP(model)
    with pytest.raises(KeyError, match="not part of the model, expected one of smooth, level"):
        CoordinateAscent(model).run(FRAMES)["other"]
