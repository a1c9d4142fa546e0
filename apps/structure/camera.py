"""What is known of a film's camera beforehand, and what a run says of camera and points in a few words."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...chains.reconstruction import Reconstruction, lens_of
from ...inference.sfm.perspective.structure import Lens, PerspectiveStructure
from ...models.core.frame import Frame
from ..io.sources.images import focal_of_picture


def known_lens(frames: Sequence[Frame], focal: float | None, picture: Path | None) -> tuple[Lens, str]:
    """What is known of the camera, and what was taken for granted, in a sentence.

    Parameters
    ----------
    frames
        with images or with given points.
    focal
        px; `None` where it is not given.
    picture
        a file of the film that may tell the focal length, as cameras write it there.
    """
    pictures = any(frame.image is not None for frame in frames)
    stated = focal_of_picture(picture) if pictures and focal is None and picture is not None else None
    lens = lens_of(frames, stated if focal is None else focal)
    if pictures:
        note = "" if stated is None else f"Focal length: {stated:.5g} px, as the pictures' files state."
        return lens, note
    height, width = lens.size
    return lens, (
        f"The picture is taken to be {width} x {height} px, with positions as far from the left and upper "
        "edge as from the others: a camera with perspective needs its middle."
    )


def camera_in_words(found: Reconstruction) -> str:
    """For instance "perspective, focal length 660 ± 4 px"; of an affine one why it is that."""
    if found.perspective is not None:
        return f"perspective, {focal_in_words(found.perspective)}"
    return f"affine: {found.affine_reason}" if found.affine_reason else "affine"


def focal_in_words(found: PerspectiveStructure) -> str:
    """For instance "focal length 660 ± 4 px"."""
    if found.curvature_deviation == 0:
        return f"focal length {found.cameras.focal:.5g} px, as given"
    if not math.isfinite(found.focal_deviation):
        shortest = 1 / (found.cameras.curvature + 2 * found.curvature_deviation)
        return f"focal length unknown, more than {shortest:.2g} px"
    return f"focal length {found.cameras.focal:.5g} ± {found.focal_deviation:.2g} px"


def in_words(summary: Mapping[str, Any]) -> list[str]:
    """Points, and how well they fit."""
    words = f"{summary['frames']} frames, {summary['points']} points from {summary['tracks']} tracks"
    if not summary["points"]:
        return [words]
    return [
        f"{words}, reprojection error {summary['reprojection_rmse_px_per_point']:.3g} px per point "
        f"({summary['reprojection_rmse_px_per_coordinate']:.3g} px per coordinate), shape: "
        f"{summary['shape']}",
        f"camera: {summary['camera_in_words']}",
    ]
