"""One film of a batch: its run, in whichever process, and what is told of it."""

import base64
import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...inference.engine import checkpoint
from ..io.sources.open_source import fingerprint
from ..options.complaints import one_line
from ..options.job import Job
from ..options.libraries import opencv_hint
from ..runs.interruption import Outcome
from ..runs.parallel import end_working, is_ending
from ..runs.saved_run import STATE, about_of, check_source
from ..view.film import FILM
from .sources import TRACKS

State = Literal["waiting", "complete", "interrupted", "lost", "failed"]
"""Of a film: not begun; all there; ended by Ctrl-C; lost for good, of a camera; ended by an error."""

THUMBNAIL = (160, 120)
"""Largest width and height, px."""

LOCKED = 10.0
"""Seconds for which a folder's lock is waited for: that of a process that was killed may outlive it."""

OTHER = "--resume: "
"""Begins what is said of results in a film's folder that this run cannot go on with."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Told:
    """What is told of a film.

    Parameters
    ----------
    state
        how it ended.
    error
        a line about what went wrong.
    frames, missing, tracks, seconds, frames_per_second
        of its summary, as far as that has them.
    thumbnail
        a JPEG in base 64; empty where there is no picture.
    """

    state: State
    error: str = ""
    frames: int | None = None
    missing: int | None = None
    tracks: int | None = None
    seconds: float | None = None
    frames_per_second: float | None = None
    thumbnail: str = ""


def run_film(application: str, job: Job) -> Told:
    """Run a job, or go on with it, unless it is complete; whatever goes wrong is told.

    What is in the job's folder decides what there is to do. So it may be called again, by another process on
    another machine, wherever an earlier call has ended.
    """
    if is_ending():
        return Told("waiting")
    try:
        return _run(application, job)
    except KeyboardInterrupt:
        end_working()
        return Told("interrupted")
    except Exception as error:
        _log.info("%s", job.source, exc_info=error)
        expected = isinstance(error, ValueError | OSError)
        line = one_line(error) + opencv_hint(error)
        if line.startswith(OTHER):
            line = f"{line.removeprefix(OTHER)}: --overwrite begins anew"
        return Told("failed", line if expected else f"{type(error).__name__}: {line}")


def _run(application: str, job: Any) -> Told:
    summary = None if job.overwrite else summary_if_complete(application, job)
    if summary is not None:
        return _completed(job, summary)
    module = import_module(f"..{application}.application", __package__)
    run = getattr(module, f"run_{application}")
    began = time.monotonic()
    while True:
        try:
            outcome = run(job)
            break
        except BlockingIOError:
            if time.monotonic() - began > LOCKED:
                raise
            time.sleep(0.2)
    if outcome.signal is not None:
        end_working()
        return _told("interrupted", job, outcome.summary)
    if outcome.lost is not None:
        return _told("lost", job, outcome.summary, f"lost for good: {outcome.lost}")
    return _completed(job, outcome.summary)


def _completed(job: Job, summary: dict[str, Any]) -> Told:
    """Of a run that came to its end, and may have found nothing."""
    nothing = Outcome(summary, None).nothing
    return _told("complete", job, summary) if nothing is None else _told("failed", job, summary, nothing)


def summary_if_complete(application: str, job: Job) -> dict[str, Any] | None:
    """The summary of the run that is complete in the job's folder; `None` if there is none.

    Nothing is written, and no picture decoded.

    Raises
    ------
    ValueError
        if it is of another application, source, or other options.
    """
    path = job.out / STATE
    if not path.exists() or Path(job.source).suffix.lower() in TRACKS:  # which are read at once
        return None
    about = about_of(checkpoint.read(path), application, job.settings())
    summary: dict[str, Any] | None = about["finished"]
    if summary is None:
        return None
    if "://" not in job.source and not about.get("live", False):
        check_source(about, fingerprint(job.source))
    return summary


def _told(state: State, job: Job, summary: Mapping[str, Any], error: str = "") -> Told:
    return Told(
        state,
        error,
        summary.get("frames"),
        len(summary["missing"]) if "missing" in summary else None,
        summary.get("tracks"),
        summary.get("seconds"),
        summary.get("frames_per_second"),
        thumbnail(job.out / FILM),
    )


def thumbnail(video: Path) -> str:
    """A picture from the middle of a video as JPEG in base 64; empty where there is none."""
    if not video.exists():
        return ""
    try:
        with av.open(str(video)) as container:
            if container.duration is not None:
                container.seek(container.duration // 2)
            picture = next(container.decode(video=0)).to_ndarray(format="bgr24")
    except (av.FFmpegError, OSError, ValueError, StopIteration):
        return ""
    height, width = picture.shape[:2]
    scale = min(THUMBNAIL[0] / width, THUMBNAIL[1] / height, 1.0)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    small: NDArray[np.uint8] = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
    return base64.b64encode(data.tobytes()).decode("ascii")
