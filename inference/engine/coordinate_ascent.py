"""Algorithm 2 of the RSMCM paper, coordinate ascent over whole sequences, for any number of chains.

Nothing of a frame is kept but what chains keep in their trajectories and what was searched for: frames are
read one after the other, forwards, in every pass, and so are messages that chains compute on demand.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from math import inf, nan
from operator import mul
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Count, Positive, checked
from ...models.core.frame import Frame
from . import checkpoint
from .graph import MultiChain, as_frame, naming_message, require_frames, require_later, require_model
from .protocols import (
    BatchChain,
    BatchIncoming,
    FeatureNode,
    LazyFrames,
    Message,
    MessageType,
    Named,
    PerFrame,
    Smoothed,
    TrajectoryType,
    name_of,
    require,
)


class TimeSlices:
    """Trajectories, messages and evidence at all times. Lists are replaced, never changed once complete."""

    def __init__(self, model: MultiChain, frames: Sequence[Frame]) -> None:
        self.model = model
        self.frames = frames
        self.trajectories: dict[str, Any] = {}
        self.sent: dict[tuple[str, str], Sequence[Message]] = {}
        self._evidence: dict[str, list[Message | None]] = {}
        # at a feature, by chains that search themselves
        self._found: dict[str, dict[str, list[Message]]] = {}
        self._smoothed: dict[str, int] = {}  # how often a chain's trajectory was worked out
        self._read: dict[str, tuple[int, ...]] = {}  # numbers of all that it was worked out from

    def copy(self) -> "TimeSlices":
        """Return a copy whose changes leave this one as it is."""
        other = TimeSlices(self.model, self.frames)
        for name in ("trajectories", "sent", "_evidence", "_smoothed", "_read"):
            setattr(other, name, dict(getattr(self, name)))
        other._found = {feature: dict(found) for feature, found in self._found.items()}
        return other

    def saved(self) -> dict[str, Any]:
        """Return everything but the messages, which follow from the trajectories."""
        return {
            "trajectories": self.trajectories,
            "evidence": {name: self._evidence.get(name) for name in self.model.features},
            "found": {name: self._found.get(name, {}) for name in self.model.features},
            "smoothed": self._smoothed,
            "read": self._read,
        }

    @classmethod
    def restored(cls, model: MultiChain, frames: Sequence[Frame], saved: Mapping[str, Any]) -> "TimeSlices":
        """Return the slices that `saved` describes; a `ValueError` for another number of frames."""
        slices = cls(model, frames)
        slices.trajectories = saved["trajectories"]
        evidence = {name: messages for name, messages in saved["evidence"].items() if messages is not None}
        found = {name: by_chain for name, by_chain in saved["found"].items() if by_chain}
        searched = [each for by_chain in found.values() for each in by_chain.values()]
        for messages in (*evidence.values(), *searched):
            if len(messages) != len(frames):
                raise ValueError(f"state: got {len(messages)} frames, expected {len(frames)}")
        slices._evidence, slices._found = evidence, found
        slices._smoothed, slices._read = saved["smoothed"], saved["read"]
        for name in slices.trajectories:
            slices._send(name)
        return slices

    def ascend(self) -> tuple[str, ...]:
        """Optimise the trajectory of every chain whose inputs have changed, and return their names."""
        smoothed = []
        for name, chain in self.model.chains.items():
            if self._read.get(name) == self._inputs(name):
                continue
            result = chain.smooth(_IncomingOverTime(self, name), self.trajectories.get(name))
            if not isinstance(result, Smoothed):
                raise TypeError(f"chain {name!r}: smooth gave {type(result).__name__}, expected Smoothed")
            self.trajectories[name] = result.trajectory
            for node, evidence in result.evidence.items():
                self._found.setdefault(node.name, {})[name] = list(evidence)
            self._read[name] = self._inputs(name)
            self._smoothed[name] = self._smoothed.get(name, 0) + 1
            self._send(name)
            for feature in self.model.features_of[name]:
                if feature not in self._found and name in self.model.senders[feature]:
                    self._evidence.pop(feature, None)  # there are other places to search
            smoothed.append(name)
        return tuple(smoothed)

    def _send(self, chain: str) -> None:
        for feature in self.model.features_of[chain]:
            node = self.model.features[feature]
            # what comes in is that of now, whatever others say later
            incoming = _IncomingOverTime(self.copy(), chain)
            with naming_message(chain, feature):
                messages = self.model.chains[chain].messages(self.trajectories[chain], node, incoming)
            if len(messages) != len(self.frames):
                raise ValueError(
                    f"messages of {chain!r}: got {len(messages)}, expected {len(self.frames)}, one a frame"
                )
            self.sent[chain, feature] = messages

    def _inputs(self, chain: str) -> tuple[int, ...]:
        """Version numbers of the chain's inputs: messages, and evidence of other chains' searches."""
        features = self.model.features_of[chain]
        messages = [
            self._smoothed.get(other, 0)
            for feature in features
            for other in self.model.senders[feature]
            if other != chain
        ]
        searches = [
            0 if chain in by_chain else sum(self._smoothed.get(other, 0) for other in by_chain)
            for by_chain in (self._found.get(feature, {}) for feature in features)
        ]
        return (*messages, *searches)

    def objective(self) -> float:
        """Return the objective; see `Round`."""
        total = sum(trajectory.log_prior for trajectory in self.trajectories.values())
        for feature in self.model.features:
            total += sum(self.belief(feature, time).log_mass for time in range(len(self.frames)))
        return float(total)

    def belief(self, feature: str, time: int) -> Any:
        """Return the product of all messages to a feature in a frame."""
        return self.messages(feature, time) * self.evidence(feature, time)

    def messages(self, feature: str, time: int, without: str | None = None) -> Any:
        """Return the product of the chains' messages."""
        factors = []
        for name in self.model.senders[feature]:
            if name != without and (name, feature) in self.sent:
                with naming_message(name, feature):  # it may be worked out only now
                    message = self.sent[name, feature][time]
                if not isinstance(message, self.model.message_kinds[feature]):
                    raise self.model.wrong_message(name, feature, message)
                factors.append(message)
        return reduce(mul, factors) if factors else self.model.features[feature].uniform()

    def evidence(self, feature: str, time: int) -> Any:
        """Return the evidence of the last search, or search where all messages so far have mass."""
        if feature in self._found:
            return reduce(mul, (found[time] for found in self._found[feature].values()))
        node = self.model.features[feature]
        if not node.searches:
            return self.search(feature, time, node.uniform())  # a function of the frame: not kept
        seen = self._evidence.setdefault(feature, [None] * len(self.frames))
        if seen[time] is None:
            seen[time] = self.search(feature, time, self.messages(feature, time))
        return seen[time]

    def search(self, feature: str, time: int, prior: Any) -> Any:
        """Return the evidence where `prior` has mass."""
        frame, node = self.frames[time], self.model.features[feature]
        return node.uniform() if frame.missing else node.evidence(frame, prior)


class _IncomingOverTime(PerFrame[BatchIncoming]):
    """Messages that reach a chain, one entry a frame."""

    def __init__(self, slices: TimeSlices, chain: str) -> None:
        self._slices, self._chain = slices, chain

    def __len__(self) -> int:
        return len(self._slices.frames)

    def _at(self, number: int) -> BatchIncoming:
        return _BatchIncoming(self._slices, self._chain, number)


class _BatchIncoming(BatchIncoming):
    def __init__(self, slices: TimeSlices, chain: str, time: int) -> None:
        self._slices, self._chain, self._time = slices, chain, time
        self._nodes = tuple(slices.model.features[name] for name in slices.model.features_of[chain])
        self._results = {}

    def _message_at(self, node: Named) -> Message:
        slices, name, time = self._slices, node.name, self._time
        product: Message = slices.messages(name, time, self._chain) * slices.evidence(name, time)
        return product

    def _others_at(self, node: Named) -> Any:
        return self._slices.messages(node.name, self._time, without=self._chain)

    def _evidence_at(self, node: Named) -> Any:
        return self._slices.evidence(node.name, self._time)

    @property
    def frame(self) -> Frame:
        return self._slices.frames[self._time]

    @property
    def time(self) -> float:
        frames = self._slices.frames
        return frames.time(self._time) if isinstance(frames, LazyFrames) else frames[self._time].time

    def search(self, feature: Any, prior: Any, /) -> Any:
        return self._slices.search(self.node(feature).name, self._time, prior)


@dataclass(frozen=True, eq=False)
class Round:
    """Report of one round of coordinate ascent.

    Parameters
    ----------
    number
        1 for the first.
    objective
        log of the model's density at the trajectories, with the features integrated out, as far as messages
        are the exact p(F | X): log densities of the trajectories, and log mass of the product at every
        feature and frame. NaN where rounds are not compared.
    smoothed
        names of the chains that were optimised; a chain whose inputs have not changed is not.
    """

    number: int
    objective: float
    smoothed: tuple[str, ...]


class Solution:
    """Trajectories of all chains, and the beliefs of the features.

    `solution[chain]` is a chain's trajectory, `solution[feature]` the list of beliefs over a feature node,
    one for each frame.

    Attributes
    ----------
    frames
        the frames.
    rounds
        reports of all rounds.
    converged
        whether the objective converged before `most_rounds`.
    """

    def __init__(
        self, best: TimeSlices, latest: TimeSlices, rounds: tuple[Round, ...], converged: bool
    ) -> None:
        self.frames = best.frames
        self.rounds = rounds
        self.converged = converged
        self._slices = best
        self._latest = latest  # from which the ascent goes on

    def __repr__(self) -> str:
        how = "converged" if self.converged else "not converged"
        rounds = f"{len(self.frames)} frames, {len(self.rounds)} rounds, {how}"
        return f"Solution({rounds}: {self._slices.model.names})"

    @property
    def objective(self) -> float:
        """Highest objective of all rounds."""
        return max(report.objective for report in self.rounds)

    @overload
    def __getitem__(self, key: BatchChain[TrajectoryType], /) -> TrajectoryType: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> list[MessageType]: ...
    @overload
    def __getitem__(self, key: str, /) -> Any: ...
    def __getitem__(self, key: Named | str, /) -> Any:
        name = name_of(key)
        if name in self._slices.trajectories:
            return self._slices.trajectories[name]
        if name in self._slices.model.features:
            return [self._slices.belief(name, time) for time in range(len(self.frames))]
        raise self._slices.model.unknown(name)

    @overload
    def messages(self, chain: Named | str, feature: FeatureNode[MessageType]) -> Sequence[MessageType]: ...
    @overload
    def messages(self, chain: Named | str, feature: str) -> Sequence[Any]: ...
    def messages(self, chain: Named | str, feature: Named | str) -> Sequence[Any]:
        """Return the chain's messages to the feature, one a frame, also without feedback."""
        return self._slices.sent[name_of(chain), name_of(feature)]

    @overload
    def evidence(self, feature: FeatureNode[MessageType]) -> list[MessageType]: ...
    @overload
    def evidence(self, feature: str) -> list[Any]: ...
    def evidence(self, feature: Named | str) -> list[Any]:
        """Return the evidence at the feature, one a frame."""
        return [self._slices.evidence(name_of(feature), time) for time in range(len(self.frames))]


class CoordinateAscent:
    """Coordinate ascent (Algorithm 2): optimise one chain's trajectory after the other.

    Chains are optimised in the order of `MultiChain.chains`. The first round is the feed-forward pipeline: a
    chain receives only messages of earlier chains. A chain whose inputs have not changed is skipped. When
    chains approximate, the objective can fall; the best round is kept. Loops make no difference: given all
    trajectories, features are independent.

    Parameters
    ----------
    model
        chains with `smooth` and `messages`; later connections need a new engine.
    most_rounds
        greatest number of rounds.
    tolerance
        relative increase of the objective below which the ascent stops; `None`: rounds are not compared, the
        last one is the result, and the objective is not computed.

    Raises
    ------
    ValueError
        if the model has no chain or `most_rounds` is below 1.
    TypeError
        if one of the chains is not a batch chain.
    """

    @checked
    def __init__(self, model: MultiChain, most_rounds: Count = 20, tolerance: float | None = 1e-5) -> None:
        require_model(model)
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, BatchChain)
        model.check_complete()
        self.model = model.copy()
        self.most_rounds = most_rounds
        self.tolerance = tolerance

    def __repr__(self) -> str:
        return f"CoordinateAscent({self.model})"

    @checked
    def run(self, frames: Iterable[Frame | NDArray[np.uint8] | None], dt: Positive = 1 / 25) -> Solution:
        """Run rounds until the objective stops rising, at most `most_rounds`.

        Parameters
        ----------
        frames
            all `Frame`s, or plain images `dt` seconds apart (`None` for a missing one), which are kept in
            memory. `LazyFrames` are read again in every pass.
        dt
            seconds from one plain image to the next.

        Raises
        ------
        ValueError
            if there is no frame, they are not in order of time, or as a chain does.
        """
        *_, last = self.rounds(frames, dt)
        return last

    @checked
    def rounds(
        self,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: Positive = 1 / 25,
        after: Solution | None = None,
    ) -> Iterator[Solution]:
        """Run as `run` does, and yield the best solution so far after every round.

        `after` is a solution of the same frames (see `load`) from which to continue.
        """
        if after is None:
            best = slices = TimeSlices(self.model, _as_frames(frames, dt))
            reports: list[Round] = []
        else:
            best, slices, reports = after._slices, after._latest, list(after.rounds)
            if after.converged or len(reports) >= self.most_rounds:
                yield after
                return
        while True:
            slices = slices.copy()
            smoothed = slices.ascend()
            if not smoothed:
                yield Solution(best, slices, tuple(reports), converged=True)
                return
            objective = nan if self.tolerance is None else slices.objective()
            if self.tolerance is None or not reports or objective > max(each.objective for each in reports):
                best = slices
            reports.append(Round(len(reports) + 1, objective, smoothed))
            before = reports[-2].objective if len(reports) > 1 else -inf
            converged = self.tolerance is not None and objective < before + self.tolerance * abs(before)
            yield Solution(best, slices, tuple(reports), converged)
            if converged or len(reports) == self.most_rounds:
                return

    def save(self, path: str | Path, solution: Solution, about: Mapping[str, Any] | None = None) -> None:
        """Save the ascent to an `.npz` file, which is written completely or not at all.

        The file contains trajectories, evidence and `about` (plain JSON), but no frames.

        Raises
        ------
        TypeError
            if a trajectory or a message is not what the return annotation of `smooth` or `evidence` says.
        OSError
            if the file cannot be written; an older one is then left as it was.
        """
        same = solution._latest is solution._slices
        values = {
            "best": solution._slices.saved(),
            "latest": None if same else solution._latest.saved(),
            "rounds": solution.rounds,
            "converged": solution.converged,
            "parameters": self.model.parameters(),
            "about": dict(about or {}),
        }
        checkpoint.save(path, values, self._kinds())

    @checked
    def load(
        self,
        file: str | Path | checkpoint.Contents,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: Positive = 1 / 25,
    ) -> tuple[Solution, dict[str, Any]]:
        """Load what `save` wrote, for the same frames: the solution, and `about`.

        Raises
        ------
        ValueError
            if the file is broken, of another version, of other chains, parameters or number of frames.
        OSError
            if the file cannot be opened.
        """
        contents = file if isinstance(file, checkpoint.Contents) else checkpoint.read(file)
        checkpoint.require_same(contents.path, contents.plain("parameters"), self.model.parameters())
        values = checkpoint.load(contents, self._kinds())
        slices = _as_frames(frames, dt)
        best = TimeSlices.restored(self.model, slices, values["best"])
        latest = values["latest"]
        return (
            Solution(
                best,
                best if latest is None else TimeSlices.restored(self.model, slices, latest),
                values["rounds"],
                values["converged"],
            ),
            values["about"],
        )

    def _kinds(self) -> dict[str, Any]:
        def returned(method: Any) -> Any:
            hints = get_type_hints(method)
            if "return" not in hints:
                raise TypeError(f"{method.__qualname__}: no return annotation, which says what is saved")
            return hints["return"]

        trajectories = {}
        for name, chain in self.model.chains.items():
            kind = returned(type(chain).smooth)
            if get_origin(kind) is not Smoothed:
                raise TypeError(f"{type(chain).smooth.__qualname__}: returns {kind}, expected Smoothed[...]")
            trajectories[name] = get_args(kind)[0]
        messages = {name: returned(type(node).evidence) for name, node in self.model.features.items()}
        slices = {
            "trajectories": trajectories,
            "evidence": {name: list[kind | None] | None for name, kind in messages.items()},  # type: ignore[valid-type]
            "found": {name: dict[str, list[kind]] for name, kind in messages.items()},  # type: ignore[valid-type]
            "smoothed": dict[str, int],
            "read": dict[str, tuple[int, ...]],
        }
        plain = dict[str, Any]
        rest = {"rounds": tuple[Round, ...], "converged": bool, "parameters": plain, "about": plain}
        return {"best": slices, "latest": slices, **rest}


def _as_frames(items: Iterable[Frame | NDArray[np.uint8] | None], dt: float) -> Sequence[Frame]:
    if isinstance(items, LazyFrames):
        return items
    require_frames(items)
    frames = [as_frame(item, index * dt, index + 1) for index, item in enumerate(items)]
    if not frames:
        raise ValueError("frames: got none, expected at least one")
    for before, after in pairwise(frames):
        require_later(after, before.time, before.number)
    return frames
