"""Pages: text is escaped, numbers are rounded, pictures are kept, nothing half-written."""

import os
from pathlib import Path

import pytest
from markupsafe import Markup
from rsmcm.apps.reports import page

from ...support.records import MASK, PICTURE


def test_nothing_half_written_stays_behind(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        page.write_page(tmp_path / "taken", "Title", [])
    assert os.listdir(tmp_path) == ["taken"]


def test_tables_escape_text_and_round_numbers() -> None:
    text = page.table(("a", "b"), [("<i>", 0.123456), (Markup("<b>2</b>"), True)], "x < y")
    assert "&lt;i&gt;" in text
    assert '<td class="number">0.1235</td>' in text
    assert "<td><b>2</b></td><td>True</td>" in text
    assert "x &lt; y" in text
    with pytest.raises(ValueError, match="expected 2"):
        page.table(("a", "b"), [(1,)])
    with pytest.raises(ValueError, match="expected 2"):
        page.picture_grid([("row", [PICTURE])], ["a", "b"])


def test_masks_are_kept_exactly() -> None:
    assert "image/png" in page.picture(MASK)
    assert "image/jpeg" in page.picture(PICTURE)
