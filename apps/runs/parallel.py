"""Work on many things at once: in processes on this machine, or on a Dask cluster that is there."""

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from importlib import import_module
from logging import ERROR
from typing import Any, TypeVar

from joblib import cpu_count
from joblib.externals.loky import ProcessPoolExecutor

from ...models.numerics.threads import set_threads
from ..options.libraries import ONE_THREAD_EACH
from .interruption import Interruption
from .messages import show_messages
from .progress import Progress

Task = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and its arguments, all of which can be sent to another process."""

Name = TypeVar("Name")

PATIENCE = 20.0
"""Seconds for which a cluster may have no worker."""

REPLACED = "A worker stopped while some jobs were given to the executor"
"""Begins loky's warning when a process has grown by more than 300 MB and is replaced by a fresh one, between
two tasks: films of other sizes than the first one's do that, and nothing is lost."""

_ending = threading.Event()
"""Of a worker process that was asked to end."""


@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Parameters
    ----------
    jobs
        processes, 1 or more; as many as there are cores if not given.
    threads
        of each of them.
    dask
        address of a scheduler whose workers do it instead, in one thread each.
    """

    jobs: int = field(default_factory=cpu_count)
    threads: int = 1
    dask: str | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ValueError(f"jobs: got {self.jobs}, expected 1 or more")


def chosen_workers(jobs: int | None, dask: str | None) -> Workers:
    """Workers as they are asked for by options of a command; ValueError if both are given."""
    if jobs is not None and dask is not None:
        raise ValueError("--jobs and --dask: got both, expected one of them (its workers are the jobs)")
    return Workers(jobs=cpu_count() if jobs is None else jobs, dask=dask)


_chosen: ContextVar[Workers | None] = ContextVar("workers", default=None)


@contextmanager
def working(workers: Workers) -> Iterator[None]:
    """Have these workers do what is worked on in parallel inside the block."""
    before = _chosen.set(workers)
    try:
        yield
    finally:
        _chosen.reset(before)


def in_parallel(label: str, work: Sequence[Task]) -> list[Any]:
    """Results of functions with their arguments, in order; what one of them raises is raised."""
    found: dict[int, Any] = {}
    with closing(as_they_end(label, work, "sequences")) as ended:
        for number, future in ended:
            found[number] = future.result()
    return [found[number] for number in range(len(work))]


def as_they_end(
    label: str, work: Sequence[Task], unit: str, stopping: Callable[[], bool] = lambda: False
) -> Generator[tuple[int, Future[Any]]]:
    """Number of each task and what became of it, in the order in which they end.

    Progress is shown with `label` and `unit`. When `stopping` is true, what has not been begun is left out.

    Raises
    ------
    ValueError
        if there is no cluster at the address of the `Workers`, or nobody works there.
    """
    workers = _chosen.get() or Workers()
    with Progress(label, len(work), unit=unit) as progress, _executor(workers, len(work)) as executor:
        futures = {
            executor.submit(_alone, workers.threads, *task): number for number, task in enumerate(work)
        }
        for future in as_completed(futures):
            if stopping():
                for waiting in futures:
                    waiting.cancel()
            if not future.cancelled():
                yield futures[future], future
                progress.update()


def whatever_fails(
    label: str,
    work: Mapping[Name, Task],
    unit: str,
    stopping: Callable[[], bool] = lambda: False,
    begun: Callable[[Name], bool] = lambda _: True,
) -> Generator[tuple[Name, Any]]:
    """Name of each task with its result, or the exception that it raised, in the order in which they end.

    None stops another, not even one that takes its process along. When a process dies, all tasks that wait
    for it are given back. Those that were `begun` (all, where nothing is known) run again one by one at the
    end; one that dies again was the cause, and is a ChildProcessError. The rest is as of `as_they_end`.
    """

    def ended(names: Sequence[Name]) -> Iterator[tuple[Name, Any]]:
        for number, future in as_they_end(label, [work[name] for name in names], unit, stopping):
            try:
                result = future.result()
            except Exception as error:
                if isinstance(error, BrokenProcessPool) and stopping():
                    continue
                result = error
            yield names[number], result

    waiting, suspects = list(work), list[Name]()
    while waiting and not stopping():
        given_back = []
        for name, result in ended(waiting):
            if isinstance(result, BrokenProcessPool):
                given_back.append(name)
            else:
                yield name, result
        suspected = [name for name in given_back if begun(name)] or given_back
        suspects += suspected
        waiting = [name for name in given_back if name not in suspected]
    with working(replace(_chosen.get() or Workers(), jobs=1)):
        for suspect in suspects:
            for name, result in ended([] if stopping() else [suspect]):
                died = isinstance(result, BrokenProcessPool)
                yield (
                    name,
                    ChildProcessError("its process was ended by the system, twice") if died else result,
                )


@contextmanager
def _executor(workers: Workers, tasks: int) -> Iterator[Executor]:
    """Who takes in tasks; they are ended at once where the block is left by an error."""
    if workers.dask is not None:
        with _cluster(workers.dask) as executor:
            yield executor
        return
    executor = ProcessPoolExecutor(
        min(workers.jobs, max(tasks, 1)),
        initializer=_settle,
        initargs=(os.getpid(),),
        env=ONE_THREAD_EACH,
    )
    completed = False
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", REPLACED)
            yield executor
        completed = True
    finally:
        executor.shutdown(wait=True, kill_workers=not completed)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise ValueError("--dask needs distributed: pip install 'rsmcm[dask]'") from None
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"--dask: got {address}, expected the address of a scheduler ({error})") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise ValueError(
                f"--dask: there is no worker at {address}: start dask worker {address}"
            ) from None
        yield client.get_executor(pure=False)


def _settle(parent: int) -> None:
    """Begin to work in a process: Ctrl-C is the parent's, which asks for the end by SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: _ending.set())
    Interruption.heeded = (signal.SIGTERM,)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End when the parent was killed: nobody would take the result, and a folder would stay locked."""
    while os.getppid() == parent or sys.platform == "win32":
        time.sleep(0.5)
    os._exit(1)


def _alone(threads: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    import cv2

    set_threads(threads)
    cv2.setNumThreads(1)  # a worker of a cluster was not started with our limits
    show_messages(ERROR)  # progress is the parent's
    return function(*arguments)


def is_ending() -> bool:
    """Whether this process works for another one that wants it to end."""
    return _ending.is_set()


def end_working() -> None:
    """Begin nothing more in this process, where a run that it had begun took the signal to end."""
    _ending.set()
