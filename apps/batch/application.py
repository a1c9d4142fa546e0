"""`rsmcm batch`: films to jobs, jobs to workers, and what becomes of them to a summary."""

import base64
import logging
import os
import shlex
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

import av
import cv2
import numpy as np
import psutil
from joblib import cpu_count

from ...inference.engine import checkpoint
from ...models.numerics.threads import thread_count
from ..io.sources.open_source import fingerprint
from ..io.sources.video_reader import without_password
from ..options.complaints import one_line, reason
from ..options.job import Job
from ..runs.interruption import SIGNALLED, Interrupted, Interruption, Outcome
from ..runs.messages import say_wrong
from ..runs.output_folder import lock_of, was_cut_off
from ..runs.parallel import Workers, chosen_workers, end_working, is_ending, whatever_fails, working
from ..runs.saved_run import STATE, about_of, check_source
from ..view.film import FILM
from .job import APPLICATIONS, INDEX, OWN, SUMMARY, Batch, Typed, job_of, typed, words_of
from .sources import TRACKS, FilmSource, find_films, folder_names
from .summary import NUMBERS, FilmStatus, Line, State, Summary

THUMBNAIL = (160, 120)
"""Largest width and height, px."""

LOCKED = 10.0
"""Seconds for which a folder's lock is waited for: that of a process that was killed may outlive it."""

FAILED = 1

COUNTED = {**NUMBERS, "missing": list}
"""What a batch says of a film, and what it is in the summary of a run that has it."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchResult:
    """Lines of a batch's films, and the number of the signal that ended it early, if one did."""

    lines: Sequence[Line]
    signal: int | None = None

    def report(self, out: Path) -> int:
        """Print how the batch ended, and failures on standard error; return the exit code."""
        failed = [line for line in self.lines if line.status.state in ("failed", "lost")]
        for line in failed:
            error = line.status.error
            named = error if error.startswith(line.source) else f"{line.source}: {error}"
            say_wrong(named)
        counts = Counter({"complete": 0})
        counts.update(line.status.state for line in self.lines)
        listed = ", ".join(f"{count} {state}" for state, count in counts.items())
        print(f"{len(self.lines)} videos: {listed}", f"results: {out / INDEX}", sep="\n")
        return FAILED * bool(failed) if self.signal is None else SIGNALLED + self.signal


class _SignalHandler(Interruption):
    """A first signal has all runs on this machine end with what they have, the second ends the batch.

    Runs on a cluster are not reached: the first signal ends the batch, and what has begun there goes on.
    """

    def __init__(self, here: bool) -> None:
        super().__init__()
        self._here = here

    def _arrive(self, number: int, _: FrameType | None) -> None:
        if self.signal is not None or not self._here:
            super()._arrive(number, None)
        self.signal = number
        for child in psutil.Process().children():
            with suppress(psutil.Error):  # it has just ended by itself
                child.terminate()


def run_batch(application: str, sources: Sequence[str], batch: Batch, options: Any) -> BatchResult:
    """Run an application over many films; each in a folder of its own in that of the batch.

    What is complete is left as it is, what was broken off goes on, what fails stops no other film. Options
    are of `options_of`.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with options or sources, or that another batch writes into the folder,
        before anything is begun.
    """
    found, jobs = planned(application, sources, batch, typed(options))
    workers = workers_for(found, batch)
    batch.out.mkdir(parents=True, exist_ok=True)
    lock = lock_of(batch.out)  # two batches would write one summary, and give one name to two films
    try:
        summary = Summary(batch.out)
        source_of = {job.out.name: source for source, job in jobs.items()}
        for source, line in list(summary.lines.items()):
            if source_of.get(line.folder, source) != source:  # of a camera that has another address now
                del summary.lines[source]
        for source, job in jobs.items():
            earlier = None if batch.overwrite else summary.lines.get(source)
            status = FilmStatus("waiting") if earlier is None else earlier.status
            summary.lines[source] = Line(source, job.out.name, status)
        summary.write()
        ending = _SignalHandler(here=workers.dask is None)
        try:
            work = {source: (run_film, (application, job)) for source, job in jobs.items()}
            ended = whatever_fails(
                application,
                work,
                "films",
                lambda: ending.signal is not None,
                lambda source: was_cut_off(jobs[source].out),
            )
            with ending, working(workers), closing(ended):
                for source, status in ended:
                    if isinstance(status, Exception):
                        status = _failed(status)
                    summary.tell(Line(source, jobs[source].out.name, status))
        except Interrupted as stop:
            ending.signal = stop.signal
        finally:
            summary.write()
        return BatchResult([summary.lines[source] for source in jobs], ending.signal)
    finally:
        lock.release()


def planned(
    application: str, sources: Sequence[str], batch: Batch, options: Typed
) -> tuple[list[FilmSource], dict[str, Job]]:
    """Return the films that are meant, and the job of each by its source as it is shown."""
    found = find_films(sources, tracks=application == "structure")
    earlier = Summary(batch.out).lines.items() if (batch.out / SUMMARY).exists() else ()
    shown_as = [replace(each, source=shown(each.source)) for each in found]
    twice = next((each for each, n in Counter(each.source for each in shown_as).items() if n > 1), None)
    if twice is not None:
        raise ValueError(
            f"{twice}: got it twice, expected sources that differ by more than user and password"
        )
    names = folder_names(shown_as, {source: line.folder for source, line in earlier}, (SUMMARY, INDEX))
    jobs = {}
    for each, source, name in zip(found, shown_as, names, strict=True):
        words = words_of(application, {**each.options, **options})
        try:
            job = job_of(application, [each.source, "--out", str(batch.out.absolute() / name), *words])
        except (ValueError, OSError) as error:
            if not each.where:
                raise
            raise ValueError(f"{each.where}: {one_line(error)}") from None
        jobs[source.source] = _from_anywhere(job, batch.overwrite, each.live)
    return found, jobs


def _from_anywhere(job: Job, overwrite: bool, live: bool) -> Job:
    """The job with paths that mean the same in any folder, on any machine that has the same files.

    It goes on with what is there; a live source cannot, and its results are replaced only by `overwrite`.
    """
    changed: dict[str, Any] = {
        each.name: value.absolute()
        for each in fields(job)
        if isinstance(value := getattr(job, each.name), Path)
    }
    roi = getattr(job, "roi", None)
    if roi is not None and os.path.exists(roi):
        changed["roi"] = os.path.abspath(roi)
    return replace(job, **changed, resume=not overwrite and not live, overwrite=overwrite)


def shown(source: str) -> str:
    """A source as it stands in a summary: without user and password, and of letters that can be written."""
    letters = without_password(source)
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in letters)


def workers_for(found: Sequence[FilmSource], batch: Batch) -> Workers:
    """Who works: all live cameras at once, and no more threads together than there are cores.

    It is a ValueError if there would be fewer processes than live cameras.
    """
    workers = chosen_workers(batch.jobs, batch.dask)
    live = sum(each.live for each in found)
    if batch.jobs is None:
        workers = replace(workers, jobs=max(workers.jobs, live))
    elif workers.jobs < live:
        raise ValueError(f"--jobs: got {batch.jobs}, expected {live} or more: all live cameras run at once")
    return replace(workers, threads=max(1, min(thread_count(), cpu_count() // workers.jobs)))


def commands(application: str, sources: Sequence[str], batch: Batch, options: Any) -> list[str]:
    """One shell command for each film, which runs it, or goes on with it, as the batch would."""
    found, jobs = planned(application, sources, batch, typed(options))
    threads = workers_for(found, batch).threads
    lines = []
    for job in jobs.values():
        options_of_job = [each for each in fields(APPLICATIONS[application]) if each.name not in OWN]
        values = {each.name: getattr(job, each.name) for each in options_of_job}
        given = {each.name: values[each.name] for each in options_of_job if values[each.name] != each.default}
        how = ["--overwrite"] * job.overwrite + ["--resume"] * job.resume
        words = [*how, *words_of(application, given), "--threads", str(threads)]
        lines.append(shlex.join(["rsmcm", application, job.source, "--out", str(job.out), *words]))
    return lines


def _failed(error: Exception) -> FilmStatus:
    line = reason(error)
    if line.startswith("--resume: "):  # of results in the film's folder
        line = f"{line.removeprefix('--resume: ')}: --overwrite begins anew"
    return FilmStatus("failed", line)


def run_film(application: str, job: Job) -> FilmStatus:
    """Run a job, or resume it, unless it is complete; return how it ended, whatever went wrong.

    What is in the job's folder decides what there is to do. So it may be called again, by another process on
    another machine, wherever an earlier call has ended.
    """
    if is_ending():
        return FilmStatus("waiting")
    try:
        return _run(application, job)
    except KeyboardInterrupt:
        end_working()
        return FilmStatus("interrupted")
    except Exception as error:
        _log.info("%s", job.source, exc_info=error)
        return _failed(error)


def _run(application: str, job: Any) -> FilmStatus:
    complete = None if job.overwrite else summary_if_complete(application, job)
    if complete is not None:
        outcome = Outcome(complete, None)
    else:
        run = getattr(import_module(f"..{application}.application", __package__), f"run_{application}")
        began = time.monotonic()
        while True:
            try:
                outcome = run(job)
                break
            except BlockingIOError:
                if time.monotonic() - began > LOCKED:
                    raise
                time.sleep(0.2)
    state: State = "complete"
    error = ""
    if outcome.signal is not None:
        end_working()
        state = "interrupted"
    elif outcome.lost is not None:
        state, error = "lost", f"lost permanently: {outcome.lost}"
    elif outcome.nothing is not None:
        state, error = "failed", outcome.nothing
    summary = outcome.summary
    return FilmStatus(
        state,
        error,
        summary.get("frames"),
        len(summary["missing"]) if "missing" in summary else None,
        summary.get("tracks"),
        summary.get("seconds"),
        summary.get("frames_per_second"),
        thumbnail(job.out / FILM),
    )


def summary_if_complete(application: str, job: Job) -> dict[str, Any] | None:
    """Return the summary of the run that is complete in the job's folder; `None` if there is none.

    One that was killed behind its last state is not: it leaves what a resumed run removes. Nothing is
    written, and no picture decoded. It is a ValueError if it is of another application, source, or other
    options.
    """
    path = job.out / STATE
    if not path.exists() or Path(job.source).suffix.lower() in TRACKS:  # which are read at once
        return None
    if was_cut_off(job.out):
        return None
    about = about_of(checkpoint.read(path), application, job.settings())
    summary: dict[str, Any] | None = about["finished"]
    if summary is None:
        return None
    if not all(isinstance(summary.get(name, kind()), kind) for name, kind in COUNTED.items()):
        raise ValueError(f"{path}: got another summary, {checkpoint.EXPECTED}")
    if "://" not in job.source and not about.get("live", False):
        check_source(about, fingerprint(job.source))
    return summary


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
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
    return base64.b64encode(data.tobytes()).decode("ascii")
