"""Trees of dataclasses and arrays in one `.npz` file: never pickled, checked before it is written, atomic.

Arrays are members of their own, named by their place in the tree; the member `skeleton` is JSON with all the
rest, and `digest` the SHA-256 of both. Values are read by their declared kinds: dataclasses, `NamedTuple`s,
`NDArray`, `int`, `float`, `bool`, `str`, `None`, `X | None`, `tuple[X, ...]`, `tuple[X, Y]`, `list[X]`,
`dict[str, X]`, `dict[int, X]`, `numpy.random.Generator`, and `Any` or `object` for plain JSON, or an alias
of one of these. A field of a dataclass whose metadata say `{"saved": False}` is left out. A nested mapping
of names to kinds stands for a record without a class of its own, or `None` where it is not there yet.

Whoever changes a file can give it a new digest, and compiled loops trust what they index with. Therefore,
when a file is read, fields have to be as their annotations declare (`models.core.checks`), and arrays of
the declared type; names of sizes hold within a dataclass, those of a nested mapping in all that lies
below it. Where parts must fit each other, the dataclass has a method `require_fit`.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import singledispatch
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from ...models.array_files import read_arrays
from ...models.core.checks import Check, Sizes, check_of, shown
from ...models.files import write_atomically

FORMAT = "rsmcm state 3"
EXPECTED = "expected a state that was saved here"
SKELETON = "skeleton"
DIGEST = "digest"  # of everything else: loops compiled for speed trust the shapes and numbers of a state
SCALARS = (int, float, bool, str, NoneType)
LARGEST_WHOLE = 1 << 53  # beyond it a float does not tell whole numbers apart
GENERATORS = {
    "PCG64": np.random.PCG64,
    "PCG64DXSM": np.random.PCG64DXSM,
    "MT19937": np.random.MT19937,
    "Philox": np.random.Philox,
    "SFC64": np.random.SFC64,
}

Arrays = dict[str, NDArray[Any]]


def save(path: str | Path, values: Mapping[str, Any], kinds: Mapping[str, Any]) -> None:
    """Write `values`, which are of the given `kinds`; an older file stays if that fails (`OSError`).

    A `ValueError` or `TypeError` says if a value is not of its kind, so that it could not be read back.
    """
    arrays: Arrays = {}
    skeleton = json.dumps({"format": FORMAT, "values": _encode(values, arrays, "")})
    _restore(json.loads(skeleton)["values"], kinds, arrays, None)
    whole = {SKELETON: np.array(skeleton), **arrays}
    with write_atomically(Path(path)) as unfinished, unfinished.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **whole, **{DIGEST: np.array(_digest(whole))})
        stream.flush()
        os.fsync(stream.fileno())  # a power cut right after the new name leaves no empty file


@dataclass(frozen=True, eq=False)
class Contents:
    """Content of a file, checked: `values` are JSON that refers to the `arrays`."""

    path: Path
    values: dict[str, Any]
    arrays: Arrays

    def plain(self, name: str) -> Any:
        """Return a value that is plain JSON, whatever the others are; `None` if there is none."""
        return self.values.get(name)


def read(path: str | Path) -> Contents:
    """Read what `save` wrote, without its kinds; errors are those of `load`."""
    path = Path(path)
    size = path.stat().st_size  # nothing is packed, so that a number takes a byte or more
    arrays = read_arrays(path, EXPECTED, most=size)
    try:
        digest = str(arrays.pop(DIGEST, ""))
        actual = _digest(arrays)
        content = json.loads(str(arrays.pop(SKELETON)))
        form, values = content["format"], dict(content["values"])
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(f"{path}: got other arrays than a state's, {EXPECTED}") from None
    if form != FORMAT:
        raise ValueError(f"{path}: got format {str(form)[:60]!r}, expected {FORMAT!r}")
    if actual != digest:
        raise ValueError(f"{path}: got a state that was changed since it was saved, {EXPECTED}")
    return Contents(path, values, arrays)


def load(file: str | Path | Contents, kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Read the values that `save` wrote with the same `kinds`.

    A `ValueError` in one line names the file if it is broken, of another format, or holds other things; an
    `OSError` says if it cannot be opened.
    """
    contents = file if isinstance(file, Contents) else read(file)
    try:
        return _restore(contents.values, kinds, contents.arrays, {})
    except ValueError as error:
        raise ValueError(f"{contents.path}: {error}") from error


@singledispatch
def parameters_of(value: Any) -> Any:
    """Return the parameters of a chain or feature node as plain JSON; arrays by digest, functions by name."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, SCALARS):
        return value
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {_digest({'': value})[:8]}"
    if is_dataclass(value) and not isinstance(value, type):
        own = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        value = {"class": type(value).__name__, **own}
    if isinstance(value, Mapping):
        return {str(key): parameters_of(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [parameters_of(item) for item in value]
    return getattr(value, "__qualname__", type(value).__name__)


def require_same(where: object, saved: Any, own: Any, name: str = "") -> None:
    """Raise a `ValueError` that names the first parameter which a saved state and a model do not share."""
    if saved == own:
        return
    got, expected = shown(saved), shown(own)
    if isinstance(saved, dict) and isinstance(own, dict):
        for key in own if saved.keys() == own.keys() else ():
            require_same(where, saved[key], own[key], f"{name}.{key}" if name else key)
        got, expected = (", ".join(sorted(each)) for each in (saved, own))
    raise ValueError(f"{where}: {name or 'model'}: got {got}, expected {expected} as in the model")


def _digest(arrays: Arrays) -> str:
    """SHA-256 of names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def _encode(value: Any, arrays: Arrays, place: str) -> Any:
    """JSON for a value, whose arrays go to `arrays`."""
    if isinstance(value, np.ndarray | np.generic):
        # A numpy scalar stays one: a Python number would promote differently in the resumed run.
        if value.dtype.hasobject:
            raise TypeError(f"{place}: got an array of Python objects, expected numbers")
        arrays[place] = np.asarray(value)
        return {"array": place}
    if isinstance(value, np.random.Generator):
        return _encode(value.bit_generator.state, arrays, place)
    if is_dataclass(value):
        value = {name: getattr(value, name) for name in _saved_fields(value)}
    if isinstance(value, Mapping):
        return {key: _encode(item, arrays, _below(place, key)) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_encode(item, arrays, _below(place, index)) for index, item in enumerate(value)]
    return value


def _restore(data: Any, kinds: Mapping[str, Any], arrays: Arrays, sizes: Sizes | None) -> dict[str, Any]:
    """Decode everything; nothing may be left over. Without `sizes`, what is declared is not checked."""
    unread = dict(arrays)
    values: dict[str, Any] = _decode(data, kinds, unread, "", sizes)
    if unread:
        raise ValueError(f"{next(iter(unread))}: got an array, expected plain JSON")
    return values


def _decode(data: Any, kind: Any, arrays: Arrays, place: str, sizes: Sizes | None) -> Any:
    """The value of a kind from its JSON and from `arrays`, which lose those that are used; see `SizesOf`."""
    kind = _without_aliases(kind)
    if get_origin(kind) is Annotated:
        kind = _without_aliases(get_args(kind)[0])
    origin, inner = get_origin(kind) or kind, get_args(kind)
    is_array = isinstance(data, dict) and isinstance(data.get("array"), str) and data["array"] in arrays
    if origin in (Any, object):
        return data
    if origin in (Union, UnionType) and len(inner) == 2 and NoneType in inner:
        (present,) = (part for part in inner if part is not NoneType)
        return None if data is None else _decode(data, present, arrays, place, sizes)
    if origin is np.ndarray and is_array:
        return _of_type(arrays.pop(data["array"]), inner, place)
    if origin in SCALARS and is_array and arrays[data["array"]].ndim == 0:
        if _is_of(origin, arrays[data["array"]].item()):
            return arrays.pop(data["array"])[()]
    elif origin in SCALARS and _is_of(origin, data):
        return data
    if (
        origin is np.random.Generator
        and isinstance(data, dict)
        and str(data.get("bit_generator")) in GENERATORS
    ):
        bits = GENERATORS[str(data["bit_generator"])](0)
        state = _decode(data, _kind_of(bits.state), arrays, place, sizes)
        try:
            bits.state = state
        except (OverflowError, TypeError, ValueError, LookupError) as error:
            raise ValueError(f"{place}: {error}") from None
        return np.random.Generator(bits)
    if origin is dict and inner[0] in (str, int) and isinstance(data, dict):
        key_kind, item_kind = inner
        return {
            key_kind(key): _decode(item, item_kind, arrays, _below(place, key), sizes)
            for key, item in data.items()
        }
    if origin in (tuple, list) and isinstance(data, list):
        parts = [inner[0]] * len(data) if origin is list or inner[-1] is Ellipsis else list(inner)
        if len(parts) == len(data):
            pairs = zip(data, parts, strict=True)
            return origin(
                _decode(item, part, arrays, _below(place, n), sizes) for n, (item, part) in enumerate(pairs)
            )
    if isinstance(origin, type) and issubclass(origin, tuple) and hasattr(origin, "_fields"):
        hints = get_type_hints(origin, include_extras=True)
        values = _decode(data, GenericAlias(tuple, tuple(hints.values())), arrays, place, sizes)
        inside = None if sizes is None else dict(sizes)
        for value, (name, hint) in zip(values, hints.items(), strict=True):
            _check(check_of(hint), value, _below(place, name), inside)
        return origin(*values)
    if isinstance(kind, Mapping) and data is None:
        return None
    if isinstance(kind, Mapping) or is_dataclass(origin):
        return _decode_record(data, kind, arrays, place, sizes)
    raise ValueError(f"{place}: got {str(data)[:40]!r}, expected {_spelled(kind)}")


def _is_of(kind: type, value: object) -> bool:
    """Whether a value is of a type, or a whole number that a `float` can be."""
    return type(value) is kind or (kind is float and type(value) is int and abs(value) <= LARGEST_WHOLE)


def _decode_record(data: Any, kind: Any, arrays: Arrays, place: str, sizes: Sizes | None) -> Any:
    if isinstance(kind, Mapping):
        record, build, inside = kind, dict, sizes
    else:
        hints = get_type_hints(kind, include_extras=True)
        record = {name: hints[name] for name in _saved_fields(kind)}
        build, inside = kind, None if sizes is None else dict(sizes)
    content = data if isinstance(data, dict) else {}
    if content.keys() != record.keys():
        got, expected = (", ".join(names) or "nothing" for names in (content, record))
        raise ValueError(f"{place or 'file'}: got {got}, expected {expected}")
    values = {}
    for name, part in record.items():
        below = _below(place, name)
        values[name] = value = _decode(content[name], part, arrays, below, sizes)
        if not isinstance(part, Mapping) and part is not float:  # which may be infinite
            _check(check_of(part), value, below, inside)
    made = build(**values)
    if sizes is not None and hasattr(made, "require_fit"):
        try:
            made.require_fit()
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from None
    return made


def _of_type(array: NDArray[Any], inner: tuple[Any, ...], place: str) -> NDArray[Any]:
    """The array as loops are compiled for, if it is of the type that `NDArray[type]` declares."""
    declared = (*(get_args(inner[-1]) if inner else ()), Any)[0]
    if declared is Any or not isinstance(declared, type):
        return array
    array = array.astype(array.dtype.newbyteorder("="), order="C", copy=False)
    if issubclass(array.dtype.type, declared):
        return array
    if declared is np.float64 and array.dtype.kind in "iuf":  # as users may give points
        return array if array.dtype.kind == "f" else array.astype(np.float64)
    raise ValueError(f"{place}: got an array of {array.dtype}, expected {declared.__name__}")


def _check(check: Check, value: Any, place: str, sizes: Sizes | None) -> None:
    try:
        if sizes is not None:
            check(value, place, sizes)
    except TypeError as error:
        raise ValueError(str(error)) from None


def _saved_fields(kind: Any) -> list[str]:
    """Names of a dataclass's fields that are saved."""
    return [field.name for field in fields(kind) if field.init and field.metadata.get("saved", True)]


def _without_aliases(kind: Any) -> Any:
    """What an alias made by a `type` statement stands for (numpy's `NDArray` is one since 2.5)."""
    while hasattr(kind, "__value__"):
        given = dict(zip(kind.__type_params__, get_args(kind), strict=False))
        kind = kind.__value__
        if given:
            kind = kind[tuple(given[parameter] for parameter in kind.__parameters__)]
    return kind


def _kind_of(value: Any) -> Any:
    """Kind of a bit generator's state: nested dictionaries of numbers and, for some, arrays."""
    return {name: _kind_of(part) for name, part in value.items()} if isinstance(value, dict) else type(value)


def _below(place: str, key: object) -> str:
    """Name of a part, without characters that a zip member's name cannot have."""
    name = quote(str(key), safe="")
    return f"{place}/{name}" if place else name


def _spelled(kind: Any) -> str:
    return str(getattr(kind, "__name__", kind)) if not get_args(kind) else str(kind)
