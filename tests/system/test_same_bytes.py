"""The same input and seed give the same bytes on any number of threads and on one core."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import face, signer, sleeping_man
from rsmcm.models.body.upper_body import JOINTS

from ..support.deforming import deforming
from ..support.films import results
from ..support.reconstructions import write_film

WAYS = {
    "two threads": (["--threads", "2"], "2", None),
    "one thread": (["--threads", "1"], "1", None),
    "four threads": (["--threads", "4"], "4", None),
    "one core": ([], None, 0),
}
"""Options, threads of linear algebra, and the core to which a process is bound."""

Arguments = list[str]


def pictures(folder: Path, images: Any) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number}.png"), image)
    return folder


def background(folder: Path) -> Arguments:
    write_scene(sleeping_man(30, size=(128, 96), enter=0), folder)
    return [str(folder / "input"), "--ground-truth", str(folder)]


def structure(folder: Path) -> Arguments:
    write_film(folder, n_frames=12)
    return [str(folder)]


def shape(folder: Path) -> Arguments:
    np.save(folder / "tracks.npy", deforming(n_frames=15)[0])
    return [str(folder / "tracks.npy"), "--bases", "3"]


def face_of_a_film(folder: Path) -> Arguments:
    scene = face(10, 3, (200, 160))
    film = pictures(folder / "film", scene.images())
    np.save(folder / "start.npy", scene.vertices[0])
    return [str(film), "--landmarks", str(folder / "start.npy"), "--experts", "6"]


def body(folder: Path) -> Arguments:
    scene = signer(16, 3, 0.0, 0.3, (640, 360))
    x, y = scene.joints[0, JOINTS.index("head"), :2]
    width, height = scene.body.head_width, scene.body.head_height
    head = f"{x - width / 2:.0f},{y - height / 2:.0f},{width:.0f},{height:.0f}"
    return [str(pictures(folder / "film", scene.images())), "--head", head, "--samples", "200"]


def bound_to(core: int | None) -> Callable[[], None] | None:
    """What binds a child to a core, where the system can."""
    if core is None or not hasattr(os, "sched_setaffinity"):
        return None
    first = sorted(os.sched_getaffinity(0))[core]
    return lambda: os.sched_setaffinity(0, {first})


def started(command: Arguments, blas: str | None, core: int | None) -> "subprocess.Popen[str]":
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
@pytest.mark.parametrize(
    ("command", "prepare"),
    [
        ("background", background),
        ("structure", structure),
        ("shape", shape),
        ("face", face_of_a_film),
        ("body", body),
    ],
)
def test_threads_and_cores_change_no_byte(
    command: str, prepare: Callable[[Path], Arguments], tmp_path: Path
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    arguments = prepare(source)
    processes = {
        way: started([command, *arguments, "--out", str(tmp_path / way), *options], blas, core)
        for way, (options, blas, core) in WAYS.items()
    }
    for process in processes.values():
        printed, _ = process.communicate(timeout=600)
        assert process.returncode == 0, printed
    first, *others = (results(tmp_path / way) for way in WAYS)
    assert ("shapes.npz" if command == "shape" else "film.mp4") in first
    for way, other in zip(list(WAYS)[1:], others, strict=True):
        assert set(other) == set(first), way
        assert [name for name in first if other[name] != first[name]] == [], way
