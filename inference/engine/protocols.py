"""Protocols of chains, feature nodes and messages: all that the engines use of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Generic, Never, Protocol, Self, TypeVar, cast, overload

from ...models.core.checks import checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr

State = TypeVar("State")
TrajectoryType = TypeVar("TrajectoryType", bound="Trajectory")
MessageType = TypeVar("MessageType", bound="Message")
Result = TypeVar("Result")

Results = dict[tuple[object, ...], tuple[tuple[object, ...], Any]]
"""Of pure functions, by function and ids of arguments: the arguments, and what it gave."""


class Message(Protocol):
    """A non-negative function of one feature node, with its scale.

    Products are commutative and associative, and the node's `uniform()`, the constant 1, is neutral. Products
    are not normalised. The prediction of a chain integrates to 1. An engine multiplies the same factors only
    once in a time slice, so that a message may cache results.
    """

    @property
    def log_mass(self) -> float:
        """Log of the integral of the function (without meaning for an improper one, such as `uniform()`)."""
        ...

    def __mul__(self, other: Self, /) -> Self: ...


class SettlingMessage(Message, Protocol):
    """Optional methods of messages, for models with loops; each may be left out.

    `normalised` is needed if the scale contains information of other features: it would grow with every
    sweep. Without powers it is not damped; without `distance` it has settled when the log mass of the belief
    at its feature does not change.
    """

    def normalised(self) -> Self:
        """Return the same function, scaled to integrate to 1."""
        ...

    def distance(self, other: Self, /) -> float:
        """Return how far the function is from another one, whatever their scales: 0 if they are the same."""
        ...

    def __pow__(self, exponent: float, /) -> Self: ...


class Named(Protocol):
    """A chain or a feature node, which has a unique name in a model."""

    @property
    def name(self) -> str:
        """Unique name among the chains and features of a model."""
        ...


class FeatureNode(Named, Protocol[MessageType]):
    """A latent feature F of the scene, shared by chains; messages are of `MessageType`."""

    @property
    def searches(self) -> bool:
        """Whether `evidence` searches for the feature where `prior` has mass; if not, `prior` is uniform."""
        ...

    def uniform(self) -> MessageType:
        """Return the constant 1, identity of the message product."""
        ...

    def evidence(self, frame: Frame, prior: MessageType, /) -> MessageType:
        """Return phi(I, F), the likelihood of a frame that is not missing, where `prior` has mass.

        `prior` only limits the search and is not part of the result.
        """
        ...


class Cavity(IntEnum):
    """Content of a feature's entry of `incoming` when a chain computes its message to that feature.

    It may use this to decide where a mixture is projected onto the form of the feature, but not as
    information, which would be counted twice. In a time slice, chains that need the least send first, then in
    the order of names. At a feature that is searched for in the image (`FeatureNode.searches`), chains that
    need the evidence are called once before, with the messages sent by then: the image is searched where they
    predict the feature.
    """

    NOTHING = 0
    """The uniform message: it speaks from the past, and from its other features, alone."""

    IMAGE = 1
    """The evidence."""

    OTHERS = 2
    """The evidence times the messages of those that have spoken before."""


@checked
@short_repr
@dataclass(frozen=True)
class Port:
    """A kind of feature node to which a chain can be connected.

    Parameters
    ----------
    kind
        class of the feature node.
    cavity
        messages that the chain needs there before it sends its own.
    optional
        whether the chain works without such a node.
    many
        whether the chain may have several of these nodes.
    sole
        name of a factor of the message that only one chain may send to a node: messages with two of them have
        no product.
    """

    kind: type
    cavity: Cavity = Cavity.NOTHING
    optional: bool = False
    many: bool = False
    sole: str | None = None


class Incoming:
    """Messages that reach a chain, by the kind of feature node or by the node itself.

    `incoming[PixelLabels]` and `incoming[pixels]` are the product of the evidence and of all other chains'
    messages at that node. Its two factors are `incoming.evidence(PixelLabels)`, of the image, and
    `incoming.others(PixelLabels)`, of the other chains. `incoming.get(ObjectBoxes)` is `None` if the chain
    has no such node. Iteration gives the nodes. Products are computed on demand.

    Parameters
    ----------
    others
        product of the other chains' messages, by feature node.
    evidence
        likelihood of the frame, by feature node; uniform at nodes that are left out.
    results
        those of `once`.
    """

    def __init__(
        self,
        others: Mapping[Named, Message],
        evidence: Mapping[Named, Message] | None = None,
        results: Results | None = None,
    ) -> None:
        self._others, self._evidence = others, evidence or {}
        self._nodes = tuple(others)
        self._results: Results = {} if results is None else results

    @overload
    def __getitem__(self, key: type[FeatureNode[MessageType]], /) -> MessageType: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> MessageType: ...
    def __getitem__(self, key: type | Named, /) -> Message:
        return self._message_at(self.node(key))

    def evidence(self, key: type[FeatureNode[MessageType]] | FeatureNode[MessageType], /) -> MessageType:
        """Return the likelihood of the frame at the feature; uniform where the frame is missing."""
        return cast(MessageType, self._evidence_at(self.node(key)))

    def others(self, key: type[FeatureNode[MessageType]] | FeatureNode[MessageType], /) -> MessageType:
        """Return the product of the other chains' messages at the feature, without the image."""
        return cast(MessageType, self._others_at(self.node(key)))

    def get(self, kind: type[FeatureNode[MessageType]], /) -> MessageType | None:
        """Return the message at the one node of that kind; `None` where there is no such node."""
        return self[kind] if self._matching(kind) else None

    def by_name(self, kind: type[FeatureNode[MessageType]], /) -> dict[str, MessageType]:
        """Return the messages at all nodes of that kind, by name."""
        return {node.name: cast(MessageType, self._message_at(node)) for node in self._matching(kind)}

    def once(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Return `function(*arguments)` of a pure function, computed once in a time slice.

        Arguments are compared by identity, functions by equality (no lambdas).
        """
        key = (function, *map(id, arguments))
        if key not in self._results:
            # the arguments stay alive, so that no other object gets the id of one
            self._results[key] = arguments, function(*arguments)
        result: Result = self._results[key][1]
        return result

    def node(self, key: type | Named, /) -> Named:
        """Return the node that the chain is connected to, or the one of that kind; else a `KeyError`."""
        matching = self._matching(key)
        if len(matching) != 1:
            names = ", ".join(node.name for node in self._nodes) or "none"
            wanted = key.__name__ if isinstance(key, type) else key.name
            raise KeyError(f"{wanted}: got {len(matching)} such nodes among {names}, expected one")
        return matching[0]

    def __iter__(self) -> Iterator[Named]:
        return iter(self._nodes)

    def __len__(self) -> int:
        return len(self._nodes)

    def _message_at(self, node: Named) -> Message:
        """The product at one of the nodes, which may be worked out only now."""
        others = self._others_at(node)
        return self._evidence[node] * others if node in self._evidence else others

    def _others_at(self, node: Named) -> Message:
        return self._others[node]

    def _evidence_at(self, node: Named) -> Message:
        return self._evidence[node] if node in self._evidence else cast(Any, node).uniform()

    def _matching(self, key: type | Named) -> list[Named]:
        if isinstance(key, str):
            raise TypeError(f"incoming: got {key!r}, expected a feature node or a kind of them")
        if isinstance(key, type):
            return [node for node in self._nodes if isinstance(node, key)]
        return [node for node in self._nodes if node.name == key.name]


class Chain(Named, Protocol[State]):
    """A hidden state with its own dynamics, which predicts and observes feature nodes.

    A chain contains only parameters; intermediate results of a time slice go through `incoming.once`. States
    are values: methods do not change their arguments. A method that draws random numbers draws from a copy
    (`copy.deepcopy(state.random)`) and returns it in the new state. Results depend on the arguments only.
    """

    @property
    def ports(self) -> tuple[Port, ...]:
        """The kinds of feature nodes that it is connected to, and the cavity that it needs there."""
        ...

    def initial(self, frame: Frame, /) -> State:
        """Return the prior state at the first frame that has an image.

        Saved states are read by its return annotation.
        """
        ...

    def predict(self, state: State, dt: float, /) -> State:
        """Predict the state `dt` seconds ahead (mu_{X(t-1) -> X(t)}); two steps equal one."""
        ...

    def message(self, state: State, feature: Never, incoming: Incoming, /) -> Message:
        """Return mu_{X -> F}: the integral over X of prediction, p(F | X) and *other* features' `incoming`.

        Its scale matters: without other features, or with uniform ones, it integrates to 1. The entry of the
        feature itself is the cavity of the port (see `Cavity`). A chain with several kinds of features may
        declare one overload for each, for type checkers.
        """
        ...

    def update(self, state: State, incoming: Incoming, /) -> State:
        """Return p(X | I), in proportion to the prediction times all of `incoming`."""
        ...


class Trajectory(Protocol):
    """Estimate of a batch chain's states at all times."""

    @property
    def log_prior(self) -> float:
        """Log density of the trajectory under the chain's own dynamics, up to a constant."""
        ...


@short_repr
@dataclass(frozen=True)
class Smoothed(Generic[TrajectoryType]):
    """Result of a batch chain for a sequence.

    Parameters
    ----------
    trajectory
        the best one.
    evidence
        by feature node, for each frame: evidence of the chain's own search (see `BatchIncoming.search`). All
        chains receive it until the next search; evidence of several chains is multiplied.
    """

    trajectory: TrajectoryType
    evidence: Mapping[Named, Sequence[Message]] = field(default_factory=dict)


class BatchIncoming(Incoming, ABC):
    """Messages that reach a batch chain at one time, while all other chains are fixed.

    `incoming[f]`, `incoming.evidence(f)` and `incoming.others(f)` are those of filtering.
    """

    @property
    @abstractmethod
    def frame(self) -> Frame:
        """The frame; it may be read from the source on access."""

    @property
    @abstractmethod
    def time(self) -> float:
        """s, of the frame, without reading it."""

    @abstractmethod
    def search(
        self, feature: type[FeatureNode[MessageType]] | FeatureNode[MessageType], prior: MessageType, /
    ) -> MessageType:
        """Search for the feature where `prior` has mass, and return the evidence.

        A chain may search by itself, and return the evidence that it used with its trajectory (see
        `Smoothed`).
        """


class BatchChain(Named, Protocol[TrajectoryType]):
    """A hidden state that is estimated at all times at once. The rules of `Chain` apply."""

    @property
    def ports(self) -> tuple[Port, ...]:
        """The kinds of feature nodes that it is connected to."""
        ...

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: TrajectoryType | None = None, /
    ) -> Smoothed[TrajectoryType]:
        """Return the best trajectory given `incoming_over_time`, one entry for each frame in order of time.

        `current` is the trajectory of the last round, to start from. Saved trajectories are read by the
        return annotation.
        """
        ...

    def messages(
        self, trajectory: TrajectoryType, feature: Never, incoming_over_time: Sequence[BatchIncoming], /
    ) -> Sequence[Message]:
        """Return mu_{X -> F} for each frame, given the trajectory.

        `incoming_over_time` are the messages that the trajectory was computed from: a chain with a state too
        large to be kept for every frame computes it again, forwards.
        """
        ...


def name_of(key: Named | str) -> str:
    """Return the name of a chain or feature node, or the name itself."""
    return key if isinstance(key, str) else str(key.name)


def require(what: str, node: object, *protocols: type) -> None:
    """Raise a `TypeError` that names `what` unless an object has all members of one of the protocols.

    A member counts however the object provides it, `__getattr__` included (`isinstance` looks past that
    since Python 3.12). A class in place of an instance is refused as well.
    """
    if isinstance(node, type):
        raise TypeError(f"{what}: got the class {node.__name__}, expected an instance: {node.__name__}(...)")
    missing = {
        protocol.__name__: [name for name in _members(protocol) if not hasattr(node, name)]
        for protocol in protocols
    }
    if all(missing.values()):
        expected = " or ".join(f"a {name} (it lacks {', '.join(names)})" for name, names in missing.items())
        raise TypeError(f"{what}: got {type(node).__name__}, expected {expected}")


def _members(protocol: type) -> list[str]:
    """Public members, those of `Named` first."""
    bases = [base for base in reversed(protocol.__mro__) if base not in (object, Protocol, Generic)]
    return [name for base in bases for name in vars(base) if not name.startswith("_")]


class PerFrame(Sequence[Result]):
    """Sequence with one entry a frame, computed on demand."""

    @abstractmethod
    def _at(self, number: int) -> Result: ...

    @overload
    def __getitem__(self, time: int) -> Result: ...
    @overload
    def __getitem__(self, time: slice) -> Sequence[Result]: ...
    def __getitem__(self, time: int | slice) -> Result | Sequence[Result]:
        numbers = range(len(self))[time]  # which raises IndexError beyond the end
        return self._at(numbers) if isinstance(numbers, int) else [self._at(number) for number in numbers]


class LazyFrames(Sequence[Frame]):
    """Frames in order of time that are read on demand.

    `CoordinateAscent` does not keep them in memory, and reads each frame once per pass, forwards.
    """

    @abstractmethod
    def time(self, index: int, /) -> float:
        """Return `Frame.time` of a frame, without reading it."""
