"""The report of a background run: self-contained, the same for the same run."""

import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.background.record import RunRecord, TrackHistory
from rsmcm.apps.background.report import draw_tracks, write_report
from rsmcm.apps.drawing.boxes import identity_colour
from rsmcm.apps.reports.plots import INK

from ...support.records import PICTURE, recorded


class Page(HTMLParser):
    """Tags, addresses that a browser would follow, and pictures of a page."""

    VOID = frozenset({"meta", "link", "img", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        assert self.open == [], "every tag is closed"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_report_is_complete_and_asks_nothing_of_the_network(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(
        path,
        recorded(1000, missing=frozenset({5, 6})),
        PICTURE,
        {"engine": "recursive-bp", "background": {"noise": 30.0}, "source": "<b>&.avi"},
        {"F": 0.912345},
        title="Street & square",
    )
    text = path.read_text()
    page = Page(text)
    assert page.addresses
    assert all(address.startswith(("data:", "#")) for address in page.addresses)
    assert not re.search(r"url\((?!#)|@import|<script|<link(?! rel=.icon. href=.data:)", text)
    for expected in (
        "Street &amp; square",
        "background.noise",
        "&lt;b&gt;&amp;.avi",
        "0.9123",
        "5, 6",
        "nats",
    ):
        assert expected in text
    assert page.tags.count("svg") == 1
    assert INK not in text
    assert os.listdir(tmp_path) == ["report.html"]


@pytest.mark.parametrize(
    "record", [recorded(1), recorded(1, frozenset({1})), recorded(3, frozenset({1, 2, 3}))]
)
def test_report_of_hardly_anything(tmp_path: Path, record: RunRecord) -> None:
    write_report(tmp_path / "r.html", record, PICTURE[..., 0], {})
    Page((tmp_path / "r.html").read_text())


def test_report_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="record"):
        write_report(tmp_path / "r.html", RunRecord(), PICTURE, {})
    assert not any(tmp_path.iterdir())


def test_same_run_same_bytes(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, recorded(20), PICTURE, {})
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_tracks_are_drawn_in_their_colours() -> None:
    history = TrackHistory(first=1)
    for number in range(50):
        history.add(number, (2.0 * number, 30.0, 10.0, 20.0))
    grey = np.full((80, 120), 90, np.uint8)
    drawn = draw_tracks(grey, {4: history})
    assert drawn.shape == (640, 960, 3)
    assert np.all(drawn == identity_colour(4), axis=-1).sum() > 500
