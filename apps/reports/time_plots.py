"""Curves over the time of a video, below each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from .plots import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED = "#2f7fc1", "#d9822b", "#3a9a5b", "#d64545"


@dataclass(frozen=True, eq=False)
class Line:
    """A curve: label, colour, value in every frame, and (if known) lower and upper bounds about it."""

    label: str
    colour: str
    values: Array
    band: tuple[Array, Array] | None = None


def over_time(
    times: Sequence[float],
    plots: Sequence[tuple[str, Sequence[Line]]],
    caption: str,
    shaded: Sequence[tuple[float, float]] = (),
    dotted: Sequence[float] = (),
    axis: str = "time in the video, s",
) -> Markup:
    """Plots below each other over one axis of time.

    Parameters
    ----------
    times
        of the frames, s.
    plots
        name of the vertical axis, and lines with one value a frame.
    caption
        of all plots.
    shaded
        periods that are marked: times of the first and the last frame, s.
    dotted
        moments that are marked, s.
    axis
        name of the axis, where times are other numbers.
    """
    half = 0.5 * float(np.median(np.diff(times))) if len(times) > 1 else 0.5

    def draw(canvas: "Figure") -> None:
        axes = canvas.subplots(len(plots), sharex=True, squeeze=False)[:, 0]
        for panel, (name, lines) in zip(axes, plots, strict=True):
            for line in lines:
                panel.plot(times, line.values, color=line.colour, linewidth=1.2, label=line.label)
                if line.band is not None:
                    panel.fill_between(times, *line.band, color=line.colour, alpha=0.2, linewidth=0)
            for first, last in shaded:
                panel.axvspan(first - half, last + half, color=RED, alpha=0.18, linewidth=0)
            for moment in dotted:
                panel.axvline(moment, color=RED, linewidth=0.8, linestyle=":")
            panel.set_ylabel(name)
            panel.margins(x=0.01)
            if len(lines) > 1:
                panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)
        axes[-1].set_xlabel(axis)
        canvas.align_ylabels()

    return figure(draw, (11, 1.2 + 1.9 * len(plots)), caption)
