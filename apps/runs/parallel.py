"""Experiments on several sequences at once, each in a process of one thread."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from ...models.numerics.threads import set_threads
from .progress import Progress

MOST_WORKERS = 2


def in_processes(label: str, work: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]]) -> list[Any]:
    """Results of functions with their arguments, in order, worked out in two processes at most."""
    found: dict[int, Any] = {}
    workers = min(MOST_WORKERS, os.cpu_count() or 1)
    # spawned: a fork would copy what libraries hold, and not all of their threads outlive it
    with (
        _one_thread_each(),
        ProcessPoolExecutor(workers, get_context("spawn"), set_threads, (1,)) as pool,
        Progress(label, len(work), unit="sequences") as progress,
    ):
        futures = {
            pool.submit(function, *arguments): number for number, (function, arguments) in enumerate(work)
        }
        try:
            for future in as_completed(futures):
                found[futures[future]] = future.result()
                progress.update()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [found[number] for number in range(len(work))]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started do linear algebra in one thread: more would wait for each other."""
    names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
