"""Damaged inputs for every reader: `python -m tests.fuzz`.

Each one has to end as a result, or as one error that names the file. What ends otherwise is counted, shown by
its kind, and kept in a folder.
"""

import argparse
import math
import re
import sys
from collections import Counter
from pathlib import Path

from rsmcm.apps.evaluation.text_tables import in_columns
from tqdm import tqdm

from .readers import READERS, SLOW
from .seeds import made
from .workers import REFUSED, RESULT, Task, input_of, outcomes, write


def main() -> int:
    """Read damaged inputs; 1 if one of them did something else than it should."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=100_000, help="in all (100000)")
    parser.add_argument("--seed", type=int, default=0, help="of random numbers (0)")
    parser.add_argument("--readers", nargs="+", choices=sorted(READERS), default=list(READERS))
    parser.add_argument("--out", type=Path, default=Path("results/fuzz"), help="for what is found")
    chosen = parser.parse_args()
    seeds = made(chosen.readers)
    shares = {reader: 1 / SLOW.get(reader, 1) for reader in chosen.readers}
    each = chosen.inputs / sum(shares.values())
    tasks: list[Task] = [
        (reader, number)
        for number in range(math.ceil(each))
        for reader, share in shares.items()
        if number < share * each
    ]
    counts = {reader: Counter[str]() for reader in chosen.readers}
    with tqdm(total=len(tasks), unit="inputs") as progress:
        for task, outcome in outcomes(seeds, tasks, chosen.seed):
            reader, number = task
            counts[reader][outcome] += 1
            if outcome not in (RESULT, REFUSED):
                folder = chosen.out / f"{reader}-{chosen.seed}-{number}"
                write(input_of(seeds, task, chosen.seed), folder)
                (folder / "outcome.txt").write_text(outcome + "\n")
            progress.update()
    rows = []
    for reader, found in [*counts.items(), ("all", sum(counts.values(), Counter[str]()))]:
        total = found.total()
        each = (total, found[RESULT], found[REFUSED], total - found[RESULT] - found[REFUSED])
        rows.append((reader, *map(str, each)))
    print(in_columns(("reader", "inputs", "results", "refused", "else"), rows))
    for reader, found in counts.items():
        kinds = Counter[str]()
        for outcome, count in found.items():
            kinds[re.sub(r"\d+|0x\w+", "#", outcome)] += count
        for kind, count in kinds.most_common():
            if kind not in (RESULT, REFUSED):
                print(f"{reader}: {count} times {kind}")
    return int(rows[-1][-1] != "0")


if __name__ == "__main__":
    sys.exit(main())
