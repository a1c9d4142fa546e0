"""What a reader of one kind of source is, and which of its frames are wanted."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ....models.core.frame import Frame

DEFAULT_RATE = 25.0  # frames per second, where nothing states one


@dataclass(frozen=True)
class Selection:
    """Which frames of the source are wanted (1-based, both ends included)."""

    start: int = 1
    stop: int | None = None
    step: int = 1
    after: int = 0

    def __post_init__(self) -> None:
        if self.start < 1:
            raise ValueError(f"start: got {self.start}, expected 1 or more (frames count from 1)")
        if self.step < 1:
            raise ValueError(f"step: got {self.step}, expected 1 or more")
        if self.stop is not None and self.stop < self.start:
            raise ValueError(f"stop: got {self.stop}, expected {self.start} (start) or more")

    def __contains__(self, number: int) -> bool:
        return (
            number >= self.start
            and number > self.after
            and not self.ended(number)
            and (number - self.start) % self.step == 0
        )

    def ended(self, number: int) -> bool:
        """Whether neither this frame nor any after it is wanted."""
        return self.stop is not None and number > self.stop

    def numbers(self, total: int) -> range:
        """Return the selected numbers of a source of `total` frames, those up to `after` included."""
        return range(self.start, (total if self.stop is None else min(total, self.stop)) + 1, self.step)


@dataclass(frozen=True)
class Gap:
    """A stretch without pictures in a live source: its connection was lost, and came back.

    `lost_at` and `back_after` are s, from the first picture and from the last one before the loss; `frames`
    are missing in between, at the source's rate.
    """

    lost_at: float
    back_after: float
    frames: int
    reason: str

    def __str__(self) -> str:
        return f"at {self.lost_at:.1f} s for {self.back_after:.1f} s, {self.frames} frames ({self.reason})"


class Reader(ABC):
    """One kind of source: decodes the selected frames in order, in the thread that iterates.

    Attributes
    ----------
    name, kind, live, rate, truncated, counted, pictures
        as of `Source`.
    header_size
        `(width, height)` px, 0 where only a picture tells.
    total
        frames in the whole source as far as it is stated.
    last_number
        of the last frame seen, also of those not selected.
    lost
        why the connection is lost permanently; `None` as long as it is not.
    gaps
        in which the connection was lost, so far.
    notes
        warnings, one sentence each.
    """

    name: str
    kind: str
    rate: float
    header_size: tuple[int, int] = (0, 0)
    live = False
    total: int | None = None
    counted = False
    truncated = False
    last_number = 0
    lost: str | None = None
    gaps: Sequence[Gap] = ()
    notes: Sequence[str] = ()
    pictures: Sequence[str] = ()

    @abstractmethod
    def frames(self, selection: Selection, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the selected frames, until the event is set at most."""

    @abstractmethod
    def fingerprint(self) -> dict[str, Any]:
        """Return what identifies the source, as JSON."""

    def close(self) -> None:  # noqa: B027
        """Release the file or device."""
