"""Experiments with their targets: `rsmcm reproduce NAME`; and speeds: `make bench`."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path


@dataclass(frozen=True)
class Entry:
    """Line of the table of experiments."""

    about: str  # what it shows
    function: str  # module and function that does the work: from here, and imported when it is run
    parallel: bool = False  # whether it has several sequences that can be worked on at once
    long: str = ""  # what `--long` adds; empty if nothing


EXPERIMENTS = {
    "sleeping-man": Entry(
        "Figures 1 and 7 of the RSMCM paper: a person stands still and stays foreground.",
        "masks:sleeping_man",
        parallel=True,
        long="Also a person who stands for 1300 frames, and cloud shadows.",
    ),
    "pets": Entry("Figures 8 and 11 of the RSMCM paper, on PETS2009 S2.L1.", "pets:pets", parallel=True),
    "highway": Entry(
        "Foreground of CDnet's highway, compared with its masks.", "masks:highway", parallel=True
    ),
    "cylinder": Entry(
        "Figures 9 and 10 of the RSMCM paper: points of a cylinder that are lost, found again, and drift.",
        "structure:turning_cylinder",
        parallel=True,
    ),
    "box": Entry(
        "Figure 12 of the RSMCM paper, on CMU's hotel and a table top.", "structure:box", parallel=True
    ),
    "shapes": Entry(
        "Morph bases learned from tracks of points, compared with the true shapes of three public sets.",
        "shapes:shapes",
        parallel=True,
    ),
    "talking-face": Entry(
        "A real video: landmarks tracked by G-flow with a generic model, and with a learned one.",
        "faces:talking_face",
        parallel=True,
    ),
    "experts": Entry(
        "Figure 3a of the G-flow paper: one expert and several, optic flow and a slow texture, fast motion.",
        "faces:experts",
        parallel=True,
    ),
    "gain": Entry(
        "Figure 3b of the G-flow paper: gains from template to optic flow, and learned ones.",
        "faces:gain",
        parallel=True,
    ),
    "recovery": Entry(
        "Figure 4 of the G-flow paper: experts scattered around the true pose find it.",
        "faces:recovery",
        parallel=True,
    ),
    "face-background": Entry(
        "The gain of G-flow by a background and by self-occlusion.",
        "faces:face_background",
        parallel=True,
    ),
    "body": Entry(
        "Figure 6 of the RSMCM paper: likelihood sampling with and without feedback, and CONDENSATION.",
        "body:body",
        parallel=True,
    ),
    "calibration": Entry(
        "What all applications state of themselves, compared with the truth: probabilities, regions, claims.",
        "calibration:calibration",
        parallel=True,
    ),
}
"""All experiments, by name."""


def usual_folder(name: str) -> Path:
    """Return the default folder of an experiment's results."""
    return Path("results") / ("body-comparison" if name == "body" else name)  # `rsmcm body` uses results/body


def run_experiment(name: str, out: Path, *, long: bool = False) -> None:
    """Run one of `EXPERIMENTS`, optionally its long part, and write all results to a folder.

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
