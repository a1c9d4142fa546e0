"""Figures of the papers reproduced: `rsmcm reproduce`."""

from importlib import import_module
from pathlib import Path

EXPERIMENTS = {
    "sleeping-man": "Figures 1 and 7 of the RSMCM paper: a person stands still and stays foreground.",
    "pets": "Figures 8 and 11 of the RSMCM paper, on PETS2009 S2.L1.",
    "highway": "Foreground of CDnet's highway, against its masks.",
    "cylinder": "Figures 9 and 10 of the RSMCM paper: a cylinder whose points are lost, found again and "
    "drift.",
    "box": "Figure 12 of the RSMCM paper, on CMU's hotel and a table top.",
    "shapes": "Morph bases learned from tracks of points, against the true shapes of three public sets.",
    "talking-face": "A real film: landmarks carried by G-flow with a generic model, and with one learned "
    "from the film.",
    "experts": "Figure 3a of the G-flow paper: one expert and several, flow and a slow texture, on quick "
    "motion.",
    "gain": "Figure 3b of the G-flow paper: gains from template to flow, and learned ones.",
    "recovery": "Figure 4 of the G-flow paper: experts scattered about the pose find it.",
    "face-background": "What a background and the surface's own occlusion are worth to G-flow.",
    "body": "Figure 6 of the RSMCM paper: likelihood sampling with and without feedback, and CONDENSATION.",
}
"""What each of them shows. The module of that name, with underscores, has its `reproduce_...`."""

LONG = {
    "sleeping-man": "Also a person who stands for 1300 frames, and shadows of clouds.",
    "pets": "Try all settings of MOG2 and KNN, and all clean-ups, instead of the middle ones.",
}
"""What some of them do beside that when there is time."""

PARALLEL = ("pets", "cylinder", "experts", "gain", "recovery", "face-background", "body")
"""Those of several sequences that can be worked on at once."""


def usual_folder(name: str) -> Path:
    """Where the figures of an experiment go."""
    return Path("results") / ("body-comparison" if name == "body" else name)  # `rsmcm body` has the other


def run_experiment(name: str, out: Path, *long: bool) -> None:
    """Reproduce a figure, and leave all results in a folder; what that needs is imported now.

    Parameters
    ----------
    name
        one of `EXPERIMENTS`.
    out
        folder, made if need be.
    long
        whether to do what takes longer, for those of `LONG`.

    Raises
    ------
    OSError
        if data cannot be found or fetched, or the folder cannot be written to.
    """
    from ..experiment import run_and_publish

    module = name.replace("-", "_")
    reproduce = getattr(import_module(f".{module}", __name__), f"reproduce_{module}")
    command = " ".join(["rsmcm reproduce", name, *(["--long"] if any(long) else [])])
    run_and_publish(name, command, out, lambda: reproduce(out, *long))
