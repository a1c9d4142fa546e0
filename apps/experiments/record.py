"""What an experiment measured, and where and when: records that are compared, kept and shown."""

import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import psutil

from ...models.numerics.threads import thread_count
from ..io.files import write_json
from ..runs.session import versions
from .expectations import Expectation

ROOT = Path(__file__).resolve().parents[2]
"""Where the packages lie: the checkout, or the installed package."""

TRACKING = ("models", "inference", "chains")
"""Packages on whose code measurements depend."""

NOT_BUSY = ("idle", "iowait", "guest", "guest_nice")
"""Times of processors that are none, or are counted as a user's already."""


@dataclass(frozen=True)
class Provenance:
    """Where, when and with what something was measured.

    Parameters
    ----------
    date
        when it began, ISO 8601 in UTC, to the second.
    seconds
        how long it took.
    commit
        of the checkout, ten hex digits; empty for an installed package.
    changed
        whether the checkout had changes that were not committed.
    processor, cores, memory
        of the machine; memory in GB.
    load
        mean number of processes that wanted to run in the minute before: speeds need a quiet machine.
    threads
        of our loops in this process.
    versions
        of Python, this package and others, by name.
    others
        mean number of cores that other processes kept busy meanwhile; NaN where that was not noted.
    """

    date: str
    seconds: float
    commit: str
    changed: bool
    processor: str
    cores: int
    memory: float
    load: float
    threads: int
    versions: Mapping[str, str]
    others: float = math.nan

    @property
    def machine(self) -> str:
        """In words."""
        return f"{self.processor}, {self.cores} cores, {self.memory:.0f} GB"


class Stopwatch:
    """Notes where and when it was made; `provenance` adds how long it took since."""

    def __init__(self) -> None:
        self._started, self._busy = time.perf_counter(), _busy_elsewhere()
        commit = git("rev-parse", "HEAD")[:10]
        self._known = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit,
            "changed": bool(commit and git("status", "--porcelain", "--", *TRACKING, "apps")),
            "processor": _processor(),
            "cores": os.cpu_count() or 1,
            "memory": psutil.virtual_memory().total / 2**30,
            "load": psutil.getloadavg()[0],
            "versions": versions(),
        }

    def provenance(self) -> Provenance:
        """Of what was measured since."""
        seconds = time.perf_counter() - self._started
        others = max(0.0, _busy_elsewhere() - self._busy) / seconds
        return Provenance(**self._known, seconds=seconds, others=others, threads=thread_count())


def _busy_elsewhere() -> float:
    """Core seconds that all other processes have used so far, and those that the machine's host has taken."""
    of_all, ours = psutil.cpu_times()._asdict(), os.times()
    busy = sum(seconds for name, seconds in of_all.items() if name not in NOT_BUSY)
    return float(busy - ours.user - ours.system - ours.children_user - ours.children_system)


def git(*arguments: str) -> str:
    """What git says of the checkout; nothing for a package that is installed."""

    def said(*arguments: str) -> str:
        command = ["git", "-C", str(ROOT), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        said("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
        return said(*arguments)
    except (OSError, subprocess.CalledProcessError):
        return ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


@dataclass(frozen=True, eq=False)
class Table:
    """What was measured: names of the columns, rows, and what is said above them."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Record:
    """What an experiment measured.

    Parameters
    ----------
    name, title
        of the experiment.
    command
        that repeats it.
    made
        where, when and with what.
    expectations
        figures, beside what is wanted of them.
    tables
        everything that was measured.
    """

    name: str
    title: str
    command: str
    made: Provenance
    expectations: Sequence[Expectation]
    tables: Sequence[Table]

    @cached_property
    def by_what(self) -> dict[str, Expectation]:
        """Figures by what they are."""
        return {each.what: each for each in self.expectations}

    def write(self, path: Path, runs: Any = None) -> None:
        """Write it as JSON, with every run's measures if they are given.

        Raises
        ------
        OSError
            if the file cannot be written.
        """
        content = {field.name: getattr(self, field.name) for field in fields(self)}
        content["made"] = asdict(self.made)
        content["expectations"] = [{**asdict(each), "verdict": each.verdict} for each in self.expectations]
        content["tables"] = [asdict(each) for each in self.tables]
        write_json(path, content if runs is None else {**content, "runs": runs})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what `write` has written, but for the runs.

        Raises
        ------
        OSError
            if the file cannot be read.
        ValueError
            if it is no such record; one line that names the file.
        """
        try:
            content = json.loads(path.read_text())
            return cls(
                content["name"],
                content["title"],
                content["command"],
                Provenance(**_with_numbers(content["made"], "others")),
                [_expectation(each) for each in content["expectations"]],
                [Table(**each) for each in content["tables"]],
            )
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: no record of an experiment: {error!r}") from error


def _expectation(content: Mapping[str, Any]) -> Expectation:
    known = {name: value for name, value in content.items() if name != "verdict"}
    if known.get("quartiles") is not None:
        known["quartiles"] = tuple(known["quartiles"])
    return Expectation(**_with_numbers(known, "measured", "spread"))


def _with_numbers(content: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """With NaN, which JSON does not know, in the place of nothing."""
    return {name: math.nan if name in names and value is None else value for name, value in content.items()}
