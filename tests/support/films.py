"""Many very short films as folders of images, and batches of them as processes."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

COMMAND = [sys.executable, "-m", "rsmcm.apps.command_line"]

OF_TIMES = {"view.html", "state.npz", "summary.json"}
"""Results that tell of times, or are encoded in other segments where a run went on."""


def write_film(folder: Path, frames: int = 6, size: tuple[int, int] = (64, 48), seed: int = 0) -> Path:
    """A box that crosses a textured picture; `size` is `(width, height)` px."""
    width, height = size
    folder.mkdir(parents=True)
    scene = np.random.default_rng(seed).integers(60, 200, (height, width, 3)).astype(np.uint8)
    for number in range(frames):
        picture = scene.copy()
        left = 5 + number * (width - 20) // frames
        picture[height // 3 : -8, left : left + 10] = (20, 20, 220)
        cv2.imwrite(str(folder / f"{number:04d}.png"), picture)
    return folder


def write_films(folder: Path, count: int, frames: int = 6) -> Path:
    """So many of them."""
    for number in range(count):
        write_film(folder / f"film{number:03d}", frames, seed=number)
    return folder


def write_long_films(folder: Path, count: int, frames: int) -> Path:
    """So many of them, of twelve pictures that come again and again."""
    for number in range(count):
        film = write_film(folder / f"film{number:03d}", 12, seed=number)
        for frame in range(12, frames):
            (film / f"{frame:04d}.png").hardlink_to(film / f"{frame % 12:04d}.png")
    return folder


def start(*arguments: object) -> subprocess.Popen[str]:
    """A command in a process group of its own, which heeds Ctrl-C even where this process ignores it."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_until(is_so: Callable[[], bool], seconds: float = 300) -> None:
    """Return when something is the case."""
    deadline = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def results(folder: Path) -> dict[str, bytes]:
    """All results in a folder that do not tell of times."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".") and path.name not in OF_TIMES
    }


def stamps(folder: Path) -> dict[Path, tuple[int, int]]:
    """By which it shows whether files were written again."""
    found = {path: path.stat() for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}
    return {path: (stat.st_ino, stat.st_mtime_ns) for path, stat in found.items()}
