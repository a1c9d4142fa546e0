"""Made-up records: what a thousand cameras and a billion observations need follows from them."""

import math
from dataclasses import replace

import pytest
from rsmcm.apps.experiments.expectations import Expectation
from rsmcm.apps.experiments.record import ROOT, Record, Table
from rsmcm.apps.experiments.results.plan import (
    ENGINE,
    ITERATION,
    carried,
    of_cameras,
    of_observations,
    room,
)
from rsmcm.apps.experiments.results.scale_page import between, scale_page
from rsmcm.apps.experiments.scale.capacity import HEADER
from rsmcm.apps.experiments.scale.curve import Curve, Measured, tables

from ....support.made_up_records import MADE as SOMEWHERE

MADE = replace(SOMEWHERE, modules=[], load=0.2)


def capacity() -> Record:
    rows = [
        ("one", "640x480", "1 x 1", 100.0, 20, 500.0, 10.0, 20.0, 14.0),
        ("one", "640x480", "2 x 1", 100.0, 20, 400.0, 10.0, 20.0, 14.0),  # a core works 20 ms at a frame
        ("other", "640x480", "2 x 1", 200.0, 40, 300.0, 5.0, 15.0, 14.0),
        ("one", "640x480", "40 x 1", 90.0, 18, 400.0, 10.0, 20.0, 14.0),
        ("one", "1920x1080", "2 x 1", 20.0, 4, 1000.0, 30.0, 60.0, 60.0),
    ]
    return Record("capacity", "How many", "command", MADE, [], [Table(HEADER, rows, "Carried.")])


def curves() -> Record:
    def straight(named: tuple[str, str], each: float, held: float, sizes: tuple[float, ...]) -> Curve:
        return Curve(
            *named,
            [Measured(n, each * n, (each * n, each * n), 0.1 * each * n, held * n) for n in sizes],
        )

    found = [
        straight(ENGINE, 1e-8, 25.0, (1e5, 1e6, 1e7)),
        straight(ITERATION, 3e-8, 80.0, (1e3, 1e5, 1e7)),
    ]
    expectations = [Expectation("power", 1.0, "<=", 1.1, 0.01, 3)]
    return Record("curves", "Cost as curves", "make bench", MADE, expectations, tables(found))


def rows(table: Table) -> dict[str, list[float]]:
    return {str(name): [float(str(value)) for value in values] for name, *values in table.rows}


def test_the_slowest_film_with_all_cores_at_work_counts() -> None:
    small, large = carried(capacity())
    assert (small.size, small.seconds, small.memory) == ((640, 480), pytest.approx(0.02), pytest.approx(4e8))
    assert (large.size, large.seconds) == ((1920, 1080), pytest.approx(0.1))
    with pytest.raises(ValueError, match="curves: got a record without a table of capacity"):
        carried(curves())


def test_a_thousand_cameras() -> None:
    found = of_cameras(capacity(), curves())
    assert found.header == ("", "640x480", "1920x1080")
    of = rows(found)
    assert of["a frame of a whole run on one core, ms"] == [20, 100]
    assert of["of which the engine by its curve, ms"] == pytest.approx([3.07, 20.7])
    assert of["cores, 70 % busy"] == pytest.approx([143, 714])  # 1000 cameras, 5 frames, 20 ms, over 0.7
    assert of["memory with a process a camera, GB"] == [400, 1000]
    assert of["films that come in, Gbit/s"] == [0.4, 1.2]
    assert of["results that are written, MB/s"] == [100, 300]
    assert of["the same, TB a day"] == pytest.approx([8.64, 25.9])
    assert of["states saved every 500 frames, MB/s"] == [140, 600]  # every 100 s


def test_a_billion_observations() -> None:
    found = of_observations(curves())
    assert found.header == ("", "1e+07", "1e+09")
    of = rows(found)
    assert of["lists of observations, GB"] == [0.8, 80]
    assert of["an iteration on one core, s"] == [0.3, 30]
    assert of["the same by blocks of points on 100 cores, s"] == [0.003, 0.3]
    frames = math.sqrt(1e9) / 2
    assert of["frames"][1] == pytest.approx(frames, rel=1e-3)
    assert of["sums of the cameras that a block sends, MB"][1] == pytest.approx(frames * 144e-6, rel=5e-3)
    # the table has 24 bytes for each of sqrt(n) / 2 frames and n / 30 points: 128 GB are full where it says
    assert "lists of 1.6e+09 observations" in room(curves())
    table = float(room(curves()).split()[-1].rstrip("."))
    assert 24 * math.sqrt(table) / 2 * table / 30 == pytest.approx(128e9, rel=0.05)


def test_the_page_has_them_between_its_marks() -> None:
    page = (ROOT / "docs" / "scale.md").read_text()
    made = scale_page(page, {"capacity": capacity(), "curves": curves()}, ROOT)
    for name, line in {
        "capacity": "| one | 640x480 | 1 x 1 | 100 | 20 | 500 | 10 | 20 | 14 |",
        "curves": "| power | ≤ 1.1 | 1 | 0.01 | 3 | holds |",
        "cameras": "| films that come in, Gbit/s | 0.4 | 1.2 |",
        "observations": "| lists of observations, GB | 0.8 | 80 |",
    }.items():
        assert line in made.partition(f"<!-- {name} -->")[2].partition(f"<!-- /{name} -->")[0]
    assert scale_page(made, {"capacity": capacity(), "curves": curves()}, ROOT) == made
    assert scale_page(made, {"curves": curves()}, ROOT).count("*Not recorded yet.*") == 2
    with pytest.raises(ValueError, match=r"scale\.md: expected <!-- curves --> and <!-- /curves -->"):
        between("no marks", "curves", "")
