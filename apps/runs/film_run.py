"""A run over the frames of a film: what is read, saved and written, and in which order.

All applications that filter frame after frame run this way. They differ in their chains, in what has to be
known before the first frame, and in what they write.
"""

import logging
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from ...inference import Belief, RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models.core.frame import Frame
from ...models.numerics.threads import thread_count
from ..drawing.overlay import Draw, OverlayVideo
from ..io.files import write_json
from ..io.film import SeenFrames
from ..io.segments import segments_of
from ..io.sources.open_source import Source, describe, open_source
from ..live.address import read_address
from ..live.running import Running
from ..live.server import live_page
from ..options.job import FilmJob
from ..view.film import ROWS, Film, FilmWriter, Row, read_film
from ..view.page import VIEW, Page, write_page
from .interruption import Interrupted, Outcome
from .memory import check_memory
from .progress import Progress
from .run import OVERLAY, Run
from .saved_run import STATE, SavedRun, check_source

_log = logging.getLogger(__name__)

F = TypeVar("F", bound=FilmJob)


class Writer(AbstractContextManager[Any], Protocol):
    """A file of results that grows with the frames, and can be gone on with after a checkpoint."""

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""


@dataclass(frozen=True, eq=False)
class Step:
    """A frame that was taken in.

    Parameters
    ----------
    belief
        after the frame.
    found
        what was read from it.
    seconds
        that both took.
    """

    belief: Belief
    found: Any
    seconds: float


class _EndedEarlyError(Exception):
    """Leaves the writers' blocks in a way that they keep what a resumed run needs."""


class FilmRun(Run[F]):
    """One run, frame after frame; an application says what is particular to it.

    Attributes
    ----------
    source, engine, state
        as they are while the run goes on; `state` is that after the last frame that is answered.
    record
        what page and summary need, with columns `numbers`, `missing` and `seconds` of the frames so far.
    before
        numbers of the frames before the one in which the track starts.
    news
        lines about what has happened in the last frame, for the live page.
    """

    blank_is_missing: ClassVar[bool] = True
    """Whether frames that show nothing (black, saturated) count as missing."""

    source: Source
    engine: RecursiveBP
    record: Any

    def __init__(self, job: F) -> None:
        super().__init__(job)
        self.state = RunState()
        self.before: list[int] = []
        self.news: Sequence[str] = ()
        self._running: Running | None = None  # where somebody may look
        self._frames = SeenFrames(iter(()))
        self._unsaved = 0  # frames answered since the last saved state

    # --- what an application says ---

    @property
    @abstractmethod
    def kinds(self) -> Mapping[str, Any]:
        """What `memory` consists of, for `checkpoint`."""

    @property
    @abstractmethod
    def chains(self) -> Mapping[str, Any]:
        """Its chains, or their classes, by name, whose states are saved."""

    @property
    @abstractmethod
    def bytes_needed(self) -> tuple[float, float]:
        """Of working memory: per pixel, and beside that; see `check_memory`."""

    @abstractmethod
    def memory(self) -> dict[str, Any]:
        """What is saved beside the chains' states."""

    @abstractmethod
    def begin(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Find what has to be known before the first frame, and make the engine; frames that were looked at
        come again."""

    @abstractmethod
    def go_on(self, memory: Mapping[str, Any]) -> None:
        """Make the engine from what was saved by a run that this one resumes."""

    @abstractmethod
    def learn_from(self, saved: SavedRun) -> None:
        """Make the engine from what a run over another film has learned."""

    @abstractmethod
    def writers(self, rate: float, after: int) -> Sequence[Writer]:
        """Files that grow with the frames, at `rate` frames a second, of those behind frame `after`."""

    def known(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The source's frames with what is known of them beforehand."""
        return frames

    def found(self, belief: Belief) -> Any:
        """What is read from a belief, as part of the time of the frame."""
        return belief

    def answered(self, steps: Iterator[Step]) -> Iterator[Step]:
        """The frames as they are answered, in their order, each once.

        An application that waits for what later frames say holds some back, without anything that is large.
        What it holds is not saved: a run that is resumed takes these frames in again.
        """
        return steps

    @abstractmethod
    def take_in(self, belief: Belief, found: Any, seconds: float) -> None:
        """Write a frame, which took so many seconds."""

    def drawn(self, belief: Belief, found: Any) -> Callable[[], Row]:
        """What makes that which `view.html` draws on a frame; called in a thread."""
        return dict

    @abstractmethod
    def drawing(self) -> Draw:
        """What draws the rows of `drawn` on frames, for `--video` and `--live`."""

    def told(self, belief: Belief, found: Any) -> Mapping[str, object]:
        """What the live page says of a frame; called for every one of them."""
        return {}

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """What `summary.json` says beside what it says of every run."""

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write what is written once, at the end."""

    @property
    def title(self) -> str:
        """Of the pages about the run."""
        return f"{Path(self.source.name).name}: {self.application}"

    @abstractmethod
    def page(self, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """What is on `view.html`, with the film if there was any image."""

    # --- the run ---

    def way_on(self) -> str | None:
        """How the run goes on when it is interrupted: a live source cannot be resumed."""
        way = super().way_on()
        if way is not None and not self.job.resume and self.source.live:
            return f"--from {self.job.out / STATE} begins with what was learned"
        return way

    def work(self) -> Outcome:
        """Take in all frames, and write the results; the live page shows it."""
        if self.job.live is None:
            return self._work()
        self._running = Running(self.job.out)
        with live_page(read_address(self.job.live), self._running) as where:
            print(f"live: {where}", flush=True)
            outcome = self._work()
            self._running.end(outcome.words)
        return outcome

    def _work(self) -> Outcome:
        job = self.job
        saved = self._saved() if job.resume else None
        self._is_saved = saved is not None
        after = saved.state.number if saved else 0
        with open_source(
            job.source, job.start, job.stop, job.step, after=after, reconnect=job.reconnect
        ) as source:
            self.source = source
            self.fingerprint = source.fingerprint()
            if job.resume and source.live:
                raise ValueError(f"--resume: {source.name} is live and cannot be read again")
            if saved is not None:
                check_source(saved.about, self.fingerprint)
                if saved.about["finished"]:
                    return self.outcome(saved.about["finished"])
            check_memory(source.name, source.size, *self.bytes_needed)
            frames = self._beginning(saved)
            self.begin_results()
            if self._running is not None:
                self._running.begin(self.title, source.n_frames, lambda: source.stream)
            with suppress(_EndedEarlyError):
                self._process(frames)
            if self.interruption.signal is not None and not self.record.numbers:
                raise Interrupted(self.interruption.signal)
            if self._running is not None:
                self._running.finish()
            summary = self._film_summary()
            self.finish(summary)
            self._write_page(summary)
            write_json(job.out / "summary.json", summary)
            if not self._ended_early:
                self._save(finished=summary)
        if self._frames.error is not None:
            raise self._frames.error
        return self.outcome(summary, signalled=self._ended_early)

    def _write_page(self, summary: Mapping[str, Any]) -> None:
        out = self.job.out
        film = read_film(out) if (out / ROWS).exists() else None  # or there was no image
        write_page(out / VIEW, self.page(film, summary))

    def no_frame(self, reason: str) -> Exception | Interrupted:
        """Why there is no frame to begin with: the source's own error, a signal, or `reason`."""
        if self._frames.error is not None:
            return self._frames.error
        if self.interruption.signal is not None:
            return Interrupted(self.interruption.signal)
        return ValueError(f"{self.source.name}: {reason}")

    @property
    def blank(self) -> list[int]:
        """Numbers of the frames so far in which nothing is to be seen."""
        return self._frames.blank

    def _saved(self) -> SavedRun | None:
        """The run to be resumed; `None` if it has not come beyond its beginning."""
        path = self.job.out / STATE
        if not path.exists():
            return None
        saved = SavedRun.load(path, self.application, self.chains, self.kinds, self.settings)
        return saved if saved.state.number else None

    def _beginning(self, saved: SavedRun | None) -> Iterator[Frame]:
        """The frames to process, with the engine made."""
        self._frames = SeenFrames(
            self.known(self.interruption.items(self.source)), blank_is_missing=self.blank_is_missing
        )
        frames = iter(self._frames)
        if saved is not None:
            self.state = saved.state
            self._earlier_seconds = saved.about["seconds"]
            self._frames.blank.extend(saved.about["blank"])
            self.before = saved.about["before"]
            self.notes.extend(saved.about["notes"])
            if self.state.shape is not None:  # perhaps no frame is left to ask
                self.source.size = (self.state.shape[1], self.state.shape[0])
            self.go_on(saved.memory)
            _log.info("goes on after frame %d", self.state.number)
            return frames
        if self.job.learned is None:
            return self.begin(frames)
        learned = SavedRun.load(self.job.learned, self.application, self.chains, self.kinds)
        first = next(frames, None)
        if first is None:
            raise self.no_frame("holds no frame")
        self.state = self._moved(learned, first)
        _log.info("begins with what %s has learned", self.job.learned)
        self.learn_from(learned)
        return chain([first], frames)

    def _moved(self, learned: SavedRun, first: Frame) -> RunState:
        """The state of another film, just before the first frame of this one.

        Recordings are taken to follow each other without a gap; between two live sources, what the clock
        says has passed.
        """
        state, source = learned.state, self.source
        if not state.states or state.shape is None:
            raise ValueError(f"--from: {self.job.learned} has learned nothing yet")
        width, height = source.size
        shape = (height, width, *state.shape[2:]) if first.image is None else first.image.shape
        if shape != state.shape:
            raise ValueError(
                f"--from: {self.job.learned} is of frames that are {describe(state.shape)}, "
                f"but {source.name} is {describe(shape)}"
            )
        gap = self.job.step / source.rate
        if source.live and learned.about["live"]:
            gap = max(gap, time.time() - learned.about["clock"])
        return replace(state, number=0, time=first.time - gap)

    def _process(self, frames: Iterator[Frame]) -> None:
        """Take in all frames, and complete the files that grow with them."""
        job, number = self.job, self.state.number
        with ExitStack() as stack:
            done = len(self.record.numbers)
            progress = stack.enter_context(Progress(self.application, self.source.n_frames, done))
            self._save()
            rate = self.source.rate / job.step
            film = FilmWriter(job.out, rate, number)
            writers = [*self.writers(rate, number), film]
            video = self._video(rate, number)
            if video is not None:
                writers.append(video)
            for writer in writers:
                stack.enter_context(writer)
            for step in self.answered(self._steps(frames, writers)):
                self._answer(step, film, video)
                progress.update()
            if self._ended_early and not self.source.live:  # which nobody can resume
                raise _EndedEarlyError
            self._checkpoint(writers)

    def _steps(self, frames: Iterator[Frame], writers: Sequence[Writer]) -> Iterator[Step]:
        """Take in frame after frame; when the next one is asked for, all that was answered is written."""
        state = self.state
        for frame in frames:
            before = time.perf_counter()
            belief = self.engine.step(state, frame)
            found = self.found(belief)
            state = belief.state
            yield Step(belief, found, time.perf_counter() - before)
            if self._unsaved >= self.job.every:
                self._checkpoint(writers)
        self._ended_early = bool(
            self.interruption.signal is not None or self._frames.error or self.source.lost
        )
        if self._ended_early and not self.source.live:
            # frames that are still held back will be answered better by a run that is resumed
            self._checkpoint(writers)

    def _video(self, rate: float, after: int) -> OverlayVideo | None:
        """The video that is asked for, and what the live page shows."""
        path: Path | None = self.job.out / OVERLAY
        if not (
            self.job.video or segments_of(self.job.out / OVERLAY)
        ):  # a run that is resumed goes on with it
            path = None
        show = None if self._running is None else self._running.show
        if path is None and show is None:
            return None
        return OverlayVideo(path, rate, self.drawing(), after, show)

    def _answer(self, step: Step, film: FilmWriter, video: OverlayVideo | None) -> None:
        """Write a frame, and show it."""
        belief, found = step.belief, step.found
        self.state = belief.state
        self.take_in(belief, found, step.seconds)
        drawn = self.drawn(belief, found)
        film.add(belief.frame, drawn)
        if video is not None:
            video.add(belief.frame, drawn)
        if self._running is not None:
            self._running.take_in(belief.frame, self.told(belief, found), self.news)
        self._unsaved += 1

    def _checkpoint(self, writers: Sequence[Writer]) -> None:
        for writer in writers:
            writer.checkpoint()
        self._save()
        self._unsaved = 0
        _log.info("state saved after frame %d", self.state.number)

    def _save(self, finished: dict[str, Any] | None = None) -> None:
        about = {
            **self.about(finished),
            "live": self.source.live,
            "clock": time.time(),
            "before": self.before,
            "blank": [number for number in self.blank if number <= self.state.number],
            "notes": self.notes,
        }
        SavedRun(about, self.state, self.memory()).save(self.job.out / STATE, self.chains, self.kinds)
        self._is_saved = True

    def _film_summary(self) -> dict[str, Any]:
        source, record, seconds = self.source, self.record, self.seconds()
        count = len(record.numbers)
        facts = self.facts()
        about_film = {
            "size": list(source.size),
            "rate": source.rate,
            "missing_frames": len(record.missing),
            "truncated": source.truncated,
            "stream": source.stream,
            **({"before_the_start": self.before, "blank": self.blank} if self.blank_is_missing else {}),
            **facts,
            "seconds": seconds,
            "frames_per_second": count / seconds,
            "frames_per_second_of_engine": count / sum(record.seconds) if count else None,
            "threads": thread_count(),
            "seed": self.job.seed,
            "notes": [*source.notes, *self.notes, *facts.get("notes", [])],
        }
        return self.summary(source.name, record.numbers, record.missing, about_film)
