"""Frames with what a detector finds in them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ....models.core.frame import Frame, GivenBoxes
from ..sources.open_source import Source
from .read import read_detections
from .table import Detections


def with_boxes(frames: Iterable[Frame], detector: Callable[[Frame], Any], every: int = 1) -> Iterator[Frame]:
    """Frames with the boxes that a detector finds in them.

    Parameters
    ----------
    frames
        in order, as `open_source` gives them; one without an image stays without boxes.
    detector
        is called with a frame. It returns what `GivenBoxes.of` takes (`supervision.Detections`, an array
        `(n, 4)` to `(n, 6)`), or `None`: it has not looked. `Detections` of a file are such a detector.
    every
        it is called for every so many frames with an image, the first among them.

    Raises
    ------
    ValueError
        if `every` is below 1; or naming the frame, if what the detector returns are no boxes.
    TypeError
        if the detector cannot be called, or what comes are no frames.
    """
    return with_found(
        frames, detector, every, lambda frame, found: replace(frame, boxes=GivenBoxes.of(found))
    )


def with_found(
    frames: Iterable[Frame],
    detector: Callable[[Frame], Any],
    every: int,
    taken: Callable[[Frame, Any], Frame],
) -> Iterator[Frame]:
    """Frames with what a detector finds in them, which `taken` puts into each; as `with_boxes` otherwise."""
    if every < 1:
        raise ValueError(f"every: got {every}, expected 1 or more frames")
    if not callable(detector):
        raise TypeError(f"detector: got {type(detector).__name__}, expected something to call with a frame")
    return _attached(frames, detector, every, taken)


def _attached(
    frames: Iterable[Frame],
    detector: Callable[[Frame], Any],
    every: int,
    taken: Callable[[Frame, Any], Frame],
) -> Iterator[Frame]:
    count = 0
    for frame in frames:
        if not isinstance(frame, Frame):
            raise TypeError(f"frames: got {type(frame).__name__}, expected Frame, as open_source gives them")
        found = None
        if frame.image is not None:
            found = detector(frame) if count % every == 0 else None
            count += 1
        if found is None:
            yield frame
            continue
        try:
            known = taken(frame, found)
        except ValueError as error:
            raise ValueError(f"frame {frame.number}: {error}") from None
        yield known


def given_boxes(
    path: Path | None, classes: Sequence[str], source: Source, start: int, stop: int | None, step: int
) -> Detections | None:
    """Read what a detector has found in a source, if that is given, and make sure that it belongs to it.

    Parameters
    ----------
    path, classes
        as of `read_detections`; without a path there is nothing.
    source
        opened.
    start, stop, step
        which of its frames are taken.

    Raises
    ------
    ValueError
        if the source is live, or they are of frames or places that it does not have.
    """
    if path is None:
        return None
    if source.live:
        raise ValueError(f"--detections: {source.name} is live, so nobody has seen its frames before")
    found = read_detections(path, classes, film=source.name, pictures=source.pictures)
    found.check(source.name, source.size, last_frame(source, start, stop, step))
    return found


def last_frame(source: Source, start: int, stop: int | None, step: int) -> int | None:
    """Number of the last frame of a source of which some are taken; `None` if that is not known."""
    if source.n_frames is None or not source.counted:
        return None
    last = start + source.n_frames * step - 1
    return None if stop is not None and stop <= last else last  # the film may go on behind it
