"""Work that threads share: bands of rows, pieces that do not wait for each other, work in the background.

It pays where kernels release the interpreter's lock. OpenCV's own threads are another matter: most calls here
are too short for them, so that it has one in all commands.
"""

import itertools
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Result = TypeVar("Result")

_settings = {"threads": min(2, os.cpu_count() or 1)}
_workers: dict[int, ThreadPoolExecutor] = {}


def _before_fork() -> None:
    """Have OpenCV end its threads: one that held a lock would leave it locked in the child for ever."""
    if (opencv := sys.modules.get("cv2")) is not None:
        _settings["opencv"] = opencv.getNumThreads()
        opencv.setNumThreads(1)


def _after_fork() -> None:
    if (opencv := sys.modules.get("cv2")) is not None:
        opencv.setNumThreads(_settings["opencv"])


def _after_fork_in_child() -> None:
    _workers.clear()  # it has none of its parent's threads
    _after_fork()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork_in_child)


def set_threads(count: int) -> None:
    """Use `count` threads in the kernels that work on bands of rows; results do not change.

    With 1, all work stays in the caller's thread; below, it is a `ValueError`.
    """
    if count < 1:
        raise ValueError(f"threads: got {count}, expected 1 or more")
    _settings["threads"] = count


def thread_count() -> int:
    """Return the number of threads that kernels use."""
    return _settings["threads"]


class Background:
    """Pieces of work that are done one after the other beside the caller's, if there are threads for it."""

    def __init__(self) -> None:
        self._worker: ThreadPoolExecutor | None = None

    def begin(self, work: Callable[[], Result]) -> "Future[Result]":
        """Begin a piece of work after those before, and return what will have its result."""
        if self._worker is None and thread_count() > 1:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="rsmcm-background")
        if self._worker is not None:
            return self._worker.submit(work)
        done: Future[Result] = Future()
        done.set_result(work())
        return done


def over_bands(
    work: Callable[[int, int], None], n_rows: int, *, worth: bool = True, costs: NDArray[Any] | None = None
) -> None:
    """Call `work(first_row, end_row)` on consecutive bands that together cover `n_rows` rows.

    The bands have as many rows, or the same sum of `costs` `(n_rows,)`. Where all of it takes less than about
    0.2 ms, waking another thread is not `worth` it.
    """
    count = min(_settings["threads"], n_rows) if worth else 1
    if costs is None:
        edges = [n_rows * k // count for k in range(count + 1)]
    else:
        upto = np.cumsum(costs)
        edges = [0, *np.searchsorted(upto, upto[-1] * np.arange(1, count) / count).tolist(), n_rows]
    side_by_side([partial(work, first, end) for first, end in pairwise(edges) if first < end])


def side_by_side(works: Sequence[Callable[[], Result]]) -> list[Result]:
    """Return the results of independent pieces of work, in their order, on as many threads as are free.

    The caller's thread takes part, and does all of it where the others are busy, so that a piece of work may
    itself have some to share. What one raises is raised here, when those that have begun have ended.
    """
    count = min(_settings["threads"], len(works))
    if count <= 1:
        return [work() for work in works]
    if count not in _workers:
        _workers[count] = ThreadPoolExecutor(count - 1, thread_name_prefix="rsmcm-band")
    waiting = dict(enumerate(works))
    turns = itertools.count()  # taking the next one is a single step, whichever thread does it
    results: dict[int, Result] = {}

    def take() -> None:
        while work := waiting.pop(turn := next(turns), None):
            results[turn] = work()

    helpers = [_workers[count].submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
        waiting.clear()  # helpers that were not needed keep nothing alive
    for helper in begun:
        helper.result()
    return [results[turn] for turn in range(len(works))]
