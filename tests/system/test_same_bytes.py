"""The same input and seed give the same bytes on any number of threads and on one core."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ..support.deforming import deforming
from ..support.films import results
from ..support.reconstructions import write_film
from ..support.small_runs import small_run

WAYS = {
    "two threads": (["--threads", "2"], "2", None),
    "one thread": (["--threads", "1"], "1", None),
    "four threads": (["--threads", "4"], "4", None),
    "one core": ([], None, 0),
}
"""Options, threads of linear algebra, and the core to which a process is bound."""


def arguments_of(name: str, folder: Path) -> list[str]:
    if name == "structure":
        write_film(folder, n_frames=12)
        return [name, str(folder)]
    if name == "shape":
        np.save(folder / "tracks.npy", deforming(n_frames=15)[0])
        return [name, str(folder / "tracks.npy"), "--bases", "3"]
    run = small_run(name, folder)
    return [name, str(run.source), *run.options]


def bound_to(core: int | None) -> Callable[[], None] | None:
    """What binds a child to a core, where the system can."""
    if core is None or not hasattr(os, "sched_setaffinity"):
        return None
    first = sorted(os.sched_getaffinity(0))[core]
    return lambda: os.sched_setaffinity(0, {first})


def started(command: list[str], blas: str | None, core: int | None) -> "subprocess.Popen[str]":
    environment = dict(os.environ)
    environment.pop("OPENBLAS_NUM_THREADS", None)
    if blas is not None:
        environment["OPENBLAS_NUM_THREADS"] = blas
    return subprocess.Popen(
        [sys.executable, "-m", "rsmcm.apps.command_line", *command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=bound_to(core),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["background", "structure", "shape", "face", "body"])
def test_threads_and_cores_change_no_byte(name: str, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    arguments = arguments_of(name, source)
    processes = {
        way: started([*arguments, "--out", str(tmp_path / way), *options], blas, core)
        for way, (options, blas, core) in WAYS.items()
    }
    for process in processes.values():
        printed, _ = process.communicate(timeout=600)
        assert process.returncode == 0, printed
    first, *others = (results(tmp_path / way) for way in WAYS)
    assert ("shapes.npz" if name == "shape" else "film.mp4") in first
    for way, other in zip(list(WAYS)[1:], others, strict=True):
        assert set(other) == set(first), way
        assert [name for name in first if other[name] != first[name]] == [], way
