"""Parameters of the background application's chains: by section and name, from a TOML file or defaults."""

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

from ..chains import AdaptiveBackground, BlobTracker, GroundPlane

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by section ("background", "blobs", "ground") and name."""

SECTIONS: dict[str, type[Any]] = {
    "background": AdaptiveBackground,
    "blobs": BlobTracker,
    "ground": GroundPlane,
}


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
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a TOML file ({error})") from None
    for section, values in content.items():
        if section not in SECTIONS or not isinstance(values, dict):
            raise ValueError(f"{path}: unknown key {section!r}, expected sections {_listed(SECTIONS)}")
        kinds = _kinds(SECTIONS[section])
        for name, value in values.items():
            if name not in kinds:
                raise ValueError(f"{path}, [{section}]: unknown key {name!r}, expected {_listed(kinds)}")
            if not _is(value, kinds[name]):
                raise ValueError(f"{path}, [{section}]: {name} = {value!r}, expected {kinds[name].__name__}")
        try:
            SECTIONS[section](**values)
        except ValueError as error:
            raise ValueError(f"{path}, [{section}]: {error}") from None
    return content


def with_defaults(parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Every parameter of every chain: given ones as they are, the others at their defaults."""
    complete = {}
    for section, chain in SECTIONS.items():
        made = chain(**parameters.get(section, {}))
        complete[section] = {name: getattr(made, name) for name in _kinds(chain)}
    return complete


def _kinds(chain: type[Any]) -> dict[str, Any]:
    """Types of a chain's parameters; the name of the node in the graph is none of them."""
    hints = get_type_hints(chain)
    return {each.name: hints[each.name] for each in fields(chain) if each.init and each.name != "name"}


def _is(value: object, kind: type[Any]) -> bool:
    """Whether a TOML value is of a kind; whole numbers are numbers, and true and false are neither."""
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is kind


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(names)
