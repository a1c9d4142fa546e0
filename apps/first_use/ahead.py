"""Loops are compiled when they are called first; a second process does so from the other end of the list.

`python -m rsmcm.apps.first_use.ahead APPLICATION` is that process. Both find what the other one has done
where numba keeps compiled loops.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core import event

from ...models.numerics.threads import thread_count
from .kernels import compile_loop, listed

COMPILES = "numba:compile"
"""Numba's event: something that it does not keep yet is compiled."""

SAID = "compiling loops for this machine, which happens once"


@contextmanager
def compiling_ahead(application: str) -> Iterator[None]:
    """Help with what has to be compiled inside the block, if anything has."""
    helper = _Helper(application)
    try:
        with event.install_listener(COMPILES, helper):
            yield
    finally:
        helper.end()


class _Helper(event.Listener):
    """Starts the second process when something is compiled, unless one thread is all there is."""

    def __init__(self, application: str) -> None:
        self._application = application
        self._process: subprocess.Popen[bytes] | None = None
        self._begun = False

    def on_start(self, event: Any) -> None:
        """Something begins to be compiled."""
        if self._begun:
            return
        self._begun = True
        if sys.stderr is not None and sys.stderr.isatty():
            print(f"{self._application}: {SAID}", file=sys.stderr)
        if thread_count() > 1:
            with suppress(OSError):  # then without help
                self._process = subprocess.Popen(
                    [sys.executable, "-m", __name__, self._application],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )

    def on_end(self, event: Any) -> None:
        """It is compiled."""

    def end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


def main(application: str) -> None:
    """Compile the loops of an application, the last one first, while the process lives that wants them."""
    parent = os.getppid()
    for loop in reversed(listed(application)):
        if os.getppid() != parent:
            return
        with suppress(Exception):  # the list may be old, and who calls a loop hears what is wrong with it
            compile_loop(*loop)


if __name__ == "__main__":
    main(*sys.argv[1:])
