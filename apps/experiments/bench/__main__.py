"""Speed beside peers: `make bench`, or `python -m rsmcm.apps.experiments.bench`.

    python -m rsmcm.apps.experiments.bench [--only PART,PART]
    python -m rsmcm.apps.experiments.bench --against docs/results/benchmarks.json

Every part runs in a process of its own, one after another. What all of them have left, now or earlier, is
joined in `results/bench/benchmarks.json`; a part that fails is a line there, and the others stay. The second
line measures nothing: it names the ratios that have become worse since another record.
"""

import argparse
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from ...evaluation.text_tables import rounded
from ...options.libraries import ONE_THREAD_EACH
from ..experiment import publish
from ..record import Expectation, Record, Stopwatch, Table

FOLDER = Path("results") / "bench"
RECORD = FOLDER / "benchmarks.json"

CURVES = "curves"  # the part that is a record of its own: there nothing is beside a peer

PARTS = {
    "background": "background:speeds",
    "large": "background:large",
    "command": "background:whole_command",
    "start": "background:start",
    "points": "points:points",
    "structure": "points:structure",
    "faces": "people:faces",
    "bodies": "people:bodies",
    "streams": "streams:streams",
    CURVES: "curves:curves",
}
"""Module and function of each."""

QUIET = 0.5  # cores that other processes may keep busy before speeds count as those of a loaded machine
SLACK = 0.25  # share by which a ratio may be worse than the worse quartile of the one before


def main(arguments: Sequence[str]) -> int:
    """Measure or compare; 1 if a part failed or a ratio has become worse, 2 for what cannot be done."""
    parser = argparse.ArgumentParser(prog="python -m rsmcm.apps.experiments.bench")
    parser.add_argument("--only", metavar="PARTS", help=f"some of {','.join(PARTS)}")
    parser.add_argument("--against", metavar="RECORD", type=Path, help="compare ratios, measure nothing")
    parser.add_argument("--here", metavar="PART", help=argparse.SUPPRESS)  # in this process
    given = parser.parse_args(arguments)
    if given.here:
        run_part(given.here)
        return 0
    chosen = given.only.split(",") if given.only else list(PARTS)
    unknown = [name for name in chosen if name not in PARTS]
    try:
        if unknown:
            raise ValueError(f"--only: got {','.join(unknown)}, expected some of {','.join(PARTS)}")
        if given.against:
            worse = regressions(Record.read(RECORD), Record.read(given.against))
            print("\n".join(worse) if worse else f"no ratio is worse than in {given.against}")
            return int(bool(worse))
        return _measured(chosen)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2


def folder_of(name: str) -> Path:
    """Return the folder of a part's record."""
    return Path("results") / name if name == CURVES else FOLDER / name


def run_part(name: str) -> None:
    """Measure a part in this process, print what was found, and leave its record."""
    module, function = PARTS[name].split(":")
    part = getattr(import_module(f".{module}", __package__), function)
    publish(name, f"python -m {__package__} --only {name}", folder_of(name), part)


def _measured(chosen: Sequence[str]) -> int:
    failed = 0
    for number, name in enumerate(chosen, start=1):
        print(f"\n--- {name}, {number} of {len(chosen)} ---\n", flush=True)
        command, watch = [sys.executable, "-m", str(__package__), "--here", name], Stopwatch()
        code = subprocess.run(command, env={**os.environ, **ONE_THREAD_EACH}).returncode
        if code:
            failed += 1
            folder_of(name).mkdir(parents=True, exist_ok=True)
            what = Expectation(f"part {name}: failed, exit code {code}", math.nan, "<=", 0)
            record = Record(name, name, " ".join(command[1:]), watch.provenance(), [what], [])
            record.write(folder_of(name) / "results.json")
    paths = [folder_of(name) / "results.json" for name in PARTS if name != CURVES]
    parts = [Record.read(path) for path in paths if path.exists()]
    if parts:
        joined(parts).write(RECORD)
        print(f"\nrecord: {RECORD}")
    return int(failed > 0)


def joined(parts: Sequence[Record]) -> Record:
    """Join several records; figures of a part that other processes disturbed are marked.

    It is as old as the oldest part.
    """
    all_made = [part.made for part in parts]
    seconds = sum(made.seconds for made in all_made)
    made = replace(
        min(all_made, key=lambda each: each.date),
        seconds=seconds,
        load=max(made.load for made in all_made),
        others=sum(made.others * made.seconds for made in all_made) / seconds,
        changed=any(made.changed for made in all_made),
    )
    expectations = [
        replace(each, loaded=bool(part.made.others > QUIET)) for part in parts for each in part.expectations
    ]
    rows = [
        (part.name, part.made.date, part.made.seconds, part.made.load, part.made.others) for part in parts
    ]
    header = ("part", "began", "seconds", "load before", "cores busy with others")
    caption = "The parts, each in a process of its own, and who else was at work."
    tables = [*(each for part in parts for each in part.tables), Table(header, rows, caption)]
    return Record("benchmarks", "Speed beside peers", "make bench", made, expectations, tables)


def regressions(new: Record, old: Record) -> list[str]:
    """Return a line for each ratio that is worse than before, and for each that is no longer measured.

    Only ratios of times that were measured together are compared, which do not depend on how fast a machine
    is, and only those of which something is wanted. Worse is what is beyond the worse quartile of before by
    more than `SLACK`; figures of a loaded machine are judged like all others, and are said to be so.
    """
    lines = []
    for before in old.expectations:
        if not (before.ratio and before.bound is not None):
            continue
        now = new.by_what.get(before.what)
        if now is None:
            lines.append(f"{before.what}: not measured any more, was {rounded(before.measured)}")
        elif _worse(now, before):
            loaded = ", on a loaded machine" if now.loaded else ""
            lines.append(
                f"{before.what}: {rounded(now.measured)}, was {rounded(before.measured)} "
                f"({'–'.join(map(rounded, before.quartiles or (before.measured,)))}){loaded}"
            )
    return lines


def _worse(now: Expectation, before: Expectation) -> bool:
    low, high = before.quartiles or (before.measured, before.measured)
    if not math.isfinite(now.measured):
        return math.isfinite(before.measured)
    if before.relation == "<=":
        return now.measured > high * (1 + SLACK)
    return now.measured < low / (1 + SLACK)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
