"""The graph of chains, feature nodes and the image, and the order of messages that follows from it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Never, Protocol, Self, TypeVar

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import checked, shown
from ...models.core.frame import Frame
from .checkpoint import parameters_of
from .protocols import (
    BatchChain,
    BatchIncoming,
    Cavity,
    Chain,
    FeatureNode,
    Incoming,
    MessageType,
    Named,
    Port,
    require,
)

IMAGE = "image"  # name of the observation in the graph

Step = tuple[str, str]  # one message of a time slice: its sender (a chain, or `IMAGE`) and the feature

Method = TypeVar("Method", bound=Callable[..., Any], covariant=True)


class Speaker(Chain[Any], Protocol[Method]):
    """A chain, as type checkers see it to infer the type of its messages to a feature.

    With `message` as a property, its type is looked for among the overloads of the chain's method.
    """

    @property
    def message(self) -> Method:
        """The method."""
        ...


class BatchSpeaker(BatchChain[Any], Protocol[Method]):
    """The same of a batch chain."""

    @property
    def messages(self) -> Method:
        """The method."""
        ...


class MultiChain:
    """Graph of chains and of the feature nodes that they share.

    >>> model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)

    Attributes
    ----------
    graph
        undirected `networkx` graph; its nodes are names with `kind` ("chain", "feature", "observation") and
        `node` (the object), the edges of chains carry `feedback`.
    """

    def __init__(self) -> None:
        self.graph: nx.Graph[str] = nx.Graph()
        self.graph.add_node(IMAGE, kind="observation", node=None)

    @checked
    def connect(
        self,
        chain: Speaker[Callable[[Any, Never, Incoming], MessageType]]
        | BatchSpeaker[Callable[[Any, Never, Sequence[BatchIncoming]], Sequence[MessageType]]],
        feature: FeatureNode[MessageType],
        feedback: bool = True,
    ) -> Self:
        """Connect the chain to the feature node, in both directions; the order of connections has no effect.

        Parameters
        ----------
        chain, feature
            new ones, or ones that are already part of the model.
        feedback
            `False` removes the messages from the chain to the feature: the chain only reads there
            (feed-forward pipeline).

        Returns
        -------
        MultiChain
            this model, so that calls can be chained.

        Raises
        ------
        TypeError
            if `chain` or `feature` does not implement its protocol, its name is not a string, or the chain
            has no port for such a feature.
        ValueError
            if the two are already connected, another object has the same name, the port is already used, or
            another chain already sends a `sole` factor.
        """
        require("chain", chain, Chain, BatchChain)
        require("feature", feature, FeatureNode)
        for node in (chain, feature):
            if not (isinstance(node.name, str) and node.name):
                raise TypeError(f"name of {type(node).__name__}: got {node.name!r}, expected a text")
            is_taken = self.graph.nodes[node.name]["node"] is not node if node.name in self.graph else False
            if is_taken or chain.name == feature.name:
                raise ValueError(
                    f"name: {node.name!r} is taken by another node of the model, expected a new one"
                )
        if self.graph.has_edge(chain.name, feature.name):
            raise ValueError(f"connect: {chain.name!r} and {feature.name!r} are connected already")
        port = self._free_port(chain, feature)
        if feedback and port.sole is not None:
            for other in self.senders.get(feature.name, ()):
                if self._port(other, feature.name).sole == port.sole:
                    raise ValueError(
                        f"connect: got {chain.name!r} for the {port.sole} of {feature.name!r}, which "
                        f"{other!r} sends already, expected one chain to send it"
                    )
        self.graph.add_node(chain.name, kind="chain", node=chain)
        self.graph.add_node(feature.name, kind="feature", node=feature)
        self.graph.add_edge(IMAGE, feature.name)
        self.graph.add_edge(chain.name, feature.name, feedback=feedback, port=port)
        for derived in ("chains", "features", "features_of", "senders", "cavities", "message_kinds"):
            self.__dict__.pop(derived, None)
        return self

    def __repr__(self) -> str:
        edges = [
            f"{chain} {'--' if chain in self.senders[feature] else '<-'} {feature}"
            for chain in self.chains
            for feature in self.features_of[chain]
        ]
        return f"MultiChain({', '.join(edges)})"

    def _repr_svg_(self) -> str:
        """The graph, for notebooks."""
        from .drawing import svg  # matplotlib is slow to import

        return svg(self)

    @property
    def names(self) -> str:
        """Names of all chains and features, as a text."""
        return f"{', '.join(self.chains)} on {', '.join(self.features)}"

    @cached_property
    def chains(self) -> dict[str, Any]:
        """Chains by name, in the order in which they are updated.

        Sorted by their cavities, those without feedback last, then by name.
        """
        chains = self._nodes("chain")

        def turn(name: str) -> tuple[Cavity, bool, str]:
            cut = not all(edge["feedback"] for edge in self.graph[name].values())
            return max(self.cavities[name, feature] for feature in self.graph[name]), cut, name

        return {name: chains[name] for name in sorted(chains, key=turn)}

    @cached_property
    def features(self) -> dict[str, Any]:
        """Feature nodes by name, in the order of names."""
        return dict(sorted(self._nodes("feature").items()))

    @cached_property
    def features_of(self) -> dict[str, tuple[str, ...]]:
        """Names of the features that each chain reads, in order."""
        return {name: tuple(sorted(self.graph[name])) for name in self.chains}

    @cached_property
    def senders(self) -> dict[str, tuple[str, ...]]:
        """Names of the chains that send messages to each feature, in the order of sending."""
        senders = {}
        for feature in self.features:
            speaking = [name for name, edge in self.graph[feature].items() if edge.get("feedback")]
            senders[feature] = tuple(sorted(speaking, key=lambda name: (self.cavities[name, feature], name)))
        return senders

    @cached_property
    def cavities(self) -> dict[tuple[str, str], Cavity]:
        """Cavity of each chain at each of its features."""
        return {
            (name, feature): self._port(name, feature).cavity
            for name in self._nodes("chain")
            for feature in self.graph[name]
        }

    @cached_property
    def message_kinds(self) -> dict[str, type]:
        """Class of each feature's messages."""
        return {name: type(node.uniform()) for name, node in self.features.items()}

    def copy(self) -> "MultiChain":
        """Return a copy of the model with the same chains and features."""
        other = MultiChain()
        other.graph = self.graph.copy()
        return other

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of all chains and feature nodes by name, as plain JSON."""
        return {name: parameters_of(node) for name, node in {**self.chains, **self.features}.items()}

    def components(self) -> list[list[str]]:
        """Return the groups of features that remain connected without the cut edges."""
        edges = [(name, feature) for feature in self.features for name in self.senders[feature]]
        parts = nx.connected_components(nx.Graph(edges))
        return sorted([name for name in self.features if name in part] for part in parts)

    def wrong_message(self, sender: str, feature: str, message: object) -> TypeError:
        """Return the error about a message of another class than the feature's."""
        return TypeError(
            f"message from {sender!r} to {feature!r}: got {type(message).__name__}, "
            f"expected {self.message_kinds[feature].__name__}"
        )

    def unknown(self, name: str) -> KeyError:
        """Return the error about a name that is neither a chain's nor a feature's."""
        names = ", ".join([*self.chains, *self.features])
        return KeyError(f"{name}: not part of the model, expected one of {names}")

    def check_complete(self) -> None:
        """Raise a `ValueError` unless every required port of every chain is connected."""
        for name, chain in self.chains.items():
            met = [self._port(name, feature) for feature in self.graph[name]]
            for port in chain.ports:
                if not port.optional and port not in met:
                    raise ValueError(
                        f"model: {name!r} is connected to {', '.join(self.features_of[name])}, "
                        f"expected a {port.kind.__name__} too, which it needs"
                    )

    @property
    def has_loops(self) -> bool:
        """Whether the graph has loops, so that messages are sent in sweeps.

        An edge without feedback (`feedback=False`) opens a loop.
        """
        return not nx.is_directed_acyclic_graph(self._dependencies())

    def schedule(self) -> list[tuple[Step, ...]]:
        """Return every message to a feature once, in an order that makes sum-product exact on forests.

        Messages of a loop form one group, all others have groups of one. At a feature, messages are ordered
        by `Cavity`: first chains that need nothing, then the image (whose likelihood is computed where the
        predictions have mass), then chains that need the image, then those that need the others, by name.
        """
        needs = self._dependencies()
        has_loops = not nx.is_directed_acyclic_graph(needs)
        for feature in self.features:
            senders = self.senders[feature]
            early = [(name, feature) for name in senders if self.cavities[name, feature] == Cavity.NOTHING]
            late = [(name, feature) for name in senders if self.cavities[name, feature] != Cavity.NOTHING]
            before = [*early, (IMAGE, feature)]
            wanted = [(step, (IMAGE, feature)) for step in early]
            wanted += [(step, then) for then in late for step in before]
            wanted += pairwise(late)
            for first, then in wanted:
                if not nx.has_path(needs, then, first):
                    needs.add_edge(first, then)

        def speaks(step: Step) -> tuple[Cavity, Step]:
            return self.cavities.get(step, Cavity.NOTHING), step

        groups = nx.condensation(needs)
        steps = {group: tuple(sorted(groups.nodes[group]["members"], key=speaks)) for group in groups}

        def turn(group: int) -> tuple[bool, tuple[Step, ...]]:
            # beside a loop, the image is searched when as much as possible is known of where to look
            sender, feature = steps[group][0]
            return has_loops and sender == IMAGE and self.features[feature].searches, steps[group]

        return [steps[group] for group in nx.lexicographical_topological_sort(groups, key=turn)]

    def draw(self, path: str | Path) -> None:
        """Draw the graph to an SVG or PNG file (by its suffix)."""
        from .drawing import draw  # matplotlib is slow to import

        draw(self, path)

    def _free_port(self, chain: Any, feature: Named) -> Port:
        """The chain's port for the feature, unless another feature has it."""
        declared = chain.ports
        if not (isinstance(declared, tuple) and all(isinstance(port, Port) for port in declared)):
            raise TypeError(f"ports of {chain.name!r}: got {declared!r}, expected a tuple of Port(...)")
        ports: list[Port] = [port for port in declared if isinstance(feature, port.kind)]
        if not ports:
            kinds = " or ".join(port.kind.__name__ for port in declared) or "none at all"
            raise TypeError(
                f"connect: got {feature.name!r} ({type(feature).__name__}) for {chain.name!r}, "
                f"expected a feature that this {type(chain).__name__} meets: {kinds}"
            )
        for other in self.features_of.get(chain.name, ()):
            if self._port(chain.name, other) == ports[0] and not ports[0].many:
                raise ValueError(
                    f"connect: got {feature.name!r} for {chain.name!r}, which meets {other!r} already, "
                    f"expected one {ports[0].kind.__name__}"
                )
        return ports[0]

    def _port(self, chain: str, feature: str) -> Port:
        port: Port = self.graph.edges[chain, feature]["port"]
        return port

    def _nodes(self, kind: str) -> dict[str, Any]:
        return {name: data["node"] for name, data in self.graph.nodes.items() if data["kind"] == kind}

    def _dependencies(self) -> "nx.DiGraph[Step]":
        """Which messages depend on which: a chain's message depends on those to its other features."""
        needs: nx.DiGraph[Step] = nx.DiGraph()
        for feature in self.features:
            needs.add_node((IMAGE, feature))
            needs.add_nodes_from((name, feature) for name in self.senders[feature])
        for chain, feature in list(needs):
            if chain != IMAGE:
                for other in self.features_of[chain]:
                    if other != feature:
                        senders = [IMAGE, *self.senders[other]]
                        needs.add_edges_from(
                            ((sender, other), (chain, feature)) for sender in senders if sender != chain
                        )
        return needs


@parameters_of.register
def _(model: MultiChain) -> Any:
    """Of a model inside a chain."""
    return model.parameters()


@contextmanager
def naming_message(sender: str, feature: str) -> Iterator[None]:
    """Have an error of a chain's message, such as NaN in it, name the chain and the feature."""
    beginning = "message from "
    try:
        yield
    except (TypeError, ValueError) as error:
        if str(error).startswith(beginning):  # of another chain's message, which this one depends on
            raise
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(f"{beginning}{sender!r} to {feature!r}: {error}") from error


def require_model(model: object) -> None:
    """Raise a `TypeError` unless an engine is given a model, a `ValueError` if it has no chain."""
    if not isinstance(model, MultiChain):
        raise TypeError(
            f"model: got {type(model).__name__}, expected a MultiChain to which chains are connected"
        )
    if not model.chains:
        raise ValueError("model: got no chain, expected at least one")


def require_frames(frames: object) -> None:
    """Raise a `TypeError` for a path or a single image where several frames are meant."""
    if isinstance(frames, str | Path):
        raise TypeError(
            f"frames: got {str(frames)!r}, expected frames; open_source of rsmcm.apps.io opens a film"
        )
    is_image = isinstance(frames, np.ndarray) and (frames.ndim < 3 or frames.shape[2:] == (3,))
    if is_image or isinstance(frames, Frame):
        raise TypeError(f"frames: got {shown(frames)}, expected a sequence of frames or images")


def as_frame(item: Frame | NDArray[np.uint8] | None, time: float, number: int) -> Frame:
    """Return a frame as it is, or that of a plain image."""
    if isinstance(item, Frame):
        return item
    try:
        return Frame(None if item is None else np.asarray(item), time, number)
    except TypeError as error:
        raise TypeError(f"{error}, at frame {number}") from None


def require_later(frame: Frame, time: float, number: int) -> None:
    """Raise a `ValueError` unless a frame is later than the one before, of this time and number."""
    if not frame.time > time:
        raise ValueError(
            f"frames: got time {frame.time} s at frame {frame.number}, "
            f"expected later than {time} s at frame {number}"
        )
