"""The best perspective structure of a film: from several starts, by likelihood."""

from collections.abc import Iterable
from dataclasses import replace

from ...models.points.affine_camera import Euclidean
from ...models.points.perspective_camera import MIRROR, PerspectiveCameras
from ..factor_analysis.observations import Listed, Numbers
from .bundle_adjustment import Bundle, adjust, retriangulated
from .growth import grown

Start = tuple[PerspectiveCameras, Numbers]

FOCAL_STARTS = (1.0, 2.0)
"""Focal lengths to begin with, in widths of the picture: of usual lenses, from 53 to 28 degrees wide."""

TRIAL_STEPS = 15
"""Steps of bundle adjustment after which starts are compared."""
MOST_ROUNDS = 6
"""Of bundle adjustment and new points, at the end."""
SETTLED = 1.0
"""Nats: a round that gains less is the last."""


def affine_starts(
    metric: Euclidean, principal: Numbers, width: float, focal: float | None
) -> Iterable[Start]:
    """Starts from an affine structure: the shape and its mirror image, with focal lengths that are usual.

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
    focals = [focal] if focal is not None else [factor * width for factor in FOCAL_STARTS]
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
    for each in [focal] if focal is not None else [factor * width for factor in FOCAL_STARTS]:
        found = grown(places - principal, each, focal_known=focal is not None)
        if found is not None:
            cameras, shape, _ = found
            yield replace(cameras, principal=principal), shape


def best_bundle(listed: Listed, starts: Iterable[Start], *, focal_known: bool) -> Bundle | None:
    """Bundle adjustment from the start that gets farthest; `None` where there is none.

    Of an unknown focal length the sign is free, too: a negative one is that of the mirrored shape.
    """
    trials = [_round(listed, start, focal_known, TRIAL_STEPS) for start in starts]
    trials = [_round(listed, (trial.cameras, trial.shape), focal_known, TRIAL_STEPS) for trial in trials]
    if not trials:
        return None
    best = max(trials, key=lambda each: each.log_likelihood)
    for _ in range(MOST_ROUNDS):
        before = best.log_likelihood
        best = _round(listed, (best.cameras, retriangulated(listed, best)), focal_known)
        if best.log_likelihood < before + SETTLED:
            break
    return best


def _round(listed: Listed, start: Start, focal_known: bool, most_steps: int = 100) -> Bundle:
    """Bundle adjustment and new points, before cameras of a focal length that is not negative."""
    found = adjust(listed, *start, focal_known=focal_known, most_steps=most_steps)
    if found.cameras.curvature < 0:
        found = replace(found, cameras=found.cameras.mirrored(), shape=found.shape @ MIRROR)
    return replace(found, shape=retriangulated(listed, found))
