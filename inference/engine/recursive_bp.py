"""Algorithm 1 of the RSMCM paper, recursive belief propagation, for any number of chains and features."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import inf
from pathlib import Path
from typing import Any, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.numerics.threads import side_by_side
from . import checkpoint
from .graph import IMAGE, MultiChain, Step, as_frame, require_later, require_model
from .protocols import (
    BatchIncoming,
    Cavity,
    Chain,
    FeatureNode,
    Incoming,
    Message,
    MessageType,
    Named,
    PerFrame,
    Results,
    name_of,
    require,
)

State = TypeVar("State")


@dataclass(eq=False)
class Sent:
    """A message, worked out from the factors `incoming` by feature when it is first multiplied."""

    sender: str
    feature: str
    incoming: Mapping[str, "Factors"]
    message: Any = None


Factors = tuple[Sent, ...]


class TimeSlice:
    """Messages of one frame, and their products.

    The same factors always give the same product object, so that messages may keep what they work out. No
    message refers to the slice, so that large arrays go with it.
    """

    def __init__(self, model: MultiChain, predictions: Mapping[str, Any], frame: Frame) -> None:
        self.model = model
        self.predictions = predictions
        self.frame = frame
        self._results: Results = {}
        self._sent: dict[Step, Sent] = {}
        self._products: dict[tuple[str, Factors], Any] = {}

    def send(self, sender: str, feature: str) -> None:
        """Send a message that follows from what has been sent by now."""
        if sender == IMAGE:
            if self.frame.missing:
                return
            incoming = {feature: self._ahead(feature) if self.model.features[feature].searches else ()}
        else:
            incoming = {name: self._factors(name, sender) for name in self.model.features_of[sender]}
            wanted = self.model.cavities[sender, feature]
            if wanted != Cavity.OTHERS:
                image = self._sent.get((IMAGE, feature))
                incoming[feature] = () if image is None or wanted == Cavity.NOTHING else (image,)
        self._sent[sender, feature] = Sent(sender, feature, incoming)

    def incoming(self, chain: str) -> Incoming:
        """All that reaches the chain by now except for its own messages, worked out."""
        factors = {name: self._factors(name, chain) for name in self.model.features_of[chain]}
        for feature, those in factors.items():
            self._multiply(feature, those)
        return _Incoming(self, factors)

    def sent(self, sender: str, feature: str) -> Any:
        """The message of a chain, or of the image, to the feature; a `KeyError` if there is none."""
        if (sender, feature) not in self._sent:
            raise KeyError(f"{sender!r} says nothing to {feature!r}")
        return self._message(self._sent[sender, feature])

    def product(self, feature: str) -> Any:
        """Product of all that the feature has been sent by now."""
        return self._multiply(feature, self._factors(feature))

    def log_evidence(self) -> float:
        """Log p(image | past), by the chain rule: that of each feature given those before it."""
        return float(
            sum(
                self._log_evidence_at(feature, features[:number])
                for features in self.model.components()
                for number, feature in enumerate(features)
            )
        )

    def _log_evidence_at(self, feature: str, seen: Sequence[str]) -> float:
        """Log probability of what the image shows of a feature, given what it shows of those `seen`."""
        if (IMAGE, feature) not in self._sent:
            return 0.0
        predicted = tuple(self._given(name, feature, seen) for name in self.model.senders[feature])
        log_mass = self._multiply(feature, (self._sent[IMAGE, feature], *predicted)).log_mass
        return float(log_mass - self._multiply(feature, predicted).log_mass) if log_mass > -inf else -inf

    def _given(self, chain: str, feature: str, seen: Sequence[str]) -> Sent:
        """What the chain would send if the image showed no feature of its component but those `seen`.

        What it found in its own cavity, and what it reads through cut edges, stays as it is.
        """
        sent = self._sent[chain, feature]
        incoming = dict(sent.incoming)
        for other in incoming:
            senders = self.model.senders[other]
            if other != feature and chain in senders:
                image = [self._sent[IMAGE, other]] if other in seen else []
                others = [self._given(name, other, seen) for name in senders if name != chain]
                incoming[other] = (*image, *others)
        return sent if incoming == sent.incoming else Sent(chain, feature, incoming)

    def _ahead(self, feature: str) -> Factors:
        """Where the image is to be searched: what was said by now, and what others predict without it."""
        predicted = [
            Sent(name, feature, {other: self._factors(other, name) for other in self.model.features_of[name]})
            for name in self.model.senders[feature]
            if (name, feature) not in self._sent
        ]
        return (*self._factors(feature), *predicted)

    def _factors(self, feature: str, without: str | None = None) -> Factors:
        """What the feature has been sent by now, but for one chain's message."""
        steps = [(name, feature) for name in (IMAGE, *self.model.senders[feature]) if name != without]
        return tuple(self._sent[step] for step in steps if step in self._sent)

    def _multiply(self, feature: str, factors: Factors) -> Any:
        if len(factors) == 1:
            return self._message(factors[0])
        key = feature, factors
        if key not in self._products:
            if factors:
                product = self._multiply(feature, factors[:-1]) * self._message(factors[-1])
            else:
                product = self.model.features[feature].uniform()
            # chains that are updated side by side may ask for the same product
            return self._products.setdefault(key, product)
        return self._products[key]

    def _message(self, sent: Sent) -> Any:
        """The message that was sent."""
        if sent.message is None:
            node = self.model.features[sent.feature]
            if sent.sender == IMAGE:
                prior = self._multiply(sent.feature, sent.incoming[sent.feature])
                message = node.evidence(self.frame, prior)
            else:
                chain, state = self.model.chains[sent.sender], self.predictions[sent.sender]
                message = chain.message(state, node, _Incoming(self, sent.incoming))
            if not isinstance(message, self.model.message_kinds[sent.feature]):
                raise self.model.wrong_message(sent.sender, sent.feature, message)
            sent.message = message
        return sent.message


class _Incoming(Incoming):
    """Products of factors at a chain's feature nodes, each worked out when it is asked for."""

    def __init__(self, time_slice: TimeSlice, factors: Mapping[str, Factors]) -> None:
        self._slice, self._factors = time_slice, factors
        self._nodes = tuple(time_slice.model.features[name] for name in factors)
        self._results = time_slice._results

    def _message_at(self, node: Named) -> Message:
        product: Message = self._slice._multiply(node.name, self._factors[node.name])
        return product

    def _others_at(self, node: Named) -> Message:
        return self._part(node, lambda sent: sent.sender != IMAGE)

    def _evidence_at(self, node: Named) -> Message:
        return self._part(node, lambda sent: sent.sender == IMAGE)

    def _part(self, node: Named, belongs: Callable[[Sent], bool]) -> Message:
        factors = tuple(sent for sent in self._factors[node.name] if belongs(sent))
        product: Message = self._slice._multiply(node.name, factors)
        return product


@short_repr
@dataclass(frozen=True, eq=False)
class RunState:
    """All that a run needs to go on: a value that can be kept, branched from, saved and loaded.

    Parameters
    ----------
    states
        state of every chain by its name; empty as long as there was nothing to see.
    number, time
        of the last frame (1-based, seconds).
    shape
        of the frames' images; `None` as long as there was none.
    """

    states: Mapping[str, Any] = field(default_factory=dict)
    number: int = 0
    time: float = -inf
    shape: tuple[int, ...] | None = None

    @staticmethod
    def kinds(chains: Mapping[str, Any]) -> dict[str, Any]:
        """What the state of these chains (or classes of chains) by name consists of, for `checkpoint`."""
        states = {}
        for name, chain in chains.items():
            hints = get_type_hints(chain.initial)
            if "return" not in hints:
                raise TypeError(f"chain {name!r}: initial has no return annotation, which says what is saved")
            states[name] = hints["return"]
        return {"states": states, "number": int, "time": float, "shape": tuple[int, ...] | None}

    def saved(self) -> dict[str, Any]:
        """Everything, as a record of these kinds."""
        return {
            "states": dict(self.states) or None,
            "number": self.number,
            "time": self.time,
            "shape": self.shape,
        }

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> "RunState":
        """The state of which `saved` was kept."""
        return cls(**{**saved, "states": saved["states"] or {}})


class Belief:
    """What is known after a frame.

    `belief[chain]` or `belief["name"]` is the posterior state of a chain, `belief[feature]` or
    `belief["name"]` the product of all messages that reach a feature node. As long as all frames were
    missing there is no belief, and asking for one is a `KeyError`.

    Attributes
    ----------
    frame
        the frame.
    state
        from which the run can go on.
    """

    def __init__(self, frame: Frame, state: RunState, time_slice: TimeSlice | None) -> None:
        self.frame = frame
        self.state = state
        self._slice = time_slice

    def __repr__(self) -> str:
        missing = ", missing" if self.frame.missing else ""
        names = "nothing yet" if self._slice is None else self._slice.model.names
        return f"Belief(frame {self.frame.number} at {self.frame.time:.6g} s{missing}: {names})"

    def _repr_png_(self) -> bytes | None:
        """The frame with what is believed of its features, for notebooks."""
        if self._slice is None or self.frame.image is None:
            return None
        from .drawing import png  # OpenCV is slow to import

        features = self._slice.model.features
        return png(self.frame.image, [(node, self[name]) for name, node in features.items()])

    @property
    def states(self) -> Mapping[str, Any]:
        """Posterior states of the chains by name."""
        return self.state.states

    @cached_property
    def log_evidence(self) -> float:
        """log p(I_t | I_1..t-1), worked out when asked for; 0 before the first image.

        At each feature that chains speak to, it is the log of the integral of the product with the image
        less that without it: models can be compared, whatever the scale of their messages. Features that
        share a chain follow each other (their evidence is given that of those before); a component that
        reads another one through a cut edge is conditioned on it. What is not exact is what chains
        approximate.
        """
        return 0.0 if self._slice is None else self._slice.log_evidence()

    def message(self, chain: Named | str, feature: FeatureNode[MessageType]) -> MessageType:
        """What the chain said to the feature before it heard the image; a `KeyError` if nothing."""
        return self._sent(name_of(chain), feature)

    def evidence(self, feature: FeatureNode[MessageType]) -> MessageType:
        """What the frame shows of the feature, uniform where missing; a `KeyError` if nothing is believed."""
        return feature.uniform() if self.frame.missing else self._sent(IMAGE, feature)

    def _sent(self, sender: str, feature: FeatureNode[MessageType]) -> MessageType:
        if self._slice is None:
            raise KeyError(f"{feature.name}: nothing is said before the first frame that is not missing")
        message: MessageType = self._slice.sent(sender, feature.name)
        return message

    @overload
    def __getitem__(self, key: Chain[State], /) -> State: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> MessageType: ...
    @overload
    def __getitem__(self, key: str, /) -> Any: ...
    def __getitem__(self, key: Named | str, /) -> object:
        name = name_of(key)
        if self._slice is None:
            raise KeyError(f"{name}: nothing is believed before the first frame that is not missing")
        if name in self.state.states:
            return self.state.states[name]
        if name in self._slice.model.features:
            return self._slice.product(name)
        raise self._slice.model.unknown(name)


class RecursiveBP:
    """Recursive belief propagation (Algorithm 1): predict, exchange messages, update, frame by frame.

    The marginals of the chains after a frame are the priors of the next; within a frame sum-product runs on
    the tree of chains and features, one message each way on every edge.

    Parameters
    ----------
    model
        as it is now: later connections need a new engine.

    Raises
    ------
    ValueError
        if the model has no chain or has a loop.
    TypeError
        if one of the chains cannot filter.
    """

    def __init__(self, model: MultiChain) -> None:
        require_model(model)
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, Chain)
        model.check_complete()
        self.model = model.copy()
        self._schedule = self.model.schedule()

    def __repr__(self) -> str:
        return f"RecursiveBP({self.model})"

    def step(self, state: RunState, frame: Frame) -> Belief:
        """Take in one frame.

        The first frame with an image or points is met with the chains' initial states, later ones with
        predictions. A missing frame brings no evidence: chains predict, hear each other, and go on.

        Parameters
        ----------
        state
            of the run until now, which is left as it is; `RunState()` at the beginning.
        frame
            the next frame.

        Raises
        ------
        ValueError
            if the frame is not later than the last one or has another size, or if `state` belongs to other
            chains.
        TypeError
            if a chain gives something that is no message of the feature, or no state.
        """
        shape = state.shape if frame.image is None else frame.image.shape
        require_later(frame, state.time, state.number)
        if state.shape is not None and shape != state.shape:
            raise ValueError(
                f"frames: got {shape} uint8 at frame {frame.number}, expected {state.shape} uint8"
            )
        if not state.states and frame.image is None and frame.points is None:
            # boxes alone are nothing that chains could start from
            return Belief(replace(frame, boxes=None), RunState({}, frame.number, frame.time, None), None)

        chains = self.model.chains
        if not state.states:
            predictions = {name: chain.initial(frame) for name, chain in chains.items()}
        elif state.states.keys() == chains.keys():
            dt = frame.time - state.time
            predictions = {name: chain.predict(state.states[name], dt) for name, chain in chains.items()}
            _require_states("predict", state.states, predictions)
        else:
            raise ValueError(f"state: got chains {', '.join(state.states)}, expected {', '.join(chains)}")
        time_slice = TimeSlice(self.model, predictions, frame)
        for sender, feature in self._schedule:
            time_slice.send(sender, feature)
        incoming = {name: time_slice.incoming(name) for name in chains}
        updated = side_by_side(
            [partial(chain.update, predictions[name], incoming[name]) for name, chain in chains.items()]
        )
        states = dict(zip(chains, updated, strict=True))
        _require_states("update", predictions, states)
        return Belief(frame, RunState(states, frame.number, frame.time, shape), time_slice)

    def run(
        self,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: float = 1 / 25,
        state: RunState | None = None,
    ) -> Iterator[Belief]:
        """Take in frames one after the other, and give the belief after each.

        Parameters
        ----------
        frames
            `Frame`s, or plain images `dt` seconds apart (`None` for a missing one).
        dt
            seconds from one plain image to the next.
        state
            to go on from; from the beginning where it is left out.

        Raises
        ------
        ValueError
            as `step` does, or if something is not an image.
        """
        if isinstance(frames, str | Path):
            raise TypeError(
                f"frames: got {str(frames)!r}, expected frames; open_source of rsmcm.apps.io opens a film"
            )
        state = state or RunState()
        for item in frames:
            time = state.time + dt if state.time > -inf else 0.0
            belief = self.step(state, as_frame(item, time, state.number + 1))
            state = belief.state
            yield belief

    def save(self, path: str | Path, state: RunState, about: Mapping[str, Any] | None = None) -> None:
        """Write the state of a run, and `about`, plain JSON, to one `.npz` file: all of it, or none.

        Raises
        ------
        TypeError
            if a chain's state is not what the return annotation of its `initial` says.
        OSError
            if the file cannot be written; an older one is then left as it was.
        """
        values = {**state.saved(), "about": dict(about or {})}
        checkpoint.save(path, values, {**RunState.kinds(self.model.chains), "about": dict[str, Any]})

    def load(self, path: str | Path) -> tuple[RunState, dict[str, Any]]:
        """Read back what `save` wrote: the state of the run, and `about`.

        Raises
        ------
        ValueError
            if the file is broken, of another version, or of a model with other chains.
        OSError
            if the file cannot be opened.
        """
        values = checkpoint.load(path, {**RunState.kinds(self.model.chains), "about": dict[str, Any]})
        about = values.pop("about")
        return RunState.restored(values), about


def _require_states(method: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Make sure that chains gave a state for each one: a forgotten `return` is said in words."""
    for name, state in after.items():
        if state is None and before[name] is not None:
            raise TypeError(f"chain {name!r}: {method} gave None, expected a state")


class ForwardPass(PerFrame[MessageType]):
    """What a filter says in each frame, worked out when it is asked for.

    Asked for forwards, a frame costs one step of the filter; asked for an earlier frame, it begins again. It
    holds one state and one belief, however long the sequence is.

    Parameters
    ----------
    engine, start
        of the filter, and its state before the first frame.
    incoming_over_time
        whose frames it takes in.
    read
        what is said in a frame, given the belief after it.
    """

    def __init__(
        self,
        engine: RecursiveBP,
        start: RunState,
        incoming_over_time: Sequence[BatchIncoming],
        read: Callable[[Belief], MessageType],
    ) -> None:
        self._engine = engine
        self._start = start
        self._incoming = incoming_over_time
        self._read = read
        self._state = start
        self._next = 0
        self._belief: Belief

    def __len__(self) -> int:
        return len(self._incoming)

    def _at(self, number: int) -> MessageType:
        if number < self._next - 1:
            self._state, self._next = self._start, 0
        while self._next <= number:
            self._belief = self._engine.step(self._state, self._incoming[self._next].frame)
            self._state = self._belief.state
            self._next += 1
        return self._read(self._belief)
