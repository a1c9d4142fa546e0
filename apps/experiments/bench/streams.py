"""Cameras that a machine carries side by side: `rsmcm batch background` on live streams of this machine."""

import http.server
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

import cv2

from ...io.sources.open_source import DECODE_AHEAD
from ..experiment import Findings
from ..record import Expectation, Table
from .background import image_of, preloaded

RATES = (10, 25)
PLACES = {"1 core": (1, False), "2 cores": (2, False), "2 cores, a Dask cluster of processes": (2, True)}
"""Cores, and whether each camera has a worker of a cluster instead of a process of the batch."""

SECONDS, START = 20.0, 8.0  # of pictures that count, after the first one, which programs start with
MOST_DROPPED = 0.01  # share of the pictures, by which a machine carries its cameras
FIRST, MOST = {10: 2, 25: 1}, 8  # cameras for each core that are tried first; and at most of all


class _Camera(http.server.BaseHTTPRequestHandler):
    """Motion JPEG: one picture, a pause in which the program starts, then all others in real time."""

    pictures: Sequence[bytes] = ()
    rate = 10

    def do_GET(self) -> None:
        """Send the film, in a rate that nobody can change."""
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        began = time.monotonic() + START
        for number in range(1 + round(SECONDS * self.rate)):
            time.sleep(max(began + number / self.rate - time.monotonic(), 0.0) if number else 0.0)
            picture = self.pictures[number % len(self.pictures)]
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
            self.wfile.write(head.encode() + picture + b"\r\n")

    def log_message(self, *_: object) -> None:
        """Say nothing of requests."""


@contextmanager
def _cameras(rate: int, pictures: Sequence[bytes]) -> Iterator[str]:
    """Addresses of any number of cameras, each of which shows the film to whom it is asked by."""
    handler = type("Camera", (_Camera,), {"pictures": pictures, "rate": rate})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@contextmanager
def _workers(count: int) -> Iterator[Sequence[str]]:
    """Options of a batch for a Dask cluster of so many processes, which it has for itself."""
    from distributed import LocalCluster

    cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)  # type: ignore[no-untyped-call]
    with cluster:
        yield "--dask", cluster.scheduler_address


def _dropped(address: str, count: int, cores: int, rate: int, on_dask: bool) -> float:
    """Share of the pictures of so many cameras that are dropped by a batch on so many cores."""
    place = _workers(count) if on_dask else nullcontext(("--jobs", str(count)))
    with tempfile.TemporaryDirectory() as name, place as options:
        folder = Path(name)
        listed = (f'[[camera]]\nname = "c{k}"\nsource = "{address}/{k}"\n' for k in range(count))
        (folder / "cameras.toml").write_text("\n".join(listed))
        arguments = ["--threads", "1", "batch", "background", str(folder / "cameras.toml")]
        arguments += ["--out", str(folder / "out"), *options]
        command = [sys.executable, "-m", "rsmcm.apps.command_line", *arguments]
        usable = sorted(os.sched_getaffinity(0))[:cores]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.sched_setaffinity(process.pid, usable)  # before it starts others, which inherit it
        process.wait()
        summaries = [json.loads(path.read_text()) for path in folder.glob("out/c*/summary.json")]
    if len(summaries) != count:
        raise ValueError(f"streams: got results of {len(summaries)} cameras, expected {count}")
    return statistics.fmean(each["stream"]["dropped_frames"] for each in summaries) / (SECONDS * rate)


def streams() -> Findings:
    """Measure how many cameras one core, two, and a cluster on two carry, at the size of PETS."""
    pictures = [cv2.imencode(".jpg", image_of(frame))[1].tobytes() for frame in preloaded()]
    expectations, rows = list[Expectation](), list[tuple[object, ...]]()
    for place, (cores, on_dask) in PLACES.items():
        for rate in RATES:
            tried: dict[int, float] = {}
            with _cameras(rate, pictures) as address:
                count = FIRST[rate] * cores
                while 0 < count <= MOST and count not in tried:
                    tried[count] = _dropped(address, count, cores, rate, on_dask)
                    count += 1 if tried[count] <= MOST_DROPPED else -1
            carried = max((count for count, share in tried.items() if share <= MOST_DROPPED), default=0)
            expectations.append(Expectation(f"cameras, 768x576, {rate} frames a second, {place}", carried))
            rows += [(place, rate, count, 100 * share) for count, share in sorted(tried.items())]
    header = ("on", "frames a second", "cameras", "dropped, %")
    caption = f"At most {DECODE_AHEAD} frames wait, which bounds the lag; the oldest of more is dropped."
    return Findings("Cameras side by side", [Table(header, rows, caption)], expectations)
