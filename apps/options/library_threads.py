"""Threads of libraries: what they share out is so little that mostly they wait for each other."""

import os

OF_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
"""Of linear algebra, that read a variable `..._NUM_THREADS` when they are loaded."""

OF_OPENCV = "OPENCV_FOR_THREADS_NUM"
"""The same of OpenCV."""


def thread_limits(threads: int) -> dict[str, str]:
    """Variables by which libraries that are loaded from now on have so many threads; OpenCV has one."""
    return {**{f"{library}_NUM_THREADS": str(threads) for library in OF_LIBRARIES}, OF_OPENCV: "1"}


def have_one_thread() -> None:
    """Limit libraries that are not loaded yet to one thread each, but for what the user has set."""
    for name, value in thread_limits(1).items():
        os.environ.setdefault(name, value)
