"""Frames with the points that a detector finds of persons in them."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from ....models.core.frame import Frame
from ....models.core.keypoints import GivenKeypoints
from ..detections.attached import last_frame, with_found
from ..sources.open_source import Source
from .read import read_keypoints
from .table import Keypoints


def with_keypoints(
    frames: Iterable[Frame], detector: Callable[[Frame], Any], every: int = 1
) -> Iterator[Frame]:
    """Frames with the points that a detector of poses or hands finds in them.

    Parameters
    ----------
    frames
        in order, as `open_source` gives them; one without an image stays without points.
    detector
        is called with a frame. It returns what `GivenKeypoints.of` takes, or `None`: it has not looked.
        `Keypoints` of a file are such a detector.
    every
        it is called for every so many frames with an image, the first among them.

    Raises
    ------
    ValueError
        if `every` is below 1; or naming the frame, if what the detector returns are no points.
    TypeError
        if the detector cannot be called, or what comes are no frames.
    """

    def taken(frame: Frame, found: Any) -> Frame:
        return replace(frame, keypoints=GivenKeypoints.of(found))

    return with_found(frames, detector, every, taken)


def given_keypoints(path: Path, source: Source, start: int, stop: int | None, step: int) -> Keypoints:
    """Read what a detector has found in a source, and make sure that it belongs to it.

    Parameters
    ----------
    path
        as of `read_keypoints`.
    source
        opened.
    start, stop, step
        which of its frames are taken.

    Raises
    ------
    ValueError
        if the source is live, or they are of frames or places that it does not have.
    """
    if source.live:
        raise ValueError(f"--keypoints: {source.name} is live, so nobody has seen its frames before")
    found = read_keypoints(path, film=source.name, pictures=source.pictures)
    found.check(source.name, source.size, last_frame(source, start, stop, step))
    return found
