"""TOML files of settings: options of the command at the top, parameters of chains in sections."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from cyclopts import App, Argument, ArgumentCollection
from cyclopts.config import Dict

from ...models.files import MOST_SETTINGS, read_text
from .complaints import EXPECTED, meant

T = TypeVar("T")

OPTION = "--config"
"""Which names the file on the command line."""

ALWAYS_TYPED = "Batch options"
"""The group of the options that are about many runs, which stand in no file of one."""

SCALARS = (bool, int, float, str)

RENAMED = {
    "BlobTracker.smallest": "min_area",
    "BlobTracker.spread": "colour_variance",
    "BlobTracker.temper": "likelihood_power",
    "BlobTracker.first_speed": "initial_velocity_std",
    "BlobTracker.patience": "max_coast_time",
    "BlobTracker.hidden_patience": "max_hidden_time",
    "BlobTracker.confirmed_time": "confirmation_time",
    "BlobTracker.ghost_evidence": "ghost_threshold",
    "BlobTracker.parting_time": "split_time",
    "GroundPlane.spread": "height_std",
    "GroundPlane.foot_spread": "foot_std",
    "GroundPlane.first_speed": "initial_velocity_std",
    "GroundPlane.patience": "max_coast_time",
    "DetectorRates.found": "detection_probability",
}
"""Present names of renamed parameters (`Class.old`) and of renamed options (`old`)."""


def read_settings(path: Path) -> dict[str, Any]:
    """Read a TOML file; ValueError, naming the file, if it is none."""
    text = read_text(path, "expected a TOML file of parameters", MOST_SETTINGS)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"{path}: not a TOML file (brackets in brackets without end)") from None
    except ValueError as error:
        raise ValueError(f"{path}: not a TOML file ({error})") from None


def options_from_file(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Take options that were not typed from the file that was, as `cyclopts.App.config` has it.

    An option that there is not is a ValueError; values are judged like those that are typed.
    """
    path = next((each.tokens[0].value for each in arguments if OPTION in each.names and each.tokens), "")
    if path:
        options = top_level(read_settings(Path(path)))
        names = {name for each in arguments if not _always_typed(each) for name in each.names} - {OPTION}
        known = [name.removeprefix("--").replace("-", "_") for name in names]
        for key in options:  # cyclopts would pass over those of every command
            if key.replace("-", "_") not in known:
                new = RENAMED.get(key.replace("-", "_"))
                expected = f", it is {new} now" if new in known else meant(key, known)
                expected = expected or ", expected an option of the command, or a section"
                raise ValueError(f"{path}: unknown key {key!r}{expected}")
        several = {name for each in arguments if each.token_count()[1] for name in each.names}
        for key, value in options.items():  # old versions of cyclopts take a list for any option
            if isinstance(value, list) and f"--{key.replace('_', '-')}" not in several:
                options[key] = str(value)
        Dict(options, source=path, use_commands_as_keys=False)(app, commands, arguments)


def _always_typed(argument: Argument) -> bool:
    groups = argument.parameter.group
    return isinstance(groups, tuple) and any(getattr(group, "name", "") == ALWAYS_TYPED for group in groups)


def top_level(settings: Mapping[str, Any]) -> dict[str, Any]:
    """What stands outside of sections."""
    return {name: value for name, value in settings.items() if not isinstance(value, dict)}


def make(kind: type[T], values: Mapping[str, Any]) -> T:
    """A dataclass with these values; fields that are left out are at their defaults.

    It is a ValueError if one has no default, or a value is out of range.
    """
    try:
        signature(kind).bind(**values)
    except TypeError as error:
        raise ValueError(str(error)) from None
    return kind(**values)


def read_fields(
    where: str, kind: type[Any], values: object, also: Mapping[str, type[Any]] | None = None
) -> dict[str, Any]:
    """Read the values of a section as the fields of a dataclass; the keys `also` are none of them.

    A ValueError begins with `where`: there is no such field, or a value is of another type or out of range.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{where}: got {values!r}, expected a section")
    kinds = {**(also or {}), **_kinds(kind)}
    found = {}
    for name, value in values.items():
        if name not in kinds:
            if new := RENAMED.get(f"{kind.__name__}.{name}"):
                raise ValueError(f"{where}: unknown key {name!r}, it is {new} now")
            raise ValueError(
                f"{where}: unknown key {name!r}, expected {', '.join(kinds)}{meant(name, kinds)}"
            )
        try:
            found[name] = _read(value, kinds[name])
        except TypeError:
            expected = EXPECTED.get(kinds[name], kinds[name])
            raise ValueError(f"{where}: {name} = {value!r}, expected {expected}") from None
    try:
        make(kind, {name: value for name, value in found.items() if name not in (also or {})})
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return found


def plain_fields(made: Any) -> dict[str, Any]:
    """Those fields of a dataclass that a file can say, as JSON gives them back."""
    values: dict[str, Any] = json.loads(
        json.dumps({name: getattr(made, name) for name in _kinds(type(made))})
    )
    return values


def _kinds(kind: type[Any]) -> dict[str, Any]:
    """Types of the fields that a file can say; the name of a chain is the graph's."""
    hints = get_type_hints(kind)
    named = [each.name for each in fields(kind) if each.init and each.name != "name"]
    return {name: hints[name] for name in named if _readable(hints[name])}


def _readable(kind: Any) -> bool:
    """Whether a file can say a value of a kind."""
    parts = get_args(kind) if get_origin(kind) is tuple else ()
    return kind in SCALARS or (bool(parts) and all(part is Ellipsis or _readable(part) for part in parts))


def _read(value: Any, kind: Any) -> Any:
    """A TOML value of a kind, or TypeError; whole numbers are numbers, arrays are tuples."""
    if get_origin(kind) is tuple and isinstance(value, list):
        parts = get_args(kind)
        if parts[-1] is Ellipsis:
            parts = parts[:1] * len(value)
        if len(parts) == len(value):
            return tuple(map(_read, value, parts))
    elif type(value) is kind or (kind is float and type(value) is int):
        return value
    raise TypeError
