"""Drawings of a model's graph."""

from io import StringIO
from pathlib import Path
from statistics import mean
from typing import Any

import networkx as nx
from matplotlib.figure import Figure

from .graph import IMAGE, MultiChain

SPACING = 2.2  # between nodes of a row; one is 1 wide
HEIGHT = {"chain": 4.0, "feature": 1.9, "observation": 0.0}  # of the rows
SIZE = 2600  # points^2
INK = "#263238"
FILL = {"chain": "#e3edf7", "feature": "#fdf3dc", "observation": "#b8bec4"}


def draw(model: MultiChain, path: str | Path) -> None:
    """Draw circles for chains, squares for features, the observed image shaded; cut edges are dashed arrows.

    `path` ends in `.svg` or `.png`, or it is a `ValueError`.
    """
    path = Path(path)
    if path.suffix.lower() not in (".svg", ".png"):
        raise ValueError(f"path: got {path.name!r}, expected a name that ends in .svg or .png")
    _figure(model).savefig(path, dpi=150)


def svg(model: MultiChain) -> str:
    """The same drawing as SVG text."""
    out = StringIO()
    _figure(model).savefig(out, format="svg")
    return out.getvalue()


def _figure(model: MultiChain) -> Figure:
    places, graph = _layout(model), model.graph
    width, height = max(x for x, _ in places.values()) + SPACING, HEIGHT["chain"] + 2.0
    figure = Figure(figsize=(0.8 * width, 0.8 * height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-SPACING / 2, width - SPACING / 2), ylim=(-1, height - 1), aspect="equal")
    axes.axis("off")
    for kind, shape in (("chain", "o"), ("feature", "s"), ("observation", "o")):
        names = [name for name, data in graph.nodes.items() if data["kind"] == kind]
        look: dict[str, Any] = {"node_shape": shape, "node_color": FILL[kind], "edgecolors": INK}
        nx.draw_networkx_nodes(graph, places, names, node_size=SIZE, linewidths=1.3, ax=axes, **look)
    feedback = [edge for edge in graph.edges if graph.edges[edge].get("feedback", True)]
    cut = [
        (feature, chain)
        for chain in model.chains
        for feature in graph[chain]
        if not graph[chain][feature]["feedback"]
    ]
    nx.draw_networkx_edges(graph, places, feedback, width=1.3, edge_color=INK, ax=axes, node_size=SIZE)
    arrows = nx.DiGraph(cut)
    nx.draw_networkx_edges(
        arrows, places, width=1.3, edge_color=INK, style="dashed", arrowsize=13, node_size=SIZE, ax=axes
    )
    on_edges = dict.fromkeys(cut, "reads only")
    nx.draw_networkx_edge_labels(arrows, places, on_edges, font_size=8, font_color=INK, rotate=False, ax=axes)
    labels = {name: name.replace("_", " ").replace("-", " ").replace(" ", "\n") for name in places}
    nx.draw_networkx_labels(graph, places, labels, font_size=7, font_color=INK, ax=axes)
    return figure


def _layout(model: MultiChain) -> dict[str, tuple[float, float]]:
    """Every row evenly spaced in the order that keeps neighbours close, and centred."""
    chains, features = list(model.chains), list(model.features)
    for _ in range(4):  # barycentre ordering of a two-layer graph settles at once for trees of this size
        features.sort(key=lambda name: mean(chains.index(c) for c in model.graph[name] if c != IMAGE))
        chains.sort(key=lambda name: mean(features.index(f) for f in model.graph[name]))
    columns = max(len(chains), len(features), 1)
    return {
        name: (SPACING * ((columns - len(names)) / 2 + index), HEIGHT[kind])
        for kind, names in (("chain", chains), ("feature", features), ("observation", [IMAGE]))
        for index, name in enumerate(names)
    }
