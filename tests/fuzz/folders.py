"""Folders of runs: finished ones that other commands read, and stopped ones that go on from all they hold."""

import contextlib
import io
import json
import math
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rsmcm.apps.batch.job import SUMMARY
from rsmcm.apps.batch.summary import FilmStatus, Line, Summary
from rsmcm.apps.events.page import run_events
from rsmcm.apps.events.watch import read_events
from rsmcm.apps.exports import to_movement, to_video
from rsmcm.apps.io.point_files import read_shapes
from rsmcm.apps.runs import progress
from rsmcm.apps.runs.loop import run_film
from rsmcm.apps.scenes import face, turntable
from scipy.io import savemat

from .mutations import Files
from .runs import RUN, SHAPED, ZONES, _film, _signer, _stop, application_of, walker

OUT = "out"
UNREAD = {".lock", "view.html", "events.html", "overlay.mp4", "structure.ply"}
"""Files of a run that nothing reads."""


def _sources(folder: Path) -> dict[str, list[str]]:
    """By application, the arguments of a short run; its files are written to the folder."""
    talking, (signing, head) = face(8, 3, (100, 80)), _signer()
    np.save(folder / "landmarks.npy", talking.vertices)
    _film(folder / "street.mkv", walker())
    _film(folder / "turned.mkv", turntable(SHAPED + 3, (96, 120), 4.0).images)
    _film(folder / "face.mkv", talking.images())
    _film(folder / "body.mkv", signing)
    return {
        "background": ["street.mkv"],
        "structure": ["turned.mkv", "--engine", "recursive-bp"],
        "face": ["face.mkv", "--landmarks", "landmarks.npy", "--experts", "3"],
        "body": ["body.mkv", "--head", head, "--samples", "20", "--lag", "0"],
    }


def _folders(folder: Path, run: Callable[[Any], object], names: Iterable[str]) -> list[Files]:
    """What runs of applications leave, and their sources."""
    made = []
    with contextlib.chdir(folder):
        sources = _sources(folder)
        for name in names:
            words = sources[name]
            out = folder / name
            run(application_of([name, *words, "--out", str(out)]))
            kept = {
                f"{OUT}/{path.relative_to(out)}": path.read_bytes()
                for path in sorted(out.rglob("*"))
                if path.is_file() and path.name not in UNREAD
            }
            about = {RUN: json.dumps([name, *words, "--out", OUT, "--resume"]).encode()}
            made.append(about | kept | {words[0]: (folder / words[0]).read_bytes()})
    return made


def finished_folders(folder: Path) -> list[Files]:
    """Folders of finished runs, of every application, without what only the run itself reads."""
    return [
        {name: content for name, content in files.items() if not name.endswith(("state.npz", "png", "mkv"))}
        for files in _folders(folder, run_film, ("background", "structure", "face", "body"))
    ]


def stopped_folders(folder: Path) -> list[Files]:
    """Folders of runs that a signal has stopped, with their sources."""
    after = {"background": 25, "structure": SHAPED, "body": 4}  # a face's landmarks would lie elsewhere
    return _folders(folder, lambda each: _stop(each, after[each.name]), after)


def watched_folders(folder: Path) -> list[Files]:
    """A finished run of the background application, with zones."""
    return [files | {"zones.toml": ZONES} for files in finished_folders(folder)[:1]]


def posed_folders(folder: Path) -> list[Files]:
    """Those of finished runs that have `poses.npz`."""
    return [files for files in finished_folders(folder) if f"{OUT}/poses.npz" in files]


def batches(folder: Path) -> list[Files]:
    """The summary of a batch of films."""
    summary = Summary(folder)
    for number, state in enumerate(("complete", "failed", "waiting"), start=1):
        status = FilmStatus(state, "a.mp4: no such file", 25, 1, 3, 2.5, 10.0)
        summary.lines[f"a, {number}.mp4"] = Line(f"a, {number}.mp4", f"a_{number}", status)
    summary.write()
    return [{SUMMARY: (folder / SUMMARY).read_bytes()}]


def event_tables(_: Path) -> list[Files]:
    """What happened in zones and at lines."""
    lines = (
        "time,frame,event,zone,id,x,y,duration,direction",
        "0.040,2,entered,a,1,5.00,6.00,,",
        "0.080,3,crossed,b,1,7.00,6.00,,in",
        "0.120,4,left,a,1,9.00,6.00,0.080,",
    )
    return [{"events.csv": "".join(f"{line}\n" for line in lines).encode()}]


def moving_shapes(_: Path) -> list[Files]:
    """Shapes in space over time: our own layout, and those of motion capture."""
    shapes = np.random.default_rng(0).normal(size=(6, 7, 3))
    made: list[Files] = []
    for name, arrays in (
        ("a.npz", {"shapes": shapes}),
        ("a.mat", {"X": shapes.transpose(2, 1, 0)}),
        ("a.mat", {"P3_gt": shapes.swapaxes(1, 2).reshape(18, 7)}),
    ):
        stream = io.BytesIO()
        (np.savez if name == "a.npz" else lambda file, **each: savemat(file, each))(stream, **arrays)
        made.append({name: stream.getvalue()})
    return made


# --- what reads them ----------------------------------------------------------------------------------------


def continued(folder: Path) -> None:
    """A stopped run that goes on to its end from all that its folder holds, as `--resume` does."""
    words = json.loads((folder / RUN).read_bytes())
    progress.SPARSE_SECONDS = math.inf  # on a busy machine its lines would count as said by itself
    with contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            run_film(application_of([*words[:-2], str(folder / OUT), words[-1]]))
        except ValueError as error:
            if str(error).startswith(f"{words[1]}: ") or str(error).startswith("--resume: other source"):
                raise ValueError(f"{folder}: {error}") from error  # the source is named as it was given
            raise


def poses(folder: Path) -> None:
    """Poses of a finished run, for `movement`."""
    to_movement(folder / OUT, folder / "poses.nc")


def videos(folder: Path) -> None:
    """The film of a finished run with its results drawn on it."""
    progress.SPARSE_SECONDS = math.inf
    to_video(folder / OUT, folder / "video.mp4")


def recounts(folder: Path) -> None:
    """Events in zones of a finished run."""
    run_events(folder / OUT, folder / "zones.toml")


def summaries(folder: Path) -> None:
    """The summary of a batch, to which another one adds."""
    Summary(folder).write()


def events(folder: Path) -> None:
    """Events of a run."""
    read_events(folder / "events.csv")


def shapes(folder: Path) -> None:
    """True shapes in space."""
    read_shapes(min(path for path in folder.iterdir()))
