"""Shape and perspective cameras from point tracks with gaps, and whether they explain them best.

Starts of bundle adjustment are affine cameras, with which the result is compared too, and structures that
grow from two views (Snavely, Seitz, Szeliski, "Photo tourism", 2006): the essential matrix of two views with
much parallax, points between them, further cameras from these points, further points from those cameras, and
bundle adjustment whenever the film has grown.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation, Slerp

from ....models.camera.perspective_camera import MIRROR, PerspectiveCameras
from ....models.core.short_repr import short_repr
from ....models.numerics.rotations import exponential
from ....models.numerics.threads import side_by_side
from ..affine_camera import Euclidean, euclidean
from ..factor_analysis.factorisation import NEAR, projected, variable_projection
from ..factor_analysis.observations import Array, Observations, SparseObservations, covering, determined
from .bundle_adjustment import (
    Bundle,
    StudentNoise,
    about,
    adjust,
    covariance_of,
    freedom,
    predicted,
    retriangulated,
    squares_of,
)
from .placement import LEAST_SHARED, LEAST_TYING, NARROW, SURE, TURN, WIDE, angles_between, known_frames

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

AGREEING_DISTANCE = 2.0  # px, between an observation and where camera and point have it
MOST_VIEWS = 16  # frames, evenly spread, of which pairs are tried for the beginning
MOST_PAIRS = 12  # pairs of these with most shared motion, whose essential matrix is found
LEVELS = ((1, 1.0), (2 / 3, 0.5), (0.5, 0.2))
"""Shares of `LEAST_SHARED` and of `NARROW` that are enough: less, when no other frame can be added."""
LEAST_AGREEING = 0.35  # share of the points that agree with a frame's camera: few, where it sees another side
SAMPLES = math.ceil(math.log(1 - SURE) / math.log(1 - LEAST_AGREEING**4))  # of four points
MOSTLY = 0.7  # share of the points of the frame that shows most from which another one is taken along with it
GROWTH = 1.25  # factor by which the number of frames grows between two bundle adjustments
STEPS = 12  # of bundle adjustment while it grows
FOCAL_FREE = 5  # frames from which the focal length is estimated, too; fewer hardly show it


def grown(places: Array, focal: float, *, focal_known: bool) -> tuple[PerspectiveCameras, Array, Mask] | None:
    """Grow a structure as far as it goes; `None` if no pair of frames shows enough.

    Places `(n_frames, n_points, 2)` are px from the principal point, NaN where nothing was seen; `focal` px
    is what to begin with. Gives cameras of all frames, those without `known` `(n_frames,)` standing where
    the nearest known one stands, and the shape `(n_points, 3)`.
    """
    growth = _Growth(places, focal, focal_known)
    if not growth.begin():
        return None
    while growth.add_frames():
        pass
    return growth.result()


class _Growth:
    """Cameras and points so far."""

    def __init__(self, places: Array, focal: float, focal_known: bool) -> None:
        self._places = places
        self._seen: Mask = np.isfinite(places[..., 0])
        self._focal_known = focal_known
        n_frames, n_points = self._seen.shape
        self._cameras = PerspectiveCameras(
            np.tile(np.eye(3), (n_frames, 1, 1)),
            np.ones(n_frames),
            np.zeros((n_frames, 2)),
            1 / focal,
            np.zeros(2),
        )
        self._shape = np.zeros((n_points, 3))
        self._frames, self._points = np.zeros(n_frames, bool), np.zeros(n_points, bool)
        self._adjusted = 2
        self._level = 0

    def result(self) -> tuple[PerspectiveCameras, Array, Mask]:
        """Return the structure that has grown; see `grown`."""
        known = np.flatnonzero(self._frames)
        nearest = known[np.abs(np.arange(len(self._frames))[:, None] - known).argmin(axis=1)]
        return self._cameras.of(nearest), self._shape, self._frames

    # --- the beginning ---

    def begin(self) -> bool:
        """Return two views with most parallax, and the points between them; whether there are such."""
        best, score = None, 0.0
        for one, other in self._pairs():
            found = self._two_views(one, other)
            if found is not None and found[-1] > score:
                best, score = (one, other, *found[:-1]), found[-1]
        if best is None:
            return False
        one, other, rotation, translation, middle = best
        # about the middle of the points, so that cameras have the origin before them
        self._place(one, np.eye(3), middle)
        self._place(other, rotation, rotation @ middle + translation)
        self._add_points()
        self._adjust()
        return True

    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs of frames that share many points that have moved much, those with most motion first."""
        able = np.flatnonzero(self._seen.sum(axis=1) >= LEAST_SHARED)
        evenly = np.unique(np.linspace(0, max(len(able) - 1, 0), min(MOST_VIEWS, len(able))).astype(int))
        views = able[evenly]
        scores = []
        for k, one in enumerate(views.tolist()):
            for other in views[k + 1 :].tolist():
                both = self._seen[one] & self._seen[other]
                if both.sum() >= LEAST_SHARED:
                    moved = np.linalg.norm(self._places[other, both] - self._places[one, both], axis=1)
                    scores.append((float(np.sqrt(both.sum()) * np.median(moved)), one, other))
        return [(one, other) for _, one, other in sorted(scores, reverse=True)[:MOST_PAIRS]]

    def _two_views(self, one: int, other: int) -> tuple[Array, Array, Array, float] | None:
        """How the second view lies to the first."""
        both = np.flatnonzero(self._seen[one] & self._seen[other])
        curvature = self._cameras.curvature
        here, there = self._places[one, both] * curvature, self._places[other, both] * curvature
        essential, agreeing = cv2.findEssentialMat(
            here, there, np.eye(3), method=cv2.USAC_DEFAULT, prob=SURE,
            threshold=AGREEING_DISTANCE / 2 * curvature,
        )  # fmt: skip
        if essential is None or essential.shape != (3, 3):
            return None
        n_before, rotation, translation, agreeing = cv2.recoverPose(
            essential, here, there, np.eye(3), mask=agreeing
        )
        if n_before < LEAST_SHARED:
            return None
        here, there = here[agreeing[:, 0] > 0], there[agreeing[:, 0] > 0]
        views = np.eye(3, 4), np.concatenate([rotation, translation], axis=1)
        points = cv2.triangulatePoints(*views, here.T, there.T)
        points = (points[:3] / points[3]).T
        angles = angles_between(points, points + translation[:, 0] @ rotation)
        if np.median(angles) < NARROW:
            return None
        score = float(np.minimum(angles, WIDE).sum())
        return _float(rotation), _float(translation[:, 0]), _float(np.median(points, axis=0)), score

    def _place(self, frame: int, rotation: Array, translation: Array) -> None:
        cameras = self._cameras
        cameras.rotations[frame] = rotation
        cameras.scales[frame] = cameras.focal / translation[2]
        cameras.shifts[frame] = cameras.focal * translation[:2] / translation[2]
        self._frames[frame] = True

    # --- growth ---

    def add_frames(self) -> bool:
        """Find cameras of further frames, points that these show, and adjust; whether there were any."""
        shared = (self._seen & self._points).sum(axis=1)
        shared[self._frames] = 0
        wanted = np.argsort(-shared, kind="stable")
        # those that show nearly as much as the best one do not have to wait for it
        least = LEVELS[self._level][0] * LEAST_SHARED
        wanted = wanted[shared[wanted] >= max(least, MOSTLY * shared.max())]
        most = max(1, int((GROWTH - 1) * self._frames.sum()))
        added = 0
        for frame in wanted:
            added += self._resected(int(frame))
            if added >= most:
                break
        if not added:
            if self._frames.all() or self._level + 1 == len(LEVELS):
                return False
            self._level += 1
        if not added or self._frames.all() or self._frames.sum() >= GROWTH * self._adjusted:
            self._adjust()
        self._add_points()
        return True

    def _resected(self, frame: int) -> bool:
        """Find a frame's camera from the points that are known; whether there is one."""
        points = np.flatnonzero(self._seen[frame] & self._points)
        shape, seen = self._shape[points], self._places[frame, points] * self._cameras.curvature
        try:
            found, _, _, agreeing = cv2.solvePnPRansac(
                shape, seen, np.eye(3), None, confidence=SURE, iterationsCount=SAMPLES,
                reprojectionError=AGREEING_DISTANCE * self._cameras.curvature, flags=cv2.SOLVEPNP_AP3P,
            )  # fmt: skip
            least = max(LEAST_TYING, LEAST_AGREEING * len(points))
            if not found or agreeing is None or len(agreeing) < least:
                return False
            good = agreeing[:, 0]
            solved, vector, translation = cv2.solvePnP(
                shape[good], seen[good], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
            )
        except cv2.error:  # points that are nearly in one place or on a line
            return False
        if not solved or translation[2, 0] <= 0:
            return False
        self._place(frame, exponential(_float(vector.T))[0], _float(translation[:, 0]))
        return True

    def _add_points(self) -> None:
        """Points that two or more frames show whose rays meet under an angle."""
        bundle = self._bundle(np.ones(len(self._points), bool))
        if bundle is None:
            return
        part, listed, points = bundle
        self._shape[points] = retriangulated(listed, part)
        squares = squares_of(listed, part.cameras, self._shape[points])
        near = np.zeros((len(points), len(part.cameras.scales)), bool)
        near[listed.own, listed.other] = squares < AGREEING_DISTANCE**2
        centres = part.cameras.centres
        good = near.sum(axis=1) >= 2
        first, last = near.argmax(axis=1), near.shape[1] - 1 - near[:, ::-1].argmax(axis=1)
        places = self._shape[points]
        good &= (
            angles_between(places - centres[first], places - centres[last]) > LEVELS[self._level][1] * NARROW
        )
        self._points[:] = False
        self._points[points[good]] = True

    def _adjust(self) -> None:
        bundle = self._bundle(self._points)
        if bundle is None:
            return
        part, listed, points = bundle
        free = not self._focal_known and self._frames.sum() >= FOCAL_FREE
        part = adjust(listed, part.cameras, part.shape, focal_known=not free, most_steps=STEPS)
        self._adjusted = int(self._frames.sum())
        if part.cameras.curvature <= 0:
            return
        cameras = self._cameras
        cameras.rotations[self._frames] = part.cameras.rotations
        cameras.scales[self._frames] = part.cameras.scales
        cameras.shifts[self._frames] = part.cameras.shifts
        self._cameras = replace(cameras, curvature=part.cameras.curvature)
        self._shape[points] = part.shape

    def _bundle(self, wanted: Mask) -> tuple[Bundle, SparseObservations, Indices] | None:
        """The part that is known so far, of which only some points are wanted, and these points."""
        seen = self._seen[self._frames]
        points = np.flatnonzero(wanted & (seen.sum(axis=0) >= 2))
        if len(points) < LEAST_SHARED:
            return None
        frames, columns = np.nonzero(seen[:, points])
        x, y = self._places[self._frames][:, points][frames, columns].T.copy()
        by_frame = SparseObservations.sorted_by(frames, len(seen), columns, x, y, np.ones(len(x)))
        listed = by_frame.transposed(len(points))
        noise = StudentNoise((AGREEING_DISTANCE / 2) ** 2, 4.0)
        part = Bundle(self._cameras.of(self._frames), self._shape[points], noise, 0.0)
        return part, listed, points


def _float(values: ArrayLike) -> Array:
    return np.asarray(values, np.float64)


FIT_ROUNDS = 15
FIT_SETTLED = 1e-3  # nats an observation: a round that gains less is the last
PRECISION, MOST_STEPS = 1e-3, 20  # of the least squares of a round: the next one has other weights


@dataclass(frozen=True, eq=False)
class AffineFit:
    """Cameras `(n_frames, 2, 4)` and shape `(n_points, 3)` under Student's noise.

    `frames` and `points` are those which the observations determine; others are not fitted.
    """

    cameras: Array
    shape: Array
    frames: NDArray[np.bool_]
    points: NDArray[np.bool_]
    log_likelihood: float


def affine_fit(
    positions: ArrayLike, weights: ArrayLike, cameras: Array, shape: Array, *, outliers: bool = True
) -> AffineFit:
    """Make observations likelier, by weighted least squares whose weights follow from the round before.

    Arguments and errors are those of `factorise` and a start; frames may fall into sets that share no
    points.
    """
    where, given = np.asarray(positions, np.float64), np.asarray(weights, np.float64)
    frames, points = determined(Observations.from_arrays(where, given), apart=True)
    seen = (given > 0) & frames[:, None] & points
    best: AffineFit | None = None
    for _ in range(FIT_ROUNDS):
        squares = np.sum((where - projected(cameras, shape)) ** 2, axis=2)[seen]
        noise = StudentNoise.of_errors(squares, given[seen], outliers=outliers)
        likelihood = noise.log_likelihood(squares, given[seen])
        before = -np.inf if best is None else best.log_likelihood
        if likelihood > before:
            best = AffineFit(cameras, shape, frames, points, likelihood)
        if likelihood < before + FIT_SETTLED * len(squares):
            break
        counted = np.zeros_like(given)
        counted[seen] = noise.weights(squares, given[seen])
        cameras, shape = _refitted(where, counted, cameras)
    assert best is not None
    return best


def _refitted(positions: Array, weights: Array, cameras: Array) -> tuple[Array, Array]:
    observations = Observations.from_arrays(positions, weights)
    found = variable_projection(
        observations, observations.scaled(cameras), damping=NEAR, tolerance=PRECISION, most_steps=MOST_STEPS
    )
    moved = found.cameras * observations.scale
    moved[..., 3] += observations.centre
    return moved, found.shape


Start = tuple[PerspectiveCameras, Array]

FOCAL_STARTS = (0.8, 1.5, 3.0, 6.0)  # focal lengths to grow with, in widths of the picture: 64 to 10 degrees
AFFINE_STARTS = (1.0, 2.0)  # and those for an affine structure, which may need them for either mirror image
TRIAL_STEPS = 15  # of bundle adjustment, twice: after the first ones the better half of starts goes on
FINALISTS = 2  # starts that go on after both
MOST_ROUNDS = 6  # of bundle adjustment and new points, at the end
SETTLED = 3.0  # nats: a round that gains less is the last
SHORT_ROUNDS, SHORT_STEPS = 3, 8  # before these, where points are added: they go far, which steps do slowly


def affine_starts(metric: Euclidean, principal: Array, width: float, focal: float | None) -> Iterable[Start]:
    """Return an affine structure and its mirror image, before cameras of several focal lengths."""
    shifts = metric.cameras[..., 3] - principal
    focals = [focal] if focal is not None else [factor * width for factor in AFFINE_STARTS]
    curvatures = [sign / each for each in focals for sign in (1, -1)]
    for curvature in curvatures if focal is not None else [0.0, *curvatures]:
        start = PerspectiveCameras(metric.rotations, metric.scales, shifts, curvature, principal)
        yield (start, metric.shape) if curvature >= 0 else (start.mirrored(), metric.shape @ MIRROR)


def grown_starts(places: Array, principal: Array, width: float, focal: float | None) -> Iterable[Start]:
    """Return structures that grow from two views, with several focal lengths."""
    focals = [focal] if focal is not None else [factor * width for factor in FOCAL_STARTS]
    grow = partial(grown, places - principal, focal_known=focal is not None)
    tried = side_by_side([partial(grow, each) for each in focals])
    found = [each for each in tried if each is not None]
    most = max((np.count_nonzero(known) for _, _, known in found), default=0)
    for cameras, shape, known in found:
        if np.count_nonzero(known) == most:  # where it has come to a halt all further cameras are wrong
            yield replace(cameras, principal=principal), shape


def best_bundle(
    listed: SparseObservations, starts: Iterable[Start], *, focal_known: bool, outliers: bool = True
) -> Bundle | None:
    """Adjust the bundle from the start that grows most; `None` where there is none.

    Of an unknown focal length the sign is free, too: a negative one is that of the mirrored shape.
    """
    fit = partial(_round, listed, focal_known=focal_known, outliers=outliers)
    trials: list[Bundle] = []
    going_on = list(starts)
    for most in (max(len(going_on) // 2, FINALISTS), FINALISTS):
        trials = side_by_side([partial(fit, start, most_steps=TRIAL_STEPS) for start in going_on])
        trials.sort(key=lambda each: -each.log_likelihood)
        del trials[most:]
        going_on = [(trial.cameras, trial.shape) for trial in trials]
    ends = side_by_side([partial(_settled, fit, trial) for trial in trials])
    return max(ends, key=lambda each: each.log_likelihood, default=None)


def _settled(fit: Callable[..., Bundle], bundle: Bundle) -> Bundle:
    for _ in range(MOST_ROUNDS):
        before = bundle.log_likelihood
        bundle = fit((bundle.cameras, bundle.shape))
        if bundle.log_likelihood < before + SETTLED:
            break
    return bundle


def _round(
    listed: SparseObservations, start: Start, *, focal_known: bool, outliers: bool, most_steps: int = 100
) -> Bundle:
    """Bundle adjustment and new points, before cameras of a focal length that is not negative."""
    found = adjust(listed, *start, focal_known=focal_known, outliers=outliers, most_steps=most_steps)
    if found.cameras.curvature < 0:
        found = replace(found, cameras=found.cameras.mirrored(), shape=found.shape @ MIRROR)
    return replace(found, shape=retriangulated(listed, found))


@dataclass(frozen=True)
class Lens:
    """Camera of a video: `(height, width)` px of the image, and focal length in px if known."""

    size: tuple[int, int]
    focal: float | None = None

    @property
    def principal(self) -> Array:
        """`(2,)` px, the middle of the picture."""
        return np.array([self.size[1] - 1, self.size[0] - 1]) / 2


@short_repr
@dataclass(frozen=True, eq=False)
class PerspectiveStructure:
    """Cameras and shape, up to a similarity.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    cameras
        of all frames; those that are not determined are interpolated.
    shape, shape_covariance
        `(n_points, 3)`, axes as in the first view (x right, y down, z away), in px at the mean scale of the
        cameras, and `(n_points, 3, 3)`.
    positions, covariances
        `(n_frames, n_points, 2)` px and `(n_frames, n_points, 2, 2)` px^2 of all points in all frames, seen
        or not, without the noise of observations.
    frame_determined
        `(n_frames,)` bool: the camera of the frame is known.
    noise, log_likelihood
        of observations of weight 1; of all observations, nats.
    parameters, observations
        number of fitted parameters, and of observed coordinates.
    curvature_noise, systematic_curvature
        1/px, standard deviations of 1 / focal length by the noise of observations, and by errors that all
        have in common, of the lens and of tracks; 0 for a given one.
    """

    size: tuple[int, int]
    cameras: PerspectiveCameras
    shape: Array
    shape_covariance: Array
    positions: Array
    covariances: Array
    frame_determined: Mask
    noise: StudentNoise
    log_likelihood: float
    parameters: int
    observations: int
    curvature_noise: float
    systematic_curvature: float

    @property
    def curvature_deviation(self) -> float:
        """Standard deviation of 1 / focal length, 1/px; 0 for a given one."""
        return math.hypot(self.curvature_noise, self.systematic_curvature)

    @property
    def focal_deviation(self) -> float:
        """Standard deviation of the focal length, px, to first order; infinite where it is not known."""
        if self.curvature_deviation == 0:
            return 0.0
        return self.curvature_deviation * self.cameras.focal**2 if self.focal_determined else np.inf

    @property
    def focal_determined(self) -> bool:
        """Whether the tracks show that it is finite, by Schwarz's criterion for its one number."""
        if self.curvature_noise == 0:
            return True
        return (self.cameras.curvature / self.curvature_noise) ** 2 > math.log(self.observations)

    def agrees(self, positions: Array, weights: Array) -> Mask:
        """Return which positions `(n_frames, n_points)` are observed and no outliers."""
        squares = np.sum((positions - self.positions) ** 2, axis=2)
        return (weights > 0) & self.noise.agrees(np.where(weights > 0, squares, 0), weights)

    def known(self, positions: Array, weights: Array, within: float = TURN) -> Mask:
        """Return `(n_frames,)` which cameras halves of the others' points find again `within` rad."""
        agreeing = self.agrees(positions, weights) & self.frame_determined[:, None]
        bundle = Bundle(self.cameras, self.shape, self.noise, self.log_likelihood)
        return known_frames(positions, weights > 0, agreeing, bundle, within)

    def of_points(self, points: Mask) -> Self:
        """Return the structure of some points."""
        kept = {name: getattr(self, name)[points] for name in ("shape", "shape_covariance")}
        kept |= {name: getattr(self, name)[:, points] for name in ("positions", "covariances")}
        return replace(self, **kept)

    def of_frames(self, known: Mask) -> Self:
        """Return the structure whose cameras are known in some frames `(n_frames,)`, two or more, only."""
        known = known & self.frame_determined
        cameras, positions, covariances = _in_all_frames(
            self.cameras.of(known), self.shape, self.positions[known], self.covariances[known], known
        )
        return replace(
            self, cameras=cameras, positions=positions, covariances=covariances, frame_determined=known
        )

    def better_than(self, affine: AffineFit) -> bool:
        """Return whether it explains the positions better than affine cameras, by Schwarz's criterion (BIC).

        An affine camera has 8 numbers, and 12 of a film's are the choice of the shape's axes; a perspective
        one has 6, all together have a focal length, and 7 are the choice of the axes.
        """
        n_frames, n_points = np.count_nonzero(affine.frames), np.count_nonzero(affine.points)
        more = self.parameters - (8 * n_frames + 3 * n_points - 12)
        gain = self.log_likelihood - affine.log_likelihood
        return self.focal_determined and bool(gain > 0.5 * more * math.log(self.observations))


def perspective_structure(
    positions: Array, weights: Array, affine: AffineFit, lens: Lens, *, outliers: bool = True
) -> PerspectiveStructure | None:
    """Estimate perspective cameras, focal length and shape; `None` if no start is found.

    Positions and weights are those of `factorise`, with an observation of each point; `affine` is the affine
    solution, used as a start; only frames and points that it determines are used.
    """
    known, n_points = affine.frames, positions.shape[1]
    rows, points = np.nonzero(weights[known] > 0)
    x, y = positions[known][rows, points].T.copy()
    weight = weights[known][rows, points]
    by_frame = SparseObservations.sorted_by(rows, int(known.sum()), points, x, y, weight)
    everything = about(by_frame.transposed(n_points), lens.principal)
    frames = np.ones(int(known.sum()), bool)
    listed = everything.only(affine.points, frames)
    metric = euclidean(affine.cameras[known], affine.shape)
    fixed = lens.focal is not None
    about_lens = lens.principal, float(max(lens.size)), lens.focal
    searched = affine.points & covering((weights[known] > 0) & affine.points)
    places = np.where((weights[known] > 0)[..., None] & searched[:, None], positions[known], np.nan)
    starts = [
        *(affine_starts(metric, *about_lens) if metric.determined else ()),
        *grown_starts(places, *about_lens),
    ]
    found = best_bundle(listed.only(searched, frames), starts, focal_known=fixed, outliers=outliers)
    if found is None:
        return None
    if not np.array_equal(searched, affine.points):
        found = replace(found, shape=retriangulated(listed, found), log_likelihood=-math.inf)
        fit = partial(_round, listed, focal_known=fixed, outliers=outliers)
        for _ in range(SHORT_ROUNDS):
            found = fit((found.cameras, found.shape), most_steps=SHORT_STEPS)
        found = _settled(fit, found)
    # a point of one frame has a direction, and the depth of all others
    found = _upright(found, affine.points)
    found = replace(found, shape=retriangulated(everything, found))
    spread = np.cov(found.shape[affine.points].T)
    covariance = covariance_of(everything, found, spread, focal_known=fixed)
    of_known = predicted(found, covariance)
    cameras, places, covariances = _in_all_frames(found.cameras, found.shape, *of_known, known)
    return PerspectiveStructure(
        size=lens.size,
        cameras=cameras,
        shape=found.shape,
        shape_covariance=covariance.points,
        positions=places,
        covariances=covariances,
        frame_determined=known,
        noise=found.noise,
        log_likelihood=found.log_likelihood,
        parameters=freedom(listed, focal_known=fixed),
        observations=2 * len(listed.x),
        curvature_noise=covariance.curvature_deviation,
        systematic_curvature=covariance.systematic_curvature,
    )


def _upright(bundle: Bundle, points: Mask) -> Bundle:
    """The same in the axes of the first view, about the middle of some points, in px at the mean scale."""
    cameras = bundle.cameras
    turn, middle = cameras.rotations[0], np.median(bundle.shape[points], axis=0)
    # what a camera sees of the new origin is its new depth and shift
    moved = cameras.rotations @ middle * cameras.scales[:, None]
    depths = 1 + cameras.curvature * moved[:, 2]
    scales = cameras.scales / depths
    size = float(np.exp(np.mean(np.log(scales))))
    cameras = replace(
        cameras,
        rotations=cameras.rotations @ turn.T,
        scales=scales / size,
        shifts=(moved[:, :2] + cameras.shifts) / depths[:, None],
    )
    return replace(
        bundle, cameras=cameras, shape=size * np.where(points[:, None], bundle.shape - middle, 0) @ turn.T
    )


def tied_frames(agreeing: Mask) -> Mask:
    """Return `(n_frames,)` whether observations `agreeing` `(n_frames, n_points)` tie a frame to most others.

    Points tie two frames if a third one shows them too: of two views alone they agree with wrong cameras.
    """
    counted = agreeing[:, np.count_nonzero(agreeing, axis=0) > 2].astype(np.float32)
    shared = counted @ counted.T
    enough = min(LEAST_TYING, agreeing.shape[1])
    _, sets = connected_components(shared >= enough)
    largest = np.bincount(sets, counted.sum(axis=1)).argmax()
    return np.asarray((sets == largest) & (np.diag(shared) >= enough))


def _in_all_frames(
    cameras: PerspectiveCameras, shape: Array, positions: Array, covariances: Array, observed: Mask
) -> tuple[PerspectiveCameras, Array, Array]:
    """Cameras of all frames, positions of all points in them, and how uncertain these are.

    What is given is of the observed frames.
    """
    if observed.all():
        return cameras, positions, covariances
    times, wanted = np.flatnonzero(observed), np.arange(len(observed))
    inside = np.clip(wanted, times[0], times[-1])
    cameras = replace(
        cameras,
        rotations=Slerp(times, Rotation.from_matrix(cameras.rotations))(inside).as_matrix(),
        scales=np.exp(np.interp(wanted, times, np.log(cameras.scales))),
        shifts=np.stack([np.interp(wanted, times, each) for each in cameras.shifts.T], axis=1),
    )
    places, _ = cameras.seen(shape)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    way = np.sum((positions[after] - positions[after - 1]) ** 2, axis=2)
    whole = covariances[after] + way[..., None, None] * np.eye(2)
    whole[observed], places[observed] = covariances, positions
    return cameras, places, whole
