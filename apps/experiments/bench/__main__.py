"""Speed beside peers: `make bench`, or `python -m rsmcm.apps.experiments.bench`.

    python -m rsmcm.apps.experiments.bench [--only PART,PART] [--long]
    python -m rsmcm.apps.experiments.bench --against docs/results/benchmarks.json

Every part runs in a process of its own, one after another. What all of them have left, now or earlier, is
joined in `results/bench/benchmarks.json`; a part that fails is a line there, and the others stay. The second
line measures nothing: it names the ratios that have become worse since another record.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ...options.libraries import thread_limits
from ..expectations import Expectation
from ..measuring.regressions import joined, regressions
from ..record import ROOT, Record, Stopwatch
from .part import CURVES, FOLDER, LONG, PARTS, folder_of

RECORD = FOLDER / "benchmarks.json"


def main(arguments: Sequence[str]) -> int:
    """Measure or compare; 1 if a part failed or a ratio has become worse, 2 for what cannot be done."""
    parser = argparse.ArgumentParser(prog="python -m rsmcm.apps.experiments.bench")
    parser.add_argument("--only", metavar="PARTS", help=f"some of {','.join(PARTS)}")
    parser.add_argument("--long", action="store_true", help="more frames and starts, where that tells more")
    parser.add_argument("--against", metavar="RECORD", type=Path, help="compare ratios, measure nothing")
    given = parser.parse_args(arguments)
    chosen = given.only.split(",") if given.only else list(PARTS)
    unknown = [name for name in chosen if name not in PARTS]
    if unknown:
        print(f"--only: got {','.join(unknown)}, expected some of {','.join(PARTS)}", file=sys.stderr)
        return 2
    try:
        return _compared(given.against) if given.against else _measured(chosen, given.long)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2


def _measured(chosen: Sequence[str], long: bool) -> int:
    failed = 0
    for number, name in enumerate(chosen, start=1):
        print(f"\n--- {name}, {number} of {len(chosen)} ---\n", flush=True)
        failed += not _run(name, long)
    paths = [folder_of(name) / "results.json" for name in PARTS if name != CURVES]
    parts = [Record.read(path) for path in paths if path.exists()]
    record = joined("benchmarks", "Speed beside peers", "make bench", parts, ROOT)
    record.write(RECORD)
    print(f"\nrecord: {RECORD}")
    return int(failed > 0)


def _run(name: str, long: bool) -> bool:
    """Run a part in a process of its own; one that fails leaves a record that says so."""
    options = [LONG] if long else []
    command = [sys.executable, "-m", f"{__package__}.part", name, *options]
    watch = Stopwatch()
    code = subprocess.run(command, env={**os.environ, **thread_limits(1)}).returncode
    if code == 0:
        return True
    what = Expectation(f"part {name}: failed, exit code {code}", float("nan"), "<=", 0)
    path = folder_of(name) / "results.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    Record(name, name, " ".join(command[1:]), watch.provenance(), [what], []).write(path)
    return False


def _compared(against: Path) -> int:
    worse = regressions(Record.read(RECORD), Record.read(against))
    print("\n".join(worse) if worse else f"no ratio is worse than in {against}")
    return int(bool(worse))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
