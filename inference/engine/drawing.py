"""Drawings of a model's graph, and of what is believed of a frame's features."""

from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from statistics import mean
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Rectangle
from numpy.typing import NDArray

from ...models.core.pictures import as_bgr
from .graph import IMAGE, MultiChain


@runtime_checkable
class Drawable(Protocol):
    """A feature node that can be seen in a picture."""

    def draw(self, picture: NDArray[np.uint8], belief: Any, /) -> None:
        """Draw the belief over `picture`, `(height, width, 3)` uint8 BGR."""
        ...


def png(image: NDArray[np.uint8], beliefs: Iterable[tuple[object, Any]]) -> bytes:
    """A PNG of the image with the beliefs of all feature nodes that are `Drawable` over it."""
    picture = as_bgr(image)
    for node, belief in beliefs:
        if isinstance(node, Drawable):
            node.draw(picture, belief)
    _, encoded = cv2.imencode(".png", picture)
    return encoded.tobytes()


Point = tuple[float, float]

SPACING = 2.2
HEIGHT = {"chain": 4.0, "feature": 1.9, "observation": 0.0}
RADIUS = 0.62
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
    places = _layout(model)
    width = max(x for x, _ in places.values()) + SPACING
    height = HEIGHT["chain"] + 2.0
    figure = Figure(figsize=(0.8 * width, 0.8 * height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-SPACING / 2, width - SPACING / 2), ylim=(-1, height - 1), aspect="equal")
    axes.axis("off")
    nodes = {name: _node(axes, name, data["kind"], places[name]) for name, data in model.graph.nodes.items()}
    for chain in model.chains:
        for feature in model.features_of[chain]:
            _edge(
                axes,
                nodes[feature],
                nodes[chain],
                places[feature],
                places[chain],
                chain in model.senders[feature],
            )
    for feature in model.features:
        _edge(axes, nodes[feature], nodes[IMAGE], places[feature], places[IMAGE], True)
    return figure


def _layout(model: MultiChain) -> dict[str, Point]:
    """Every row evenly spaced in the order that keeps neighbours close, and centred."""
    chains, features = list(model.chains), list(model.features)
    for _ in range(4):  # barycentre ordering of a two-layer graph settles at once for trees of this size
        features.sort(key=lambda name: mean(chains.index(c) for c in model.graph[name] if c != IMAGE))
        chains.sort(key=lambda name: mean(features.index(f) for f in model.graph[name]))
    columns = max(len(chains), len(features), 1)
    rows: list[tuple[str, Sequence[str]]] = [
        ("chain", chains),
        ("feature", features),
        ("observation", [IMAGE]),
    ]
    return {
        name: (SPACING * ((columns - len(names)) / 2 + index), HEIGHT[kind])
        for kind, names in rows
        for index, name in enumerate(names)
    }


def _node(axes: Axes, name: str, kind: str, place: Point) -> Patch:
    x, y = place
    patch: Patch
    if kind == "feature":
        side = 0.9 * RADIUS
        patch = Rectangle((x - side, y - side), 2 * side, 2 * side)
    else:
        patch = Circle(place, RADIUS)
    patch.set(facecolor=FILL[kind], edgecolor=INK, linewidth=1.3, zorder=2)
    axes.add_patch(patch)
    label = name.replace("_", " ").replace("-", " ").replace(" ", "\n")
    longest = max(map(len, label.split("\n")))
    axes.text(x, y, label, ha="center", va="center", fontsize=min(8.5, 82 / longest), color=INK, zorder=3)
    return patch


def _edge(axes: Axes, start: Patch, end: Patch, from_place: Point, to_place: Point, feedback: bool) -> None:
    arrow = FancyArrowPatch(
        from_place,
        to_place,
        patchA=start,
        patchB=end,
        arrowstyle="-" if feedback else "-|>",
        linestyle="-" if feedback else (0, (4, 3)),
        mutation_scale=13,
        shrinkA=0,
        shrinkB=0,
        color=INK,
        linewidth=1.3,
        zorder=1,
    )
    axes.add_patch(arrow)
    if not feedback:
        right = to_place[0] >= from_place[0]
        x, y = ((from_place[0] + to_place[0]) / 2, (from_place[1] + to_place[1]) / 2)
        x, side = (x + 0.15, "left") if right else (x - 0.15, "right")
        axes.text(x, y, "reads only", ha=side, va="top", fontsize=8, color=INK)
