"""Records of experiments: figures beside their targets, where and when they were measured."""

import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import psutil

from ...models.numerics.threads import thread_count
from ..evaluation.text_tables import rounded
from ..io.files import write_json
from ..runs.session import versions

ROOT = Path(__file__).resolve().parents[2]  # where the packages lie: the checkout, or the installed package
TRACKING = ("models", "inference", "chains")  # packages on whose code measurements depend

NOT_BUSY = ("idle", "iowait", "guest", "guest_nice")
"""Times of processors that are none, or are counted as a user's already."""

DRAWS = 200  # how often seeds are drawn again; standard errors are then known to 5 %

HEADER = ("measure", "target", "measured", "±", "")


@dataclass(frozen=True)
class Expectation:
    """A measured number and its target."""

    what: str  # is measured, with its unit
    measured: float  # its value
    # relation, bound: the target; `None` if there is no target
    relation: Literal["<=", ">="] = "<="
    bound: float | None = None
    # NaN where there is but one seed. Of speeds, the seeds are rounds
    standard_error: float = math.nan
    seeds: int = 1
    # of speeds, between which half of the rounds lie; the value is their median
    quartiles: tuple[float, float] | None = None
    ratio: bool = False  # whether it stays the same on a machine that does everything twice as fast
    loaded: bool = False  # whether other processes ran meanwhile, so that a speed says little

    @property
    def verdict(self) -> str:
        """Return `"pass"`, `"missed"`, or nothing if there is no target; NaN is a miss."""
        if self.bound is None:
            return ""
        holds = self.measured <= self.bound if self.relation == "<=" else self.measured >= self.bound
        return "pass" if holds else "missed"

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """Measure, target, value, its standard error or quartiles, verdict."""
        target = "" if self.bound is None else f"{self.relation} {self.bound:g}"
        error = "" if math.isnan(self.standard_error) else rounded(self.standard_error, 2)
        if self.quartiles is not None:
            error = "–".join(map(rounded, self.quartiles))
        return self.what, target, rounded(self.measured), error, self.verdict


def over_seeds(
    judge: Callable[[Any], Sequence[Expectation]], measured: Mapping[Any, Any]
) -> list[Expectation]:
    """Judge all seeds; add the standard errors that come from the choice of seeds.

    Seeds are drawn again from those there are (the bootstrap of Efron, 1979), the same for all methods, so
    ratios of methods keep what they have in common. `judge` gives the expectations, always in the same order,
    of what was found: mappings, of mappings perhaps, of lists with a value a seed; lists of one value stay as
    they are.
    """
    n_seeds = max(map(len, _lists(measured)))
    judged = list(judge(measured))
    if n_seeds == 1:
        return judged
    random = np.random.default_rng(0)
    draws = [judge(_resampled(measured, random.integers(0, n_seeds, n_seeds).tolist())) for _ in range(DRAWS)]
    found_values = [[draw[place].measured for draw in draws] for place in range(len(judged))]
    finite = [[value for value in values if math.isfinite(value)] for values in found_values]
    return [
        replace(
            each, standard_error=float(np.std(values, ddof=1)) if len(values) > 1 else math.nan, seeds=n_seeds
        )
        for each, values in zip(judged, finite, strict=True)
    ]


def _lists(measured: Any) -> Iterable[Sequence[Any]]:
    return (
        [each for value in measured.values() for each in _lists(value)]
        if isinstance(measured, Mapping)
        else [measured]
    )


def _resampled(measured: Any, seeds: Sequence[int]) -> Any:
    if isinstance(measured, Mapping):
        return {name: _resampled(value, seeds) for name, value in measured.items()}
    return measured if len(measured) == 1 else [measured[seed] for seed in seeds]


@dataclass(frozen=True)
class Provenance:
    """Where, when and with what something was measured."""

    date: str  # when it began, ISO 8601 in UTC, to the second
    seconds: float  # how long it took
    commit: str  # of the checkout, ten hex digits; empty for an installed package
    changed: bool  # whether the checkout had changes that were not committed
    # processor, cores, memory: of the machine; memory in GB
    processor: str
    cores: int
    memory: float
    # mean number of processes that wanted to run in the minute before: speeds need a quiet machine
    load: float
    threads: int  # of our loops in this process
    versions: Mapping[str, str]  # of Python, this package and others, by name
    # mean number of cores that other processes kept busy meanwhile; NaN where that was not noted
    others: float = math.nan

    @property
    def machine(self) -> str:
        """In words."""
        return f"{self.processor}, {self.cores} cores, {self.memory:.0f} GB"


class Stopwatch:
    """Stopwatch that notes where and when it was made; `provenance` adds how long it took since."""

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
        """Return the provenance of what was measured since."""
        seconds = time.perf_counter() - self._started
        others = max(0.0, _busy_elsewhere() - self._busy) / seconds
        return Provenance(**self._known, seconds=seconds, others=others, threads=thread_count())


def _busy_elsewhere() -> float:
    """Core seconds that all other processes have used so far, and those that the machine's host has taken."""
    of_all, ours = psutil.cpu_times()._asdict(), os.times()
    busy = sum(seconds for name, seconds in of_all.items() if name not in NOT_BUSY)
    return float(busy - ours.user - ours.system - ours.children_user - ours.children_system)


def git(*arguments: str) -> str:
    """Return the output of git in the checkout; nothing for an installed package."""

    def output_of(*arguments: str) -> str:
        command = ["git", "-C", str(ROOT), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        output_of("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
        return output_of(*arguments)
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
    """Table of measurements: names of the columns, rows, and caption."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements of an experiment."""

    # name, title: of the experiment
    name: str
    title: str
    command: str  # that repeats it
    made: Provenance  # where, when and with what
    expectations: Sequence[Expectation]  # figures, beside their targets
    tables: Sequence[Table]  # everything that was measured

    @cached_property
    def by_what(self) -> dict[str, Expectation]:
        """Figures by what they are."""
        return {each.what: each for each in self.expectations}

    def write(self, path: Path) -> None:
        """Write the record as JSON.

        Raises
        ------
        OSError
            if the file cannot be written.
        """
        content = {field.name: getattr(self, field.name) for field in fields(self)}
        content["made"] = asdict(self.made)
        content["expectations"] = [{**asdict(each), "verdict": each.verdict} for each in self.expectations]
        content["tables"] = [asdict(each) for each in self.tables]
        write_json(path, content)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a record; NaN, which JSON does not know, is null there.

        Raises
        ------
        OSError
            if the file cannot be read.
        ValueError
            if it is no such record; one line that names the file.
        """
        try:
            content = json.loads(path.read_text())
            made = {"others": None, **content["made"]}
            return cls(
                content["name"],
                content["title"],
                content["command"],
                Provenance(**{**made, "others": _number(made["others"])}),
                [_expectation(each) for each in content["expectations"]],
                [Table(**each) for each in content["tables"]],
            )
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: no record of an experiment: {error!r}") from error


def _expectation(content: Mapping[str, Any]) -> Expectation:
    known = {"standard_error": None, **content}
    known.pop("verdict", None)
    if known.get("quartiles") is not None:
        known["quartiles"] = tuple(known["quartiles"])
    return Expectation(**{**known, **{name: _number(known[name]) for name in ("measured", "standard_error")}})


def _number(value: float | None) -> float:
    return math.nan if value is None else value
