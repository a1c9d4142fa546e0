"""The graph of chains, feature nodes and the image, and the order of messages that follows from it."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import networkx as nx

from .protocols import BatchChain, Chain, FeatureNode, require, uses_cavity

IMAGE = "image"
"""Name of the observation in the graph."""

AnyChain = Chain[Any] | BatchChain[Any]
"""A chain for filtering, for batch estimation, or for both; engines ask for what they need."""

Step = tuple[str, str]
"""One message of a time slice: its sender (a chain, or `IMAGE`) and the feature node that it goes to."""


class MultiChain:
    """Chains that meet on the feature nodes which they share.

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

    def connect(self, chain: AnyChain, feature: FeatureNode[Any], feedback: bool = True) -> Self:
        """Let the chain speak to the feature node and hear from it.

        Parameters
        ----------
        chain, feature
            new ones, or ones that are part of the model already.
        feedback
            `False` cuts the message from the chain to the feature: the chain reads what others say there,
            and no one learns what it predicts (a feed-forward pipeline).

        Returns
        -------
        MultiChain
            this model, so that calls can be chained.

        Raises
        ------
        TypeError
            if `chain` or `feature` lacks what its protocol asks for.
        ValueError
            if the two are connected already or a name is taken by another object.
        """
        require("chain", chain, Chain, BatchChain)
        require("feature", feature, FeatureNode)
        for node in (chain, feature):
            taken = self.graph.nodes[node.name]["node"] is not node if node.name in self.graph else False
            if taken or chain.name == feature.name:
                raise ValueError(
                    f"name: {node.name!r} is taken by another node of the model, expected a new one"
                )
        if self.graph.has_edge(chain.name, feature.name):
            raise ValueError(f"connect: {chain.name!r} and {feature.name!r} are connected already")
        self.graph.add_node(chain.name, kind="chain", node=chain)
        self.graph.add_node(feature.name, kind="feature", node=feature)
        self.graph.add_edge(IMAGE, feature.name)
        self.graph.add_edge(chain.name, feature.name, feedback=feedback)
        return self

    @property
    def chains(self) -> dict[str, Any]:
        """Chains by name, in order of connection."""
        return self._nodes("chain")

    @property
    def features(self) -> dict[str, FeatureNode[Any]]:
        """Feature nodes by name, in order of connection."""
        return self._nodes("feature")

    def features_of(self, chain: str) -> list[str]:
        """Names of the features that the chain reads."""
        return list(self.graph[chain])

    def speakers(self, feature: str) -> list[str]:
        """Names of the chains that send messages to the feature."""
        return [name for name, edge in self.graph[feature].items() if edge.get("feedback")]

    def copy(self) -> "MultiChain":
        """The same chains and features; further connections of one do not show in the other."""
        other = MultiChain()
        other.graph = self.graph.copy()
        return other

    def components(self) -> Iterator[tuple[list[str], list[str]]]:
        """Features and chains that influence each other: the parts that remain when cut edges are removed."""
        chains = self.chains
        edges = [(name, feature) for feature in self.features for name in self.speakers(feature)]
        for part in nx.connected_components(nx.Graph(edges)):
            yield [name for name in self.features if name in part], [name for name in chains if name in part]

    def check(self) -> None:
        """Make sure that messages can be passed in a finite order.

        Raises
        ------
        ValueError
            if the chains and features of a time slice form a loop; a loop that a cut edge opens is none.
        """
        try:
            loop = nx.find_cycle(self._dependencies())
        except nx.NetworkXNoCycle:
            return
        # Each message of the cycle is read at its feature by the sender of the next; the walk may pass a
        # node several times, and between two visits it is a simple loop.
        walk: list[str] = []
        for (_, feature), (reader, _) in loop * 2:
            for name in (feature, reader):
                if name in walk:
                    names = " - ".join([*walk[walk.index(name) :], name])
                    raise ValueError(
                        f"model: chains and features form the loop {names}, expected none; "
                        "merge the feature nodes of the loop into one"
                    )
                walk.append(name)

    def schedule(self) -> list[Step]:
        """Every message to a feature once, in an order that makes sum-product exact.

        What the order leaves open is settled by what approximate messages want: at each feature first the
        chains that need no cavity, then the image (whose likelihood is worked out where those have mass),
        then the chains that use their cavity, in order of connection.

        Raises
        ------
        ValueError
            as `check` does.
        """
        self.check()
        needs = self._dependencies()

        def prefer(first: Step, then: Step) -> None:
            if not nx.has_path(needs, then, first):
                needs.add_edge(first, then)

        chains = self.chains
        for feature in self.features:
            early = [(name, feature) for name in self.speakers(feature) if not uses_cavity(chains[name])]
            late = [(name, feature) for name in self.speakers(feature) if uses_cavity(chains[name])]
            for step in early:
                prefer(step, (IMAGE, feature))
            for step in late:
                for before in [*early, (IMAGE, feature)]:
                    prefer(before, step)
            for before, step in pairwise(late):
                prefer(before, step)
        position = {step: number for number, step in enumerate(needs)}
        return list(nx.lexicographical_topological_sort(needs, position.__getitem__))

    def draw(self, path: str | Path) -> None:
        """Draw the graph to an SVG or PNG file (by its suffix)."""
        from .graph_drawing import draw  # matplotlib is slow to import

        draw(self, path)

    def _nodes(self, kind: str) -> dict[str, Any]:
        return {name: data["node"] for name, data in self.graph.nodes.items() if data["kind"] == kind}

    def _dependencies(self) -> "nx.DiGraph[Step]":
        """Which messages must have been sent before which: a chain passes on what its other features know."""
        needs: nx.DiGraph[Step] = nx.DiGraph()
        for feature in self.features:
            needs.add_node((IMAGE, feature))
            needs.add_nodes_from((name, feature) for name in self.speakers(feature))
        for chain, feature in list(needs):
            if chain != IMAGE:
                for other in self.features_of(chain):
                    if other != feature:
                        senders = [IMAGE, *self.speakers(other)]
                        needs.add_edges_from(
                            ((sender, other), (chain, feature)) for sender in senders if sender != chain
                        )
        return needs
