"""Options of a run: one dataclass for the command line, the TOML file and calls from Python.

The docstrings are the command line's help. Nothing here takes long to import.
"""

import glob
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar

from cyclopts import Group, Parameter

T = TypeVar("T")
Flag = Annotated[bool, Parameter(negative="")]
OfRuns = Annotated[T, Parameter(group=Group("Common options", sort_key=1))]


Bounds = Mapping[str, tuple[Callable[[Any], bool], str]]
"""By field: a test of the value, and the expected values in words."""

NAMES = {"learned": "from"}
"""Names of options that differ from their fields."""


@dataclass(frozen=True)
class Job:
    """Options of every run.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, the number of a camera, or an rtsp or http address.
    out
        Folder for the results.
    config
        TOML file with options by name. The command line has precedence.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Continue the run in the folder from its last saved state.
    overwrite
        Remove earlier results in the folder, and start again.
    reconnect
        Seconds for which a lost camera or stream is reconnected. The gap consists of missing frames.

    Raises
    ------
    ValueError
        if fields contradict each other, or results would be written into the source: its folder, or
        the folder of the pictures that a glob names.
    """

    source: str
    _: KW_ONLY
    out: Path
    config: OfRuns[Path | None] = None
    start: OfRuns[int] = 1
    stop: OfRuns[int | None] = None
    step: OfRuns[int] = 1
    resume: OfRuns[Flag] = False
    overwrite: OfRuns[Flag] = False
    reconnect: OfRuns[float | None] = None

    SETTINGS: ClassVar[Sequence[str]] = ()
    OF_RUNS: ClassVar[Sequence[str]] = ("start", "stop", "step")
    """Fields on which results depend: those of an application, and those of every run."""

    BOUNDS: ClassVar[Bounds] = {}
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (("--resume", "--overwrite"),)
    """Pairs of options, perhaps with one of their values, that are not given together, and perhaps why."""

    def __post_init__(self) -> None:
        for kind in reversed(type(self).__mro__):
            for name, (holds, expected) in vars(kind).get("BOUNDS", {}).items():
                value = getattr(self, name)
                if value is not None and not holds(value):
                    got = f"{value:g}" if isinstance(value, float) else value
                    option = NAMES.get(name, name).replace("_", "-")
                    raise ValueError(f"--{option}: got {got}, expected {expected}")
            for one, other, *why in vars(kind).get("EXCLUSIVE", ()):
                if self._given(one) and self._given(other):
                    reason = f" ({why[0]})" if why else ""
                    raise ValueError(f"{one} and {other}: got both, expected one of them{reason}")
        if any(self.out.resolve().is_relative_to(folder.resolve()) for folder in _folders_of(self.source)):
            wrong = "which is the source or lies in it, expected another folder"
            raise ValueError(f"--out: got {self.out}, {wrong}")

    def _given(self, option: str) -> bool:
        """Whether an option is given; of `--name value`, with this value."""
        name, _, value = option.removeprefix("--").partition(" ")
        field = next((field for field, other in NAMES.items() if other == name), name.replace("-", "_"))
        given = getattr(self, field)
        return given == value if value else given not in (None, False, ())

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source: a run is resumed only with the same."""
        return self.plain((*self.SETTINGS, *self.OF_RUNS))

    def plain(self, names: Sequence[str]) -> dict[str, Any]:
        """Fields of these names, paths in full as texts."""
        values = {NAMES.get(name, name): getattr(self, name) for name in names}
        return {
            name: str(value.resolve()) if isinstance(value, Path) else value for name, value in values.items()
        }


def _folders_of(source: str) -> set[Path]:
    """Folders of images that a source consists of; none for a video."""
    if os.path.isdir(source):
        return {Path(source)}
    if os.path.exists(source) or "://" in source or not glob.has_magic(source):
        return set()
    return {Path(each).parent for each in glob.glob(source, recursive=True)}


@dataclass(frozen=True, kw_only=True)
class FilmJob(Job):
    """Options of every run over a video.

    Parameters
    ----------
    every
        Number of frames between saved states.
    learned
        Start with what another run has learned: its state.npz. A recording is assumed to continue where that
        one ended.
    seed
        Seed of random numbers; recorded with the results.
    live
        Show the running command in a browser: PORT on this machine, or HOST:PORT, which everyone who can
        reach the host can see. 0 selects a free port.
    video
        Also write overlay.mp4, the video in full size with the results drawn in. (rsmcm export makes one from
        a finished run, at most 640 px wide or high.)
    """

    every: OfRuns[int] = 500
    learned: Annotated[Path | None, Parameter(name="--from", group="Common options")] = None
    seed: OfRuns[int] = 0
    live: OfRuns[str | None] = None
    video: OfRuns[Flag] = False

    OF_RUNS: ClassVar[Sequence[str]] = ("learned", "start", "stop", "step", "seed")
    BOUNDS: ClassVar[Bounds] = {
        "every": (lambda frames: frames >= 1, "1 or more frames"),
        "seed": (lambda seed: seed >= 0, "0 or more"),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.live is not None:
            read_address(self.live)


LOOPBACK = "127.0.0.1"
MOST = 65535


class Address(NamedTuple):
    """An interface of this machine, by its address or name, and a port, 0 for any that is free."""

    host: str
    port: int


def read_address(typed: str) -> Address:
    """Read `PORT`, of the loopback interface, or `HOST:PORT`, with an address of IPv6 in brackets.

    It is a ValueError if it is neither.
    """
    parts = re.fullmatch(r"(?:(\[[0-9a-fA-F:.]+\]|[\w.-]+):)?([0-9]{1,5})", typed, re.ASCII)
    if parts is None or int(parts[2]) > MOST:
        raise ValueError(f"--live: got {typed!r}, expected a port from 0 to {MOST}, or HOST:PORT")
    return Address((parts[1] or LOOPBACK).strip("[]"), int(parts[2]))
