"""`python -m rsmcm.apps.first_use.record ARGUMENTS`: list the loops that a run of the command compiles.

The run should be of a usual film, since other forms of pictures and options need other loops. Whenever loops
have changed much, the list wants to be made again.
"""

import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from numba.core import event

from .ahead import COMPILES
from .kernels import PACKAGE, Kernel, named, plain, write_kernels

COMMAND = f"{PACKAGE}apps.command_line"


class Compiled(event.Listener):
    """Takes down what is compiled.

    Attributes
    ----------
    kernels
        in the order in which they were done.
    """

    def __init__(self) -> None:
        self.kernels: list[Kernel] = []

    def on_start(self, event: Any) -> None:
        """Something begins to be compiled."""

    def on_end(self, event: Any) -> None:
        """It is compiled; what is no loop of ours comes with one."""
        function, arguments = event.data["dispatcher"].py_func, event.data["args"]
        if function.__module__.startswith(PACKAGE):
            with suppress(TypeError):  # of another function, say: it is compiled when it is called
                [plain(each) for each in arguments]
                self.kernels.append((named(function), arguments))


def main(arguments: Sequence[str]) -> int:
    """Run the command in a process without compiled loops, and list those that it has compiled."""
    if arguments[:1] != ["--"]:
        with tempfile.TemporaryDirectory() as nothing:
            environment = {**os.environ, "NUMBA_CACHE_DIR": nothing}
            again = [sys.executable, "-m", __spec__.name, "--", *arguments]
            return subprocess.run(again, env=environment).returncode
    compiled = Compiled()
    with event.install_listener(COMPILES, compiled), suppress(SystemExit):
        sys.argv = [COMMAND, "--threads", "1", *arguments[1:]]
        runpy.run_module(COMMAND, run_name="__main__")
    write_kernels(arguments[1], compiled.kernels)
    print(f"{len(compiled.kernels)} loops of {arguments[1]}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
