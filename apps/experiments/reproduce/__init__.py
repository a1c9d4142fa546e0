"""Figures of the papers reproduced: `rsmcm reproduce`."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Experiment:
    """A figure to reproduce; what it needs is imported when it runs.

    Parameters
    ----------
    name
        of the command; the module of that name, with underscores, has its `reproduce_...`.
    text
        what it shows.
    folder
        for the figures, if that is not `name`.
    long
        what it does beside that when there is time.
    """

    name: str
    text: str
    folder: str = ""
    long: str = ""

    @property
    def out(self) -> Path:
        """The usual folder for the figures."""
        return Path("results") / (self.folder or self.name)

    def __call__(self, out: Path, *long: bool) -> None:
        """Reproduce it; `long` for those that can take longer."""
        module = self.name.replace("-", "_")
        reproduce: Callable[..., Any] = getattr(import_module(f".{module}", __name__), f"reproduce_{module}")
        reproduce(out, *long)


EXPERIMENTS = (
    Experiment(
        "sleeping-man",
        "Figures 1 and 7 of the RSMCM paper: a person stands still and stays foreground.",
        long="Also a person who stands for 1300 frames, and shadows of clouds.",
    ),
    Experiment(
        "pets",
        "Figures 8 and 11 of the RSMCM paper, on PETS2009 S2.L1.",
        long="Try all settings of MOG2 and KNN, and all clean-ups, instead of the middle ones.",
    ),
    Experiment("highway", "Foreground of CDnet's highway, against its masks."),
    Experiment(
        "cylinder",
        "Figures 9 and 10 of the RSMCM paper: a cylinder whose points are lost, found again and drift.",
    ),
    Experiment("box", "Figure 12 of the RSMCM paper, on CMU's hotel and a table top."),
    Experiment(
        "shapes", "Morph bases learned from tracks of points, against the true shapes of three public sets."
    ),
    Experiment(
        "talking-face",
        "A real film: landmarks carried by G-flow with a generic model, and with one learned from the film.",
    ),
    Experiment(
        "experts",
        "Figure 3a of the G-flow paper: one expert and several, flow and a slow texture, on quick motion.",
    ),
    Experiment("gain", "Figure 3b of the G-flow paper: gains from template to flow, and learned ones."),
    Experiment("recovery", "Figure 4 of the G-flow paper: experts scattered about the pose find it."),
    Experiment("face-background", "What a background and the surface's own occlusion are worth to G-flow."),
    Experiment(
        "body",
        "Figure 6 of the RSMCM paper: likelihood sampling with and without feedback, and CONDENSATION.",
        folder="body-comparison",
    ),
)
