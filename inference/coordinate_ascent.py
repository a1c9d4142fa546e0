"""Algorithm 2 of the RSMCM paper, coordinate ascent over whole sequences, for any number of chains."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from math import inf
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.frame import Frame
from .graph import MultiChain
from .protocols import BatchChain, BatchIncoming, Message, name_of, require


@dataclass(frozen=True, eq=False)
class Round:
    """How far the ascent has come.

    Parameters
    ----------
    number
        1 for the first.
    objective
        sum over the chains of the log density of their trajectories, and over all features and frames of the
        log mass of the product of evidence and messages: the log of the model's density at the trajectories,
        with the features integrated out, as far as messages are the exact p(F | X).
    smoothed
        names of the chains that were worked out anew; a chain that would hear the same again is not.
    """

    number: int
    objective: float
    smoothed: tuple[str, ...]


class Solution:
    """Trajectories of all chains, and the beliefs over the features that go with them.

    `solution[chain]` is a chain's trajectory, `solution[feature]` the list of beliefs over a feature node,
    one for each frame.

    Attributes
    ----------
    frames
        the frames.
    rounds
        report of every round, the best of which this is.
    converged
        whether the ascent ended by itself and not at its wall.
    """

    def __init__(self, slices: "_Slices", rounds: tuple[Round, ...], converged: bool) -> None:
        self.frames = slices.frames
        self.rounds = rounds
        self.converged = converged
        self._slices = slices

    @property
    def objective(self) -> float:
        """The highest that was reached."""
        return max(report.objective for report in self.rounds)

    def __getitem__(self, key: Any, /) -> Any:
        name = name_of(key)
        if name in self._slices.trajectories:
            return self._slices.trajectories[name]
        if name in self._slices.model.features:
            return [self._slices.belief(name, time) for time in range(len(self.frames))]
        known = ", ".join([*self._slices.model.chains, *self._slices.model.features])
        raise KeyError(f"{name}: not part of the model, expected one of {known}")

    def messages(self, chain: Any, feature: Any) -> Sequence[Any]:
        """What the chain says of the feature, for each frame, also where nobody hears it (no feedback)."""
        return self._slices.spoken[name_of(chain), name_of(feature)]

    def evidence(self, feature: Any) -> list[Any]:
        """What the frames say of the feature."""
        return [self._slices.evidence(name_of(feature), time) for time in range(len(self.frames))]


class CoordinateAscent:
    """Coordinate ascent (Algorithm 2): chain after chain gets its best trajectory, the others held fixed.

    The first round is the feed-forward pipeline: a chain hears only those that were connected before it. A
    chain that would hear the same again is left alone, so that a model without feedback needs one round. When
    chains approximate (a tracker that looks anew where others tell it to may find other points), the
    objective can fall; the best round is what is kept.

    Parameters
    ----------
    model
        chains with `smooth` and `messages`, as they are now: later connections need a new engine.
    most_rounds
        wall on the number of rounds.
    tolerance
        share of the objective's size by which it has to rise for the ascent to go on.

    Raises
    ------
    ValueError
        if the model has no chain or `most_rounds` is below 1.
    TypeError
        if one of the chains is none for batches.
    """

    def __init__(self, model: MultiChain, most_rounds: int = 20, tolerance: float = 1e-5) -> None:
        if not model.chains:
            raise ValueError("model: got no chain, expected at least one")
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, BatchChain)
        if most_rounds < 1:
            raise ValueError(f"most_rounds: got {most_rounds}, expected 1 or more")
        self.model = model.copy()
        self.most_rounds = most_rounds
        self.tolerance = tolerance

    def run(self, frames: Iterable[Frame | NDArray[np.uint8] | None], dt: float = 1 / 25) -> Solution:
        """Go on until the objective rises no more, or to the wall.

        Parameters
        ----------
        frames
            all of them; `Frame`s, or plain images `dt` seconds apart (`None` for a missing one).
        dt
            seconds from one plain image to the next.

        Raises
        ------
        ValueError
            if there is no frame, they are not in order of time, or as a chain does.
        """
        *_, last = self.rounds(frames, dt)
        return last

    def rounds(
        self, frames: Iterable[Frame | NDArray[np.uint8] | None], dt: float = 1 / 25
    ) -> Iterator[Solution]:
        """As `run`, with the best solution so far after every round."""
        best = slices = _Slices(self.model, _as_frames(frames, dt))
        reports: list[Round] = []
        while True:
            slices = slices.copy()
            smoothed = slices.ascend()
            if not smoothed:
                yield Solution(best, tuple(reports), converged=True)
                return
            objective = slices.objective()
            if not reports or objective > max(report.objective for report in reports):
                best = slices
            reports.append(Round(len(reports) + 1, objective, smoothed))
            before = reports[-2].objective if len(reports) > 1 else -inf
            converged = objective < before + self.tolerance * abs(before)
            yield Solution(best, tuple(reports), converged)
            if converged or len(reports) == self.most_rounds:
                return


class _Slices:
    """Trajectories, messages and evidence at all times. Lists are replaced, never changed once complete."""

    def __init__(self, model: MultiChain, frames: Sequence[Frame]) -> None:
        self.model = model
        self.frames = frames
        self.trajectories: dict[str, Any] = {}
        self.spoken: dict[tuple[str, str], Sequence[Message]] = {}
        self._evidence: dict[str, list[Message | None]] = {}
        self._looking: dict[str, str] = {}
        """Feature: the chain that looks there by itself."""
        self._looked: set[str] = set()
        """Features at which the chain whose turn it is has begun to look."""
        self._heard: dict[str, tuple[Any, ...]] = {}

    def copy(self) -> "_Slices":
        other = _Slices(self.model, self.frames)
        other.trajectories, other.spoken = dict(self.trajectories), dict(self.spoken)
        other._evidence, other._looking = dict(self._evidence), dict(self._looking)
        other._heard = dict(self._heard)
        return other

    def ascend(self) -> tuple[str, ...]:
        """One round: every chain to which something new is said or shown gets its best trajectory."""
        smoothed = []
        for name, chain in self.model.chains.items():
            features = self.model.features_of(name)
            known, news = self._heard.get(name), self._news(name)
            if known is not None and all(old is new for old, new in zip(known, news, strict=True)):
                continue
            self._looked.clear()
            incoming = [_BatchIncoming(self, name, time) for time in range(len(self.frames))]
            self.trajectories[name] = chain.smooth(incoming, self.trajectories.get(name))
            self._heard[name] = self._news(name)
            for feature in features:
                node = self.model.features[feature]
                self.spoken[name, feature] = chain.messages(self.trajectories[name], node)
                if feature not in self._looking and name in self.model.speakers(feature):
                    self._evidence.pop(feature, None)  # there are other places to look at
            smoothed.append(name)
        return tuple(smoothed)

    def _news(self, chain: str) -> tuple[Any, ...]:
        """All that the chain's trajectory depends on: messages, and evidence that others found, as lists."""
        features = self.model.features_of(chain)
        said = [
            self.spoken.get((other, feature))
            for feature in features
            for other in self.model.speakers(feature)
            if other != chain
        ]
        shown = [
            self._evidence.get(feature) if self._looking.get(feature) not in (None, chain) else None
            for feature in features
        ]
        return (*said, *shown)

    def objective(self) -> float:
        total = sum(trajectory.log_prior for trajectory in self.trajectories.values())
        for feature in self.model.features:
            total += sum(self.belief(feature, time).log_mass for time in range(len(self.frames)))
        return float(total)

    def belief(self, feature: str, time: int) -> Any:
        return self.told(feature, time) * self.evidence(feature, time)

    def told(self, feature: str, time: int, without: str | None = None) -> Any:
        """Product of the chains' messages."""
        factors = [
            self.spoken[name, feature][time]
            for name in self.model.speakers(feature)
            if name != without and (name, feature) in self.spoken
        ]
        return reduce(mul, factors) if factors else self.model.features[feature].uniform()

    def evidence(self, feature: str, time: int) -> Any:
        """What was seen last, or what is seen where all messages so far have mass."""
        seen = self._evidence.setdefault(feature, [None] * len(self.frames))
        if seen[time] is None:
            seen[time] = self._see(feature, time, self.told(feature, time))
        return seen[time]

    def look(self, chain: str, feature: str, time: int, prior: Any) -> Any:
        """What is seen where `prior` has mass; what was seen in earlier rounds is forgotten."""
        if feature not in self._looked:
            self._looked.add(feature)
            self._looking[feature] = chain
            self._evidence[feature] = [None] * len(self.frames)
        message = self._evidence[feature][time] = self._see(feature, time, prior)
        return message

    def _see(self, feature: str, time: int, prior: Any) -> Any:
        frame, node = self.frames[time], self.model.features[feature]
        return node.uniform() if frame.missing else node.evidence(frame, prior)


class _BatchIncoming(BatchIncoming):
    def __init__(self, slices: _Slices, chain: str, time: int) -> None:
        self._slices, self._chain, self._time = slices, chain, time
        self.frame = slices.frames[time]

    def __getitem__(self, key: Any, /) -> Any:
        feature = name_of(key)
        return self.told(feature) * self._slices.evidence(feature, self._time)

    def __iter__(self) -> Iterator[str]:
        return iter(self._slices.model.features_of(self._chain))

    def __len__(self) -> int:
        return len(self._slices.model.features_of(self._chain))

    def told(self, feature: Any, /) -> Any:
        return self._slices.told(name_of(feature), self._time, without=self._chain)

    def look(self, feature: Any, prior: Any, /) -> Any:
        return self._slices.look(self._chain, name_of(feature), self._time, prior)


def _as_frames(items: Iterable[Frame | NDArray[np.uint8] | None], dt: float) -> list[Frame]:
    frames = [
        item
        if isinstance(item, Frame)
        else Frame(None if item is None else np.asarray(item), index * dt, index + 1)
        for index, item in enumerate(items)
    ]
    if not frames:
        raise ValueError("frames: got none, expected at least one")
    for before, after in pairwise(frames):
        if not after.time > before.time:
            raise ValueError(
                f"frames: got time {after.time} s at frame {after.number}, "
                f"expected later than {before.time} s at frame {before.number}"
            )
    return frames
