"""Folders of results that are read again."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.exports import FinishedRun, read_tracks_table

from ...conftest import Command


def test_a_run_says_what_it_is_of(background: Path) -> None:
    run = FinishedRun.of(background)
    assert (run.application, run.size, run.rate) == ("background", (128, 96), 12.5)
    assert run.numbers == range(3, 60, 2)
    assert run.picture_names[:2] == ["in000001.png", "in000002.png"]


def test_frames_have_the_tracks_and_masks_of_the_files(background: Path) -> None:
    run, table = FinishedRun.of(background), read_tracks_table(background)
    frames = list(run.frames())
    assert [frame.number for frame in frames] == list(run.numbers)
    rows = [(frame.number, *track.box, *track.velocity) for frame in frames for track in frame.tracks]
    names = ("frame", "x", "y", "width", "height", "vx", "vy")
    np.testing.assert_array_equal(rows, np.stack([table[name] for name in names], axis=1))
    assert [track.identity for frame in frames for track in frame.tracks] == table["id"].tolist()
    assert [track.seen for frame in frames for track in frame.tracks] == table["seen"].tolist()
    for frame in frames:
        mask = cv2.imread(str(background / "foreground" / f"bin{frame.number:06d}.png"), 0)
        np.testing.assert_array_equal(frame.foreground, mask)
    assert [frame.foreground for frame in run.frames(masks=False)] == [None] * len(frames)


def test_a_video_of_masks_gives_the_same(background: Path, street: Path, tmp_path: Path) -> None:
    options = ("--start", 3, "--step", 2)
    assert Command("background")(street, *options, "--masks", "video", "--out", tmp_path / "video") == 0
    assert Command("background")(street, *options, "--masks", "none", "--out", tmp_path / "none") == 0
    pictures, video, none = (
        list(FinishedRun.of(folder).frames())
        for folder in (background, tmp_path / "video", tmp_path / "none")
    )
    for one, other, blind in zip(pictures, video, none, strict=True):
        np.testing.assert_array_equal(one.foreground, other.foreground)
        assert one.number == other.number == blind.number
        assert len(one.tracks) == len(other.tracks) == len(blind.tracks)
        assert blind.foreground is None
    summary = json.loads((tmp_path / "video" / "summary.json").read_text())
    dropped = {**summary, "frames": 20, "stream": {"dropped_frames": 9}}
    (tmp_path / "video" / "summary.json").write_text(json.dumps(dropped))
    with pytest.raises(ValueError, match=r"foreground\.mkv: which frames its pictures show is not known"):
        list(FinishedRun.of(tmp_path / "video").frames())


def test_what_is_no_finished_run_is_named(background: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such folder"):
        FinishedRun.of(tmp_path / "nowhere")
    with pytest.raises(NotADirectoryError, match="expected the folder of a finished run"):
        FinishedRun.of(background / "summary.json")
    with pytest.raises(ValueError, match="holds no results of a finished run"):
        FinishedRun.of(tmp_path)
    with pytest.raises(ValueError, match="got results of rsmcm background, expected rsmcm body or face"):
        FinishedRun.of(background, "body", "face")


@pytest.mark.parametrize(
    ("summary", "wrong"),
    [
        ("[1]", "got something else than JSON"),
        ("[" * 100_000, "got something else than JSON"),
        ('{"size": [0, 4]}', "got no size"),
        ('{"size": [4, 4], "first_frame": 1, "last_frame": "x"}', "got no first_frame"),
        ('{"size": [4, 4], "first_frame": 1, "last_frame": 9, "parameters": {"step": 0}}', "got no first"),
        ('{"size": [4, 4], "first_frame": 1, "last_frame": 9, "parameters": {"step": 1}}', "got no frames"),
    ],
)
def test_a_summary_that_is_damaged_is_named(
    background: Path, tmp_path: Path, summary: str, wrong: str
) -> None:
    shutil.copy(background / "manifest.json", tmp_path)
    (tmp_path / "summary.json").write_text(summary)
    with pytest.raises(ValueError, match=rf"summary\.json: {wrong}"):
        print(FinishedRun.of(tmp_path).size, FinishedRun.of(tmp_path).numbers)


def test_damaged_results_are_named(background: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(background, out)
    (out / "foreground" / "bin000005.png").write_bytes(b"x")
    with pytest.raises(ValueError, match=r"bin000005\.png: got no picture, expected a mask of 128x96 px"):
        list(FinishedRun.of(out).frames())
    with (out / "tracks.csv").open("a") as file:
        file.write("61,2.4,1,1,1,5,5,1,0,0,1\n")
    with pytest.raises(ValueError, match=r"tracks\.csv: got objects of frame 61, which is none of the run's"):
        list(FinishedRun.of(out).frames(masks=False))
