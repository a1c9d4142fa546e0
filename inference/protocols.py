"""What chains, feature nodes and messages promise each other: all that an engine knows of them."""

from collections.abc import Iterator, Mapping
from typing import Any, Protocol, Self, TypeVar, overload, runtime_checkable

from ..models.frame import Frame

State = TypeVar("State")
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


@runtime_checkable
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
        """phi(I, F), the likelihood of the frame's image (which is there), worked out where `prior` has mass.

        It is asked once a frame. `prior` only says where to look and is not part of the answer.
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


@runtime_checkable
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


def name_of(key: Any) -> str:
    """Name of a chain or feature node, or the name itself."""
    return key if isinstance(key, str) else str(key.name)


def uses_cavity(chain: Chain[Any]) -> bool:
    """Whether the chain wants to hear what else reaches a feature before it speaks to it."""
    return bool(getattr(chain, "uses_cavity", False))
