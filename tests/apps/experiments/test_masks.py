"""Scores of masks on a film with masks, and what is wanted of long scenes."""

from pathlib import Path

import pytest
from rsmcm.apps.demo import write_scene
from rsmcm.apps.evaluation.masks import PixelScore
from rsmcm.apps.experiments import masks
from rsmcm.apps.scenes import sleeping_man

SIZE = (96, 72)


@pytest.mark.usefixtures("in_this_process")
def test_a_film_is_scored_with_every_seed_of_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_scene(sleeping_man(20, size=SIZE, enter=0), tmp_path)
    monkeypatch.setattr(masks, "data_folder", lambda name: tmp_path)
    monkeypatch.setattr(masks, "SEEDS", range(2))
    findings = masks.highway()
    (table,) = findings.tables
    assert [tuple(row[:2]) for row in table.rows] == [
        (method, clean_up) for method in ("feed-forward", "RSMCM") for clean_up in ("raw", "5x5 median")
    ]
    raw = findings.expectations[0]
    assert (raw.what, raw.measured, raw.seeds) == ("F, raw", table.rows[2][4], 2)


def test_the_worst_block_of_a_long_scene_counts() -> None:
    def score(right: int, in_last: int) -> PixelScore:
        return PixelScore(list(range(500)), [(right, 0, 100 - right, 0)] * 250 + [(in_last, 0, 0, 0)] * 250)

    measured = {"long": {"RSMCM": [score(100, 100), score(50, 100)]}}
    whole, least = masks.expectations_of_long(measured)
    assert whole.measured == pytest.approx(2 * 350 / (2 * 350 + 50))
    assert least.measured == pytest.approx((1 + 2 * 50 / 150) / 2)
