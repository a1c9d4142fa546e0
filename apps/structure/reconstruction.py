"""What a structure-from-motion run finds: points, cameras, tracks, and how sure it is of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...chains import FactorStructure, FeatureMatcher, PointTracker
from ...chains.points.trajectory import PointTrajectory
from ...chains.structure.factor_structure import StructureTrajectory
from ...inference import CoordinateAscent, MultiChain, Solution
from ...inference.sfm.affine_camera import euclidean
from ...inference.sfm.depth_test import depth
from ...inference.sfm.factor_analysis.factorisation import Factorisation, predicted
from ...inference.sfm.perspective.structure import PerspectiveStructure
from ...models.core.frame import Frame
from ...models.points.point_tracks import PointTracks, noise_of_tracks
from ..evaluation.predictions import PairRecord
from .job import Association, Coherence
from .predictions import recorded_predictions

Numbers = NDArray[np.float64]
Geometry = Literal["euclidean", "affine", "none"]

MOST_ROUNDS = 20
FEWEST_POINTS = 4


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points and cameras that explain the tracks.

    Parameters
    ----------
    positions
        `(n_frames, n_points, 2)` px: where shape and cameras have every point, seen or not.
    covariances
        `(n_frames, n_points, 2, 2)` px^2 of these.
    observed
        `(n_frames, n_points)` bool.
    residuals
        `(n_frames, n_points, 2)` px: observation minus position, NaN where not observed.
    point_of_track
        `(n_tracks,)` int64: the point that each track shows, -1 where it was rejected.
    cameras
        `(n_frames, 2, 4)`: position = `cameras[t, :, :3] @ shape[i] + cameras[t, :, 3]`.
    shape
        `(n_points, 3)`, in px at the mean scale of the cameras where the geometry is Euclidean.
    shape_covariances
        `(n_points, 3, 3)` in the square of the shape's unit.
    noise_variance
        px^2 of each observed coordinate, as estimated.
    objective
        after each round of the ascent.
    converged
        whether the ascent ended by itself.
    geometry
        `"euclidean"`: `shape` is determined up to scale and reflection in depth. `"affine"`: up to an affine
        map. `"none"`: the motion says nothing of depth, and `shape` means nothing.
    reason
        why the geometry is no better; empty for a Euclidean one.
    perspective
        the structure before a perspective camera, where that is what all of the above is of; `cameras` are
        then what it is in the middle of the shape's depth.
    affine_reason
        why there is none; empty where none was wanted.
    predictions
        what tracker and shape predicted of the points, for `rsmcm validity`.
    """

    positions: Numbers
    covariances: Numbers
    observed: NDArray[np.bool_]
    residuals: Numbers
    point_of_track: NDArray[np.int64]
    cameras: Numbers
    shape: Numbers
    shape_covariances: Numbers
    noise_variance: float
    objective: tuple[float, ...]
    converged: bool
    geometry: Geometry
    reason: str = ""
    perspective: PerspectiveStructure | None = None
    affine_reason: str = ""
    predictions: tuple[PairRecord, ...] = ()

    @property
    def n_points(self) -> int:
        """How many points there are."""
        return len(self.shape)

    @property
    def n_observations(self) -> int:
        """In how many places a point was seen in a frame."""
        return int(np.count_nonzero(self.observed))

    @cached_property
    def places(self) -> Numbers:
        """`(n_frames, n_points, 2)` px: every point where it was seen, or else where it should be."""
        return self.positions + np.where(self.observed[..., None], self.residuals, 0)

    @property
    def reprojection_error(self) -> float:
        """Root mean square distance between observations and positions, px."""
        return _root_mean(self.residuals[self.observed])

    @property
    def reprojection_errors(self) -> Numbers:
        """`reprojection_error` of each frame, `(n_frames,)`; NaN where nothing was seen."""
        return np.array(
            [_root_mean(errors[seen]) for errors, seen in zip(self.residuals, self.observed, strict=True)]
        )

    @property
    def deviations(self) -> Numbers:
        """Root mean square uncertainty of each point along an axis, `(n_points,)`, in the shape's unit."""
        variances: Numbers = np.trace(self.shape_covariances, axis1=1, axis2=2) / 3
        return np.sqrt(variances)


def engine_for(frames: Sequence[Frame], coherence: Coherence, association: Association) -> CoordinateAscent:
    """The engine with tracker and shape.

    Parameters
    ----------
    frames
        all of them, with images or with given points.
    coherence
        whether the camera moves smoothly.
    association
        `"dual-chain"`: the tracker receives the shape's messages, and tracks that show one point become one.
        `"none"`: it does not, and every track is a point.
    """
    dual = association == "dual-chain"
    model, points = following(frames)
    shape = FactorStructure(coherence=coherence == "second-order", associate=dual)
    model.connect(shape, points, feedback=dual)
    return CoordinateAscent(model, MOST_ROUNDS)


def following(frames: Sequence[Frame]) -> tuple[MultiChain, PointTracks]:
    """The chains that follow points of frames, with images or with given points, and the points."""
    given = any(frame.points is not None for frame in frames)
    points = PointTracks(noise=noise_of_tracks(frames)) if given else PointTracks()
    # what a tracker predicts comes from observations that the shape has as well, and would count twice over
    model = MultiChain().connect(PointTracker(), points, feedback=False)
    if not given:
        model.connect(FeatureMatcher(), points, feedback=False)
    return model, points


def reconstruction_of(solution: Solution, n_tracks: int | None) -> Reconstruction:
    """Read points, cameras and tracks from the engine's solution.

    Parameters
    ----------
    solution
        of the engine that `engine_for` makes.
    n_tracks
        how many tracks were given, by whose columns points are called; `None` where they were made from
        images.
    """
    found: StructureTrajectory = solution["structure"]
    fit = found.factorisation
    positions, covariances = predicted(fit)
    observations, observed = observations_of_points(solution, found, len(fit.shape))
    geometry, reason = _geometry(observations, fit)
    cameras, shape, shape_covariances = fit.cameras, fit.shape, fit.shape_covariance
    if geometry != "none":
        metric = euclidean(cameras, shape, fit.camera_covariance)
        geometry, reason = ("euclidean", "") if metric.determined else ("affine", metric.reason)
        cameras, shape = metric.cameras, metric.shape
        shape_covariances = metric.transform @ shape_covariances @ metric.transform.T
    return Reconstruction(
        positions=positions,
        covariances=covariances,
        observed=observed,
        residuals=observations - positions,
        point_of_track=points_of_tracks(solution, found, n_tracks),
        cameras=cameras,
        shape=shape,
        shape_covariances=shape_covariances,
        noise_variance=found.noise,
        objective=tuple(report.objective for report in solution.rounds),
        converged=solution.converged,
        geometry=geometry,
        reason=reason,
        predictions=recorded_predictions(solution),
    )


def _geometry(observations: Numbers, fit: Factorisation) -> tuple[Geometry, str]:
    """Whether the motion shows depth, and why it does not."""
    n_points = len(fit.shape)
    if n_points < FEWEST_POINTS:
        return "none", f"the tracks determine {n_points} points, and {FEWEST_POINTS} are needed"
    if not depth(observations, None, fit).determined:
        return "none", "a flat shape explains the tracks as well as one in depth does"
    return "affine", ""


def points_of_tracks(
    solution: Solution, found: StructureTrajectory, n_tracks: int | None
) -> NDArray[np.int64]:
    """The point of each track `(n_tracks,)`, -1 for none; also of those that the tracker took for another."""
    tracks: PointTrajectory = solution["tracker"]
    point_of = dict(zip(found.identities.tolist(), found.point_of_track.tolist(), strict=True))
    for absorbed, by in tracks.absorbed.tolist():
        point_of[absorbed] = point_of.get(by, -1)
    everybody = sorted(point_of) if n_tracks is None else range(n_tracks)
    return np.array([point_of.get(identity, -1) for identity in everybody], np.int64)


def observations_of_points(
    solution: Solution, found: StructureTrajectory, n_points: int
) -> tuple[Numbers, NDArray[np.bool_]]:
    """What frames show of each point: `(n_frames, n_points, 2)` px, NaN where nothing, and where something.

    Where several tracks show a point at once, their mean counts; what was taken for an outlier does not.
    """
    sums = np.zeros((len(solution.frames), n_points, 2))
    counts = np.zeros((len(solution.frames), n_points))
    for time, evidence in enumerate(solution.evidence("points")):
        identities, means, _ = evidence.positions.moments
        place = np.searchsorted(found.identities, identities)
        known = place < len(found.identities)
        known[known] = found.identities[place[known]] == identities[known]
        points = np.full(len(identities), -1)
        points[known] = np.where(found.trusted[time, place[known]], found.point_of_track[place[known]], -1)
        taken = points >= 0
        np.add.at(sums[time], points[taken], means[taken])
        np.add.at(counts[time], points[taken], 1)
    observed = counts > 0
    with np.errstate(invalid="ignore"):
        return sums / counts[:, :, None], observed


def reconstruct(
    frames: Sequence[Frame],
    coherence: Coherence,
    association: Association,
    n_tracks: int | None = None,
    after_round: Callable[[], None] = lambda: None,
) -> Reconstruction:
    """The best solution of a whole run; parameters as of `engine_for` and `reconstruction_of`."""
    best: Any = None
    for solution in engine_for(frames, coherence, association).rounds(frames):
        best = solution
        after_round()
    return reconstruction_of(best, n_tracks)


def _root_mean(vectors: Numbers) -> float:
    return float(np.sqrt(np.square(vectors).sum(axis=-1).mean())) if len(vectors) else np.nan
