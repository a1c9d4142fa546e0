"""Ctrl-C ends a run with complete results of what was done."""

import signal
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any, ClassVar, Self, TypeVar

T = TypeVar("T")

SIGNALLED = 128
"""Exit code of what a signal ended, plus the signal's number: 130 for Ctrl-C."""


@dataclass(frozen=True)
class Outcome:
    """Result of a run: its `summary.json`, also in `words`, and the signal that ended it, if any."""

    summary: dict[str, Any]
    signal: int | None
    words: Sequence[str] = ()

    @property
    def lost(self) -> str | None:
        """Why the camera or stream was lost permanently; otherwise `None`."""
        stream = self.summary.get("stream")
        return None if stream is None else stream["lost"]

    @property
    def nothing(self) -> str | None:
        """Message if there is no result; otherwise `None`."""
        diagnosis = self.summary.get("diagnosis")
        return None if diagnosis is None else diagnosis["missing"]


class Interrupted(KeyboardInterrupt):
    """A signal, by its number, has ended a run at once; it says what there is of the run."""

    def __init__(self, signal: int, what: str = "interrupted before there was any result") -> None:
        super().__init__(what)
        self.signal = signal


class Interruption:
    """Ctrl-C (SIGINT) and SIGTERM as a question that is asked between frames or rounds.

    Inside its block, the first signal only ends `items`; while that waits for the next one, at once. Before
    the first item nothing has been done yet, and a signal is an `Interrupted`; so is a second one, wherever
    it arrives. Outside the main thread, signals are left alone.

    Attributes
    ----------
    heeded
        signals that are heard; in a process that works for another one, Ctrl-C is that one's.
    signal
        number of the signal that arrived; `None` as long as none did.
    """

    heeded: ClassVar[Sequence[signal.Signals]] = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self.signal: int | None = None
        self._waiting = True
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in self.heeded:
                self._before[number] = signal.signal(number, self._arrive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def items(self, source: Iterator[T]) -> Iterator[T]:
        """What the source yields until it ends or a signal arrives."""
        while self.signal is None:
            try:
                self._waiting = True
                item = next(source)
                self._waiting = False
            except StopIteration:
                return
            except Interrupted:
                return
            finally:
                self._waiting = False
            yield item

    def _arrive(self, number: int, _: FrameType | None) -> None:
        again = self.signal is not None
        self.signal = number
        if again or self._waiting:
            self._waiting = False
            raise Interrupted(number)
