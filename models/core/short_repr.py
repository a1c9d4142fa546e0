"""Helpers of dataclasses: `repr` of one line, tables for notebooks, rows, pickles of fields only.

Arrays are shown by dtype and shape, collections by their length, parameters where they were set.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from html import escape
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind", bound=type)

WHOLE = 200  # characters of a `repr` from which no further field is shown
FIELD = 60  # characters that a field may have
SMALL = 4  # numbers in an array that are shown


def short_repr(kind: Kind) -> Kind:
    """Give a class a `repr` of one line, without the fields that have their defaults.

    It goes over `@dataclass`. Of a class that is none, all public attributes count as fields.
    """
    kind.__repr__ = _summary  # type: ignore[method-assign, assignment]
    return kind


def html_table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table for a notebook (`_repr_html_`), whose cells are shown in a few characters, escaped."""

    def line(kind: str, cells: Iterable[str]) -> str:
        return f"<tr>{''.join(f'<{kind}>{escape(cell)}</{kind}>' for cell in cells)}</tr>"

    lines = [line("th", header), *(line("td", map(_cell, row)) for row in rows)]
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"


def _cell(value: object) -> str:
    return value if isinstance(value, str) else repr(value) if is_dataclass(value) else brief(value)


def brief(value: object) -> str:
    """Return a few characters for one value."""
    match value:
        case np.ndarray():
            if value.size <= SMALL:
                return " ".join(np.array2string(value, precision=4, separator=", ").split())
            return f"{value.dtype} {value.shape}"
        case np.floating() | float():
            return f"{value:.6g}"
        case type():
            return value.__name__
        case str():
            text = repr(value)
        case Mapping():
            text = "{" + ", ".join(f"{key}: {brief(member)}" for key, member in value.items()) + "}"
            if len(text) > FIELD:
                text = "{" + ", ".join(map(str, value)) + "}"
        case tuple() if hasattr(value, "_fields"):  # a named tuple
            return _name(value)
        case tuple() if len(value) <= SMALL and _flat(value):
            text = f"({', '.join(map(brief, value))}{',' * (len(value) == 1)})"
        case Collection() if len(value) > SMALL or not _flat(value):
            kinds = {type(member).__name__ for member in value}
            text = f"[{len(value)} {kinds.pop() if len(kinds) == 1 else 'values'}]"
        case _:
            text = _name(value) if is_dataclass(value) else repr(value)
    return text if len(text) <= FIELD and "\n" not in text else _name(value)


def _summary(value: object) -> str:
    shown: list[str] = []
    for name, member in _set(value):
        if sum(map(len, shown)) > WHOLE - FIELD:
            shown.append("...")
            break
        shown.append(f"{name}={brief(member)}")
    return f"{type(value).__name__}({', '.join(shown)})"


def _set(value: object) -> Iterator[tuple[str, object]]:
    """Fields and their values, but for those that have their defaults."""
    if not is_dataclass(value):
        yield from ((name, member) for name, member in vars(value).items() if not name.startswith("_"))
        return
    for field in fields(value):
        member = getattr(value, field.name)
        if field.repr and not _is_default(field, member):
            yield field.name, member


def _is_default(field: Field[Any], member: object) -> bool:
    default: Any = field.default if field.default_factory is MISSING else field.default_factory()
    if isinstance(default, np.ndarray):
        return isinstance(member, np.ndarray) and np.array_equal(member, default)
    return member is default or (type(member) is type(default) and bool(member == default))


def _flat(members: Collection[object]) -> bool:
    return all(isinstance(member, int | float | str | np.number | None) for member in members)


def _name(value: object) -> str:
    return brief(value) if isinstance(value, np.ndarray) else f"{type(value).__name__}(...)"


class Rows:
    """A dataclass of arrays with one row for each item.

    Rows of what is checked are not checked again.
    """

    def only(self, kept: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Self:
        """Return the rows where `kept` is true, or at these places, in order."""
        return self.made(getattr(self, name)[kept] for name in self._names())

    def joined(self, others: Iterable[Self]) -> Self:
        """Return these rows followed by others."""
        every = (self, *others)
        return self.made(np.concatenate([getattr(each, name) for each in every]) for name in self._names())

    @classmethod
    def made(cls, arrays: Iterable[NDArray[Any]]) -> Self:
        """Return an object of these arrays, in the order of the fields, without checks."""
        whole = object.__new__(cls)
        vars(whole).update(zip(cls._names(), arrays, strict=True))
        return whole

    @classmethod
    @cache
    def _names(cls) -> tuple[str, ...]:
        return tuple(field.name for field in fields(cls))  # type: ignore[arg-type]


class PickledByFields:
    """A dataclass whose pickle holds its fields only, without cached properties."""

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
