"""What the page of the background application is made of: outlines of the mask, spans of each track."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.background.page import (
    TrackHistory,
    background_page,
    draw_paths,
    over_the_film,
    view_row_of,
)
from rsmcm.apps.events.page import ZoneEvents
from rsmcm.apps.events.watch import Event, Kind, Moment
from rsmcm.apps.io.tracks import TrackedBox
from rsmcm.apps.io.zones import Zones
from rsmcm.apps.view.film import Film, Row
from rsmcm.apps.view.overlay import identity_colour
from rsmcm.apps.view.page import PREDICTED, SEEN, write_page

from ...support.records import PICTURE, SUMMARY, recorded

SIZE = (96, 128)


def film_of(rows: Sequence[Row]) -> Film:
    """With these rows, at ten frames a second."""
    times = np.arange(len(rows)) / 10
    return Film(
        None,
        SIZE,
        np.arange(1, len(rows) + 1),
        times,
        times,
        {name: np.concatenate([row[name] for row in rows]) for name in rows[0]},
        {name: np.array([len(row[name]) for row in rows]) for name in rows[0]},
    )


def test_outlines_are_those_of_the_foreground() -> None:
    mask = np.zeros(SIZE, np.uint8)
    cv2.ellipse(mask, (40, 50), (20, 30), 20, 0, 360, 255, -1)  # type: ignore[call-overload]
    cv2.circle(mask, (40, 50), 8, 0, -1)  # type: ignore[call-overload]
    cv2.rectangle(mask, (90, 10), (120, 80), 255, -1)  # type: ignore[call-overload]
    drawn = view_row_of(mask, [])
    assert len(drawn["corners"]) == 3, "two things, one with a hole"
    again = np.zeros(SIZE, np.uint8)
    polygons = np.split(drawn["outline"].astype(np.int32), np.cumsum(drawn["corners"])[:-1])
    cv2.fillPoly(again, polygons, 255)  # type: ignore[call-overload]
    # between the hole and its outline lie the px of the border, on both sides
    assert np.count_nonzero(again != mask) < 0.03 * np.count_nonzero(mask)
    assert len(drawn["outline"]) < 60


@given(
    st.lists(st.lists(st.sampled_from([None, True, False]), min_size=3, max_size=3), min_size=1, max_size=12)
)
def test_rows_tell_when_each_was_seen(life: list[list[bool | None]]) -> None:
    """By frame and identity: not there, seen, or predicted."""
    rows = [
        view_row_of(
            np.zeros(SIZE, np.uint8),
            [TrackedBox(k + 1, (k, 2, 3, 4), seen=seen) for k, seen in enumerate(frame) if seen is not None],
        )
        for frame in life
    ]
    film = film_of(rows)
    again: list[list[bool | None]] = [[None] * 3 for _ in life]
    _, timeline = over_the_film(film)
    for row in timeline:
        for first, last, kind in row.spans.tolist():
            assert kind in (SEEN, PREDICTED)
            for index in range(first, last + 1):
                assert again[index][row.identity - 1] is None, "spans do not overlap"
                again[index][row.identity - 1] = kind == SEEN
    assert again == life


def test_events_are_in_the_order_of_their_times() -> None:
    """In which they are not known: that somebody has gone shows later than what others do meanwhile."""
    rows = [view_row_of(np.zeros(SIZE, np.uint8), [TrackedBox(1, (1, 2, 3, 4))]) for _ in range(6)]
    moments = [Moment((frame - 1) / 10, frame, 0, 0) for frame in (5, 2, 4, 9)]
    events = [Event(moment, Kind.STANDS, "", 1) for moment in moments]
    layers, _ = over_the_film(film_of(rows), ZoneEvents(Zones(), events, (0.0, 0.5)))
    assert [event["frame"] for event in layers["events"]] == [2, 4, 5], "the film has no frame 9"


def test_a_page_says_everything(tmp_path: Path) -> None:
    """Without a film: no frame could be read."""
    summary = {**SUMMARY, "metrics": {"F": 0.912345}, "notes": ["The camera moves."]}
    page = background_page("Street & square", recorded(20, frozenset({5, 6})), summary, None, PICTURE)
    write_page(tmp_path / "view.html", page)
    text = (tmp_path / "view.html").read_text()
    for expected in (
        "Street &amp; square", "background.noise", "&lt;b&gt;&amp;.avi", "0.9123", "frames 5, 6", "nats",
        "The camera moves.", "Paths of the feet",
    ):  # fmt: skip
        assert expected in text
    assert [path.name for path in tmp_path.iterdir()] == ["view.html"]


def test_paths_are_drawn_in_their_colours() -> None:
    path = np.stack([5.0 + 2 * np.arange(50), np.full(50, 50.0)], axis=1)
    history = TrackHistory(1, 50, 50, 10.0, 20.0, path)
    drawn = draw_paths(np.full((80, 120), 90, np.uint8), {4: history})
    assert drawn.shape == (640, 960, 3)
    assert np.all(drawn == identity_colour(4), axis=-1).sum() > 500
