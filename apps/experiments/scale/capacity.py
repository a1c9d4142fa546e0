"""How many cameras a machine carries: `python -m rsmcm.apps.experiments.bench.capacity`.

A camera here is a whole run of `rsmcm background` over a film of 640x480 px, masks and overlay written: read,
decoded, tracked, drawn, encoded, saved. It is carried when it is worked off at five frames a second.
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
from joblib import cpu_count
from numpy.typing import NDArray

from ...background.application import run_background
from ...background.job import BackgroundJob
from ...io.datasets import data_folder
from ...io.segmented_video import PLAYABLE, SegmentedVideo
from ...io.sources.open_source import open_source
from ...reports.experiment import Experiment, run_and_publish
from ...reports.record import Table
from ...runs.parallel import Task, Workers, in_parallel, working
from ...scenes import sleeping_man

SIZE = (640, 480)
RATE = 5.0
N_FRAMES = 150
"""Of a film: half a minute."""

RUNS = 2
"""Of each process; the first one, in which loops are loaded, does not count."""

MEGA = 1e6
HEADER = ("film", "processes x threads", "frames/s", "cameras at 5/s", "memory a process, MB")


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
    """

    process: int
    rate: float
    memory: float


def main() -> None:
    """Measure films that can be had: a generated street, and PETS2009 S2.L1 in this size and rate."""
    command = "python -m rsmcm.apps.experiments.bench.capacity"
    run_and_publish("capacity", command, Path("results") / "capacity", capacity)


def capacity() -> Experiment:
    """What processes and threads on all cores carry."""
    cores = cpu_count()
    rows: list[Sequence[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for film in films(Path(folder)):
            alone = carried(film, Workers(1, 1))
            at_once = max(cores, int(cores * alone[0] / RATE))
            rows.append(_row(film, Workers(1, 1), alone))
            settings = (Workers(1, cores), Workers(cores, 1), Workers(at_once, 1))
            rows += [_row(film, workers, carried(film, workers)) for workers in settings]
    caption = (
        f"Cameras of {SIZE[0]}x{SIZE[1]} px at {RATE:g} frames a second that {cores} cores carry: rsmcm "
        "background, masks and overlay written; in the last line of a film each has a process, all at once."
    )
    return Experiment("How many cameras a machine carries", [Table(HEADER, rows, caption)], [])


def films(folder: Path) -> list[Path]:
    """The films that are worked on, written into a folder."""
    found = [folder / "street.mp4"]
    _write(found[0], (frame.image for frame in sleeping_man(N_FRAMES, size=SIZE, stand=40, enter=8)))
    try:
        source = data_folder("pets2009-s2l1") / "vtest.avi"
    except OSError:
        return found
    found.append(folder / "pets.mp4")
    with open_source(str(source), step=2, stop=2 * N_FRAMES) as frames:
        _write(found[1], (frame.image for frame in frames))
    return found


def _write(path: Path, pictures: Iterable[NDArray[np.uint8] | None]) -> None:
    film = SegmentedVideo(path, RATE, PLAYABLE)
    for number, picture in enumerate(pictures, start=1):
        if picture is not None:
            film.write(np.asarray(cv2.resize(picture, SIZE), np.uint8), number, (number - 1) / RATE)
    film.close(finished=True)


def carried(film: Path, workers: Workers) -> tuple[float, float]:
    """Frames a second of all processes together, and the most memory that one of them took, in MB."""
    with tempfile.TemporaryDirectory() as folder, working(workers):
        job = BackgroundJob(str(film), out=Path())
        work: list[Task] = [
            (measured, (replace(job, out=Path(folder) / str(number)),))
            for number in range(RUNS * workers.jobs)
        ]
        label = f"{film.stem}, {workers.jobs} x {workers.threads}"
        found: list[Measured] = in_parallel(label, work)
    rates = defaultdict(list)
    for each in found:
        rates[each.process].append(each.rate)
    steady = [np.mean(of_process[1:] or of_process) for of_process in rates.values()]
    return float(np.sum(steady)), max(each.memory for each in found)


def measured(job: BackgroundJob) -> Measured:
    """Run a job in this process."""
    summary = run_background(job).summary
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    return Measured(os.getpid(), summary["frames_per_second"], kilobytes * 1024 / MEGA)


def _row(film: Path, workers: Workers, found: tuple[float, float]) -> tuple[object, ...]:
    rate, memory = found
    return film.stem, f"{workers.jobs} x {workers.threads}", rate, int(rate / RATE), memory


if __name__ == "__main__":
    main()
