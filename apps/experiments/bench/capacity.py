"""How many cameras a machine carries: `python -m rsmcm.apps.experiments.bench.capacity`.

A camera here is a whole run of `rsmcm background` over a film, masks as a video, and page written: read,
decoded, tracked, encoded, saved. It is carried when it is worked off at five frames a second.
"""

import os
import resource
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import psutil
from joblib import cpu_count

from ...background.application import run_background
from ...background.job import BackgroundJob
from ...runs.parallel import Workers, in_parallel, working
from ...runs.saved_run import STATE
from ..experiment import Findings, publish
from ..record import Table
from .background import image_of, preloaded, write_film

SMALL, LARGE = (640, 480), (1920, 1080)
RATE = 5.0
N_FRAMES = 150  # of a film: half a minute
RUNS = 2  # of each process; the first one, in which loops are loaded, does not count where there is another
SHARE = 0.7  # of the memory that is free, for processes of cameras that run all at once

HEADER = (
    "size", "processes x threads", "frames/s", "cameras at 5/s", "memory a process, MB",
    "kB a frame read", "kB a frame written", "saved state, MB",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One run: its process, frames a second, and MB that the process held, of results and saved state."""

    process: int
    rate: float
    memory: float
    written: float
    state: float


def capacity() -> Findings:
    """Measure what processes and threads on all cores carry, of a film in two sizes."""
    cores = cpu_count()
    alone, together = Workers(1, 1), Workers(cores, 1)
    with tempfile.TemporaryDirectory() as name:
        images = [image_of(frame) for frame in preloaded(N_FRAMES, 2, size=(320, 240), stand=40, enter=8)]
        small, large = (
            write_film(
                Path(name) / f"{size[0]}.mp4",
                (np.asarray(cv2.resize(image, size), np.uint8) for image in images),
                RATE,
            )
            for size in (SMALL, LARGE)
        )
        rows = [row(large, LARGE, each, carried(large, each)) for each in (alone, together)]
        one = carried(small, alone)
        room = int(SHARE * psutil.virtual_memory().available / 1e6 / one[0].memory)
        at_once = Workers(max(cores, min(room, int(cores * one[0].rate / RATE))), 1)
        rows.append(row(small, SMALL, alone, one))
        for each, runs in ((Workers(1, cores), RUNS), (together, RUNS), (at_once, 1)):
            rows.append(row(small, SMALL, each, carried(small, each, runs)))
    caption = (
        f"Cameras at {RATE:g} frames a second that {cores} cores carry: rsmcm background, masks as a video, "
        "tracks and page written; in the last line each camera has a process, all at once."
    )
    return Findings("How many cameras a machine carries", [Table(HEADER, rows, caption)], [])


def carried(film: Path, workers: Workers, runs: int = RUNS) -> list[Run]:
    """Run over the film several times in every process; of each, the mean rate of all runs but the first."""
    with tempfile.TemporaryDirectory() as folder, working(workers):
        job = BackgroundJob(str(film), out=Path(), masks="video")
        jobs = [replace(job, out=Path(folder) / str(number)) for number in range(runs * workers.jobs)]
        label = f"{film.stem}, {workers.jobs} x {workers.threads}"
        found: list[Run] = in_parallel(label, [(measured, (each,)) for each in jobs])
    steady = []
    for process in dict.fromkeys(each.process for each in found):
        own = [each for each in found if each.process == process]
        rate = float(np.mean([each.rate for each in own[1:] or own]))
        steady.append(replace(own[-1], rate=rate, memory=max(each.memory for each in own)))
    return steady


def measured(job: BackgroundJob) -> Run:
    """Measure a job in this process."""
    rate = run_background(job).summary["frames_per_second"]
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1)
    sizes = {path.name: path.stat().st_size for path in job.out.rglob("*") if path.is_file()}
    state = sizes.pop(STATE)
    return Run(os.getpid(), rate, kilobytes / 976.5625, sum(sizes.values()) / 1e6, state / 1e6)


def row(film: Path, size: tuple[int, int], workers: Workers, limits: list[Run]) -> tuple[object, ...]:
    """Return a line of the table."""
    rate = sum(each.rate for each in limits)
    return (
        f"{size[0]}x{size[1]}", f"{workers.jobs} x {workers.threads}", rate, int(rate / RATE),
        max(each.memory for each in limits), film.stat().st_size / N_FRAMES / 1e3,
        1e3 * limits[0].written / N_FRAMES, limits[0].state,
    )  # fmt: skip


if __name__ == "__main__":
    publish(
        "capacity", "python -m rsmcm.apps.experiments.bench.capacity", Path("results") / "capacity", capacity
    )
