"""Collect records, and make the page of results and the figures of README: `make results`.

    python -m rsmcm.apps.experiments.results [FOLDER]

takes the records that experiments have left in the folders of FOLDER (`results`), keeps them in
`docs/results/`, and writes `docs/results.md`, and the part of `README.md` between its marks. Only in a
checkout.
"""

import math
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from ...models.files import write_text
from ..evaluation.text_tables import rounded
from .record import HEADER, ROOT, TRACKING, Expectation, Provenance, Record, git

OF_USERS = ("compare", "films")  # records of films that others do not have
VERDICTS = {"pass": "met", "missed": "**missed**"}


INTRODUCTION = """\
# Results

`make results` makes this page from the records of `rsmcm reproduce NAME` and `make bench`
(`docs/results/*.json`); only the last part was noted by hand. All sequences use the same parameters. Where
a target is missed, the text below the table gives the reasons.

± is the standard error over n seeds, by the bootstrap (200 draws of the seeds with replacement); captions
say what tables of methods contain. Seeds are those of a generated scene, or of noise in a video (one grey
level in a thousandth of its pixels), for us and for all other methods. A figure without ± was measured
once. "Of earlier code" means: measured before the last commit that touched `models`, `inference` or
`chains`.

Speeds are medians over n rounds in which all methods took turns, with quartiles; ratios are computed in
each round. "Loaded" figures were measured while other processes kept more than half a core busy.
"""


@dataclass(frozen=True)
class Documents:
    """Content from which pages are made."""

    records: Mapping[str, Record]  # by name, in the order of the notes
    notes: Mapping[str, str]  # by a record's name, what is to be said of it
    # README's figures: `film`, `measure`, `record`, `column`, and labels of its rows `without` and `with`
    chosen: Sequence[Mapping[str, Any]]
    earlier: str  # what was measured by hand, as Markdown

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read records, `notes.toml` and `earlier.md`.

        Raises
        ------
        OSError
            if a file cannot be read.
        ValueError
            if a file is no such thing, or a record has no note; one line that names it.
        """
        notes = _toml(folder / "notes.toml")
        found = {record.name: record for record in map(Record.read, sorted(folder.glob("*.json")))}
        without = found.keys() - notes["notes"].keys()
        if without:
            raise ValueError(f"{folder / 'notes.toml'}: no note of {', '.join(sorted(without))}")
        records = {name: found[name] for name in notes["notes"] if name in found}
        return cls(
            records, notes["notes"], notes["readme"], (folder / "earlier.md").read_text(encoding="utf-8")
        )


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}") from error


def results_page(documents: Documents, changed: str) -> str:
    """Return the page of results.

    `changed`, ISO 8601, is when the code of trackers was changed last; older measurements are marked. It is
    empty if unknown.
    """
    overview, parts = [], []
    for name, record in documents.records.items():
        passed, missed = (
            sum(each.verdict == verdict for each in record.expectations) for verdict in VERDICTS
        )
        link = f"[{record.title}](#{_anchor(record.title)})"
        overview.append([link, f"`{record.command}`", str(passed), str(missed or "")])
        note = documents.notes[name].strip()
        parts += [f"## {record.title}\n", f"{measured_when(record, changed)}\n", figures(record)]
        parts += [f"{note}\n"] if note else []
        parts += _tables(record)
    return "\n".join(
        [INTRODUCTION, table(("", "command", "met", "missed"), overview), *parts, documents.earlier]
    )


def figures(record: Record) -> str:
    """Return a table of an experiment's figures, beside their targets."""
    rows = []
    for each in record.expectations:
        what, target, measured, error, _ = each.cells
        count = str(each.seeds) if each.seeds > 1 else ""
        rows.append([what, _bound(target), measured, error, count, _verdict(each)])
    return table([*HEADER[:4], "n", ""], rows)


def _tables(record: Record) -> list[str]:
    parts = []
    for one in record.tables:
        parts += [f"{one.caption}\n"] if one.caption else []
        parts.append(table(one.header, [[_cell(each) for each in row] for row in one.rows]))
    return parts


def measured_when(record: Record, changed: str) -> str:
    """Return the command of a record, and when, where and on how busy a machine it was measured."""
    made = record.made
    minutes = round(made.seconds / 60)
    took = f"{made.seconds:.0f} s" if minutes < 2 else f"{minutes} min"
    others = "" if math.isnan(made.others) else f", {made.others:.1f} cores busy with other processes"
    versions = ", ".join(f"{name} {version}" for name, version in made.versions.items())
    return (
        f"`{record.command}`; {_when(made, changed)}; {made.machine}; {took}, load {made.load:.1f} "
        f"at the start{others}; {versions}."
    )


def readme_with(text: str, documents: Documents, changed: str) -> str:
    """Return README with its figures.

    Raises
    ------
    ValueError
        if it lacks the marks, or a chosen cell is not in its record.
    """
    rows, machines = [], set()
    for each in documents.chosen:
        record = documents.records.get(each["record"])
        if record is None:
            continue
        values = [_cell(_value(record, each["column"], each[name])) for name in ("without", "with")]
        rows.append([each["film"], each["measure"], *values, _when(record.made, changed)])
        machines.add(record.made.machine)
    chosen = table(("film", "measure", "without feedback", "with", "date, commit"), rows)
    machine = f"Measured on {'; '.join(sorted(machines))}. " if machines else ""
    legend = "± is the standard deviation over seeds; brackets contain quartiles over scenes."
    return between(text, "figures", f"{chosen}\n{machine}{legend}", "README.md")


def _value(record: Record, column: str, labels: Sequence[str]) -> object:
    """The cell of a record's tables in `column`, of the first row that has all of `labels`."""
    for one in record.tables:
        for row in one.rows:
            if column in one.header and set(labels) <= set(map(str, row)):
                return row[list(one.header).index(column)]
    raise ValueError(f"readme: got {column!r} of {list(labels)}, no cell of the record {record.name!r}")


def between(text: str, name: str, content: str, page: str) -> str:
    """Return a page's text with new lines between the marks of a name, which must be there."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"{page}: expected {begin} and {end}")
    return f"{before}{begin}\n{content}\n{end}{after}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, with a newline behind it."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '&#124;') for cell in line)} |\n" for line in lines)


def _cell(value: object) -> str:
    return rounded(value) if isinstance(value, float) else "–" if value is None else str(value)


def _verdict(figure: Expectation) -> str:
    return ", ".join(filter(None, (VERDICTS.get(figure.verdict, ""), "loaded" if figure.loaded else "")))


def _bound(target: str) -> str:
    return target.replace("<=", "≤").replace(">=", "≥")


def _when(made: Provenance, changed: str) -> str:
    commit = f"`{made.commit}`" if made.commit else f"version {made.versions['rsmcm']}"
    more = " and changes" if made.changed else ""
    before = bool(changed) and datetime.fromisoformat(made.date) < datetime.fromisoformat(changed)
    return f"{made.date[:10]}, {commit}{more}{', **of earlier code**' if before else ''}"


def _anchor(title: str) -> str:
    return "".join(each for each in title.lower().replace(" ", "-") if each.isalnum() or each == "-")


def collect(folder: Path, kept: Path) -> None:
    """Keep the records in the folders of `folder`, if no younger one is kept."""
    for path in sorted([*folder.glob("*/results.json"), *folder.glob("*/benchmarks.json")]):
        record = Record.read(path)
        if record.name in OF_USERS:
            continue
        place = kept / f"{record.name}.json"
        if not place.exists() or Record.read(place).made.date < record.made.date:
            record.write(place)
            print(f"{record.name}: {record.made.date}")


def write_pages(root: Path, changed: str) -> None:
    """Write the page of results and the figures of README of a checkout."""
    documents, readme = Documents.read(root / "docs" / "results"), root / "README.md"
    write_text(root / "docs" / "results.md", results_page(documents, changed))
    write_text(readme, readme_with(readme.read_text(encoding="utf-8"), documents, changed))


def main(folder: Path) -> int:
    """Collect and write; 2 if a file cannot be read or written."""
    try:
        collect(folder, ROOT / "docs" / "results")
        write_pages(ROOT, git("log", "-1", "--format=%cI", "--", *TRACKING))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))
