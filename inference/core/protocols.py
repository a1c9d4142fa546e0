"""What chains, feature nodes and messages promise each other: all that an engine knows of them."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, Self, TypeVar, overload

from ...models.core.frame import Frame

State = TypeVar("State")
TrajectoryType = TypeVar("TrajectoryType", bound="Trajectory")
MessageType = TypeVar("MessageType")


class Message(Protocol):
    """A non-negative function of one feature node, with its scale.

    Products are commutative and associative, and the node's `uniform()`, the constant 1, is neutral. They
    are not normalised: beliefs are, when something is read from them. What a chain predicts integrates to 1.
    """

    @property
    def log_mass(self) -> float:
        """Log of the integral of the function (without meaning for an improper one, such as `uniform()`)."""
        ...

    def __mul__(self, other: Self, /) -> Self: ...


class FeatureNode(Protocol[MessageType]):
    """A latent feature of the scene, F, on which chains meet; `MessageType` is what they exchange there."""

    @property
    def name(self) -> str:
        """Unique name among the chains and features of a model."""
        ...

    def uniform(self) -> MessageType:
        """The constant 1, identity of the message product."""
        ...

    def evidence(self, frame: Frame, prior: MessageType, /) -> MessageType:
        """phi(I, F), the likelihood of the frame, which is not missing, worked out where `prior` has mass.

        `prior` only says where to look and is not part of the answer.
        """
        ...


class Incoming(Mapping[str, Any]):
    """Messages that reach a chain, by feature node or its name: `incoming[pixels]`, `incoming["pixels"]`.

    `incoming[f]` is the product of the evidence and of all other chains' messages at f.
    """

    def __init__(self, messages: Mapping[str, Any]) -> None:
        self._messages = messages

    @overload
    def __getitem__(self, feature: FeatureNode[MessageType], /) -> MessageType: ...
    @overload
    def __getitem__(self, feature: str, /) -> Any: ...
    def __getitem__(self, feature: FeatureNode[Any] | str, /) -> Any:
        return self._messages[name_of(feature)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._messages)

    def __len__(self) -> int:
        return len(self._messages)


class Chain(Protocol[State]):
    """A hidden state with its own dynamics, which predicts and reads feature nodes.

    States are values: no method changes the state it is given, and one that draws random numbers draws from
    a copy (`copy.deepcopy(state.random)`) and puts that into the state it returns.

    A class attribute `uses_cavity = True` tells the engine that `message` makes use of its own feature's
    entry in `incoming` (to decide where a mixture is projected onto the node's form; never as information):
    the engine then lets the other chains of that feature and the image speak first.
    """

    @property
    def name(self) -> str:
        """Unique name among the chains and features of a model."""
        ...

    def initial(self, frame: Frame, /) -> State:
        """Prior state at the first frame that has an image.

        Its return annotation says how a saved state is read back.
        """
        ...

    def predict(self, state: State, dt: float, /) -> State:
        """mu_{X(t-1) -> X(t)}: the state `dt` seconds on."""
        ...

    def message(self, state: State, feature: Any, incoming: Incoming, /) -> Message:
        """mu_{X -> F}: the integral over X of prediction, p(F | X) and the *other* features' `incoming`.

        It keeps its scale: without other features, or with uniform ones, it integrates to 1.
        """
        ...

    def update(self, state: State, incoming: Incoming, /) -> State:
        """p(X | I), in proportion to the prediction times all of `incoming`."""
        ...


class Trajectory(Protocol):
    """What a batch chain believes of its state at all times."""

    @property
    def log_prior(self) -> float:
        """Log density of the trajectory under the chain's own dynamics, up to a constant."""
        ...


class BatchIncoming(Incoming):
    """What reaches a batch chain at one time, while all other chains are held where they are.

    `incoming[f]` is the product of the evidence and of all other chains' messages at f, as in filtering.
    """

    frame: Frame

    @abstractmethod
    def told(self, feature: FeatureNode[MessageType] | str, /) -> Any:
        """Product of the other chains' messages at the feature, without the image."""

    @abstractmethod
    def look(self, feature: FeatureNode[MessageType] | str, prior: Any, /) -> Any:
        """Evidence at the feature, worked out anew where `prior` has mass.

        A chain that knows better than the others where to look (a tracker knows it from the frame before)
        looks by itself. What it saw stays the evidence for everybody until it looks again.
        """


class BatchChain(Protocol[TrajectoryType]):
    """A hidden state that is estimated at all times at once."""

    @property
    def name(self) -> str:
        """Unique name among the chains and features of a model."""
        ...

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: TrajectoryType | None = None, /
    ) -> TrajectoryType:
        """Best trajectory given `incoming_over_time`, one entry for each frame in order of time.

        `current` is the chain's trajectory of the round before, to start from.
        """
        ...

    def messages(self, trajectory: TrajectoryType, feature: Any, /) -> Sequence[Message]:
        """mu_{X -> F} for each frame: what the trajectory says of the feature."""
        ...


def name_of(key: Any) -> str:
    """Name of a chain or feature node, or the name itself."""
    return key if isinstance(key, str) else str(key.name)


def require(what: str, node: object, *protocols: type) -> None:
    """Make sure that an object has all members of one of the protocols.

    A member counts however the object provides it, `__getattr__` included: a wrapper that hands on what it
    does not know to a chain is a chain. (`isinstance` looks past `__getattr__` since Python 3.12.)

    Raises
    ------
    TypeError
        if it has not; the message starts with `what` and names the missing members.
    """
    missing = {
        protocol.__name__: [
            name for name in vars(protocol) if not name.startswith("_") and not hasattr(node, name)
        ]
        for protocol in protocols
    }
    if all(missing.values()):
        expected = " or ".join(f"a {name} (it lacks {', '.join(names)})" for name, names in missing.items())
        raise TypeError(f"{what}: got {type(node).__name__}, expected {expected}")


def uses_cavity(chain: Chain[Any]) -> bool:
    """Whether the chain wants to hear what else reaches a feature before it speaks to it."""
    return bool(getattr(chain, "uses_cavity", False))
