"""A film that is read again for every pass over it, so that its length costs no memory."""

from collections.abc import Callable, Iterator
from typing import Self, overload

from ...inference.core.sequence import LazyFrames
from ...models.core.frame import Frame
from .sources.open_source import Source


class Film(LazyFrames):
    """The frames of a source as a sequence: decoded when they are asked for, and one of them held.

    Asked for forwards, a frame is decoded once; asked for an earlier one, the source is opened again. It is
    read through once in the beginning, to know its frames' times: what a header says of them may be wrong.

    Parameters
    ----------
    open_again
        opens the source, which gives the same frames every time.
    passing
        wraps the frames of a pass, to show progress, or end it.

    Attributes
    ----------
    error
        by which the source breaks in the middle, where the film ends; `None` if it does not.

    Raises
    ------
    ValueError, OSError
        as opening does.
    """

    def __init__(
        self,
        open_again: Callable[[], Source],
        passing: Callable[[Iterator[Frame]], Iterator[Frame]] = iter,
    ) -> None:
        self._open_again = open_again
        self._passing = passing
        self._source: Source | None = None
        self._frames: Iterator[Frame] = iter(())
        self._held: Frame | None = None
        self._index = -1
        self.error: Exception | None = None
        self._times: list[float] = []
        self._begin()
        try:
            self._times.extend(frame.time for frame in self._frames)
        except (ValueError, OSError) as error:
            if not self._times:
                raise
            self.error = error
        self._begin()

    def __len__(self) -> int:
        return len(self._times)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        numbers = range(len(self))[index]  # which raises IndexError beyond the end
        if isinstance(numbers, range):
            return [self[number] for number in numbers]
        if numbers < self._index:
            self._begin()
        while self._index < numbers:
            self._held = next(self._frames)
            self._index += 1
        assert self._held is not None
        return self._held

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def time(self, index: int) -> float:
        """`Frame.time` of a frame."""
        return self._times[index]

    def close(self) -> None:
        """Stop decoding."""
        if self._source is not None:
            self._source.close()

    def _begin(self) -> None:
        self.close()
        self._source = self._open_again()
        self._frames = self._passing(self._source)
        self._held, self._index = None, -1
