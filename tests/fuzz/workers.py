"""Processes in which inputs are read: with bounds on memory and time, and whatever dies there is counted."""

import contextlib
import os
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from .forging import STATE, forged
from .mutations import Files, mutated
from .readers import FORGED, READERS

try:
    import resource
except ImportError:  # Windows: only time is bounded there
    resource = None  # type: ignore[assignment]

MEMORY = 2 << 30
"""Bytes that reading an input may take."""
HEADROOM = 3
"""Factor of the process limit above this memory, so that an excessive request is measured, not refused."""
SECONDS = 30.0
"""Most computing time of an input, of a process's first one with imports."""
PATIENCE = 10
"""Factor of this time above which an input is ended that does not compute, on however busy a machine."""
RESULT, REFUSED = "result", "refused"

Seeds = dict[str, list[Files]]
Task = tuple[str, int]
"""A reader and the number of an input."""


def input_of(seeds: Seeds, task: Task, seed: int) -> Files:
    """The input of a task: always the same."""
    reader, number = task
    random = np.random.default_rng([seed, number, *reader.encode()])
    chosen = seeds[reader][number % len(seeds[reader])]
    if reader in FORGED:
        return forged(chosen, STATE, random)
    archives = [name for name in sorted(chosen) if name.endswith(".npz")]
    if archives and random.random() < 0.5:
        return forged(chosen, str(random.choice(archives)), random)
    return mutated(chosen, seeds[reader], random)


def write(files: Files, folder: Path) -> None:
    """Put an input's files into a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def outcomes(
    seeds: Seeds,
    tasks: Iterable[Task],
    seed: int = 0,
    readers: dict[str, Callable[[Path], None]] = READERS,
    n_workers: int = 2,
    seconds: float = SECONDS,
    memory: int = MEMORY,
) -> Iterator[tuple[Task, str]]:
    """What came of each input, when it came: `RESULT`, `REFUSED`, or words for anything else."""
    waiting = iter(tasks)
    with contextlib.ExitStack() as stack:
        workers = [_Worker((seeds, seed, readers, memory)) for _ in range(n_workers)]
        for worker in workers:
            stack.callback(worker.stop)
        for worker in workers:
            worker.take(next(waiting, None))
        while busy := {worker.pipe: worker for worker in workers if worker.task is not None}:
            ready = connection.wait(list(busy), timeout=0.5)
            for pipe, worker in busy.items():
                if pipe in ready:
                    outcome = worker.outcome()
                elif time.monotonic() - worker.started > PATIENCE * seconds or worker.computed() > seconds:
                    worker.stop()
                    outcome = f"more than {seconds:g} s"
                else:
                    continue
                assert worker.task is not None
                yield worker.task, outcome
                worker.take(next(waiting, None))


@dataclass(eq=False)
class _Worker:
    """A process that reads one input after the other; a new one when it is gone."""

    arguments: tuple[Any, ...]
    task: Task | None = None
    started: float = 0.0
    _before: float = 0.0
    process: Any = None
    pipe: Any = field(default=None)

    def take(self, task: Task | None) -> None:
        self.task = task
        if task is None:
            return
        if self.process is None or not self.process.is_alive():
            context = get_context("spawn")
            self.pipe, other = context.Pipe()
            self.process = context.Process(target=_serve, args=(other, *self.arguments), daemon=True)
            self.process.start()
            other.close()
            self.pipe.recv()  # ready
        self.started, self._before = time.monotonic(), 0.0
        self._before = self.computed()
        self.pipe.send(task)

    def computed(self) -> float:
        """Seconds of computing for this task."""
        with contextlib.suppress(psutil.Error):
            times = psutil.Process(self.process.pid).cpu_times()
            return times.user + times.system - self._before
        return 0.0

    def outcome(self) -> str:
        try:
            return str(self.pipe.recv())
        except (EOFError, ConnectionResetError):
            self.process.join()
            code = self.process.exitcode
            return f"the process died: {signal.Signals(-code).name if code < 0 else f'exit code {code}'}"

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()


def _serve(
    pipe: Any, seeds: Seeds, seed: int, readers: dict[str, Callable[[Path], None]], memory: int
) -> None:  # pragma: no cover (another process)
    """Read the inputs that are asked for."""
    warnings.simplefilter("always")  # each would be a line on standard error
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryDirectory(prefix="fuzz-") as top:
        for number in (1, 2):
            os.dup2(printed.fileno(), number)
        if resource is not None and hasattr(resource, "RLIMIT_AS"):
            bound = _status("VmSize") + HEADROOM * memory
            resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
        pipe.send("ready")
        while True:
            task = pipe.recv()
            folder = Path(tempfile.mkdtemp(dir=top))
            write(input_of(seeds, task, seed), folder)
            before = _fresh_peak()
            outcome = _read(readers[task[0]], folder)
            taken = _status("VmHWM") - before
            if taken > memory:
                outcome = f"{taken / 2**20:.0f} MiB of memory"
            printed.seek(0)
            if words := printed.read(2000).decode(errors="replace"):
                outcome = f"said by itself: {words.strip().splitlines()[-1][:100]}"
                printed.seek(0)
                printed.truncate()
            shutil.rmtree(folder)
            pipe.send(outcome)


def _read(reader: Callable[[Path], None], folder: Path) -> str:
    try:
        reader(folder)
    except (ValueError, OSError) as error:
        if str(folder) in str(error):
            return REFUSED
        return f"names no file: {_where(error)}"
    except BaseException as error:
        return _where(error)
    return RESULT


def _where(error: BaseException) -> str:
    """The error, and the last place of ours that it went through."""
    ours = [
        each for each in traceback.extract_tb(error.__traceback__) if "site-packages" not in each.filename
    ]
    place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "nowhere"
    return f"{type(error).__name__} in {place}: {str(error).splitlines()[0][:60] if str(error) else ''}"


def _fresh_peak() -> int:
    """Bytes in memory now; the peak counts from here."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _status(name: str) -> int:
    """A size of this process in bytes; 0 where the system does not say it so."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), 0)
