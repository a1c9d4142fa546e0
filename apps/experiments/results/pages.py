"""Records as Markdown: the page of results, and the figures in README."""

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ...evaluation.text_tables import rounded
from ..expectations import Expectation, columns
from ..record import Provenance, Record

BEGIN, END = "<!-- figures -->", "<!-- /figures -->"
"""What stands around README's figures."""

ELSEWHERE = {"curves": "scale.md", "capacity": "scale.md"}
"""Records that are on another page."""

INTRODUCTION = """\
# Results

Made by `make results` from what `rsmcm reproduce NAME` and `make bench` record (`docs/results/*.json`), with
what is wanted of it beside it; only the last part is noted by hand. All parameters have the same setting for
every sequence.

± is the standard error of a figure over its n seeds, found by drawing the seeds anew (200 times); tables of
methods say what they give. Seeds are those of a generated scene, or of noise on a film (one grey level in a
thousandth of its pixels), for us and for all peers. Figures of one film without noise have none. "Of an
earlier state" is what was measured before the last change of a file that it takes in `models`, `inference`
or `chains`. What falls short is marked, and below it stands why.

Speeds are medians over n rounds in which all methods had their turn, with quartiles; a ratio is that of every
round. The limit is what would be left if the bytes that must be moved, or the operations that must be done,
took no longer than in a plain copy or a product of matrices on the same machine in the same run. "Loaded" is
what was measured while other processes kept more than half a core busy.
"""
BY_HAND = """\
## Measured by hand, in earlier states

What no command prints, or what has not been recorded yet, as it was noted at the time; bold is short of what
was wanted. Where a record took the place of a table, that is in `docs/results/earlier.toml` only.
"""


@dataclass(frozen=True)
class Documents:
    """What pages are made from.

    Parameters
    ----------
    records
        by name, in the order of the notes.
    notes
        by a record's name, what is to be said of it.
    chosen
        README's figures: `what` they are called there, `record`, and `row`, their name in it.
    earlier
        what was measured by hand: `title`, `state`, `header`, `rows`, `text`, and `until`, names of the
        records that take their place.
    """

    records: Mapping[str, Record]
    notes: Mapping[str, str]
    chosen: Sequence[Mapping[str, str]]
    earlier: Sequence[Mapping[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read records, `notes.toml` and `earlier.toml`.

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
        return cls(records, notes["notes"], notes["readme"], _toml(folder / "earlier.toml")["tables"])


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}") from error


def results_page(documents: Documents, root: Path) -> str:
    """The page of results.

    Parameters
    ----------
    documents
        what it is made from.
    root
        checkout with the code that tracks, as it is now.
    """
    overview = [
        [
            f"[{record.title}]({ELSEWHERE.get(name, '')}#{_anchor(record.title)})",
            f"`{record.command}`",
            str(_count(record, "pass")),
            str(_count(record, "short") or ""),
        ]
        for name, record in documents.records.items()
    ]
    parts = [INTRODUCTION, table(("", "command", "holds", "short"), overview)]
    parts += [
        _section(record, documents.notes[name], root)
        for name, record in documents.records.items()
        if name not in ELSEWHERE
    ]
    parts.append(BY_HAND)
    parts += [_earlier(each) for each in documents.earlier if not _replaced(each, documents)]
    return "\n".join(parts)


def figures(record: Record) -> str:
    """What an experiment measured, beside what is wanted of it."""
    header, rows = columns(record.expectations)
    for row, each in zip(rows, record.expectations, strict=True):
        row[1], row[-1] = _bound(row[1]), _verdict(each)
        row.insert(4, str(each.seeds) if each.seeds > 1 else "")
    return table([*header[:4], "n", *header[4:]], rows)


def _section(record: Record, note: str, root: Path) -> str:
    parts = [f"## {record.title}\n", f"{measured_when(record, root)}\n", figures(record)]
    if note:
        parts.append(f"{note.strip()}\n")
    for one in record.tables:
        parts += [f"{one.caption}\n"] if one.caption else []
        parts.append(table(one.header, [[cell(each) for each in row] for row in one.rows]))
    return "\n".join(parts)


def measured_when(record: Record, root: Path) -> str:
    """With which command a record was made, when, where, and how busy the machine was."""
    made = record.made
    return (
        f"`{record.command}`; {_when(made, root)}; {made.machine}; {_duration(made.seconds)}, "
        f"load before it {made.load:.1f}{_others(made)}; {_versions(made)}."
    )


def _earlier(content: Mapping[str, Any]) -> str:
    parts = [f"### {content['title']}\n", f"{content['state'].strip()}\n"]
    parts += [table(content["header"], content["rows"])] if "rows" in content else []
    parts += [f"{content['text'].strip()}\n"] if "text" in content else []
    return "\n".join(parts)


def _replaced(content: Mapping[str, Any], documents: Documents) -> bool:
    until = content.get("until", [])
    return bool(until) and documents.records.keys() >= set(until)


def readme_with(text: str, documents: Documents, root: Path) -> str:
    """README with its figures.

    Raises
    ------
    ValueError
        if it lacks the marks, or a chosen figure is not in its record.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"README.md: expected {BEGIN} and {END}")
    rows, machines = [], set()
    for each in documents.chosen:
        record = documents.records.get(each["record"])
        if record is None:
            continue
        figure = record.by_what.get(each["row"])
        if figure is None:
            raise ValueError(f"readme: got {each['row']!r}, no row of the record {record.name!r}")
        _, wanted, measured, error, _ = figure.cells
        value = f"{measured} ± {error}" if error else measured
        rows.append([each["what"], _bound(wanted), value, _verdict(figure), _when(record.made, root)])
        machines.add(record.made.machine)
    figures = table(("what", "wanted", "measured", "", "when, commit"), rows)
    machine = f"On {'; '.join(sorted(machines))}. " if machines else ""
    return f"{before}{BEGIN}\n{figures}\n{machine}± is the standard error over seeds.\n{END}{after}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, with a line's end behind it."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '&#124;') for cell in line)} |\n" for line in lines)


def cell(value: object) -> str:
    """A value in a table."""
    return rounded(value) if isinstance(value, float) else "–" if value is None else str(value)


def _verdict(figure: Expectation) -> str:
    words = {"pass": "holds", "short": "**short**", "": ""}[figure.verdict]
    return ", ".join(filter(None, (words, "loaded" if figure.loaded else "")))


def _bound(wanted: str) -> str:
    return wanted.replace("<=", "≤").replace(">=", "≥")


def _count(record: Record, verdict: str) -> int:
    return sum(each.verdict == verdict for each in record.expectations)


def _when(made: Provenance, root: Path) -> str:
    commit = f"`{made.commit}`" if made.commit else f"version {made.versions['rsmcm']}"
    changed = " and changes" if made.changed else ""
    earlier = "" if made.is_of(root) else ", **of an earlier state**"
    return f"{made.date[:10]}, {commit}{changed}{earlier}"


def _versions(made: Provenance) -> str:
    return ", ".join(f"{name} {version}" for name, version in made.versions.items())


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if minutes < 2 else f"{minutes} min"


def _others(made: Provenance) -> str:
    return "" if math.isnan(made.others) else f", meanwhile {made.others:.1f} cores busy with others"


def _anchor(title: str) -> str:
    return "".join(each for each in title.lower().replace(" ", "-") if each.isalnum() or each == "-")
