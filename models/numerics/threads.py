"""Bands of rows on several threads, for kernels that release the interpreter's lock."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import cv2

_settings = {"threads": min(2, os.cpu_count() or 1)}
_workers: dict[int, ThreadPoolExecutor] = {}


def _before_fork() -> None:
    """Have OpenCV end its threads: one that held a lock would leave it locked in the child for ever."""
    _settings["opencv"] = cv2.getNumThreads()
    cv2.setNumThreads(1)


def _after_fork() -> None:
    cv2.setNumThreads(_settings["opencv"])


def _after_fork_in_child() -> None:
    _workers.clear()  # it has none of its parent's threads
    _after_fork()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork_in_child)


def set_threads(count: int) -> None:
    """Use `count` threads in the kernels that work on bands of rows and in OpenCV; results do not change.

    With 1, all work stays in the caller's thread.

    Raises
    ------
    ValueError
        if `count` is below 1.
    """
    if count < 1:
        raise ValueError(f"threads: got {count}, expected 1 or more")
    _settings["threads"] = count
    cv2.setNumThreads(count)


def thread_count() -> int:
    """Give the number of threads that kernels use."""
    return _settings["threads"]


def over_bands(work: Callable[[int, int], None], n_rows: int) -> None:
    """Call `work(first_row, end_row)` on consecutive bands that together cover `n_rows` rows."""
    count = min(_settings["threads"], n_rows)
    if count == 1:
        work(0, n_rows)
        return
    if count not in _workers:
        _workers[count] = ThreadPoolExecutor(count - 1, thread_name_prefix="rsmcm-band")
    edges = [n_rows * k // count for k in range(count + 1)]
    waiting = [_workers[count].submit(work, edges[k], edges[k + 1]) for k in range(1, count)]
    work(edges[0], edges[1])
    for future in waiting:
        future.result()
