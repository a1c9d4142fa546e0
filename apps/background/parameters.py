"""Parameters of the background application's chains: by section and name, from a TOML file or defaults."""

from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ...chains import (
    AdaptiveBackground,
    BlobTracker,
    CameraMotion,
    DetectorRates,
    GroundPlane,
    MixtureBackground,
)
from ..options.complaints import meant
from ..options.settings import make, plain_fields, read_fields, read_settings, top_level

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by section (those of `SECTIONS`) and name; below `OTHERS` by chain and name."""

SECTIONS: dict[str, dict[str, type[Any]]] = {
    "background": {"gaussian": AdaptiveBackground, "mixture": MixtureBackground},
    "blobs": {"layers": BlobTracker},
    "ground": {"plane": GroundPlane},
    "detector": {"rates": DetectorRates},
    "camera-motion": {"affine": CameraMotion},
}
"""Kinds of chain by section and by the value of its key `model`, the default first."""

OTHERS = "chains"
"""The section whose subsections hold parameters of chains of others."""

GROUP = "rsmcm.chains"
"""Entry points by which other distributions announce classes of chains."""


def read_parameters(path: Path | None, chosen: Iterable[str] = ()) -> Parameters:
    """Read the sections of a TOML file; what they leave out keeps its default.

    Sections are those of `SECTIONS`, and `[chains.NAME]` for chains of others. What stands outside of
    sections are options of the command line. The chains `chosen` are wanted, whether the file has parameters
    of them or not.

    Raises
    ------
    ValueError
        if it is no TOML, names a section, chain or parameter that does not exist, or a value is of another
        type or out of range; in one line that says where.
    """
    content = {} if path is None else read_settings(path)
    known = [*SECTIONS, OTHERS]
    sections: dict[str, Any] = {}
    for section, values in content.items():
        if section in top_level(content):
            continue
        if section not in known:
            raise ValueError(
                f"{path}: unknown key {section!r}, expected sections {', '.join(known)}"
                f"{meant(section, known)}"
            )
        if section == OTHERS:
            sections[OTHERS] = {
                name: read_fields(f"{path}, [{OTHERS}.{name}]", _other(name), given)
                for name, given in values.items()
            }
        else:
            where = f"{path}, [{section}]"
            kind = SECTIONS[section][_model(section, values, f"{where}: ")]
            sections[section] = read_fields(where, kind, values, {"model": str})
    for name in chosen:
        sections.setdefault(OTHERS, {}).setdefault(name, {})
    return sections


def build_chain(section: str, parameters: Parameters) -> Any:
    """Make a section's chain: given parameters as they are, the others at their defaults."""
    values = dict(parameters.get(section, {}))
    kind = SECTIONS[section][_model(section, values)]
    values.pop("model", None)
    return make(kind, values)


def other_chains(parameters: Parameters) -> dict[str, Any]:
    """Make the chains of others, by the names under which they are announced.

    It is a ValueError if there is no such chain, it cannot be loaded, or a parameter is out of range.
    """
    made = {}
    for name, values in parameters.get(OTHERS, {}).items():
        kind = _other(name)
        try:
            made[name] = make(kind, values)
        except ValueError as error:
            raise ValueError(f"chain {name}: {error}") from None
    return made


def with_defaults(parameters: Parameters) -> dict[str, Any]:
    """Every parameter of every chain: given ones as they are, the others at their defaults."""
    complete: dict[str, Any] = {}
    for section in SECTIONS:
        made = build_chain(section, parameters)
        complete[section] = {"model": _model(section, parameters.get(section, {})), **plain_fields(made)}
    others = {name: plain_fields(made) for name, made in other_chains(parameters).items()}
    return {**complete, OTHERS: others} if others else complete


def _other(name: str) -> type[Any]:
    """The class of a chain that another distribution has announced, which is a dataclass."""
    announced = {point.name: point for point in entry_points(group=GROUP)}
    if name not in announced:
        there = f"expected {', '.join(announced)}" if announced else "expected one that is installed; none is"
        raise ValueError(f"--chain: got {name!r}, {there}{meant(name, announced)}")
    try:
        chain: type[Any] = announced[name].load()
    except (ImportError, AttributeError) as error:
        raise ValueError(f"chain {name}: {announced[name].value} cannot be loaded: {error}") from None
    if not (isinstance(chain, type) and is_dataclass(chain)):
        raise ValueError(f"chain {name}: {announced[name].value} is no dataclass, expected a chain's class")
    return chain


def _model(section: str, values: Mapping[str, Any], where: str = "") -> str:
    """The value of a section's key `model`."""
    known = list(SECTIONS[section])
    model = values.get("model", known[0])
    if model not in known:
        raise ValueError(f"{where}model = {model!r}, expected {', '.join(known)}")
    return str(model)
