"""The region of interest: the part of the picture of which foreground and tracks are wanted."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..io.sources.images import read_grey
from ..io.tracks import TrackedObject

Mask = NDArray[np.uint8]


def read_region(text: str, size: tuple[int, int]) -> Mask:
    """Read a region of interest: `(height, width)` uint8, 255 inside and 0 outside.

    It is given as `x,y,width,height` px, with x and y of the upper left corner from 0, or as the name of a
    picture of the video's `size` `(width, height)` px that is not black inside the region.

    Raises
    ------
    ValueError
        if the rectangle is empty or reaches out of the picture, or the mask is no picture, has too many
        pixels, another size or nothing inside.
    OSError
        if there is no such file.
    """
    width, height = size
    region: Mask = np.zeros((height, width), np.uint8)
    if re.fullmatch(r"[\d\s.+-]+(,[\d\s.+-]+)+", text):
        try:
            x, y, w, h = (int(number) for number in text.split(","))
        except ValueError:
            raise ValueError(f"--roi: got {text!r}, expected x,y,width,height in whole px") from None
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
            raise ValueError(
                f"--roi: got {text!r}, expected a rectangle inside the picture of {width}x{height}"
            )
        region[y : y + h, x : x + w] = 255
        return region
    path = Path(text)
    if not path.exists():
        raise FileNotFoundError(f"--roi: got {text!r}, which is neither x,y,width,height nor a file")
    try:
        picture = read_grey(path)
    except ValueError as error:
        raise ValueError(f"--roi: {error}") from None
    if picture is None:
        raise ValueError(f"--roi: {text} is not a readable picture")
    if picture.shape != region.shape:
        raise ValueError(
            f"--roi: {text} has {picture.shape[1]}x{picture.shape[0]} px, "
            f"expected {width}x{height} like the video"
        )
    region[picture > 0] = 255
    if not region.any():
        raise ValueError(f"--roi: {text} is black everywhere, expected a region that is not")
    return region


def stands_inside(region: Mask, box: tuple[float, float, float, float]) -> bool:
    """Whether the middle of a box's lower edge is in the region; the box is x, y, width, height px."""
    height, width = region.shape
    x, y, w, h = box
    column = min(max(int(x + w / 2), 0), width - 1)
    row = min(max(int(y + h) - 1, 0), height - 1)
    return bool(region[row, column])


def inside(region: Mask | None, tracks: Sequence[TrackedObject]) -> list[TrackedObject]:
    """The tracks that stand in the region; all without one."""
    return list(tracks) if region is None else [track for track in tracks if stands_inside(region, track.box)]
