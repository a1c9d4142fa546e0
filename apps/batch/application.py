"""`rsmcm batch`: films to jobs, jobs to workers, and what becomes of them to a summary."""

import os
import shlex
import signal
import sys
import threading
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import FrameType
from typing import Any

import psutil
from joblib import cpu_count

from ...models.numerics.threads import thread_count
from ..io.sources.video_reader import without_password
from ..options.complaints import one_line
from ..options.job import Job
from ..runs.interruption import Interrupted
from ..runs.output_folder import lock_of, was_cut_off
from ..runs.parallel import Workers, as_they_end, chosen_workers, working
from .film import Told, run_film
from .job import APPLICATIONS, INDEX, OWN, SUMMARY, Batch, Typed, job_of, typed, words_of
from .sources import Found, find_films, folder_names
from .summary import Line, Summary


@dataclass(frozen=True)
class Film:
    """A film and its run.

    Parameters
    ----------
    name
        the source as it is shown, without user and password.
    job
        of its run.
    """

    name: str
    job: Job


@dataclass(frozen=True)
class Ended:
    """How a batch ended.

    Parameters
    ----------
    lines
        of the films of this batch.
    signal
        number of the signal that ended it early; `None` if it came to the end.
    """

    lines: Sequence[Line]
    signal: int | None = None

    @property
    def failed(self) -> list[Line]:
        """Those that went wrong, or were lost."""
        return [line for line in self.lines if line.told.state in ("failed", "lost")]


class Ending:
    """SIGINT and SIGTERM to a batch: the first has all runs end with what they have, the second ends them.

    Parameters
    ----------
    here
        whether the runs are in processes on this machine. Others are not reached, so that the first signal
        ends the batch; what has begun on a cluster goes on there to its end.
    """

    def __init__(self, here: bool) -> None:
        self.signal: int | None = None
        self._here = here

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Hear signals inside the block."""
        here = threading.current_thread() is threading.main_thread()
        numbers = (signal.SIGINT, signal.SIGTERM) if here else ()
        before = {number: signal.signal(number, self._arrive) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _arrive(self, number: int, _: FrameType | None) -> None:
        again, self.signal = self.signal is not None, number
        if again or not self._here:
            raise Interrupted(number)
        for child in psutil.Process().children():
            with suppress(psutil.Error):  # it has just ended by itself
                child.terminate()


def run_batch(application: str, sources: Sequence[str], batch: Batch, options: Any) -> Ended:
    """Run an application over many films; each in a folder of its own in that of the batch.

    What is complete is left as it is, what was broken off goes on, what fails is told and stops nobody.

    Parameters
    ----------
    application
        a key of `APPLICATIONS`.
    sources
        as of `find_films`.
    batch
        where the results go, and who works.
    options
        of the application, as of `options_of`.

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
        return _carried_out(application, found, jobs, batch, workers)
    finally:
        lock.release()


def _carried_out(
    application: str, found: Sequence[Found], jobs: Sequence[Job], batch: Batch, workers: Workers
) -> Ended:
    """The batch that is planned, in a folder in which no other one writes."""
    summary = Summary(batch.out)
    films = [Film(shown(each.source), job) for each, job in zip(found, jobs, strict=True)]
    of_film = {film.job.out.name: film.name for film in films}
    for source, line in list(summary.lines.items()):
        if of_film.get(line.folder, source) != source:  # of a camera that has another address now
            del summary.lines[source]
    for film in films:
        earlier = summary.lines.get(film.name)
        told = Told("waiting") if earlier is None or batch.overwrite else earlier.told
        summary.lines[film.name] = Line(film.name, film.job.out.name, told)
    summary.write()
    ending = Ending(here=workers.dask is None)
    try:
        told_by = _all_told(application, films, workers, ending)
        with ending.heard(), working(workers), closing(told_by):
            for film, told in told_by:
                summary.tell(Line(film.name, film.job.out.name, told))
    except Interrupted as stop:
        ending.signal = stop.signal
    finally:
        summary.write()
    return Ended([summary.lines[film.name] for film in films], ending.signal)


def planned(
    application: str, sources: Sequence[str], batch: Batch, options: Typed
) -> tuple[list[Found], list[Job]]:
    """The films that are meant, and the job of each.

    Raises
    ------
    ValueError, OSError
        as of `run_batch`.
    """
    found = find_films(sources, tracks=application == "structure")
    known = {} if not (batch.out / SUMMARY).exists() else Summary(batch.out).folders
    shown_as = [replace(each, source=shown(each.source)) for each in found]
    twice = next((each for each, n in Counter(each.source for each in shown_as).items() if n > 1), None)
    if twice is not None:
        raise ValueError(
            f"{twice}: got it twice, expected sources that differ by more than user and password"
        )
    names = folder_names(shown_as, known, (SUMMARY, INDEX))
    jobs = []
    for each, name in zip(found, names, strict=True):
        words = words_of(application, {**each.options, **options})
        try:
            job = job_of(application, [each.source, "--out", str(batch.out.absolute() / name), *words])
        except (ValueError, OSError) as error:
            if not each.where:
                raise
            raise ValueError(f"{each.where}: {one_line(error)}") from None
        jobs.append(_from_anywhere(job, batch.overwrite, each.live))
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


def workers_for(found: Sequence[Found], batch: Batch) -> Workers:
    """Who works: all live cameras at once, and no more threads together than there are cores.

    Raises
    ------
    ValueError
        if there would be fewer processes than live cameras.
    """
    workers = chosen_workers(batch.jobs, batch.dask)
    live, cores = sum(each.live for each in found), cpu_count()
    if batch.jobs is None:
        workers = replace(workers, jobs=max(workers.jobs, live))
    elif workers.jobs < live:
        raise ValueError(f"--jobs: got {batch.jobs}, expected {live} or more: all live cameras run at once")
    return replace(workers, threads=max(1, min(thread_count(), cores // workers.jobs)))


def commands(application: str, sources: Sequence[str], batch: Batch, options: Any) -> list[str]:
    """One shell command for each film, which runs it, or goes on with it, as the batch would."""
    found, jobs = planned(application, sources, batch, typed(options))
    threads = workers_for(found, batch).threads
    return [shlex.join(_command(application, job, threads)) for job in jobs]


def _command(application: str, job: Job, threads: int) -> list[str]:
    kind = APPLICATIONS[application]
    values = {each.name: getattr(job, each.name) for each in fields(kind) if each.name not in OWN}
    defaults = {each.name: each.default for each in fields(kind)}
    given = {name: value for name, value in values.items() if value != defaults[name]}
    how = ["--overwrite"] * job.overwrite + ["--resume"] * job.resume
    words = [
        job.source,
        "--out",
        str(job.out),
        *how,
        *words_of(application, given),
        "--threads",
        str(threads),
    ]
    return ["rsmcm", application, *words]


def _all_told(
    application: str, films: Sequence[Film], workers: Workers, ending: Ending
) -> Generator[tuple[Film, Told]]:
    """What becomes of all films, as they end; whoever takes his process along does not stop the others.

    When a process dies, all that wait for it are given back. Those that were begun are run again by
    themselves, at the end; one that dies again was the one.
    """
    waiting, suspects = list(films), list[Film]()
    while waiting and ending.signal is None:
        given_back: list[Film] = []
        for film, told in _told(application, waiting, ending):
            if told is None:
                given_back.append(film)
            else:
                yield film, told
        cut_off = [film for film in given_back if was_cut_off(film.job.out)]
        suspects += cut_off
        waiting = [film for film in given_back if film not in cut_off]
        if given_back and not cut_off:  # before they came to their folders: as little is known of any of them
            suspects, waiting = suspects + waiting, []
    with working(replace(workers, jobs=1)):
        for suspect in suspects:
            if ending.signal is None:
                for film, told in _told(application, [suspect], ending):
                    yield film, told or Told("failed", "its process was ended by the system, twice")


def _told(application: str, films: Sequence[Film], ending: Ending) -> Iterator[tuple[Film, Told | None]]:
    """Each film with what is told of it; `None` where a process has died that might have had it."""
    work = [(run_film, (application, film.job)) for film in films]
    results = as_they_end(application, work, "films", lambda: ending.signal is not None)
    for number, future in results:
        if not (ending.signal is not None and isinstance(future.exception(), BrokenProcessPool)):
            yield films[number], _result(future)


def _result(future: Future[Told]) -> Told | None:
    try:
        return future.result()
    except BrokenProcessPool:
        return None
    except Exception as error:
        return Told("failed", f"{type(error).__name__}: {one_line(error)}")


def in_words(ended: Ended, out: Path) -> list[str]:
    """How a batch ended, in a line, and where the results are."""
    states = [line.told.state for line in ended.lines]
    counts = {state: states.count(state) for state in dict.fromkeys(["complete", *states])}
    listed = ", ".join(f"{count} {state}" for state, count in counts.items())
    return [f"{len(states)} films: {listed}", f"results: {out / INDEX}"]


def report_failures(ended: Ended) -> None:
    """A line on standard error for each film that went wrong."""
    for line in ended.failed:
        error = line.told.error
        named = error if error.startswith(line.source) else f"{line.source}: {error}"
        print(f"rsmcm: {named}", file=sys.stderr)
