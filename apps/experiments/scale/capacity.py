"""How many cameras a machine carries: `python -m rsmcm.apps.experiments.scale.capacity`.

A camera here is a whole run of `rsmcm background` over a film, masks as a video, overlay and page written:
read, decoded, tracked, drawn, encoded, saved. It is carried when it is worked off at five frames a second.
"""

import os
import resource
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import psutil
from joblib import cpu_count
from numpy.typing import NDArray

from ...background.application import run_background
from ...background.job import BackgroundJob
from ...io.datasets import data_folder
from ...io.segmented_video import PLAYABLE, SegmentedVideo
from ...io.sources.open_source import open_source
from ...runs.parallel import Task, Workers, in_parallel, working
from ...runs.saved_run import STATE
from ...scenes import sleeping_man
from ..experiment import Experiment, run_and_publish
from ..record import Table

SMALL, LARGE = (640, 480), (1920, 1080)
RATE = 5.0
N_FRAMES = 150
"""Of a film: half a minute."""

RUNS = 2
"""Of each process; the first one, in which loops are loaded, does not count where there is another."""

SHARE = 0.7
"""Of the memory that is free, for processes of cameras that run all at once."""

NOT_GROWING = (STATE, "background.png", "summary.json")
"""Results that are as large after many frames as after few."""

MEGA = 1e6
HEADER = (
    "film",
    "size",
    "processes x threads",
    "frames/s",
    "cameras at 5/s",
    "memory a process, MB",
    "kB a frame read",
    "kB a frame written",
    "saved state, MB",
)


@dataclass(frozen=True)
class Film:
    """A film that is worked on: where it lies, and `(width, height)` px."""

    path: Path
    size: tuple[int, int]


@dataclass(frozen=True)
class Measured:
    """One run, in its process.

    Parameters
    ----------
    process
        its id.
    rate
        frames a second of the run, reading and writing included.
    memory
        most that the process has held so far, MB, libraries included.
    written, state
        bytes of its results that grow with the frames, and of the saved state.
    """

    process: int
    rate: float
    memory: float
    written: float
    state: float


def main() -> None:
    """Measure films that can be had: a generated street, and PETS2009 S2.L1 in two sizes, at this rate."""
    command = "python -m rsmcm.apps.experiments.scale.capacity"
    run_and_publish("capacity", command, Path("results") / "capacity", capacity)


def capacity() -> Experiment:
    """What processes and threads on all cores carry."""
    cores = cpu_count()
    alone, together = Workers(1, 1), Workers(cores, 1)
    rows: list[Sequence[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        small, large, *more = films(Path(folder))
        for film in more:
            rows += [_row(film, workers, carried(film, workers)) for workers in (alone, together)]
        rows += [_row(large, workers, carried(large, workers)) for workers in (alone, together)]
        one = carried(small, alone)
        rows.append(_row(small, alone, one))
        rows += [_row(small, workers, carried(small, workers)) for workers in (Workers(1, cores), together)]
        room = int(SHARE * psutil.virtual_memory().available / MEGA / one[0].memory)
        at_once = Workers(max(cores, min(room, int(cores * one[0].rate / RATE))), 1)
        rows.append(_row(small, at_once, carried(small, at_once, runs=1)))
    caption = (
        f"Cameras at {RATE:g} frames a second that {cores} cores carry: rsmcm background, masks as a video, "
        "overlay, tracks and page written; in the last line each camera has a process, all at once."
    )
    return Experiment("How many cameras a machine carries", [Table(HEADER, rows, caption)], [])


def films(folder: Path) -> list[Film]:
    """The films that are worked on, written into a folder: one in two sizes, and others in the small one."""
    street = Film(folder / "street.mp4", SMALL)
    _write(street, (frame.image for frame in sleeping_man(N_FRAMES, size=SMALL, stand=40, enter=8)))
    try:
        source = data_folder("pets2009-s2l1") / "vtest.avi"
    except OSError:
        large = Film(folder / "street-large.mp4", LARGE)
        _write(large, (frame.image for frame in sleeping_man(N_FRAMES, size=LARGE, stand=40, enter=8)))
        return [street, large]
    found = [Film(folder / "pets.mp4", SMALL), Film(folder / "pets-large.mp4", LARGE)]
    for film in found:
        with open_source(str(source), step=2, stop=2 * N_FRAMES) as frames:
            _write(film, (frame.image for frame in frames))
    return [*found, street]


def _write(film: Film, pictures: Iterable[NDArray[np.uint8] | None]) -> None:
    written = SegmentedVideo(film.path, RATE, PLAYABLE)
    for number, picture in enumerate(pictures, start=1):
        if picture is not None:
            scaled = np.asarray(cv2.resize(picture, film.size), np.uint8)
            written.write(scaled, number, (number - 1) / RATE)
    written.close(finished=True)


def carried(film: Film, workers: Workers, runs: int = RUNS) -> list[Measured]:
    """The last run of every process, of which each works off the film several times."""
    with tempfile.TemporaryDirectory() as folder, working(workers):
        job = BackgroundJob(str(film.path), out=Path(), masks="video")
        work: list[Task] = [
            (measured, (replace(job, out=Path(folder) / str(number)),))
            for number in range(runs * workers.jobs)
        ]
        label = f"{film.path.stem}, {workers.jobs} x {workers.threads}"
        found: list[Measured] = in_parallel(label, work)
    by_process = defaultdict(list)
    for each in found:
        by_process[each.process].append(each)
    return [_steady(of_process) for of_process in by_process.values()]


def _steady(found: Sequence[Measured]) -> Measured:
    """Of one process: the mean rate of all runs but the first, if there are others."""
    rate = float(np.mean([each.rate for each in found[1:] or found]))
    return replace(found[-1], rate=rate, memory=max(each.memory for each in found))


def measured(job: BackgroundJob) -> Measured:
    """Run a job in this process."""
    summary = run_background(job).summary
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    files = [path for path in job.out.rglob("*") if path.is_file() and path.name not in NOT_GROWING]
    written, state = sum(path.stat().st_size for path in files), (job.out / STATE).stat().st_size
    return Measured(os.getpid(), summary["frames_per_second"], kilobytes * 1024 / MEGA, written, state)


def _row(film: Film, workers: Workers, found: Sequence[Measured]) -> tuple[object, ...]:
    rate = sum(each.rate for each in found)
    return (
        film.path.stem.removesuffix("-large"),
        f"{film.size[0]}x{film.size[1]}",
        f"{workers.jobs} x {workers.threads}",
        rate,
        int(rate / RATE),
        max(each.memory for each in found),
        film.path.stat().st_size / N_FRAMES / 1e3,
        found[0].written / N_FRAMES / 1e3,
        found[0].state / MEGA,
    )


if __name__ == "__main__":
    main()
