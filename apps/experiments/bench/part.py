"""One part of the bench, in this process: `python -m rsmcm.apps.experiments.bench.part NAME [--long]`."""

import sys
from collections.abc import Callable
from pathlib import Path

from ...reports.expectations import Expectation
from ...reports.experiment import Experiment, run_and_publish
from ...reports.record import Table

FOLDER = Path("results") / "bench"
LONG = "--long"
CURVES = "curves"
"""The part that is a record of its own: nothing in it is beside a peer."""


def folder_of(name: str) -> Path:
    """Where a part leaves its record."""
    return Path("results") / name if name == CURVES else FOLDER / name


def main(name: str, *options: str) -> None:
    """Measure a part, print what was found, and leave its record."""
    command = " ".join(["python -m rsmcm.apps.experiments.bench --only", name, *options])
    run_and_publish(name, command, folder_of(name), lambda: PARTS[name](LONG in options))


def _background(_: bool) -> Experiment:
    from .background import speeds

    return speeds()


def _large(_: bool) -> Experiment:
    from .background import large

    return large()


def _objects(_: bool) -> Experiment:
    from .background import objects

    return objects()


def _frames(long: bool) -> Experiment:
    from .background import MANY_FRAMES, SOME_FRAMES, over_time

    return over_time(MANY_FRAMES if long else SOME_FRAMES)


def _points(_: bool) -> Experiment:
    from .points import point_expectations

    return Experiment("Points", [], point_expectations())


def _structure(long: bool) -> Experiment:
    from .structure import structure_expectations

    return Experiment("Structure", [], structure_expectations(100 if long else 25))


def _faces(_: bool) -> Experiment:
    from .face import face_expectations

    return Experiment("Faces", [], face_expectations())


def _bodies(_: bool) -> Experiment:
    from .body_samples import bootstrap_times
    from .body_tracker import body_expectations

    expectations, stages = body_expectations()
    caption = "Where the time of the body tracker goes, two threads."
    table = Table(("stage", "ms", "share, %"), stages, caption)
    return Experiment("Bodies", [table], [*expectations, *bootstrap_times()])


def _exactness(_: bool) -> Experiment:
    from ..trials.exactness import enumeration_error

    what = "BP against enumeration, greatest difference"
    return Experiment("Exactness", [], [Expectation(what, enumeration_error(), "<=", 1e-12)])


PARTS: dict[str, Callable[[bool], Experiment]] = {
    "background": _background,
    "large": _large,
    "objects": _objects,
    "frames": _frames,
    "points": _points,
    "structure": _structure,
    "faces": _faces,
    "bodies": _bodies,
    "exactness": _exactness,
}
"""What each of them measures; `True` for longer. What they need is imported when they run."""


if __name__ == "__main__":
    main(*sys.argv[1:])
