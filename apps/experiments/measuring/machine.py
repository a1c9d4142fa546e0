"""What this machine could do at best: how fast it moves bytes, and how fast it multiplies."""

import math
import time
from collections.abc import Callable
from functools import cache

import numpy as np

from ....models.numerics.threads import over_bands, set_threads, thread_count

LEAST = 1 << 12
"""Bytes; what is smaller is moved as fast as that."""

SIDE = 768
"""Of the matrices that are multiplied."""

DRAWN = 1 << 14
"""Numbers at a time."""

TRIES = 9
MOMENT = 2e-3
"""s that a try takes, at least."""


def moving(n_bytes: float, threads: int = 1) -> float:
    """Seconds in which so many bytes can be moved, half of them read and half of them written.

    They are those of a plain copy of arrays of that size, by one thread where more are no faster: what fits
    into a cache goes faster.
    """
    size = 1 << round(math.log2(max(n_bytes, LEAST)))  # few sizes are measured
    return n_bytes / max(_copied_per_second(size, count) for count in {1, threads})


def multiplying(n_operations: float) -> float:
    """Seconds in which one core does so many operations, as many as it does in a product of matrices.

    They are of single precision; a multiplication with an addition counts as two.
    """
    return n_operations / _operations_per_second()


def drawing(n_numbers: float) -> float:
    """Seconds in which one core draws so many normal numbers."""
    return n_numbers / _drawn_per_second()


def bandwidth(n_bytes: float, threads: int = 1) -> float:
    """Bytes a second that are moved where so many are."""
    return n_bytes / moving(n_bytes, threads)


def operations() -> float:
    """Operations a second of a core."""
    return 1 / multiplying(1.0)


@cache
def _copied_per_second(n_bytes: int, threads: int) -> float:
    source = np.ones(n_bytes // 2, np.uint8)
    target = np.empty_like(source)

    def copy(first: int, end: int) -> None:
        target[first:end] = source[first:end]

    before = thread_count()
    set_threads(threads)
    try:
        return n_bytes / _fastest(lambda: over_bands(copy, len(source)))
    finally:
        set_threads(before)


@cache
def _operations_per_second() -> float:
    matrix = np.ones((SIDE, SIDE), np.float32)
    result = np.empty_like(matrix)
    return 2 * SIDE**3 / _fastest(lambda: np.matmul(matrix, matrix, out=result))


@cache
def _drawn_per_second() -> float:
    random, numbers = np.random.default_rng(0), np.empty(DRAWN)
    return DRAWN / _fastest(lambda: random.standard_normal(out=numbers))


def _fastest(work: Callable[[], object]) -> float:
    """Seconds of a call: the least mean of several tries."""
    work()
    started = time.perf_counter()
    work()
    count = 1 + int(MOMENT / max(time.perf_counter() - started, 1e-7))
    seconds = []
    for _ in range(TRIES):
        started = time.perf_counter()
        for _ in range(count):
            work()
        seconds.append((time.perf_counter() - started) / count)
    return min(seconds)
