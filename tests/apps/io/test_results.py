"""Results are whole at any moment, and a resumed run ends up with the files of an uninterrupted one."""

import errno
import io
import json
import os
import resource
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.io import results
from rsmcm.apps.io.results import MaskWriter, OverlayWriter, SegmentedVideo, TrackWriter
from rsmcm.apps.runs import progress
from rsmcm.apps.runs.output_folder import output_folder
from rsmcm.models.core.frame import Frame

HEIGHT, WIDTH = 49, 63  # odd on purpose


@dataclass(frozen=True)
class TrackedBox:
    identity: int
    box: tuple[float, float, float, float]
    confidence: float


def mask(number: int) -> NDArray[np.uint8]:
    return np.where(np.random.default_rng(number).random((HEIGHT, WIDTH)) < 0.3, 255, 0).astype(np.uint8)


def frame(number: int) -> Frame:
    image = np.full((HEIGHT, WIDTH, 3), 20 + 5 * number, np.uint8)
    return Frame(image, (number - 1) / 10, number)


def boxes(number: int) -> list[TrackedBox]:
    return [TrackedBox(3, (number, 10.25, 8.5, 20), 0.75), TrackedBox(11, (30 - number, 5, 10, 12), 1.0)]


def read_video(path: Path) -> tuple[list[NDArray[np.uint8]], list[float]]:
    with av.open(str(path)) as file:
        form = "gray" if path.suffix == ".mkv" else "bgr24"
        frames = list(file.decode(video=0))
        pictures = [np.asarray(one.to_ndarray(format=form), dtype=np.uint8) for one in frames]
        return pictures, [one.time for one in frames]


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


# --- whole files --------------------------------------------------------------------------------------------


def test_file_is_whole_or_as_before(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    results.write_text(path, "before")

    def interrupted() -> None:
        with results.write_atomically(path) as unfinished:
            unfinished.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "before"
    assert names(tmp_path) == {"summary.json"}


def test_full_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"No space left on device: .*a\.png") as caught:
        results.write_image(tmp_path / "a.png", mask(1))
    assert caught.value.errno == errno.ENOSPC
    with MaskWriter(tmp_path, "png", 10) as writer:
        writer.write(mask(1), 1, 0.0)
        with pytest.raises(OSError, match=r"No space left on device: .*bin000001\.png"):
            writer.checkpoint()
        monkeypatch.undo()
        writer._worker._error = None  # type: ignore[union-attr]
    assert names(tmp_path) == set()


def test_json_is_strict(tmp_path: Path) -> None:
    content = {
        "f": np.float64(0.5),
        "n": np.int64(3),
        "bad": [float("nan"), np.inf],
        "a": np.arange(2),
        5: tmp_path,
    }
    results.write_json(tmp_path / "a.json", content)
    expected = {"f": 0.5, "n": 3, "bad": [None, None], "a": [0, 1], "5": str(tmp_path)}
    assert json.loads((tmp_path / "a.json").read_text()) == expected


# --- video --------------------------------------------------------------------------------------------------


def write_overlay(path: Path, first: int, last: int, every: int, resume_after: int = 0) -> None:
    with OverlayWriter(path, 10, resume_after) as writer:
        for number in range(first, last + 1):
            writer.write(frame(number), mask(number), boxes(number))
            if number % every == 0:
                writer.checkpoint()


def test_overlay_plays_in_a_browser(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    write_overlay(path, 1, 25, 10)
    pictures, times = read_video(path)
    assert len(pictures) == 25
    np.testing.assert_allclose(times, np.arange(25) / 10, atol=1e-6)
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == (WIDTH + 1, HEIGHT + 1)
        assert stream.average_rate == 10
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # starts before it is loaded
    assert names(tmp_path) == {"overlay.mp4"}


def test_pictures_keep_their_time_over_gaps(tmp_path: Path) -> None:
    times = [0.0, 0.1, 0.2, 0.7, 0.8, 0.8, 1.3]
    video = SegmentedVideo(tmp_path / "a.mkv", 10, results.LOSSLESS_GRAY)
    for number, moment in enumerate(times, start=1):
        video.write(mask(number), number, moment)
    video.close(finished=True)
    np.testing.assert_allclose(
        read_video(tmp_path / "a.mkv")[1], [0.0, 0.1, 0.2, 0.7, 0.8, 0.9, 1.3], atol=2e-3
    )


@pytest.mark.parametrize("rate", [25.0, 30000 / 1001, 9.97, 240.0])
def test_frame_rates(tmp_path: Path, rate: float) -> None:
    with MaskWriter(tmp_path, "video", rate) as writer:
        for number in range(1, 31):
            writer.write(mask(number), number, (number - 1) / rate)
            if number % 7 == 0:
                writer.checkpoint()
    pictures, times = read_video(tmp_path / "foreground.mkv")
    np.testing.assert_allclose(times, np.arange(30) / rate, atol=8e-3)  # Matroska counts whole milliseconds
    assert all(np.array_equal(picture, mask(number)) for number, picture in enumerate(pictures, start=1))


def test_interrupted_run_leaves_a_readable_video_and_resumes(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"

    def interrupted() -> None:
        with OverlayWriter(path, 10) as writer:
            for number in range(1, 100):
                writer.write(frame(number), mask(number), boxes(number))
                if number % 10 == 0:
                    writer.checkpoint()
                if number == 17:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(read_video(path)[0]) == 17
    write_overlay(path, 11, 30, 10, resume_after=10)  # the last state that was saved
    pictures, times = read_video(path)
    assert len(pictures) == 30
    np.testing.assert_allclose(times, np.arange(30) / 10, atol=1e-6)
    for number, picture in enumerate(pictures, start=1):
        assert abs(float(np.median(picture[44:, 30:])) - (20 + 5 * number)) < 25
    assert names(tmp_path) == {"overlay.mp4"}


def test_video_that_cannot_be_completed_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = SegmentedVideo(tmp_path / "overlay.mp4", 25.0, results.PLAYABLE)
    video.write(np.zeros((HEIGHT, WIDTH, 3), np.uint8), 1, 0.0)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(results.os, "replace", full)
    with pytest.raises(OSError, match=r"overlay\.mp4"):
        video.close(finished=False)
    assert not list(tmp_path.iterdir())


def test_resuming_a_finished_run_leaves_it_alone(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    write_overlay(path, 1, 10, 5)
    before = path.read_bytes()
    OverlayWriter(path, 10, resume_after=10).close(finished=True)
    assert path.read_bytes() == before


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_kill_loses_only_what_follows_the_last_checkpoint(tmp_path: Path) -> None:
    script = """
        import sys, time
        from pathlib import Path
        sys.path.insert(0, sys.argv[2])
        from test_results import *
        folder = Path(sys.argv[1])
        overlay, tracks = OverlayWriter(folder / "overlay.mp4", 10), TrackWriter(folder / "tracks.txt")
        masks, video = MaskWriter(folder, "png", 10), MaskWriter(folder, "video", 10)
        for number in range(1, 14):
            overlay.write(frame(number), mask(number), boxes(number))
            tracks.write(number, boxes(number))
            masks.write(mask(number), number, (number - 1) / 10)
            video.write(mask(number), number, (number - 1) / 10)
            if number == 10:
                for writer in (overlay, tracks, masks, video):
                    writer.checkpoint()
        print("ready", flush=True)
        time.sleep(60)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGKILL)
    with output_folder(tmp_path, "background", resume=True) as folder:
        folder.begin(["a.txt", "foreground/a.txt"])
    assert not any(".unfinished" in name for name in names(tmp_path))
    with (
        OverlayWriter(tmp_path / "overlay.mp4", 10, 10) as overlay,
        TrackWriter(tmp_path / "tracks.txt", 10) as tracks,
        MaskWriter(tmp_path, "png", 10, 10) as masks,
        MaskWriter(tmp_path, "video", 10, 10) as video,
    ):
        assert len(list((tmp_path / "foreground").iterdir())) == 10
        for number in range(11, 21):
            overlay.write(frame(number), mask(number), boxes(number))
            tracks.write(number, boxes(number))
            masks.write(mask(number), number, (number - 1) / 10)
            video.write(mask(number), number, (number - 1) / 10)
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == 20
    pictures, _ = read_video(tmp_path / "foreground.mkv")
    np.testing.assert_array_equal(pictures, [mask(number) for number in range(1, 21)])
    whole = tmp_path / "whole.txt"
    with TrackWriter(whole) as tracks:
        for number in range(1, 21):
            tracks.write(number, boxes(number))
    assert (tmp_path / "tracks.txt").read_bytes() == whole.read_bytes()
    for number in range(1, 21):
        png = cv2.imread(str(tmp_path / "foreground" / f"bin{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(png, mask(number))


# --- masks and overlay --------------------------------------------------------------------------------------


def test_masks_none_and_unknown(tmp_path: Path) -> None:
    with MaskWriter(tmp_path, "none", 10) as writer:
        writer.write(mask(1), 1, 0.0)
    assert names(tmp_path) == set()
    with pytest.raises(ValueError, match="masks: got 'gif', expected none, png or video"):
        MaskWriter(tmp_path, "gif", 10)  # type: ignore[arg-type]


def test_overlay_marks_masks_boxes_and_trails() -> None:
    image = np.full((120, 160), 100, np.uint8)
    foreground = np.zeros_like(image)
    foreground[40:80, 40:80] = 255
    before = image.copy()
    trails = {4: np.array([[100.0, 100.0], [150.0, 100.0]])}
    track = TrackedBox(4, (90.0, 50.0, 30.0, 40.0), 0.9)
    picture = results.draw_overlay(image, foreground, [track], trails, "frame 1")
    colour = results.identity_colour(4)
    np.testing.assert_array_equal(image, before)
    assert picture.shape == (120, 160, 3)
    assert picture[60, 60].tolist() == [60, 60, 160]  # tinted
    assert picture[40, 60].tolist() == [0, 0, 255]  # outlined
    assert tuple(picture[100, 130].tolist()) == colour
    assert tuple(picture[70, 90].tolist()) == colour
    assert picture[110, 10].tolist() == [100, 100, 100]
    # An object that leaves the picture, or a box beyond it, is no reason to fail.
    results.draw_overlay(image, None, [TrackedBox(1, (-500.0, -90.0, 9000.0, 3.0), 1.0)], {}, "")


def test_identity_colours_are_stable_and_differ() -> None:
    colours = np.array([results.identity_colour(identity) for identity in range(12)], dtype=float)
    assert ((colours >= 0) & (colours <= 255)).all()
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 999 * np.eye(12)
    assert distances.min() > 40


def test_missing_frames_show_the_one_before(tmp_path: Path) -> None:
    with OverlayWriter(tmp_path / "overlay.mp4", 10) as writer:
        writer.write(Frame(None, 0.0, 1), None, [])
        writer.write(frame(2), mask(2), [])
        writer.write(Frame(None, 0.2, 3), None, boxes(3))
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == 2


# --- tracks -------------------------------------------------------------------------------------------------


def test_tracks_are_written_as_mot_has_them(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    with TrackWriter(path) as writer:
        writer.write(1, [TrackedBox(7, (0.0, 0.0, 10.0, 20.5), 0.25)])
        writer.write(2, [])
    assert path.read_text() == "1,7,1.00,1.00,10.00,20.50,0.2500,-1,-1,-1\n"


finite = st.floats(-5000, 5000).map(lambda value: round(value, 2))


@given(
    st.lists(
        st.tuples(
            st.integers(1, 99), st.integers(1, 99), finite, finite, st.floats(0, 999), st.floats(0, 999)
        ),
        max_size=8,
    )
)
def test_tracks_come_back(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]]) -> None:
    path = tmp_path_factory.mktemp("tracks") / "tracks.txt"
    rows.sort(key=lambda row: row[0])
    with TrackWriter(path) as writer:
        for number, identity, *box in rows:
            writer.write(int(number), [TrackedBox(int(identity), tuple(box), 0.5)])  # type: ignore[arg-type]
    read = results.read_tracks(path)
    assert read["frame"].tolist() == [row[0] for row in rows]
    assert read["id"].tolist() == [row[1] for row in rows]
    np.testing.assert_allclose(read["box"], np.array([row[2:] for row in rows]).reshape(-1, 4), atol=0.0051)
    assert (read["confidence"] == 0.5).all()


def test_tracks_of_a_full_disk_are_whole_lines(tmp_path: Path) -> None:
    """A limit of the size of files stands for the full disk."""
    path = tmp_path / "tracks.txt"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        tracks = TrackWriter(path)
        for number in range(1, 100):
            tracks.write(number, [TrackedBox(1, (number, 5.0, 10.0, 20.0), 1.0)])
        with pytest.raises(OSError, match=r"tracks\.txt"):
            tracks.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert 900 < path.stat().st_size <= 1000
    text = path.read_text()
    assert text.endswith("\n")
    assert results.read_tracks(path)["frame"].tolist() == list(range(1, text.count("\n") + 1))


def test_resumed_tracks_end_at_the_state(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    path.write_text("1,1,1,1,1,1,1,-1,-1,-1\n9,1,1,1,1,1,1,-1,-1,-1\n10,1,1,1,1,1,1,-1,-1,-1\n11,1,1")
    TrackWriter(path, resume_after=9).close()
    assert path.read_text() == "1,1,1,1,1,1,1,-1,-1,-1\n9,1,1,1,1,1,1,-1,-1,-1\n"
    TrackWriter(path, resume_after=0).close()
    assert path.read_text() == ""


@pytest.mark.parametrize(
    "line",
    ["1,1,5,5,10", "1,a,5,5,10,10", "0,1,5,5,10,10", "1,1,5,5,-1,10", "1.5,1,1,1,1,1", "1,1,nan,5,1,1", "x"],
)
def test_broken_tracks_name_file_and_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(f"1,1,5,5,10,10,1,1,1\n\n{line}\n")
    with pytest.raises(ValueError, match=r"gt\.txt, line 3: got .*, expected frame"):
        results.read_tracks(path)


def test_empty_tracks(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("")
    assert results.read_tracks(tmp_path / "a.txt")["box"].shape == (0, 4)


def test_ground_truth_of_pets(data_folder: Path) -> None:
    path = data_folder / "pets2009-s2l1" / "gt.txt"
    if not path.exists():
        pytest.skip(f"no {path}")
    tracks = results.read_tracks(path)
    assert len(tracks) == sum(1 for line in path.read_text().splitlines() if line)
    assert tracks["frame"].min() >= 1


# --- progress -----------------------------------------------------------------------------------------------


def test_progress_without_a_terminal_is_sparse(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with progress.Progress("background", 400, done=100) as bar:
        for _ in range(250):
            now += 0.1
            bar.update()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("background: 201 of 400 frames, 10.0 frames/s, 00:19 left")
    with progress.Progress("background", None) as bar:
        now += 11
        bar.update(11)
    assert capsys.readouterr().err == "background: 11 frames, 1.0 frames/s\n"
    with progress.Progress("structure", 20, unit="rounds") as bar:
        now += 12.5
        bar.update()
    assert capsys.readouterr().err == "structure: 1 of 20 rounds, 12.5 s each, 03:57 left\n"


@pytest.mark.parametrize("total", [None, 3])
def test_progress_in_a_terminal(monkeypatch: pytest.MonkeyPatch, total: int | None) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.Progress("background", total) as bar:
        for _ in range(3):
            bar.update()
    assert "background" in terminal.getvalue()
    assert "frames/s" in terminal.getvalue()
    assert terminal.getvalue().endswith("\n")
