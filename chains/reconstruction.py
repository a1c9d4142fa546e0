"""Structure from motion of a whole film: shape, cameras and tracks, from pictures or from tracks of points.

result = reconstruct(tracks)  # (n_frames, n_tracks, 2) px, NaN where a track is not seen; or frames
result.geometry, result.shape, result.point_of_track
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..inference.engine.coordinate_ascent import CoordinateAscent, Solution
from ..inference.engine.graph import MultiChain
from ..inference.sfm.affine_camera import euclidean
from ..inference.sfm.depth import AS_WELL, MOST, depth, motion_of, variance_over_shape
from ..inference.sfm.factor_analysis.factorisation import Factorisation, predicted
from ..inference.sfm.perspective.placement import LEAST_SHARED, WIDE
from ..inference.sfm.perspective.structure import (
    AffineFit,
    Lens,
    PerspectiveStructure,
    affine_fit,
    perspective_structure,
)
from ..models.core.checks import Positive, Shape, checked
from ..models.core.frame import Frame
from ..models.core.identities import find, places_of
from ..models.core.short_repr import short_repr
from ..models.points.point_tracks import PointTracks, frames_of_tracks, noise_of_tracks
from .points.feature_matcher import FeatureMatcher
from .points.point_tracker import PointTracker
from .points.trajectory import PointTrajectory
from .structure.factor_structure import FactorStructure, StructureTrajectory
from .structure.recursive_structure import Structure

Numbers = NDArray[np.float64]
Geometry = Literal["euclidean", "affine", "none"]
Coherence = Literal["second-order", "none"]
Association = Literal["dual-chain", "none"]
Robust = Literal["outliers", "none"]
Camera = Literal["auto", "affine", "perspective"]

MOST_ROUNDS = 20
SETTLED, SETTLED_TRACKS = 0.02, 1e-5
"""Share of the objective that a round has to gain for another one. In images, what is decided anew in each
round, who shows what, moves it by half a percent to and fro. The unit of given tracks, and so the objective,
is arbitrary: of them nothing but the end of the ascent is known."""
FEWEST_POINTS = 4
FEWEST_FRAMES = 3  # two views of a rigid thing leave its depth open
UNKNOWN_CAMERAS = "halves of the points that others determine place cameras elsewhere, or sides look alike"
FEWEST_VIEWS = 2  # that agree about a point before a perspective camera
LASTING = 0.5  # px per point: a tracker's errors, which last, move points by so much against each other


@short_repr
@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points and cameras that explain the tracks.

    Parameters
    ----------
    positions, covariances
        `(n_frames, n_points, 2)` px: predicted positions of all points, visible or not, and their covariances
        in px^2.
    observed, residuals
        `(n_frames, n_points)` bool, and `(n_frames, n_points, 2)` px: observation minus position, NaN where
        not observed.
    point_of_track
        `(n_tracks,)` int64: the point that each track shows, -1 where it was rejected.
    cameras
        `(n_frames, 2, 4)`: position = `cameras[t, :, :3] @ shape[i] + cameras[t, :, 3]`.
    shape, shape_covariances
        `(n_points, 3)`, in px at the mean scale of the cameras where the geometry is Euclidean, and
        `(n_points, 3, 3)` in the square of its unit.
    noise_variance
        px^2 of each observed coordinate, as estimated.
    objective, converged
        after each round of the ascent, and whether it converged.
    geometry, reason
        `"euclidean"`: `shape` is determined up to scale and reflection in depth. `"affine"`: up to an affine
        map. `"none"`: the motion does not determine depth, or no camera is known, and `shape` is meaningless.
        `reason` says why.
    perspective
        the structure under a perspective camera, if one was fitted; all of the above then refers to it, and
        `cameras` are its affine approximations at the mean depth.
    affine_reason
        why there is no perspective camera; empty if none was requested.
    dropped
        `(n_frames,)`: tracked positions of each frame that no point explains: outliers, rejected tracks, and
        all of a frame whose camera is unknown. `None` where they were not counted.
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
    dropped: NDArray[np.int64] | None = None

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.shape)

    @property
    def n_observations(self) -> int:
        """Number of observations of a point in a frame."""
        return int(np.count_nonzero(self.observed))

    @property
    def determined(self) -> NDArray[np.bool_]:
        """`(n_frames,)`: whether the camera of a frame is known."""
        return np.asarray(np.isfinite(self.cameras).all(axis=(1, 2)))

    @cached_property
    def places(self) -> Numbers:
        """`(n_frames, n_points, 2)` px: observed positions, or predicted ones without an observation."""
        return self.positions + np.where(self.observed[..., None], self.residuals, 0)

    @property
    def reprojection_error(self) -> float:
        """Root mean square distance between observations and positions, px."""
        squares = np.square(self.residuals[self.observed]).sum(axis=-1)
        return float(np.sqrt(squares.mean())) if len(squares) else np.nan

    @property
    def deviations(self) -> Numbers:
        """Standard deviation of each point along an axis, `(n_points,)`, in the unit of the shape."""
        variances: Numbers = np.trace(self.shape_covariances, axis1=1, axis2=2) / 3
        return np.sqrt(variances)


class NoStructureError(ValueError):
    """There are too few points, or they are in too few frames, for a structure."""


@checked
def reconstruct(
    film: Sequence[Frame] | Annotated[Numbers, Shape(None, None, 2, finite=False)],
    *,
    coherence: Coherence = "second-order",
    association: Association = "dual-chain",
    robust: Robust = "outliers",
    camera: Camera = "auto",
    lens: Lens | None = None,
    after_round: Callable[[], None] = lambda: None,
) -> Reconstruction:
    """Estimate the structure from a video or from tracks.

    Parameters
    ----------
    film
        frames with images or with given points; or tracks, `(n_frames, n_tracks, 2)` px, NaN where missing.
    coherence, association, robust
        as of `structure_engine`.
    camera, lens
        as of `reconstruction_of`.
    after_round
        is called after every round of the ascent.

    Raises
    ------
    ValueError
        if there are fewer than 3 frames or 4 points, or frames share too few of them.
    TypeError
        if an argument is of another type.
    NoStructureError
        as `reconstruction_of` does.
    """
    frames = frames_of_tracks(film) if isinstance(film, np.ndarray) else film
    n_tracks = film.shape[1] if isinstance(film, np.ndarray) else None
    best: Any = None
    for solution in structure_engine(frames, coherence, association, robust).rounds(frames):
        best = solution
        after_round()
    return reconstruction_of(best, camera, lens, n_tracks, robust)


@checked
def structure_engine(
    frames: Sequence[Frame],
    coherence: Coherence = "second-order",
    association: Association = "dual-chain",
    robust: Robust = "outliers",
) -> CoordinateAscent:
    """Return the engine with tracker and shape for frames with images or with given points.

    `coherence` says whether the camera moves smoothly, `association` whether the tracker receives the
    shape's messages and tracks that show one point become one, `robust` whether positions may be outliers
    or count alike, as in least squares.
    """
    dual = association == "dual-chain"
    model, points = _following(frames)
    shape = FactorStructure(
        coherence=coherence == "second-order", associate=dual, outliers=robust == "outliers"
    )
    model.connect(shape, points, feedback=dual)
    return CoordinateAscent(model, MOST_ROUNDS, SETTLED_TRACKS if _given(frames) else SETTLED)


def _given(frames: Sequence[Frame]) -> bool:
    return any(frame.points is not None for frame in frames)


def _following(frames: Sequence[Frame]) -> tuple[MultiChain, PointTracks]:
    """Return a model of chains that track points of the frames, and its feature node."""
    given = _given(frames)
    points = PointTracks(noise=noise_of_tracks(frames)) if given else PointTracks()
    # what a tracker predicts comes from observations that the shape has as well, and would count twice over
    model = MultiChain().connect(PointTracker(), points, feedback=False)
    if not given:
        model.connect(FeatureMatcher(), points, feedback=False)
    return model, points


@checked
def track_points(frames: Sequence[Frame]) -> Numbers:
    """Return tracks without a shape's feedback: `(n_frames, n_tracks, 2)` px, NaN where not observed."""
    return tracks_of(CoordinateAscent(_following(frames)[0], 1).run(frames))


def tracks_of(solution: Solution) -> Numbers:
    """Return the observed positions of tracks: `(n_frames, n_tracks, 2)` px, NaN where not observed."""
    moments = [evidence.positions.moments for evidence in solution.evidence("points")]
    identities = np.unique(np.concatenate([each for each, _, _ in moments]))
    tracks = np.full((len(moments), len(identities), 2), np.nan)
    for row, (of_frame, means, _) in zip(tracks, moments, strict=True):
        row[places_of(identities, of_frame)] = means
    return tracks


def recursive_reconstruction(
    structure: Structure, cameras: Numbers, camera_covariances: Numbers, tracks: Numbers
) -> Reconstruction:
    """Return the reconstruction of the last shape of `RecursiveStructure`, which is `structure` at the end.

    Cameras `(n_frames, 2, 4)` and their covariances are those after each frame, NaN where there was none;
    tracks `(n_frames, n_points, 2)` px are where points of the shape were seen.
    """
    has_camera = np.asarray(np.isfinite(cameras).all(axis=(1, 2)))
    since = np.flatnonzero(~has_camera)  # cameras before are of another shape
    has_camera[: since.max(initial=-1) + 1] = False
    fit = Factorisation(
        cameras[has_camera], camera_covariances[has_camera], structure.shape, structure.shape_covariance,
        0.0, 0.0, True, structure.motion.noise, has_camera[has_camera], (),
    )  # fmt: skip
    n_frames, n_points = tracks.shape[:2]
    positions = np.full((n_frames, n_points, 2), np.nan)
    covariances = np.full((n_frames, n_points, 2, 2), np.nan)
    positions[has_camera], covariances[has_camera] = predicted(fit)
    metric = euclidean(fit.cameras, fit.shape, fit.camera_covariance)
    upgraded = np.full(cameras.shape, np.nan)
    upgraded[has_camera] = metric.cameras
    residuals = tracks - positions
    observed = np.isfinite(residuals[..., 0])
    return Reconstruction(
        positions=positions,
        covariances=covariances,
        observed=observed,
        residuals=residuals,
        point_of_track=np.arange(n_points),
        cameras=upgraded,
        shape=metric.shape,
        shape_covariances=metric.transform @ structure.shape_covariance @ metric.transform.T,
        noise_variance=float(np.mean(residuals[observed] ** 2)) if observed.any() else np.nan,
        objective=(),
        converged=True,
        geometry="euclidean" if metric.determined else "affine",
        reason=metric.reason,
    )


@checked
def lens_of(frames: Sequence[Frame], focal: Positive | None = None) -> Lens:
    """Return the lens: size of the images, or of the region of all positions, and the focal length in px."""
    size = next((frame.image.shape[:2] for frame in frames if frame.image is not None), None)
    if size is not None:
        return Lens((size[0], size[1]), focal)
    places = np.concatenate([frame.points.positions for frame in frames if frame.points is not None])
    least, most = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    width, height = np.ceil(most + np.minimum(least, 0) + 1).astype(int).tolist()
    return Lens((max(height, 1), max(width, 1)), focal)


@checked
def reconstruction_of(
    solution: Solution,
    camera: Camera = "auto",
    lens: Lens | None = None,
    n_tracks: int | None = None,
    robust: Robust = "outliers",
) -> Reconstruction:
    """Read points, cameras and tracks from the engine's solution, and choose the camera.

    Parameters
    ----------
    solution
        of the engine that `structure_engine` makes.
    camera
        `"auto"`: perspective if that explains the observations better than affine cameras do.
    lens
        what is known of the camera; that of `lens_of` if not given.
    n_tracks
        how many tracks were given; `None` where points are to be called in the order of their identities.
    robust
        as of the engine.

    Raises
    ------
    NoStructureError
        if there is no point, or half of those that images show are in too few views to be any.
    """
    from_images = any(frame.image is not None for frame in solution.frames)
    result = _before_affine_cameras(solution, n_tracks)
    lives = result.observed.sum(axis=0)
    if not len(lives) or (from_images and np.median(lives) < FEWEST_FRAMES):
        raise NoStructureError(
            f"tracks: got {len(lives)} points, most of them in fewer than {FEWEST_FRAMES} frames"
        )
    lens = lens or lens_of(solution.frames)
    # of what affine cameras see no depth, a perspective one fits depth to noise; one of a known focal length
    # may see a plane
    has_structure = result.geometry != "none" or lens.focal is not None
    if camera != "affine" and result.n_points >= FEWEST_POINTS and has_structure:
        result = _in_perspective(result, solution, n_tracks, camera, lens, robust == "outliers")
    result = _without_false_depth(result, from_images)
    return replace(result, dropped=_dropped(solution, result, n_tracks))


def _before_affine_cameras(solution: Solution, n_tracks: int | None) -> Reconstruction:
    structure: StructureTrajectory = solution["structure"]
    fit = structure.factorisation
    positions, covariances = predicted(fit)
    observations, observed = _observations_of_points(solution, structure, len(fit.shape))
    geometry: Geometry = "none"
    reason = ""
    if len(fit.shape) < FEWEST_POINTS:
        reason = f"the tracks determine {len(fit.shape)} points, and {FEWEST_POINTS} are needed"
    elif not depth(observations, None, fit).determined:
        reason = "a flat shape explains the tracks as well as one with depth"
    cameras, shape, shape_covariances = fit.cameras, fit.shape, fit.shape_covariance
    if not reason:
        metric = euclidean(cameras, shape, fit.camera_covariance)
        geometry, reason = "euclidean" if metric.determined else "affine", metric.reason
        cameras, shape = metric.cameras, metric.shape
        shape_covariances = metric.transform @ shape_covariances @ metric.transform.T
    return Reconstruction(
        positions=positions,
        covariances=covariances,
        observed=observed,
        residuals=observations - positions,
        point_of_track=_points_of_tracks(solution, structure, n_tracks),
        cameras=cameras,
        shape=shape,
        shape_covariances=shape_covariances,
        noise_variance=structure.noise,
        objective=tuple(report.objective for report in solution.rounds),
        converged=solution.converged,
        geometry=geometry,
        reason=reason,
    )


def _in_perspective(
    affine: Reconstruction,
    solution: Solution,
    n_tracks: int | None,
    camera: Camera,
    lens: Lens,
    outliers: bool,
) -> Reconstruction:
    """Return the reconstruction with a perspective camera; outliers and rejected tracks are tried again."""
    chain: StructureTrajectory = solution["structure"]
    point_of_track, alone = chain.point_of_track.copy(), chain.point_of_track < 0
    n_alone = int(np.count_nonzero(alone))
    point_of_track[alone] = affine.n_points + np.arange(n_alone)
    chain = replace(chain, point_of_track=point_of_track, trusted=np.ones_like(chain.trusted))
    places, observed = _observations_of_points(solution, chain, affine.n_points + n_alone)
    weights = observed.astype(np.float64)
    shape = np.concatenate([affine.shape, np.zeros((n_alone, 3))])

    in_affine = affine_fit(places, weights, affine.cameras, shape, outliers=outliers)
    perspective = perspective_structure(places, weights, in_affine, lens, outliers=outliers)
    if perspective is None:
        return replace(affine, affine_reason="no perspective camera was found")
    known, reason = perspective.known(places, weights), _why_affine(camera, in_affine, perspective)
    n_known, n_fitted = np.count_nonzero(known), np.count_nonzero(in_affine.frames)
    if FEWEST_FRAMES <= n_known < n_fitted and (not reason or 2 * n_known >= n_fitted):
        weights *= known[:, None]  # what hangs on nothing bends the rest
        in_affine = affine_fit(places, weights, affine.cameras, shape, outliers=outliers)
        again = perspective_structure(places, weights, in_affine, lens, outliers=outliers)
        if again is not None and again.known(places, weights)[known].all():
            perspective, reason = again, _why_affine(camera, in_affine, again)
    enough = np.count_nonzero(observed, axis=1).max() >= LEAST_SHARED
    if reason and enough and 2 * n_known < n_fitted:  # they may be uncertain, but on no other side
        n_known = np.count_nonzero(perspective.known(places, weights, within=WIDE))
    if enough and n_known < (n_fitted / 2 if reason else FEWEST_FRAMES):
        return replace(affine, geometry="none", reason=UNKNOWN_CAMERAS)
    if reason or not enough:
        return replace(affine, affine_reason=reason or f"no frame shows {LEAST_SHARED} points")
    agreeing = perspective.agrees(places, weights) & known[:, None]
    kept = np.count_nonzero(agreeing, axis=0) >= FEWEST_VIEWS
    perspective, observed = perspective.of_points(kept).of_frames(known), agreeing[:, kept]
    residuals = np.where(observed[..., None], places[:, kept] - perspective.positions, np.nan)
    chain = replace(chain, point_of_track=np.where(kept, np.cumsum(kept) - 1, -1)[chain.point_of_track])
    return replace(
        affine,
        positions=perspective.positions,
        covariances=perspective.covariances,
        observed=observed,
        residuals=residuals,
        point_of_track=_points_of_tracks(solution, chain, n_tracks),
        cameras=perspective.cameras.affine,
        shape=perspective.shape,
        shape_covariances=perspective.shape_covariance,
        noise_variance=perspective.noise.variance,
        geometry="euclidean",
        reason="",
        perspective=perspective,
    )


def _why_affine(camera: Camera, affine: AffineFit, perspective: PerspectiveStructure) -> str:
    """Why affine cameras are preferred to perspective ones; empty if they are not."""
    if camera != "auto" or perspective.better_than(affine):
        return ""
    if perspective.focal_determined:
        return "it explains the tracks better than a perspective one with square pixels does"
    return "the tracks show no perspective"


def _without_false_depth(result: Reconstruction, from_images: bool) -> Reconstruction:
    """Return the reconstruction without its shape if its depth is not determined.

    Before affine cameras, perspective may have been: then homographies explain clearly more than the shape. A
    perspective camera explains them too, with any depth if it stays where it is, or with any focal length if
    it sees a plane: then homographies explain as much. Or, `from_images` and with an affine shape or a
    focal length that was estimated, there is less parallax than a tracker makes by itself.
    """
    if result.geometry == "none":
        return result
    places = np.where(result.observed[..., None], result.places, np.nan)
    lens = result.perspective
    most = MOST if lens is None else 1.0  # outliers are left out already
    ratio = variance_over_shape(places, result.residuals, most)
    uncertain = result.geometry == "affine" or (lens is not None and lens.curvature_deviation > 0)
    reason = ""
    if lens is None and ratio * AS_WELL <= 1:
        reason = "homographies, which have no depth, explain the tracks better than a shape does"
    elif lens is not None and ratio <= AS_WELL:
        known = lens.curvature_deviation == 0  # the focal length is given
        if not (known and motion_of(places).kind == "plane"):
            reason = "homographies, which have no depth, explain the tracks as well as a shape does"
    if not reason and from_images and uncertain and motion_of(places, most).parallax < LASTING:
        reason = "the relative motion of points is smaller than tracking errors"
    if not reason:
        return result
    return replace(result, geometry="none", reason=reason, perspective=None, affine_reason="")


def _points_of_tracks(
    solution: Solution, structure: StructureTrajectory, n_tracks: int | None
) -> NDArray[np.int64]:
    """Return the point of each track `(n_tracks,)`, -1 for none, also of tracks that others absorbed."""
    tracks: PointTrajectory = solution["tracker"]
    point_of = dict(zip(structure.identities.tolist(), structure.point_of_track.tolist(), strict=True))
    for absorbed, by in tracks.absorbed.tolist():
        point_of[absorbed] = point_of.get(by, -1)
    identities = _identities(solution, n_tracks).tolist()
    return np.array([point_of.get(identity, -1) for identity in identities], np.int64)


def _identities(solution: Solution, n_tracks: int | None) -> NDArray[np.int64]:
    """Return the identities of the tracks, in their order."""
    if n_tracks is not None:
        return np.arange(n_tracks)
    tracks: PointTrajectory = solution["tracker"]
    structure: StructureTrajectory = solution["structure"]
    return np.union1d(structure.identities, tracks.absorbed[:, 0])


def _dropped(solution: Solution, result: Reconstruction, n_tracks: int | None) -> NDArray[np.int64]:
    """Return how many tracked positions of each frame no point explains."""
    identities, dropped = _identities(solution, n_tracks), []
    for evidence, observed in zip(solution.evidence("points"), result.observed, strict=True):
        shown, _, _ = evidence.positions.moments
        point = result.point_of_track[places_of(identities, shown)]
        dropped.append(np.count_nonzero((point < 0) | ~observed[point]))
    return np.array(dropped, np.int64)


def _observations_of_points(
    solution: Solution, structure: StructureTrajectory, n_points: int
) -> tuple[Numbers, NDArray[np.bool_]]:
    """Return mean observed positions `(n_frames, n_points, 2)` px, NaN where none, and which there are."""
    sums = np.zeros((len(solution.frames), n_points, 2))
    counts = np.zeros((len(solution.frames), n_points))
    for time, evidence in enumerate(solution.evidence("points")):
        identities, means, _ = evidence.positions.moments
        place, has_point = find(structure.identities, identities)
        points = np.full(len(identities), -1)
        points[has_point] = np.where(
            structure.trusted[time, place[has_point]], structure.point_of_track[place[has_point]], -1
        )
        is_shown = points >= 0
        np.add.at(sums[time], points[is_shown], means[is_shown])
        np.add.at(counts[time], points[is_shown], 1)
    observed = counts > 0
    with np.errstate(invalid="ignore"):
        return sums / counts[:, :, None], observed
