"""A run over the frames of a film: source -> engine -> sinks.

An application says what its model is, which columns a belief has, what it concludes, and what its page shows.
Everything else is here: reading, saving, resuming, signals, progress, the live page, the film of the page.
"""

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...inference import Belief, MultiChain, RecursiveBP
from ...inference.engine.checkpoint import EXPECTED
from ...inference.engine.recursive_bp import RunState
from ...models.core.frame import Frame
from ...models.files import fitting
from ...models.numerics.compiled import work_clock
from ...models.numerics.threads import thread_count
from ..io.files import segments_of, write_json
from ..io.film import SeenFrames
from ..io.row_log import COLUMNS, RowLog, Values
from ..io.sources.open_source import Source, describe, open_source
from ..options.job import FilmJob, read_address
from ..view.film import ROWS as FILM_ROWS
from ..view.film import Film, FilmWriter, Row, read_film
from ..view.overlay import Draw, OverlayVideo
from ..view.page import VIEW, FrameRecord, Line, Page, Plot, write_page
from .interruption import Interrupted, Outcome
from .memory import check_memory
from .progress import Progress
from .saved_run import STATE, SavedRun, check_source, save_run, words_of
from .session import OVERLAY, Session

if TYPE_CHECKING:
    from ..view.live import Running

__all__ = [
    "Application",
    "Columns",
    "Engine",
    "File",
    "FilmJob",
    "Filter",
    "Line",
    "Output",
    "Page",
    "Plot",
    "RowLog",
    "Sink",
    "Start",
    "run_film",
]

_log = logging.getLogger(__name__)

Image = NDArray[np.uint8]
F = TypeVar("F", bound=FilmJob)


@dataclass(frozen=True, eq=False)
class Columns:
    """Results of a frame: its row of the log, arrays for files, and data for the page.

    Parameters
    ----------
    frame
        a number, or an array of the same shape in every frame, by the name of its column. Columns `number`,
        `time`, `missing` and `seconds` are added.
    objects
        arrays `(n, ...)` by the name of their column, with one entry per object.
    pictures
        `(height, width[, 3])` uint8 by name, which are not part of the log: masks.
    view_row
        function that returns the data of the drawing on the page and by `Application.drawing`; called in a
        thread.
    live, events
        data for the live page, and events in this frame.
    """

    frame: Values = field(default_factory=dict)
    objects: Values = field(default_factory=dict)
    pictures: Mapping[str, Image] = field(default_factory=dict)
    view_row: Callable[[], Row] = dict
    live: Values = field(default_factory=dict)
    events: Sequence[Any] = ()


class File(AbstractContextManager[Any], Protocol):
    """A file of results that grows with the frames; an error in its block keeps what resuming needs."""

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""


@dataclass(frozen=True, eq=False)
class Sink:
    """Output that is written for every frame: `write` is called with the frame and its columns.

    `file` is the file that it writes, if any.
    """

    write: Callable[[Frame, Columns], None]
    file: File | None = None


@dataclass(frozen=True, eq=False)
class Output:
    """Output of sinks: a folder, and the frame rate.

    A resumed run continues after frame `resume_after` (0 for a new run); `log` has the rows until then.
    """

    folder: Path
    rate: float
    resume_after: int
    log: RowLog


class Engine(Protocol):
    """Engine of a run: returns results of a frame at once, or when later frames are known.

    Attributes
    ----------
    model
        whose chains' states are saved.
    state
        after the last frame with a result. A resumed run processes later frames again.
    """

    model: MultiChain
    state: RunState

    def step(self, frame: Frame) -> Sequence[Belief]:
        """Process a frame; return the beliefs of frames that have a result now, each once and in order."""

    def flush(self) -> Sequence[Belief]:
        """Return the beliefs of all other frames, after the last one."""


class Filter:
    """Recursive belief propagation from a state on, with a result for every frame at once."""

    def __init__(self, engine: RecursiveBP, state: RunState) -> None:
        self.model, self.state, self._engine = engine.model, state, engine

    def step(self, frame: Frame) -> Sequence[Belief]:
        """Process a frame, and return its belief."""
        belief = self._engine.step(self.state, frame)
        self.state = belief.state
        return (belief,)

    def flush(self) -> Sequence[Belief]:
        """Return nothing: all frames have a result."""
        return ()


class Start:
    """Start of a run: its job and opened source.

    Parameters
    ----------
    job, source, session
        options, opened source, and the run in its folder.
    saved, learned
        the run that is resumed, and the one of `--from`; otherwise `None`.
    blank_is_missing
        whether an image without contrast counts as missing.

    Attributes
    ----------
    source, interruption, notes
        the source, a received signal, and warnings for the summary, to which an application may add.
    seen
        the frames that were read from the source, with their errors.
    frames
        frames to process, up to a signal; `build` puts back those that it has read.
    before
        numbers of the frames before the start of the track, to which an application may add.
    """

    def __init__(
        self,
        job: FilmJob,
        source: Source,
        session: Session,
        saved: SavedRun | None,
        learned: SavedRun | None,
        blank_is_missing: bool,
    ) -> None:
        self.source, self.interruption, self.notes = source, session.interruption, session.notes
        self.seen = SeenFrames(self.interruption.items(source), blank_is_missing=blank_is_missing)
        self.frames: Iterator[Frame] = iter(self.seen)
        self.before: list[int] = []
        self._job, self._saved, self._learned = job, saved, learned
        if saved is not None:
            self.seen.blank.extend(saved.about["blank"])
            self.before.extend(saved.about["before"])
            if saved.shape is not None:  # perhaps no frame is left to ask
                source.size = (saved.shape[1], saved.shape[0])

    @property
    def blank(self) -> list[int]:
        """Numbers of the blank frames so far."""
        return self.seen.blank

    @property
    def resumed(self) -> bool:
        """Whether the run continues another one."""
        return self._saved is not None

    def memory(self, schema: Mapping[str, Any]) -> dict[str, Any] | None:
        """`Application.state_dict` of the run that is resumed, or of the one of `--from`.

        `None` in a new run.
        """
        saved = self._saved or self._learned
        return None if saved is None else saved.memory(schema)

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Inside, what is saved as plain JSON of another form is a ValueError that names the file."""
        try:
            yield
        except (TypeError, ValueError, LookupError) as error:
            assert self._saved is not None
            raise ValueError(f"{self._saved.path}: got another memory, {EXPECTED}") from error

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Inside, a ValueError in a run that goes on from another one's state names its file."""
        try:
            yield
        except ValueError as error:
            origin = self._saved or self._learned
            if origin is None:
                raise
            raise ValueError(f"{origin.path}: got a state that leads to: {error}, {EXPECTED}") from error

    def state(self, model: MultiChain) -> RunState:
        """Return the state of a model before the first frame."""
        if self._saved is not None:
            _log.info("continues after frame %d", self._saved.number)
            return self._saved.state(model.chains)
        if self._learned is None:
            return RunState()
        state = self._learned.state(model.chains)
        first = next(self.frames, None)
        if first is None:
            raise self.no_frame("holds no frame")
        self.frames = chain([first], self.frames)
        _log.info("starts with the state of %s", self._learned.path)
        return self._moved(state, self._learned, first)

    def filter(self, model: MultiChain) -> Filter:
        """Return the default engine."""
        return Filter(RecursiveBP(model), self.state(model))

    def no_frame(self, reason: str) -> Exception | Interrupted:
        """Return the error if there is no first frame: that of the source, a signal, or `reason`."""
        if self.seen.error is not None:
            return self.seen.error
        if self.interruption.signal is not None:
            return Interrupted(self.interruption.signal)
        return ValueError(f"{self.source.name}: {reason}")

    def _moved(self, state: RunState, learned: SavedRun, first: Frame) -> RunState:
        """The state of another film, just before the first frame of this one.

        Recordings are taken to follow each other without a gap; between two live sources, what the clock
        says has passed.
        """
        source = self.source
        if not state.states or state.shape is None:
            raise ValueError(f"--from: {learned.path} has no state yet")
        width, height = source.size
        shape = (height, width, *state.shape[2:]) if first.image is None else first.image.shape
        if shape != state.shape:
            raise ValueError(
                f"--from: {learned.path} is of frames that are {describe(state.shape)}, "
                f"but {source.name} is {describe(shape)}"
            )
        gap = self._job.step / source.rate
        if source.live and learned.about["live"]:
            gap = max(gap, time.time() - learned.about["clock"])
        return replace(state, number=0, time=first.time - gap)


class Application(ABC, Generic[F]):
    """Base class of applications: model, columns, files and page of a run.

    Attributes
    ----------
    name
        of the application.
    schema
        schema of `state_dict`, for `rsmcm.inference.engine.checkpoint`.
    blank_is_missing
        whether blank frames (black, saturated) count as missing.
    settings
        settings that the results depend on, apart from the source; recorded with them.
    """

    name: ClassVar[str]
    schema: ClassVar[Mapping[str, Any]] = {}
    blank_is_missing: ClassVar[bool] = True

    def __init__(self, job: F) -> None:
        self.job = job
        self.settings = job.settings()

    @property
    def files(self) -> Sequence[str]:
        """Names of the files that it writes, or glob patterns."""
        return ()

    @abstractmethod
    def build(self, start: Start) -> Engine:
        """Build the model, with its state before the first frame."""

    @abstractmethod
    def columns(self, belief: Belief) -> Columns:
        """Return the columns of a frame; there are no states if all frames so far are missing."""

    def sinks(self, output: Output) -> Sequence[Sink]:
        """Return further outputs that are written for every frame."""
        return ()

    def finish(self, log: RowLog) -> Mapping[str, Any]:
        """Write files at the end of the run; return further entries of `summary.json`."""
        return {}

    def page(self, log: RowLog, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Return the page, with the video if there was an image; by default plots of all columns."""
        plots = [Plot(name, "", [Line(log[name])]) for name in log.numbers]
        return FrameRecord(log).page(self.title(summary["source"]), summary, film, plots=plots)

    def drawing(self) -> Draw:
        """Return a function that draws `Columns.view_row` on frames, for `--video` and `--live`."""
        return lambda image, *_, **__: image

    def state_dict(self) -> dict[str, Any]:
        """State of the application that is saved with the states of the chains."""
        return {}

    def bytes_needed(self, source: Source) -> tuple[float, float]:
        """Bytes of working memory: per pixel, and constant; see `check_memory`."""
        return 0.0, 0.0

    def title(self, source: str) -> str:
        """Of the page, given the name of the source."""
        return f"{Path(source).name}: {self.name}"

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """A summary in a few lines."""
        return [f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second"]


class _EndedEarlyError(Exception):
    """Leaves the sinks' blocks in a way that they keep what a resumed run needs."""


def run_film(application: Application[Any]) -> Outcome:
    """Run an application; all results are in the folder of the job afterwards.

    SIGINT (Ctrl-C) and SIGTERM end the run after the current frame, with complete results; a second one ends
    it at once, with results up to the last saved state.

    Raises
    ------
    ValueError, OSError
        in one line, for any error of the job, its files, its source or its output. If a video cannot be read
        on, the results of the earlier frames remain.
    Interrupted
        if a signal came before there was any result, or a second one.
    """
    job = application.job
    session = Session(application.name, job, application.settings)
    with session.running():
        if job.live is None:
            return _FilmRun(application, session).run()
        from ..view.live import Running, live_page  # and a server of HTTP

        live = Running(job.out)
        with live_page(read_address(job.live), live) as where:
            print(f"live: {where}", flush=True)
            outcome = _FilmRun(application, session, live).run()
            live.end(outcome.words)
        return outcome


class _FilmRun:
    """One run: `run` from the source to the summary, `_answer_all` is the loop."""

    def __init__(
        self, application: Application[Any], session: Session, live: "Running | None" = None
    ) -> None:
        self._application, self._session, self._live = application, session, live
        self._job: FilmJob = application.job
        self._start: Start
        self._engine: Engine

    def run(self) -> Outcome:
        """Take in all frames, and write the results."""
        application, session, job = self._application, self._session, self._job
        saved = self._saved()
        after = 0 if saved is None else saved.number
        done = None if saved is None else saved.about["finished"]

        def fits(source: Source) -> None:
            if not done:
                check_memory(source.name, source.size, *application.bytes_needed(source))

        with open_source(
            job.source, job.start, job.stop, job.step, after=after, reconnect=job.reconnect, fits=fits
        ) as source:
            session.fingerprint = source.fingerprint()
            if job.resume and source.live:
                raise ValueError(f"--resume: {source.name} is live and cannot be read again")
            session.live = source.live
            if source.live:
                session.resume_hint = f"--from {job.out / STATE} starts with its state"
            if saved is not None:
                check_source(saved.about, session.fingerprint)
                if done:
                    return session.outcome(done, words_of(saved.path, done, application.in_words))
                session.earlier_seconds = saved.about["seconds"]
                session.notes.extend(saved.about["notes"])
            learned = None
            if saved is None and job.learned is not None:
                learned = SavedRun(job.learned, application.name)
            blank_is_missing = application.blank_is_missing
            self._start = Start(job, source, session, saved, learned, blank_is_missing)
            self._engine = application.build(self._start)
            session.begin_results([*application.files, f"{COLUMNS}/*.npy"])
            if self._live is not None:
                self._live.begin(application.title(source.name), source.n_frames, lambda: source.stream)
            with RowLog(job.out / COLUMNS, self._engine.state.number) as log:
                with suppress(_EndedEarlyError):
                    self._answer_all(log)
                if session.interruption.signal is not None and not len(log):
                    raise Interrupted(session.interruption.signal)
                if self._live is not None:
                    self._live.finish()
                summary = self._concluded(log)
                write_json(job.out / "summary.json", summary)
                if not session.ended_early:
                    self._save(finished=summary)
        outcome = session.outcome(summary, application.in_words(summary))
        if self._start.seen.error is not None:
            raise self._start.seen.error
        return outcome

    def _answer_all(self, log: RowLog) -> None:
        """Take in frame after frame, and have all sinks write what is answered."""
        application, session, engine = self._application, self._session, self._engine
        frames, source = self._start.frames, self._start.source
        with ExitStack() as stack:
            progress = stack.enter_context(Progress(application.name, source.n_frames, len(log)))
            self._save()
            sinks = self._sinks(log)
            files = [sink.file for sink in sinks if sink.file is not None]
            for file in files:
                stack.enter_context(file)

            def write(belief: Belief, seconds: float) -> None:
                columns, frame = application.columns(belief), belief.frame
                log.append(
                    {
                        "number": np.int64(frame.number),
                        "time": np.float64(frame.time),
                        "missing": np.bool_(frame.missing),
                        "seconds": np.float64(seconds),
                        **columns.frame,
                    },
                    columns.objects,
                )
                for sink in sinks:
                    sink.write(frame, columns)
                progress.update()

            def checkpoint() -> None:
                log.checkpoint()
                for file in files:
                    file.checkpoint()
                self._save()
                _log.info("state saved after frame %d", engine.state.number)

            unsaved, spent = 0, 0.0
            for frame in frames:
                began = work_clock()
                with self._start.going_on():
                    answered = engine.step(frame)
                spent += work_clock() - began
                for belief in answered:
                    write(belief, spent / len(answered))
                if answered:
                    unsaved, spent = unsaved + len(answered), 0.0
                if unsaved >= self._job.every:
                    checkpoint()
                    unsaved = 0
            error, signal = self._start.seen.error, session.interruption.signal
            session.ended_early = bool(signal is not None or error is not None or source.lost)
            # frames that are still held back will be answered better by a run that is resumed
            resumable = session.ended_early and not source.live
            if resumable:
                checkpoint()
            for belief in engine.flush():
                write(belief, spent)
                spent = 0.0
            if resumable:
                raise _EndedEarlyError
            checkpoint()

    def _sinks(self, log: RowLog) -> list[Sink]:
        """Those of the application, the page's film, and who looks on meanwhile."""
        job, live = self._job, self._live
        rate, after = self._start.source.rate / job.step, self._engine.state.number
        film = FilmWriter(job.out, rate, after)
        sinks = [
            *self._application.sinks(Output(job.out, rate, after, log)),
            Sink(lambda frame, columns: film.add(frame, columns.view_row), film),
        ]
        video = job.video or segments_of(job.out / OVERLAY)  # a run that is resumed goes on with it
        if live is not None or video:
            path = job.out / OVERLAY if video else None
            show = None if live is None else live.show
            pictures = OverlayVideo(path, rate, self._application.drawing(), after, show)
            sinks.append(Sink(lambda frame, columns: pictures.add(frame, columns.view_row), pictures))
        if live is not None:
            on_frame = live.on_frame
            sinks.append(
                Sink(lambda frame, columns: on_frame(frame, columns.live, [*map(str, columns.events)]))
            )
        return sinks

    def _saved(self) -> SavedRun | None:
        """The run to be resumed; `None` if it has not come beyond its beginning."""
        path = self._job.out / STATE
        if not self._job.resume or not path.exists():
            return None
        saved = SavedRun(path, self._application.name, self._application.settings)
        self._session.saved = bool(saved.number)
        return saved if saved.number else None

    def _save(self, finished: dict[str, Any] | None = None) -> None:
        start, state, application = self._start, self._engine.state, self._application
        about = {
            **self._session.about(finished),
            "live": start.source.live,
            "clock": time.time(),
            "before": start.before,
            "blank": [number for number in start.seen.blank if number <= state.number],
            "notes": self._session.notes,
        }
        save_run(
            self._job.out / STATE,
            about,
            state,
            self._engine.model.chains,
            application.state_dict(),
            application.schema,
        )
        self._session.saved = True

    def _concluded(self, log: RowLog) -> dict[str, Any]:
        """Write what is written once, and the page; the content of `summary.json`."""
        application, session, start, source = (
            self._application,
            self._session,
            self._start,
            self._start.source,
        )
        facts = {
            name: value.tolist() if isinstance(value, np.generic | np.ndarray) else value
            for name, value in application.finish(log).items()
        }
        seconds, count = session.seconds(), len(log)
        numbers, missing = log["number"], log["missing"]
        of_engine = float(log["seconds"].sum())
        summary = session.summary(
            source.name,
            numbers.tolist(),
            numbers[missing].tolist(),
            {
                "size": list(source.size),
                "rate": source.rate,
                "missing_frames": int(np.count_nonzero(missing)),
                "truncated": source.truncated,
                "stream": source.stream,
                **(
                    {"before_the_start": start.before, "blank": start.seen.blank}
                    if application.blank_is_missing
                    else {}
                ),
                **facts,
                "seconds": seconds,
                "frames_per_second": count / seconds,
                "frames_per_second_of_engine": count / of_engine if count else None,
                "threads": thread_count(),
                "seed": self._job.seed,
                "notes": [*source.notes, *session.notes, *facts.get("notes", [])],
            },
        )
        out = self._job.out
        film = read_film(out) if (out / FILM_ROWS).exists() else None  # or there was no image
        earlier = fitting(out / FILM_ROWS, f"expected the film of rsmcm {application.name}")
        with earlier if start.resumed else nullcontext():
            page = application.page(log, film, summary)
        write_page(out / VIEW, page)
        return summary
