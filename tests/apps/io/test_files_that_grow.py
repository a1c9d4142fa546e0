"""Files that grow with the frames: videos, masks and lines, whatever happens to their process."""

from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.io.files import LOSSLESS_GRAY, SegmentedVideo

from ...support.film import add, mask, names, overlay_of, read_video, write_overlay


def test_pictures_keep_their_time_over_gaps(tmp_path: Path) -> None:
    times = [0.0, 0.1, 0.2, 0.7, 0.8, 0.8, 1.3]
    video = SegmentedVideo(tmp_path / "a.mkv", 10, LOSSLESS_GRAY)
    for number, moment in enumerate(times, start=1):
        video.write(mask(number), number, moment)
    video.close()
    np.testing.assert_allclose(
        read_video(tmp_path / "a.mkv")[1], [0.0, 0.1, 0.2, 0.7, 0.8, 0.9, 1.3], atol=2e-3
    )


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
    assert names(tmp_path) == {"overlay.mp4", *(f"overlay.part{last:09d}.mp4" for last in (10, 20, 30))}
