"""Parameters of the background application's chains: by section and name, from a TOML file or defaults."""

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

from ...chains import AdaptiveBackground, BlobTracker, GroundPlane, MixtureBackground
from ...models.core.limits import MOST_SETTINGS
from ...models.core.text_files import read_text

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by section ("background", "blobs", "ground") and name."""

SECTIONS: dict[str, dict[str, type[Any]]] = {
    "background": {"gaussian": AdaptiveBackground, "mixture": MixtureBackground},
    "blobs": {"layers": BlobTracker},
    "ground": {"plane": GroundPlane},
}
"""Kinds of chain by section and by the value of its key `model`, the default first."""

NODES = ("name", "pixels")
"""Fields of chains that name nodes of the graph, which is the application's own."""


def read_parameters(path: Path) -> Parameters:
    """Read parameters from a TOML file with the sections of `SECTIONS`; what it leaves out keeps its default.

    Raises
    ------
    ValueError
        if it is no TOML, names a section or parameter that does not exist, or a value is of another type or
        out of range; in one line that says where.
    OSError
        if the file cannot be read.
    """
    text = read_text(path, "expected a TOML file of parameters", MOST_SETTINGS)
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"{path}: not a TOML file (brackets in brackets without end)") from None
    except ValueError as error:
        raise ValueError(f"{path}: not a TOML file ({error})") from None
    for section, values in content.items():
        if section not in SECTIONS or not isinstance(values, dict):
            raise ValueError(f"{path}: unknown key {section!r}, expected sections {_listed(SECTIONS)}")
        try:
            _check(section, values)
        except ValueError as error:
            raise ValueError(f"{path}, [{section}]: {error}") from None
    return content


def build_chain(section: str, parameters: Parameters) -> Any:
    """Make a section's chain: given parameters as they are, the others at their defaults."""
    values = dict(parameters.get(section, {}))
    kind = SECTIONS[section][_model(section, values)]
    values.pop("model", None)
    return kind(**values)


def with_defaults(parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Every parameter of every chain: given ones as they are, the others at their defaults."""
    complete = {}
    for section in SECTIONS:
        made = build_chain(section, parameters)
        values = {name: getattr(made, name) for name in _kinds(type(made))}
        complete[section] = {"model": _model(section, parameters.get(section, {})), **values}
    return complete


def _check(section: str, values: Mapping[str, Any]) -> None:
    kinds = {"model": str, **_kinds(SECTIONS[section][_model(section, values)])}
    for name, value in values.items():
        if name not in kinds:
            raise ValueError(f"unknown key {name!r}, expected {_listed(kinds)}")
        if not _is(value, kinds[name]):
            raise ValueError(f"{name} = {value!r}, expected {kinds[name].__name__}")
    build_chain(section, {section: values})


def _model(section: str, values: Mapping[str, Any]) -> str:
    """The value of a section's key `model`."""
    known = list(SECTIONS[section])
    model = values.get("model", known[0])
    if model not in known:
        raise ValueError(f"model = {model!r}, expected {', '.join(known)}")
    return str(model)


def _kinds(chain: type[Any]) -> dict[str, Any]:
    """Types of a chain's parameters; names of nodes in the graph are none of them."""
    hints = get_type_hints(chain)
    return {each.name: hints[each.name] for each in fields(chain) if each.init and each.name not in NODES}


def _is(value: object, kind: type[Any]) -> bool:
    """Whether a TOML value is of a kind; whole numbers are numbers, and true and false are neither."""
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is kind


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(names)
