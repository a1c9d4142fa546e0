"""A Dask cluster on this machine: a scheduler and workers as processes."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Cluster:
    """What runs.

    Parameters
    ----------
    address
        of the scheduler.
    workers
        processes of one thread each.
    """

    address: str
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def cluster(workers: int) -> Iterator[Cluster]:
    """A scheduler with so many workers, which are ended after the block."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    started = [_begin("scheduler", "--host", "127.0.0.1", "--port", str(port))]
    try:
        started += [_begin("worker", address, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
        yield Cluster(address, started[1:])
    finally:
        for process in started:
            process.kill()
            process.wait()


def _begin(what: str, *arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
