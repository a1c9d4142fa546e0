"""Records are read back as they were, and know where they were made."""

import math
from pathlib import Path

import pytest
from rsmcm.apps.experiments.record import Expectation, Record, Stopwatch, Table


def test_read_back(tmp_path: Path) -> None:
    record = Record(
        "name",
        "Title",
        "rsmcm reproduce name",
        Stopwatch().provenance(),
        [Expectation("a", 0.25, "<=", 1.0, 0.5, 3), Expectation("b", math.nan, ">=", 2.0)],
        [Table(["method", "F"], [["ours", 0.5], ["theirs", 1]], "Some.")],
    )
    record.write(tmp_path / "results.json")
    back = Record.read(tmp_path / "results.json")
    assert (back.name, back.title, back.command, back.made) == ("name", "Title", record.command, record.made)
    assert back.expectations[0] == record.expectations[0]
    assert back.expectations[1].verdict == "missed"
    assert math.isnan(back.expectations[1].measured)
    assert vars(back.tables[0]) == vars(record.tables[0])


def test_damaged_records_are_named(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    for text in ("", "[]", '{"name": 3}', "null"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"results\.json: no record of an experiment"):
            Record.read(path)
