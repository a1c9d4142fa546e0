"""Messages of a whole sequence, while one chain after the other gets its best trajectory.

Nothing of a frame is kept but what chains keep in their trajectories and what was searched for: frames are
asked for one after the other, forwards, in every pass, and so are messages that chains work out when asked.
"""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import mul
from typing import Any, overload

from ...models.core.frame import Frame
from .graph import MultiChain
from .protocols import BatchIncoming, Message, Named, Smoothed


class LazyFrames(Sequence[Frame]):
    """Frames in order of time that are made when they are asked for, best one after the other.

    A mark of sequences that `CoordinateAscent` must not hold: an engine asks for each frame once in a pass,
    forwards. Those who make them see to their order.
    """

    @abstractmethod
    def time(self, index: int, /) -> float:
        """`Frame.time` of a frame, without making it."""


class TimeSlices:
    """Trajectories, messages and evidence at all times. Lists are replaced, never changed once complete."""

    def __init__(self, model: MultiChain, frames: Sequence[Frame]) -> None:
        self.model = model
        self.frames = frames
        self.trajectories: dict[str, Any] = {}
        self.sent: dict[tuple[str, str], Sequence[Message]] = {}
        self._evidence: dict[str, list[Message | None]] = {}
        self._found: dict[str, dict[str, list[Message]]] = {}
        """Feature: what each of the chains that search there by themselves has found."""
        self._smoothed: dict[str, int] = {}
        """Chain: how often its trajectory was worked out."""
        self._read: dict[str, tuple[int, ...]] = {}
        """Chain: numbers of all that its trajectory was worked out from."""

    def copy(self) -> "TimeSlices":
        """The same, to go on from without changing these."""
        other = TimeSlices(self.model, self.frames)
        for name in ("trajectories", "sent", "_evidence", "_smoothed", "_read"):
            setattr(other, name, dict(getattr(self, name)))
        other._found = {feature: dict(found) for feature, found in self._found.items()}
        return other

    def saved(self) -> dict[str, Any]:
        """Everything but the messages, which follow from the trajectories."""
        return {
            "trajectories": self.trajectories,
            "evidence": {name: self._evidence.get(name) for name in self.model.features},
            "found": {name: self._found.get(name, {}) for name in self.model.features},
            "smoothed": self._smoothed,
            "read": self._read,
        }

    @classmethod
    def restored(cls, model: MultiChain, frames: Sequence[Frame], saved: Mapping[str, Any]) -> "TimeSlices":
        """The slices of which `saved` was kept.

        Raises
        ------
        ValueError
            if they are of another number of frames.
        """
        slices = cls(model, frames)
        slices.trajectories = saved["trajectories"]
        evidence = {name: messages for name, messages in saved["evidence"].items() if messages is not None}
        found = {name: by_chain for name, by_chain in saved["found"].items() if by_chain}
        for messages in (
            *evidence.values(),
            *(each for by_chain in found.values() for each in by_chain.values()),
        ):
            if len(messages) != len(frames):
                raise ValueError(f"state: got {len(messages)} frames, expected {len(frames)}")
        slices._evidence, slices._found = evidence, found
        slices._smoothed, slices._read = saved["smoothed"], saved["read"]
        for name in slices.trajectories:
            slices._send(name)
        return slices

    def ascend(self) -> tuple[str, ...]:
        """One round: every chain to which something new is said or shown gets its best trajectory."""
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
            for feature in self.model.features_of(name):
                if feature not in self._found and name in self.model.senders(feature):
                    self._evidence.pop(feature, None)  # there are other places to search
            smoothed.append(name)
        return tuple(smoothed)

    def _send(self, chain: str) -> None:
        for feature in self.model.features_of(chain):
            node = self.model.features[feature]
            # what comes in is that of now, whatever others say later
            incoming = _IncomingOverTime(self.copy(), chain)
            messages = self.model.chains[chain].messages(self.trajectories[chain], node, incoming)
            if len(messages) != len(self.frames):
                raise ValueError(
                    f"messages of {chain!r}: got {len(messages)}, expected {len(self.frames)}, one a frame"
                )
            self.sent[chain, feature] = messages

    def _inputs(self, chain: str) -> tuple[int, ...]:
        """Numbers of all that the chain's trajectory depends on: messages, and evidence that others found.

        A chain that searches by itself goes by what it finds itself.
        """
        features = self.model.features_of(chain)
        messages = [
            self._smoothed.get(other, 0)
            for feature in features
            for other in self.model.senders(feature)
            if other != chain
        ]
        searches = [
            0 if chain in by_chain else sum(self._smoothed.get(other, 0) for other in by_chain)
            for by_chain in (self._found.get(feature, {}) for feature in features)
        ]
        return (*messages, *searches)

    def objective(self) -> float:
        """See `Round`."""
        total = sum(trajectory.log_prior for trajectory in self.trajectories.values())
        for feature in self.model.features:
            total += sum(self.belief(feature, time).log_mass for time in range(len(self.frames)))
        return float(total)

    def belief(self, feature: str, time: int) -> Any:
        """Product of all that is known of a feature in a frame."""
        return self.messages(feature, time) * self.evidence(feature, time)

    def messages(self, feature: str, time: int, without: str | None = None) -> Any:
        """Product of the chains' messages."""
        factors = []
        for name in self.model.senders(feature):
            if name != without and (name, feature) in self.sent:
                message = self.sent[name, feature][time]
                self.model.require_message(name, feature, message)
                factors.append(message)
        return reduce(mul, factors) if factors else self.model.features[feature].uniform()

    def evidence(self, feature: str, time: int) -> Any:
        """What was seen last, or what is seen where all messages so far have mass.

        What several chains have found, each in places of its own, is multiplied.
        """
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
        """What is seen where `prior` has mass."""
        frame, node = self.frames[time], self.model.features[feature]
        return node.uniform() if frame.missing else node.evidence(frame, prior)


class _IncomingOverTime(Sequence[BatchIncoming]):
    """What reaches a chain at all times."""

    def __init__(self, slices: TimeSlices, chain: str) -> None:
        self._slices, self._chain = slices, chain

    def __len__(self) -> int:
        return len(self._slices.frames)

    @overload
    def __getitem__(self, time: int) -> BatchIncoming: ...
    @overload
    def __getitem__(self, time: slice) -> Sequence[BatchIncoming]: ...
    def __getitem__(self, time: int | slice) -> BatchIncoming | Sequence[BatchIncoming]:
        numbers = range(len(self))[time]  # which raises IndexError beyond the end
        if isinstance(numbers, range):
            return [_BatchIncoming(self._slices, self._chain, number) for number in numbers]
        return _BatchIncoming(self._slices, self._chain, numbers)


class _BatchIncoming(BatchIncoming):
    def __init__(self, slices: TimeSlices, chain: str, time: int) -> None:
        super().__init__(_Products(slices, chain, time))
        self._slices, self._chain, self._time = slices, chain, time

    @property
    def frame(self) -> Frame:
        return self._slices.frames[self._time]

    @property
    def time(self) -> float:
        frames = self._slices.frames
        return frames.time(self._time) if isinstance(frames, LazyFrames) else frames[self._time].time

    def others(self, feature: Any, /) -> Any:
        return self._slices.messages(self.node(feature).name, self._time, without=self._chain)

    def search(self, feature: Any, prior: Any, /) -> Any:
        return self._slices.search(self.node(feature).name, self._time, prior)


class _Products(Mapping[Named, Message]):
    """Product of evidence and other chains' messages at each of a chain's feature nodes, at one time."""

    def __init__(self, slices: TimeSlices, chain: str, time: int) -> None:
        self._slices, self._chain, self._time = slices, chain, time

    def __getitem__(self, feature: Named) -> Message:
        slices, name, time = self._slices, feature.name, self._time
        product: Message = slices.messages(name, time, self._chain) * slices.evidence(name, time)
        return product

    def __iter__(self) -> Iterator[Named]:
        return (self._slices.model.features[name] for name in self._slices.model.features_of(self._chain))

    def __len__(self) -> int:
        return len(self._slices.model.features_of(self._chain))
