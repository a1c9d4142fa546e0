"""The list of loops that an application calls, with types of arguments, in the order of their first calls.

It only saves time: what is not on it is compiled when it is called, and what is on it in vain is passed over.
"""

import json
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numba

from ...models.files import write_text

types: Any = numba.types  # most of which say nothing to type checkers

LIST = Path(__file__).parent / "kernels.json"

RECORDS = ("chains.objects.kernels.records:RECORD", "models.pixels.kernels.layers:LAYER")
"""Types of records, of which loops are given arrays."""

PACKAGE = "rsmcm."
ARRAY = re.compile(r"(readonly )?array\((\w+), (\d+)d, ([CFA])\)")

Plain = str | dict[str, Any]
"""A type as JSON."""

Kernel = tuple[str, Sequence[Any]]
"""`module:name`, without the package, and types of the arguments."""


def listed(application: str, path: Path = LIST) -> list[list[Any]]:
    """The loops of an application, each a name and its arguments as JSON."""
    told: list[list[Any]] = json.loads(path.read_text(encoding="utf-8")).get(application, [])
    return told


def write_kernels(application: str, kernels: Sequence[Kernel], path: Path = LIST) -> None:
    """Replace those of an application; each is a line of the file."""
    told = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    told[application] = [[name, *map(plain, arguments)] for name, arguments in kernels]
    parts = [
        f"  {json.dumps(each)}: [\n" + ",\n".join(f"    {json.dumps(one)}" for one in told[each]) + "\n  ]"
        for each in sorted(told)
    ]
    write_text(path, "{\n" + ",\n".join(parts) + "\n}\n")


def plain(kind: Any) -> Plain:
    """A type of numba's as JSON.

    Raises
    ------
    TypeError
        if it is none of arrays, also of `RECORDS`, numbers, literals and tuples of these.
    """
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


def named(function: Any) -> str:
    """What a loop is called on the list."""
    return f"{function.__module__.removeprefix(PACKAGE)}:{function.__qualname__}"


def compile_loop(name: str, *arguments: Plain) -> None:
    """Compile a loop of the list, or load what is kept of it.

    Raises
    ------
    ImportError, AttributeError
        if it, or a type of its arguments, is not there any more.
    """
    _named(name).compile(tuple(map(type_of, arguments)))


def _named(name: str) -> Any:
    """What is called `module:name`."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(f"{PACKAGE}{module}"), attribute)
