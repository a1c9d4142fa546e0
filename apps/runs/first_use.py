"""Loops are compiled when they are called first; a second process does so from the other end of a list.

Both find what the other one has done where numba keeps compiled loops. The list, `kernels.json`, has for each
application the loops that a usual run calls, with types of arguments, in the order of their first calls. It
only saves time: what is not on it is compiled when it is called, and what is on it in vain is passed over.

`python -m rsmcm.apps.runs.first_use APPLICATION` is the second process. With `--list ARGUMENTS` it runs the
command with these arguments, and lists the loops that it compiles. The list wants to be made again when loops
have changed much.
"""

import json
import os
import re
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from ...models.files import write_text
from ...models.numerics.threads import thread_count

types: Any = numba.types  # most of which say nothing to type checkers

COMPILES = "numba:compile"
"""Numba's event: something that it does not keep yet is compiled."""

SAID = "compiling loops for this machine, which happens once"

LIST = Path(__file__).parent / "kernels.json"

RECORDS = ("chains.objects.blob_records:RECORD", "models.pixels.layers:LAYER")
"""Types of records, of which loops are given arrays."""

PACKAGE = "rsmcm."
COMMAND = f"{PACKAGE}apps.command_line"
ARRAY = re.compile(r"(readonly )?array\((\w+), (\d+)d, ([CFA])\)")

Plain = str | dict[str, Any]
"""A type as JSON."""


class _Listener(event.Listener):
    """Does something when the compilation of a loop begins, and when it ends."""

    def on_start(self, event: Any) -> None:
        """Something begins to be compiled."""

    def on_end(self, event: Any) -> None:
        """It is compiled."""


@contextmanager
def compiling_ahead(application: str) -> Iterator[None]:
    """Help with what has to be compiled inside the block, if anything has."""
    helper = _Helper(application)
    try:
        with event.install_listener(COMPILES, helper):
            yield
    finally:
        helper.end()


class _Helper(_Listener):
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
                nothing = subprocess.DEVNULL
                self._process = subprocess.Popen(
                    [sys.executable, "-m", f"{PACKAGE}apps.runs.first_use", self._application],
                    stdin=nothing,
                    stdout=nothing,
                    stderr=nothing,
                )

    def end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


def compile_ahead(application: str) -> None:
    """Compile the loops of an application, the last one first, while the process lives that wants them."""
    parent = os.getppid()
    for loop in reversed(listed(application)):
        if os.getppid() != parent:
            return
        with suppress(Exception):  # the list may be old, and who calls a loop hears what is wrong with it
            compile_loop(*loop)


def listed(application: str) -> list[list[Any]]:
    """The loops of an application, each `module:name` without the package, and types of its arguments."""
    loops: list[list[Any]] = json.loads(LIST.read_text(encoding="utf-8")).get(application, [])
    return loops


def compile_loop(name: str, *arguments: Plain) -> None:
    """Compile a loop of the list, or load what is kept of it."""
    _named(name).compile(tuple(map(type_of, arguments)))


def plain(kind: Any) -> Plain:
    """A type of numba's as JSON; TypeError if it is none of arrays, numbers, literals and tuples."""
    if isinstance(kind, types.Literal):
        return {"literal": kind.literal_value}
    if isinstance(kind, types.Array) and isinstance(kind.dtype, types.Record):
        for name in RECORDS:
            if numba.from_dtype(_named(name)) == kind.dtype:
                return {"records": name, "axes": kind.ndim, "layout": kind.layout, "aligned": kind.aligned}
    if isinstance(kind, types.BaseTuple):
        made = getattr(kind, "instance_class", tuple)
        name = "" if made is tuple else f"{made.__module__}:{made.__qualname__}"
        return {"tuple": name, "of": [plain(each) for each in kind]}
    text = str(kind)
    if ARRAY.fullmatch(text) or isinstance(kind, types.Number | types.Boolean):
        return text
    raise TypeError(f"{text}: expected an array, a number, or a tuple of these")


def type_of(told: Plain) -> Any:
    """The type of which `plain` was told."""
    if isinstance(told, str):
        if (array := ARRAY.fullmatch(told)) is None:
            return getattr(types, told)
        readonly, element, n_axes, layout = array.groups()
        return types.Array(getattr(types, element), int(n_axes), layout, readonly=bool(readonly))
    if "literal" in told:
        return types.literal(told["literal"])
    if "records" in told:
        element = numba.from_dtype(_named(told["records"]))
        return types.Array(element, told["axes"], told["layout"], aligned=told["aligned"])
    parts = tuple(map(type_of, told["of"]))
    if not told["tuple"]:
        return types.Tuple(parts)
    module, _, name = told["tuple"].partition(":")
    made = getattr(import_module(module), name)
    alike = len(set(parts)) == 1
    return types.NamedUniTuple(parts[0], len(parts), made) if alike else types.NamedTuple(parts, made)


def _named(name: str) -> Any:
    """What is called `module:name`."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(f"{PACKAGE}{module}"), attribute)


class Compiled(_Listener):
    """Takes down what is compiled: `loops` as on the list, in the order in which they were done."""

    def __init__(self) -> None:
        self.loops: list[list[Any]] = []

    def on_end(self, event: Any) -> None:
        """It is compiled; what is no loop of ours comes with one."""
        function, arguments = event.data["dispatcher"].py_func, event.data["args"]
        if function.__module__.startswith(PACKAGE):
            with suppress(TypeError):  # of another function, say: it is compiled when it is called
                name = f"{function.__module__.removeprefix(PACKAGE)}:{function.__qualname__}"
                self.loops.append([name, *map(plain, arguments)])


def write_list(application: str, loops: Sequence[Sequence[Any]]) -> None:
    """Replace the loops of an application; each is a line of the file."""
    content = {**json.loads(LIST.read_text(encoding="utf-8")), application: loops}
    parts = [
        f"  {json.dumps(each)}: [\n" + ",\n".join(f"    {json.dumps(one)}" for one in content[each]) + "\n  ]"
        for each in sorted(content)
    ]
    write_text(LIST, "{\n" + ",\n".join(parts) + "\n}\n")


def main(arguments: Sequence[str]) -> int:
    """Compile ahead; or make the list, in a process without compiled loops."""
    if arguments[0] == "--list":
        with tempfile.TemporaryDirectory() as nothing:
            environment = {**os.environ, "NUMBA_CACHE_DIR": nothing}
            again = [sys.executable, "-m", f"{PACKAGE}apps.runs.first_use", "--run", *arguments[1:]]
            return subprocess.run(again, env=environment).returncode
    if arguments[0] == "--run":
        compiled = Compiled()
        with event.install_listener(COMPILES, compiled), suppress(SystemExit):
            sys.argv = [COMMAND, "--threads", "1", *arguments[1:]]
            runpy.run_module(COMMAND, run_name="__main__")
        write_list(arguments[1], compiled.loops)
        print(f"{len(compiled.loops)} loops of {arguments[1]}")
    else:
        compile_ahead(arguments[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
