"""A film as a sequence that is read again for every pass, and its frames that show nothing."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Self, overload

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import LazyFrames
from ...models.core.frame import Frame
from ...models.core.pictures import grey_of
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
    """

    def __init__(
        self, open_again: Callable[[], Source], passing: Callable[[Iterator[Frame]], Iterator[Frame]] = iter
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


LEAST_CONTRAST = 8
"""Grey levels between the darker and the brighter part of a frame, below which nothing is seen in it."""


def is_blank(image: NDArray[np.uint8]) -> bool:
    """Whether a frame is black, saturated or otherwise without contrast, so that nothing is seen in it."""
    darker, brighter = np.percentile(grey_of(image[::4, ::4]), (2, 98))
    return bool(brighter - darker < LEAST_CONTRAST)


class SeenFrames:
    """The frames of a source until it ends, or breaks, with blank ones as missing if `blank_is_missing`.

    Attributes
    ----------
    blank
        numbers of the frames so far that were blank.
    error
        by which the source broke in the middle, if it did: told when the results until there are complete.
    """

    def __init__(self, frames: Iterator[Frame], *, blank_is_missing: bool = True) -> None:
        self._frames = frames
        self._blank_is_missing = blank_is_missing
        self.blank: list[int] = []
        self.error: Exception | None = None

    def __iter__(self) -> Iterator[Frame]:
        try:
            for frame in self._frames:
                if self._blank_is_missing and frame.image is not None and is_blank(frame.image):
                    self.blank.append(frame.number)
                    yield replace(frame, image=None, keypoints=None)  # of what is not seen
                else:
                    yield frame
        except (ValueError, OSError) as error:
            self.error = error
