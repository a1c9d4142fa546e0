"""The best perspective structure of a film: from several starts, by likelihood."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ....models.camera.perspective_camera import MIRROR, PerspectiveCameras
from ..affine_camera import Euclidean
from ..factor_analysis.observations import Listed, Numbers
from .bundle_adjustment import Bundle, adjust, retriangulated
from .growth import grown

Start = tuple[PerspectiveCameras, Numbers]

FOCAL_STARTS = (0.8, 1.5, 3.0)
"""Focal lengths to grow with, in widths of the picture: from 64 degrees wide, as of phones, to 19."""
AFFINE_STARTS = (1.0, 2.0)
"""And those for an affine structure, which is quicker to have but may need them for either mirror image."""

TRIAL_STEPS = 15
"""Steps of bundle adjustment in each of two rounds after which starts are compared."""
FINALISTS = 2
"""Starts that go on after that."""
MOST_ROUNDS = 6
"""Of bundle adjustment and new points, at the end."""
SETTLED = 3.0
"""Nats: a round that gains less is the last. It is the evidence of no more than one number in a film."""


def affine_starts(
    metric: Euclidean, principal: Numbers, width: float, focal: float | None
) -> Iterable[Start]:
    """Starts from an affine structure: the shape and its mirror image.

    Parameters
    ----------
    metric
        the affine structure in a space with right angles.
    principal
        `(2,)` px.
    width
        px, the longer edge of the picture.
    focal
        px; `None` where it is unknown. Then scaled orthography is a start as well, from which the first step
        finds out which of the two it is.
    """
    shifts = metric.cameras[..., 3] - principal
    focals = [focal] if focal is not None else [factor * width for factor in AFFINE_STARTS]
    curvatures = [sign / each for each in focals for sign in (1, -1)]
    for curvature in curvatures if focal is not None else [0.0, *curvatures]:
        start = PerspectiveCameras(metric.rotations, metric.scales, shifts, curvature, principal)
        yield (start, metric.shape) if curvature >= 0 else (start.mirrored(), metric.shape @ MIRROR)


def grown_starts(places: Numbers, principal: Numbers, width: float, focal: float | None) -> Iterable[Start]:
    """Starts that grow from two views, which need no affine structure and take any depth.

    Parameters
    ----------
    places
        `(n_frames, n_points, 2)` px, NaN where nothing was seen.
    principal, width, focal
        as of `affine_starts`.
    """
    focals = [focal] if focal is not None else [factor * width for factor in FOCAL_STARTS]
    tried = [grown(places - principal, each, focal_known=focal is not None) for each in focals]
    found = [each for each in tried if each is not None]
    most = max((np.count_nonzero(known) for _, _, known in found), default=0)
    for cameras, shape, known in found:
        if np.count_nonzero(known) == most:  # where it has come to a halt all further cameras are wrong
            yield replace(cameras, principal=principal), shape


def best_bundle(listed: Listed, starts: Iterable[Start], *, focal_known: bool) -> Bundle | None:
    """Bundle adjustment from the start that gets farthest; `None` where there is none.

    Of an unknown focal length the sign is free, too: a negative one is that of the mirrored shape.
    """
    trials = [_tried(listed, start, focal_known) for start in starts]
    if not trials:
        return None
    trials.sort(key=lambda each: -each.log_likelihood)
    ends = [_settled(listed, trial, focal_known) for trial in trials[:FINALISTS]]
    return max(ends, key=lambda each: each.log_likelihood)


def _tried(listed: Listed, start: Start, focal_known: bool) -> Bundle:
    found = _round(listed, start, focal_known, TRIAL_STEPS)
    return _round(listed, (found.cameras, found.shape), focal_known, TRIAL_STEPS)


def _settled(listed: Listed, found: Bundle, focal_known: bool) -> Bundle:
    for _ in range(MOST_ROUNDS):
        before = found.log_likelihood
        found = _round(listed, (found.cameras, found.shape), focal_known)
        if found.log_likelihood < before + SETTLED:
            break
    return found


def _round(listed: Listed, start: Start, focal_known: bool, most_steps: int = 100) -> Bundle:
    """Bundle adjustment and new points, before cameras of a focal length that is not negative."""
    found = adjust(listed, *start, focal_known=focal_known, most_steps=most_steps)
    if found.cameras.curvature < 0:
        found = replace(found, cameras=found.cameras.mirrored(), shape=found.shape @ MIRROR)
    return replace(found, shape=retriangulated(listed, found))
