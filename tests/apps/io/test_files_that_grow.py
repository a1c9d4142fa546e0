"""Files that grow with the frames: videos, masks and lines, whatever happens to their process."""

import errno
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from rsmcm.apps.io import files
from rsmcm.apps.io.files import LOSSLESS_GRAY, PLAYABLE, MaskWriter, SegmentedVideo
from rsmcm.apps.io.tracks import TrackWriter
from rsmcm.apps.runs.output_folder import output_folder

from ...support.film import HEIGHT, WIDTH, add, boxes, mask, names, overlay_of, read_video, write_overlay


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
    video = SegmentedVideo(tmp_path / "a.mkv", 10, LOSSLESS_GRAY)
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
        with overlay_of(path) as writer:
            for number in range(1, 100):
                add(writer, number)
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
    video = SegmentedVideo(tmp_path / "overlay.mp4", 25.0, PLAYABLE)
    video.write(np.zeros((HEIGHT, WIDTH, 3), np.uint8), 1, 0.0)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(OSError, match=r"overlay\.mp4"):
        video.close(finished=False)
    assert not list(tmp_path.iterdir())


def test_resuming_a_finished_run_leaves_it_alone(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    write_overlay(path, 1, 10, 5)
    before = path.read_bytes()
    with overlay_of(path, 10):
        pass
    assert path.read_bytes() == before


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_kill_loses_only_what_follows_the_last_checkpoint(tmp_path: Path) -> None:
    script = """
        import sys, time
        from pathlib import Path
        sys.path.insert(0, sys.argv[2])
        from film import add, boxes, mask, overlay_of
        from rsmcm.apps.io.files import MaskWriter
        from rsmcm.apps.io.tracks import TrackWriter
        folder = Path(sys.argv[1])
        overlay, tracks = overlay_of(folder / "overlay.mp4"), TrackWriter(folder / "tracks.txt")
        masks, video = MaskWriter(folder, "png", 10), MaskWriter(folder, "video", 10)
        for number in range(1, 14):
            add(overlay, number)
            tracks.write(number, boxes(number))
            masks.write(mask(number), number, (number - 1) / 10)
            video.write(mask(number), number, (number - 1) / 10)
            if number == 10:
                for writer in (overlay, tracks, masks, video):
                    writer.checkpoint()
        print("ready", flush=True)
        time.sleep(60)
    """
    command = [
        sys.executable,
        "-c",
        textwrap.dedent(script),
        str(tmp_path),
        str(Path(__file__).parents[2] / "support"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGKILL)
    with output_folder(tmp_path, "background", resume=True) as folder:
        folder.begin(["a.txt", "foreground/a.txt"])
    assert not any(".unfinished" in name for name in names(tmp_path))
    lines = (tmp_path / "tracks.txt").read_text().splitlines()
    kept = [line for line in lines if int(line.split(",")[0]) <= 10]
    with (
        overlay_of(tmp_path / "overlay.mp4", 10) as overlay,
        TrackWriter(tmp_path / "tracks.txt", kept) as tracks,
        MaskWriter(tmp_path, "png", 10, 10) as masks,
        MaskWriter(tmp_path, "video", 10, 10) as video,
    ):
        assert len(list((tmp_path / "foreground").iterdir())) == 10
        for number in range(11, 21):
            add(overlay, number)
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


def test_masks_none_and_unknown(tmp_path: Path) -> None:
    with MaskWriter(tmp_path, "none", 10) as writer:
        writer.write(mask(1), 1, 0.0)
    assert names(tmp_path) == set()
    with pytest.raises(ValueError, match="masks: got 'gif', expected none, png or video"):
        MaskWriter(tmp_path, "gif", 10)  # type: ignore[arg-type]
