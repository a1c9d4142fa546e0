"""Streams that stall, drop and come back: no frame is invented or lost, and all gaps are reported."""

import http.server
import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.io.sources import live_reader
from rsmcm.apps.io.sources import open_source as sources
from rsmcm.apps.io.sources.live_reader import FILLED_SECONDS, LiveReader
from rsmcm.apps.io.sources.open_source import Source, open_source
from rsmcm.apps.io.sources.reader import Selection
from rsmcm.models.core.frame import Frame

from ..conftest import Command, summary_of
from ..support.stream_server import RATE, Connection, StreamServer, serving

Image = NDArray[np.uint8]
SIZE = (64, 48)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts to connect follow each other quickly."""
    monkeypatch.setattr(live_reader, "RETRY_EVERY", 0.1)


def counted(n_images: int) -> list[Image]:
    """Images whose grey level is their index, modulo 25."""
    return [np.full((SIZE[1], SIZE[0], 3), 10 + 9 * (index % 25), np.uint8) for index in range(n_images)]


def indices_of(frames: list[Frame]) -> list[int]:
    """Which of the counted images they are, modulo 25."""
    return [round((float(frame.image.mean()) - 10) / 9) for frame in frames if frame.image is not None]


def read(address: str, reconnect: float | None = None, most: int | None = None) -> tuple[Source, list[Frame]]:
    """All frames, or those until so many images have come."""
    frames: list[Frame] = []
    with open_source(address, reconnect=reconnect) as source:
        for frame in source:
            frames.append(frame)
            if sum(each.image is not None for each in frames) == most:
                break
        return source, frames


# --- gaps ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mjpeg", "mpegts", "matroska"])
def test_stream_that_drops_and_comes_back(form: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "DECODE_AHEAD", 1000)  # on a busy machine frames would be dropped
    server = StreamServer(
        counted(200), [Connection(20), Connection(None), Connection(20), Connection(99)], form
    )
    began = time.perf_counter()
    with serving(server.answer) as address:
        source, frames = read(address, reconnect=30, most=55)
    elapsed = time.perf_counter() - began
    assert source.stream is not None
    assert source.lost is None
    assert source.stream["dropped_frames"] == 0
    first, second = source.stream["gaps"]
    assert source.skipped == [frame.number for frame in frames if frame.image is None]
    assert len(source.skipped) == first["frames"] + second["frames"]
    assert [frame.number for frame in frames] == list(range(1, len(frames) + 1))
    assert (np.diff([frame.time for frame in frames]) > 0).all()
    # everything that was sent is there, at the times at which it was sent
    sent = server.sent[:55]
    assert indices_of(frames) == [index % 25 for index in sent]
    seen = [frame for frame in frames if frame.image is not None]
    assert seen[-1].time <= elapsed
    if (
        form != "mjpeg"
    ):  # which states no times: those of arrival are nearer together where the machine is busy
        assert seen[-1].time >= (sent[-1] - sent[0] - 3) / RATE
    for gap in (first, second):
        before = next(frame for frame in reversed(seen) if frame.time <= gap["lost_at"])
        after = next(frame for frame in seen if frame.time > gap["lost_at"])
        assert after.time - before.time == pytest.approx(gap["back_after"])
        assert after.number - before.number == round(gap["back_after"] * RATE) == gap["frames"] + 1
        assert gap["back_after"] > live_reader.RETRY_EVERY
        assert gap["reason"] == "it broke off"


# --- the clock of live sources, without waiting -------------------------------------------------------------


@dataclass
class FakeFeed:
    """Images at given times of a clock, which it sets."""

    clock: "FakeClock"
    arrivals: list[float]
    opened_at: float
    name: str = "feed"
    kind: str = "stream"
    rate: float = 25.0
    lost: str | None = None
    header_size: tuple[int, int] = SIZE

    def images(self) -> Iterator[tuple[float | None, Image | None]]:
        for arrival in self.arrivals:
            self.clock.now = max(self.clock.now, arrival)
            yield None, np.zeros((2, 2), np.uint8)
        self.lost = "gone"

    def fingerprint(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        pass


class FakeClock:
    """Stands for `time`, and for the event that is waited for between attempts."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def is_set(self) -> bool:
        return False

    def wait(self, seconds: float) -> bool:
        self.now += seconds
        return False


connections = st.lists(
    st.tuples(
        st.floats(0, 200),  # seconds until somebody answers
        st.lists(st.one_of(st.floats(0.0, 0.2), st.floats(0, 50)), min_size=1, max_size=6),
    ),
    min_size=1,
    max_size=5,
)


@given(connections, st.floats(0.1, 1000), st.integers(1, 7))
def test_numbers_are_in_step_with_time_whatever_happens(
    script: list[tuple[float, list[float]]], reconnect: float, step: int
) -> None:
    clock = FakeClock()
    remaining = list(script)
    answers_at = 0.0

    def connect() -> FakeFeed:
        nonlocal answers_at
        if not remaining or clock.now < answers_at:
            raise OSError("refused")
        _, pauses = remaining.pop(0)
        arrivals = (clock.now + np.cumsum(pauses)).tolist()
        if remaining:
            answers_at = arrivals[-1] + remaining[0][0]
        return FakeFeed(clock, arrivals, clock.now)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live_reader, "time", clock)
        reader = LiveReader(connect(), connect, reconnect)  # type: ignore[arg-type]
        everything = list(reader.frames(Selection(), clock))  # type: ignore[arg-type]
    seen = [frame for frame in everything if frame.image is not None]
    numbers, times = (np.array([getattr(frame, name) for frame in everything]) for name in ("number", "time"))
    assert (np.diff(numbers) > 0).all()
    assert (np.diff(times) > 0).all()
    assert reader.lost == "gone"
    assert everything[-1].image is not None, "no frames after the last picture"
    assert len(seen) == sum(len(pauses) for _, pauses in script[: len(script) - len(remaining)])
    missing = len(everything) - len(seen)
    assert missing <= len(reader.gaps) * FILLED_SECONDS * reader.rate
    assert missing <= sum(gap.frames for gap in reader.gaps)
    for one, other in pairwise(seen):
        steps = other.number - one.number
        gap = next((gap for gap in reader.gaps if gap.lost_at == one.time), None)
        assert steps == (1 if gap is None else max(1, round((other.time - one.time) * reader.rate)))
    # of what is selected, the same
    clock, remaining, answers_at = FakeClock(), list(script), 0.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live_reader, "time", clock)
        chosen = list(LiveReader(connect(), connect, reconnect).frames(Selection(2, 90, step), clock))  # type: ignore[arg-type]
    expected = [frame for frame in everything if frame.number in Selection(2, 90, step)]
    assert [(frame.number, frame.time) for frame in chosen] == [(f.number, f.time) for f in expected]


# --- servers that say nothing -------------------------------------------------------------------------------


@pytest.mark.slow
def test_ctrl_c_while_a_server_is_silent(tmp_path: Path) -> None:
    server = StreamServer(counted(1), [Connection(None, "stall")])
    hung_up = threading.Event()

    def answer(request: http.server.BaseHTTPRequestHandler) -> None:
        threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        server.answer(request)
        hung_up.set()

    out = tmp_path / "out"
    with serving(answer) as address:
        assert Command("background")(address, "--out", out) == 130
        assert not hung_up.is_set(), "the command did not wait for the limit"
    assert not out.exists()


def test_reconnect_is_refused_for_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), counted(1)[0])
    words = Command("background").complaint(capfd, path, "--out", tmp_path / "out", "--reconnect", 5)
    assert "a.png, expected a camera or an address" in words


# --- files behind an address --------------------------------------------------------------------------------


@dataclass
class FileServer:
    """Sends a file from the requested byte, but only a third of it at a time.

    Parameters
    ----------
    content
        of the file.
    n_answers
        how many requests are answered.
    """

    content: bytes
    n_answers: int
    n_requests: int = 0

    def answer(self, request: http.server.BaseHTTPRequestHandler) -> None:
        self.n_requests += 1
        if self.n_requests > self.n_answers:
            return
        requested = request.headers.get("Range", "bytes=0-")
        first, length = int(requested.removeprefix("bytes=").split("-")[0]), len(self.content)
        request.send_response(206)
        request.send_header("Accept-Ranges", "bytes")
        request.send_header("Content-Length", str(length - first))
        request.send_header("Content-Range", f"bytes {first}-{length - 1}/{length}")
        request.end_headers()
        request.wfile.write(self.content[first : first + length // 3 + 1])


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty frames of noise: enough bytes for a third not to lie in buffers."""
    path = tmp_path_factory.mktemp("film") / "a.mp4"
    random = np.random.default_rng(3)
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=RATE, options={"crf": "10", "g": "10"})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for _ in range(60):
            image = random.integers(0, 255, (240, 320, 3), np.uint8)
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        file.mux(stream.encode(None))
    return path


# --- whole runs ---------------------------------------------------------------------------------------------


def run(name: str, capfd: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, list[str]]:
    """A run of a command: its exit code, what it says, and its complaints."""
    capfd.readouterr()
    code = Command(name)(*arguments)
    output, errors = capfd.readouterr()
    return code, output, [line for line in errors.splitlines() if line.startswith("rsmcm: ")]  # no progress


@pytest.mark.slow
def test_file_behind_an_address_that_is_lost_is_resumed(
    film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    options = ["--out", str(out), "--masks", "none"]
    server = FileServer(film.read_bytes(), n_answers=1)
    with serving(server.answer) as address:
        assert run("background", capfd, address + "a.mp4", *options)[0] == 1
        server.n_answers = 100
        options += ["--resume", "--reconnect", "5"]
        code, _, errors = run("background", capfd, address + "a.mp4", *options)
    assert (code, errors) == (0, [])
    assert summary_of(out)["frames"] == 60
    assert summary_of(out)["stream"] == {"lost": None, "gaps": [], "dropped_frames": 0}
