"""The page of results and README's figures are what the generator makes of the records."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from rsmcm.apps.experiments.record import Expectation, Record, Table
from rsmcm.apps.experiments.results import (
    Documents,
    collect,
    main,
    readme_with,
    results_page,
)

from ...support.made_up_records import MADE

ROOT = Path(__file__).parents[3]
NOTES = """
[notes]
second = "Why it falls | short."
first = ""
[[readme]]
film = "a film"
measure = "F of it"
record = "first"
column = "F"
without = ["a|b"]
with = ["ours"]
[[readme]]
film = "not recorded yet"
record = "third"
"""
BEGIN, END = "<!-- figures -->", "<!-- /figures -->"
BEFORE, AFTER = "2026-11-22T11:00:00+02:00", "2026-11-22T09:30:00-01:00"
"""When code was changed, by the clock of another zone: before the records were made, and after."""


def record(name: str, *expectations: Expectation) -> Record:
    made = replace(MADE, seconds=300.0)
    tables = [Table(("method", "F"), [["ours", 0.87654], ["a|b", math.nan]], "All of them.")]
    return Record(name, name.title(), f"rsmcm reproduce {name}", made, expectations, tables)


FIRST = record("first", Expectation("ratio", 0.5, "<=", 1.0, 0.0123, 5))
SECOND = record("second", Expectation("lost", math.nan, "<=", 0.0), Expectation("px", 3.0))


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with nothing but what pages are made from."""
    kept = tmp_path / "docs" / "results"
    kept.mkdir(parents=True)
    (kept / "notes.toml").write_text(NOTES)
    (kept / "earlier.md").write_text("## By hand\n")
    for each in (FIRST, SECOND):
        each.write(kept / f"{each.name}.json")
    (tmp_path / "README.md").write_text(f"before\n{BEGIN}\nthe last ones\n{END}\nafter\n")
    return tmp_path


def documents(checkout: Path) -> Documents:
    return Documents.read(checkout / "docs" / "results")


def test_pages_are_what_is_made_of_the_records() -> None:
    """After a change of a record: `make results`, which also marks what was measured with earlier code."""
    found = Documents.read(ROOT / "docs" / "results")

    def unmarked(text: str) -> str:
        return text.replace(", **of earlier code**", "")

    assert unmarked((ROOT / "docs" / "results.md").read_text()) == results_page(found, "")
    readme = unmarked((ROOT / "README.md").read_text())
    assert readme == readme_with(readme, found, "")


def test_page(checkout: Path) -> None:
    page = results_page(documents(checkout), BEFORE)
    assert page.index("## Second") < page.index("## First")
    assert "| ratio | ≤ 1 | 0.5 | 0.012 | 5 | met |" in page
    assert "| lost | ≤ 0 | – |  |  | **missed** |" in page
    assert "| px |  | 3 |  |  |  |" in page
    assert "| [Second](#second) | `rsmcm reproduce second` | 0 | 1 |" in page
    assert "`rsmcm reproduce first`; 2026-11-22, `0123456789`; Processor, 2 cores, 24 GB; 5 min" in page
    assert "Why it falls | short." in page
    assert "| ours | 0.877 |\n| a&#124;b | – |" in page
    assert page.endswith("## By hand\n")
    assert "earlier code**" not in page


def test_figures_of_readme(checkout: Path) -> None:
    text = readme_with(f"before\n{BEGIN}\n{END}\n", documents(checkout), BEFORE)
    assert text.startswith(f"before\n{BEGIN}\n| film | measure | without feedback | with | date, commit |\n")
    assert "| a film | F of it | – | 0.877 | 2026-11-22, `0123456789` |" in text
    assert "earlier code" not in text
    assert "**of earlier code**" in readme_with(text, documents(checkout), AFTER)
    assert "not recorded yet" not in text


def test_what_does_not_fit_is_named(checkout: Path) -> None:
    with pytest.raises(ValueError, match=r"README\.md: expected <!-- figures -->"):
        readme_with("no marks", documents(checkout), BEFORE)
    notes = checkout / "docs" / "results" / "notes.toml"
    notes.write_text(NOTES.replace('["ours"]', '["others"]'))
    with pytest.raises(ValueError, match=r"got 'F' of \['others'\], no cell of the record 'first'"):
        readme_with(f"{BEGIN}{END}", documents(checkout), BEFORE)
    record("unknown").write(notes.with_name("unknown.json"))
    with pytest.raises(ValueError, match=r"notes\.toml: no note of unknown"):
        documents(checkout)
    notes.write_text("[notes")
    with pytest.raises(ValueError, match=r"notes\.toml: "):
        documents(checkout)


def test_younger_records_are_collected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, kept = tmp_path / "results" / "some-folder", tmp_path / "kept"
    folder.mkdir(parents=True)
    kept.mkdir()
    FIRST.write(folder / "results.json")
    collect(tmp_path / "results", kept)
    assert Record.read(kept / "first.json").by_what == FIRST.by_what
    older = replace(FIRST, made=replace(FIRST.made, date="2026-11-21T10:00:00+00:00", commit="older"))
    older.write(folder / "results.json")
    collect(tmp_path / "results", kept)
    assert Record.read(kept / "first.json").made.commit == "0123456789"
    replace(FIRST, name="films").write(folder / "results.json")  # of films that others do not have
    collect(tmp_path / "results", kept)
    assert [path.name for path in kept.iterdir()] == ["first.json"]
    assert capsys.readouterr().out == "first: 2026-11-22T10:00:00+00:00\n"


def test_a_damaged_record_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "results.json").write_text('{"name": "one"}')
    assert main(tmp_path) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{tmp_path / 'one' / 'results.json'}: no record of an experiment" in said
