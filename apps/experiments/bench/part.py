"""One part of the bench, in this process: `python -m rsmcm.apps.experiments.bench.part NAME [--long]`."""

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ..expectations import Expectation
from ..experiment import Experiment, run_and_publish
from ..record import Table

FOLDER = Path("results") / "bench"
LONG = "--long"
CURVES = "curves"
"""The part that is a record of its own: there nothing is beside a peer."""

MANY_FRAMES, SOME_FRAMES = 10_000, 1_500
"""Of the film over which time and memory are watched, with `--long` and without."""


def folder_of(name: str) -> Path:
    """Where a part leaves its record."""
    return Path("results") / name if name == CURVES else FOLDER / name


def main(name: str, *options: str) -> None:
    """Measure a part, print what was found, and leave its record."""
    command = " ".join(["python -m rsmcm.apps.experiments.bench --only", name, *options])
    run_and_publish(name, command, folder_of(name), lambda: PARTS[name](LONG in options))


def _function(name: str) -> Any:
    """`.module.function`, from here; what that needs is imported now."""
    module, _, function = name.rpartition(".")
    return getattr(import_module(module, __package__), function)


def _whole(name: str, _: bool) -> Experiment:
    """A function that gives an experiment."""
    found: Experiment = _function(name)()
    return found


def _figures(title: str, name: str, _: bool) -> Experiment:
    """A function that gives expectations."""
    return Experiment(title, [], _function(name)())


def _structure(long: bool) -> Experiment:
    return Experiment("Structure", [], _function(".structure.structure_expectations")(100 if long else 25))


def _bodies(_: bool) -> Experiment:
    expectations, stages = _function(".body_tracker.body_expectations")()
    table = Table(
        ("stage", "ms", "share, %"), stages, "Where the time of the body tracker goes, on one thread."
    )
    return Experiment("Bodies", [table], [*expectations, *_function(".body_samples.bootstrap_times")()])


def _exactness(_: bool) -> Experiment:
    from ..trials.exactness import enumeration_error

    what = "BP against enumeration, greatest difference"
    return Experiment("Exactness", [], [Expectation(what, enumeration_error(), "<=", 1e-12)])


def _curves(long: bool) -> Experiment:
    found: Experiment = _function("..scale.curves.curves")(MANY_FRAMES if long else SOME_FRAMES)
    return found


PARTS: dict[str, Callable[[bool], Experiment]] = {
    "background": partial(_whole, ".background.speeds"),
    "large": partial(_whole, ".background.large"),
    "objects": partial(_whole, ".background.objects"),
    "command": partial(_figures, "The whole command", ".whole_command.whole_command_expectations"),
    "start": partial(_figures, "Time to the first frame", ".start.start_expectations"),
    "points": partial(_figures, "Points", ".points.point_expectations"),
    "structure": _structure,
    "faces": partial(_figures, "Faces", ".face.face_expectations"),
    "bodies": _bodies,
    "exactness": _exactness,
    CURVES: _curves,
}
"""What each of them measures; `True` for longer."""


if __name__ == "__main__":
    main(*sys.argv[1:])
