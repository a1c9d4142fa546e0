"""Threads of the libraries of linear algebra: on busy cores they wait for each other most of the time."""

import os

OF_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
"""Whose threads are limited by a variable `..._NUM_THREADS` that they read when they are loaded."""


def thread_limits(threads: int) -> dict[str, str]:
    """Variables by which libraries that are loaded from now on have so many threads."""
    return {f"{library}_NUM_THREADS": str(threads) for library in OF_LIBRARIES}


def have_one_thread() -> None:
    """Limit libraries that are not loaded yet to one thread each, but for what the user has set."""
    for name, value in thread_limits(1).items():
        os.environ.setdefault(name, value)
