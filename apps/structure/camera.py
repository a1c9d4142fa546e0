"""Which camera a film was taken with: how long its lens is, and whether its perspective shows."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...chains.structure.factor_structure import StructureTrajectory
from ...inference import Solution
from ...inference.sfm.perspective.structure import (
    Lens,
    PerspectiveStructure,
    affine_fit,
    perspective_structure,
)
from ...models.core.frame import Frame
from ..io.sources.images import focal_of_picture
from .job import Camera
from .reconstruction import FEWEST_POINTS, Reconstruction, observations_of_points, points_of_tracks

FEWEST_VIEWS = 2
"""That agree about a point before a perspective camera."""


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
    least, most = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    width, height = np.ceil(most + np.minimum(least, 0) + 1).astype(int).tolist()
    note = (
        f"The picture is taken to be {width} x {height} px, with positions as far from the left and upper "
        "edge as from the others: a camera with perspective needs its middle."
    )
    return Lens((max(height, 1), max(width, 1)), focal), note


def in_perspective(
    found: Reconstruction, solution: Solution, n_tracks: int | None, camera: Camera, lens: Lens
) -> Reconstruction:
    """The same before a perspective camera, if that is wanted.

    What does not fit affine cameras has another chance: outliers count again, and a track that showed no
    point is one of its own. What does not agree with the perspective camera either is an outlier, and a point
    is one if `FEWEST_VIEWS` agree about it.

    Parameters
    ----------
    found
        before affine cameras.
    solution, n_tracks
        what it was read from, by `reconstruction_of`.
    camera
        `"auto"`: perspective if that explains the observations better than affine cameras do.
    lens
        what is known of it.
    """
    if camera == "affine" or found.n_points < FEWEST_POINTS:
        return found
    chain: StructureTrajectory = solution["structure"]
    point_of_track, alone = chain.point_of_track.copy(), chain.point_of_track < 0
    n_alone = int(np.count_nonzero(alone))
    point_of_track[alone] = found.n_points + np.arange(n_alone)
    chain = replace(chain, point_of_track=point_of_track, trusted=np.ones_like(chain.trusted))
    places, observed = observations_of_points(solution, chain, found.n_points + n_alone)
    weights = observed.astype(np.float64)
    shape = np.concatenate([found.shape, np.zeros((n_alone, 3))])
    robust = affine_fit(places, weights, found.cameras, shape)
    perspective = perspective_structure(places, weights, robust, lens)
    if perspective is None:
        return replace(found, affine_reason="no perspective camera was found")
    if camera == "auto" and not perspective.better_than(robust):
        reason = (
            "it explains the tracks better than a perspective one with square pixels does"
            if perspective.focal_determined
            else "the tracks show no perspective"
        )
        return replace(found, affine_reason=reason)
    agreeing = perspective.agrees(places, weights)
    kept = np.count_nonzero(agreeing, axis=0) >= FEWEST_VIEWS
    perspective, observed = perspective.of_points(kept), agreeing[:, kept]
    residuals = np.where(observed[..., None], places[:, kept] - perspective.positions, np.nan)
    chain = replace(chain, point_of_track=np.where(kept, np.cumsum(kept) - 1, -1)[chain.point_of_track])
    return replace(
        found,
        positions=perspective.positions,
        covariances=perspective.covariances,
        observed=observed,
        residuals=residuals,
        point_of_track=points_of_tracks(solution, chain, n_tracks),
        cameras=perspective.cameras.affine,
        shape=perspective.shape,
        shape_covariances=perspective.shape_covariance,
        noise_variance=perspective.noise.variance,
        geometry="euclidean",
        reason="",
        perspective=perspective,
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
