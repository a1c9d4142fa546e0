"""Reports: bounded memory whatever the stream's length, self-contained pages, nothing half-written."""

import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from rsmcm.apps.drawing.boxes import identity_colour
from rsmcm.apps.reports import report
from rsmcm.apps.reports.report import RunRecord, TrackHistory
from rsmcm.apps.scenes import TruthBox
from rsmcm.models.core.frame import Frame

PICTURE = np.arange(8 * 10 * 3, dtype=np.uint8).reshape(8, 10, 3)
MASK = np.where(np.arange(80).reshape(8, 10) < 20, 255, 0).astype(np.uint8)


def recorded(n_frames: int, missing: frozenset[int] = frozenset()) -> RunRecord:
    """A run with one track; a quarter of the picture is foreground."""
    record = RunRecord()
    for number in range(1, n_frames + 1):
        frame = Frame(None if number in missing else PICTURE, number / 25, number)
        tracks = [TruthBox(3, "pedestrian", (number % 7, 1.0, 2.0, 4.0))]
        record.add(frame, tracks, MASK, lambda: PICTURE, lambda: PICTURE, -160.0, 0.01)
    return record


def test_a_record_is_saved_as_json_and_goes_on_as_if_it_had_not_been() -> None:
    whole, record = recorded(40, frozenset({3, 25})), RunRecord()
    for number in range(1, 41):
        frame = Frame(None if number in (3, 25) else PICTURE, number / 25, number)
        tracks = [TruthBox(3, "pedestrian", (number % 7, 1.0, 2.0, 4.0))]
        record.add(frame, tracks, MASK, lambda: PICTURE, lambda: PICTURE, -160.0, 0.01)
        if number in (1, 24):
            record = RunRecord.restored(json.loads(json.dumps(record.saved())))
    for name in report.SERIES:
        assert getattr(record, name).tobytes() == getattr(whole, name).tobytes()
    assert vars(record.tracks[3]) == vars(whole.tracks[3])
    assert record.missing == whole.missing
    assert [each.number for each in record.snapshots] == [each.number for each in whole.snapshots]
    for one, other in zip(record.snapshots, whole.snapshots, strict=True):
        np.testing.assert_array_equal(one.foreground, other.foreground)
        assert one.picture.shape == other.picture.shape


class Page(HTMLParser):
    """Tags, addresses that a browser would follow, and pictures of a page."""

    VOID = frozenset({"meta", "img", "br"})

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


@given(n_frames=st.integers(1, 700), missing=st.frozensets(st.integers(1, 700), max_size=30))
def test_snapshots_stay_few_and_spread(n_frames: int, missing: frozenset[int]) -> None:
    record = RunRecord()
    for number in range(1, n_frames + 1):
        image = None if number in missing else PICTURE
        record.add(Frame(image, 0.0, number), [], MASK, lambda: PICTURE, lambda: PICTURE, 0.0, 0.0)
    numbers = [snapshot.number for snapshot in record.snapshots]
    assert len(numbers) <= report.MOST_SNAPSHOTS
    assert not missing & set(numbers)
    assert record.missing == sorted(number for number in missing if number <= n_frames)
    if not missing:
        gaps = np.diff(numbers)
        assert len(set(gaps.tolist())) <= 1
        assert len(numbers) >= min(n_frames, report.MOST_SNAPSHOTS // 2 + 1)


def test_pictures_are_made_for_few_frames_only() -> None:
    calls = []

    def made() -> np.ndarray:
        calls.append(1)
        return PICTURE

    record = RunRecord()
    for number in range(1, 10_001):
        record.add(Frame(PICTURE, 0.0, number), [], MASK, made, made, 0.0, 0.0)
    assert len(calls) < 200


def test_snapshots_are_small_copies() -> None:
    large = np.zeros((500, 1000, 3), np.uint8)
    record = RunRecord()
    record.add(Frame(large, 0.0, 1), [], large[..., 0], lambda: large, lambda: large, 0.0, 0.0)
    assert record.snapshots[0].picture.shape == (240, 480, 3)
    small = PICTURE.copy()
    record.add(Frame(small, 0.0, 2), [], MASK, lambda: small, lambda: small, 0.0, 0.0)
    assert not np.shares_memory(record.snapshots[1].picture, small)


@given(n_frames=st.integers(1, 3000))
def test_path_of_a_track_is_bounded_and_ends_where_it_ended(n_frames: int) -> None:
    history = TrackHistory(first=1)
    for number in range(1, n_frames + 1):
        history.add(number, (float(number), 0.0, 2.0, 4.0))
    assert len(history.path) <= report.MOST_POINTS
    assert history.path[0] == (2.0, 4.0)
    assert history.foot == (n_frames + 1.0, 4.0)
    assert (history.last, history.n_frames) == (n_frames, n_frames)
    assert history.width / history.n_frames == 2


def test_report_is_complete_and_asks_nothing_of_the_network(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    report.write_report(
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
    assert all(address.startswith(("data:image/", "#")) for address in page.addresses)
    assert not re.search(r"url\((?!#)|@import|<script|<link", text)
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
    assert report.INK not in text
    assert os.listdir(tmp_path) == ["report.html"]


@pytest.mark.parametrize(
    "record", [recorded(1), recorded(1, frozenset({1})), recorded(3, frozenset({1, 2, 3}))]
)
def test_report_of_hardly_anything(tmp_path: Path, record: RunRecord) -> None:
    report.write_report(tmp_path / "r.html", record, PICTURE[..., 0], {})
    Page((tmp_path / "r.html").read_text())


def test_report_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="record"):
        report.write_report(tmp_path / "r.html", RunRecord(), PICTURE, {})
    assert not any(tmp_path.iterdir())


def test_same_run_same_bytes(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        report.write_report(tmp_path / name, recorded(20), PICTURE, {})
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_nothing_half_written_stays_behind(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        report.write_page(tmp_path / "taken", "Title", [])
    assert os.listdir(tmp_path) == ["taken"]


def test_tables_escape_text_and_round_numbers() -> None:
    text = report.table(("a", "b"), [("<i>", 0.123456), (report.strong(2), True)], "x < y")
    assert "&lt;i&gt;" in text
    assert '<td class="number">0.1235</td>' in text
    assert "<td><strong>2</strong></td><td>True</td>" in text
    assert "x &lt; y" in text
    with pytest.raises(ValueError, match="expected 2"):
        report.table(("a", "b"), [(1,)])
    with pytest.raises(ValueError, match="expected 2"):
        report.picture_grid([("row", [PICTURE])], ["a", "b"])


def test_masks_are_kept_exactly() -> None:
    assert "image/png" in report.picture(MASK)
    assert "image/jpeg" in report.picture(PICTURE)


def test_plots_of_one_page_share_no_names() -> None:
    def draw(canvas: Figure) -> None:
        canvas.subplots().plot([1, 2, 3], marker="o")

    first, second = (set(re.findall(r' id="([^"]+)"', report.figure(draw, (3, 2), name))) for name in "ab")
    assert first
    assert not first & second


def test_tracks_are_drawn_in_their_colours() -> None:
    history = TrackHistory(first=1)
    for number in range(50):
        history.add(number, (2.0 * number, 30.0, 10.0, 20.0))
    grey = np.full((80, 120), 90, np.uint8)
    drawn = report.draw_tracks(grey, {4: history})
    assert drawn.shape == (640, 960, 3)
    assert np.all(drawn == identity_colour(4), axis=-1).sum() > 500
