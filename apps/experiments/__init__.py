"""Experiments, each with what is wanted of it: `rsmcm reproduce NAME`; and speeds: `make bench`."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path


@dataclass(frozen=True)
class Entry:
    """Line of the table of experiments."""

    about: str  # what it shows
    function: str  # module and function that does the work: from here, and imported when it is run
    parallel: bool = False  # whether it has several sequences that can be worked on at once
    long: str = ""  # what it does beside that when there is time; empty if it does nothing more


EXPERIMENTS = {
    "sleeping-man": Entry(
        "Figures 1 and 7 of the RSMCM paper: a person stands still and stays foreground.",
        "masks:sleeping_man",
        parallel=True,
        long="Also a person who stands for 1300 frames, and shadows of clouds.",
    ),
    "pets": Entry("Figures 8 and 11 of the RSMCM paper, on PETS2009 S2.L1.", "pets:pets", parallel=True),
    "highway": Entry("Foreground of CDnet's highway, against its masks.", "masks:highway", parallel=True),
    "cylinder": Entry(
        "Figures 9 and 10 of the RSMCM paper: a cylinder whose points are lost, found again and drift.",
        "structure:turning_cylinder",
        parallel=True,
    ),
    "box": Entry(
        "Figure 12 of the RSMCM paper, on CMU's hotel and a table top.", "structure:box", parallel=True
    ),
    "shapes": Entry(
        "Morph bases learned from tracks of points, against the true shapes of three public sets.",
        "shapes:shapes",
        parallel=True,
    ),
    "talking-face": Entry(
        "A real film: landmarks carried by G-flow with a generic model, and with one learned from the film.",
        "faces:talking_face",
        parallel=True,
    ),
    "experts": Entry(
        "Figure 3a of the G-flow paper: one expert and several, flow and a slow texture, on quick motion.",
        "faces:experts",
        parallel=True,
    ),
    "gain": Entry(
        "Figure 3b of the G-flow paper: gains from template to flow, and learned ones.",
        "faces:gain",
        parallel=True,
    ),
    "recovery": Entry(
        "Figure 4 of the G-flow paper: experts scattered about the pose find it.",
        "faces:recovery",
        parallel=True,
    ),
    "face-background": Entry(
        "What a background and the surface's own occlusion are worth to G-flow.",
        "faces:face_background",
        parallel=True,
    ),
    "body": Entry(
        "Figure 6 of the RSMCM paper: likelihood sampling with and without feedback, and CONDENSATION.",
        "body:body",
        parallel=True,
    ),
}
"""All of them, by the names of the command."""


def usual_folder(name: str) -> Path:
    """Return the default folder of an experiment's results."""
    return Path("results") / ("body-comparison" if name == "body" else name)  # `rsmcm body` has the other


def run_experiment(name: str, out: Path, *, long: bool = False) -> None:
    """Run one of `EXPERIMENTS`, perhaps with what takes longer, and leave all results in a folder.

    Raises
    ------
    OSError
        if data cannot be found, or the folder cannot be written to.
    """
    from .experiment import publish

    entry = EXPERIMENTS[name]
    module, function = entry.function.split(":")
    run = getattr(import_module(f".{module}", __name__), function)
    command = " ".join(["rsmcm reproduce", name, *(["--long"] if long else [])])
    publish(name, command, out, lambda: run(long=long) if entry.long else run())
