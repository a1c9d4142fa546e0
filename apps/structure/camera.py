"""Which camera a film was taken with: how long its lens is, and whether its perspective shows."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...inference.factor_analysis.factorisation import Factorisation
from ...inference.factor_analysis.robust import robust_fit
from ...inference.perspective.structure import Lens, PerspectiveStructure, perspective_structure
from ...models.core.frame import Frame
from ..io.sources.focal_length import focal_of_picture
from .job import Camera

Numbers = NDArray[np.float64]


def lens_of(frames: Sequence[Frame], focal: float | None, picture: Path | None) -> tuple[Lens, str]:
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
    size = next((frame.image.shape[:2] for frame in frames if frame.image is not None), None)
    if size is not None:
        stated = focal_of_picture(picture) if focal is None and picture is not None else None
        note = "" if stated is None else f"Focal length: {stated:.5g} px, as the pictures' files state."
        return Lens((size[0], size[1]), stated if focal is None else focal), note
    places = np.concatenate([frame.points.positions for frame in frames if frame.points is not None])
    width, height = np.ceil(places.max(axis=0) + np.minimum(places.min(axis=0), 0) + 1).astype(int).tolist()
    note = (
        f"The picture is taken to be {width} x {height} px, with positions as far from the left and upper "
        "edge as from the others: a camera with perspective needs its middle."
    )
    return Lens((max(height, 1), max(width, 1)), focal), note


def perspective_of(
    observations: Numbers, observed: NDArray[np.bool_], affine: Factorisation, camera: Camera, lens: Lens
) -> tuple[PerspectiveStructure | None, str]:
    """The perspective structure of what was observed, if it is wanted; and why there is none.

    Parameters
    ----------
    observations, observed
        `(n_frames, n_points, 2)` px, NaN where not observed, and `(n_frames, n_points)`.
    affine
        the shape as affine cameras have it.
    camera
        `"auto"`: the perspective one if that explains the observations better than affine ones do.
    lens
        what is known of it.
    """
    if camera == "affine":
        return None, ""
    weights = observed.astype(np.float64)
    robust = robust_fit(observations, weights, affine.cameras, affine.shape)
    found = perspective_structure(observations, weights, robust, lens)
    if found is None:
        return None, "no perspective camera was found"
    if camera == "perspective" or found.better_than(robust):
        return found, ""
    if not found.focal_determined:
        return None, "affine cameras explain the tracks as well: the film shows no perspective"
    return None, "affine cameras explain the tracks better than perspective ones with square pixels do"


def focal_in_words(found: PerspectiveStructure) -> str:
    """For instance "focal length 660 ± 4 px"."""
    if found.curvature_deviation == 0:
        return f"focal length {found.cameras.focal:.5g} px, as given"
    if not math.isfinite(found.focal_deviation):
        shortest = 1 / (found.cameras.curvature + 2 * found.curvature_deviation)
        return f"focal length unknown, more than {shortest:.2g} px"
    return f"focal length {found.cameras.focal:.5g} ± {found.focal_deviation:.2g} px"
