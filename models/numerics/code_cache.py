"""Compiled code on disk, made once for all processes.

What a loop is compiled to may depend on which of the loops that it calls were on disk by then: sums are
ordered in another way, so that two processes which compile the same one may have results that differ in the
last digits. Here the first one compiles, and those who come meanwhile wait for what it leaves.
"""

import os
import time
from contextlib import suppress
from typing import Any

from numba.core.caching import FunctionCache

try:
    import fcntl
except ImportError:  # on Windows every process compiles for itself
    fcntl = None  # type: ignore[assignment]

PATIENCE = 120.0
"""s for which another process is waited for; one that has failed to compile keeps its lock until it ends."""

POLL = 0.05
"""s between two looks."""


class CodeCache(FunctionCache):
    """numba's cache of a function, of which one process at a time fills in what is missing.

    Parameters
    ----------
    function
        in Python.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._lock: int | None = None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """What is kept for these types; where nothing is, the caller compiles it and nobody else does."""
        found = super().load_overload(signature, context)  # type: ignore[no-untyped-call]
        if found is None and self._lock is None and fcntl is not None:
            self._wait()
            found = super().load_overload(signature, context)  # type: ignore[no-untyped-call]
            if found is not None:
                self._release()
        return found

    def save_overload(self, signature: Any, made: Any) -> None:
        """Keep what was compiled."""
        try:
            super().save_overload(signature, made)  # type: ignore[no-untyped-call]
        finally:
            self._release()

    def _wait(self) -> None:
        """Take the lock; where it cannot be had, go on without."""
        with suppress(OSError):
            self._impl.locator.ensure_cache_path()
            path = os.path.join(self.cache_path, f"{self._impl.filename_base}.lock")
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            started = time.monotonic()
            while time.monotonic() - started < PATIENCE:
                with suppress(BlockingIOError):
                    fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                time.sleep(POLL)

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
