"""A perspective structure that grows frame by frame, from two views: for films of which no affine one exists.

Incremental structure from motion as usual (Snavely, Seitz, Szeliski, "Photo tourism", 2006): the essential
matrix of two views with much parallax, points between them, further cameras from these points, further points
from those cameras, and bundle adjustment whenever the film has grown.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....models.camera.perspective_camera import PerspectiveCameras
from ....models.numerics.rotations import exponential
from ..factor_analysis.observations import Listed, Numbers
from .bundle_adjustment import Bundle, adjust, retriangulated, squares_of
from .student_noise import StudentNoise

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

AGREEING_DISTANCE = 2.0
"""px, within which an observation agrees with a camera and a point: some deviations of usual trackers."""
SURE = 0.999
"""Probability with which a sample without outlier is found."""

MOST_VIEWS = 16
"""Frames, evenly spread, of which pairs are tried for the beginning."""
MOST_PAIRS = 12
"""Pairs of these with most shared motion, whose essential matrix is found."""
WIDE = np.radians(15.0)
"""Angle between rays from which a wider one makes a point no better known."""
NARROW = np.radians(1.5)
"""And below which its depth is not known."""

LEAST_SHARED = 12
"""Points from which a camera is found: twice what it needs."""
LEVELS = ((1, 1.0), (2 / 3, 0.5), (0.5, 0.2))
"""Shares of `LEAST_SHARED` and of `NARROW` that are enough: less, when no other frame can be added."""
SAMPLES = 200
"""Of points from which a camera is found, at most."""
LEAST_AGREEING = 0.5
"""Share of the points that agree with a frame's camera."""
MOSTLY = 0.7
"""Share of the points of the frame that shows most from which another one is taken along with it."""
GROWTH = 1.25
"""Factor by which the number of frames grows between two bundle adjustments."""
STEPS = 12
"""Of bundle adjustment while it grows."""
FOCAL_FREE = 5
"""Frames from which the focal length is estimated, too; fewer hardly show it."""


def grown(
    places: Numbers, focal: float, *, focal_known: bool
) -> tuple[PerspectiveCameras, Numbers, Mask] | None:
    """Grow a structure as far as it goes; `None` if no pair of frames shows enough.

    Parameters
    ----------
    places
        `(n_frames, n_points, 2)` px from the principal point, NaN where nothing was seen.
    focal
        px, with which to begin.
    focal_known
        whether to keep it.

    Returns
    -------
    cameras, shape, known
        of all frames, those without `known (n_frames,)` standing where the known one before or after stands;
        `(n_points, 3)`.
    """
    growth = _Growth(places, focal, focal_known)
    if not growth.begin():
        return None
    while growth.add_frames():
        pass
    return growth.result()


class _Growth:
    """Cameras and points so far."""

    def __init__(self, places: Numbers, focal: float, focal_known: bool) -> None:
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

    def result(self) -> tuple[PerspectiveCameras, Numbers, Mask]:
        """What has grown; see `grown`."""
        known = np.flatnonzero(self._frames)
        nearest = known[np.abs(np.arange(len(self._frames))[:, None] - known).argmin(axis=1)]
        return self._cameras.of(nearest), self._shape, self._frames

    # --- the beginning ---

    def begin(self) -> bool:
        """Two views with most parallax, and the points between them; whether there are such."""
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

    def _two_views(self, one: int, other: int) -> tuple[Numbers, Numbers, Numbers, float] | None:
        """How the second view lies to the first.

        Rotation and translation, the middle of the points, and how well these are known: the sum of the
        angles under which they are seen.
        """
        both = np.flatnonzero(self._seen[one] & self._seen[other])
        curvature = self._cameras.curvature
        here, there = self._places[one, both] * curvature, self._places[other, both] * curvature
        cv2.setRNGSeed(0)
        essential, agreeing = cv2.findEssentialMat(
            here, there, np.eye(3), method=cv2.RANSAC, prob=SURE, threshold=AGREEING_DISTANCE / 2 * curvature
        )
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
        angles = _angles(points, points + translation[:, 0] @ rotation)
        if np.median(angles) < NARROW:
            return None
        score = float(np.minimum(angles, WIDE).sum())
        return _float(rotation), _float(translation[:, 0]), _float(np.median(points, axis=0)), score

    def _place(self, frame: int, rotation: Numbers, translation: Numbers) -> None:
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
        seen = self._places[frame, points] * self._cameras.curvature
        cv2.setRNGSeed(0)
        try:
            found, vector, translation, agreeing = cv2.solvePnPRansac(
                self._shape[points], seen, np.eye(3), None, reprojectionError=AGREEING_DISTANCE * self._cameras.curvature,
                confidence=SURE, iterationsCount=SAMPLES, flags=cv2.SOLVEPNP_SQPNP,
            )  # fmt: skip
        except cv2.error:  # points that are nearly in one place or on a line
            return False
        enough = found and agreeing is not None and len(agreeing) >= LEAST_AGREEING * len(points)
        if not enough or translation[2, 0] <= 0:
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
        good &= _angles(places - centres[first], places - centres[last]) > LEVELS[self._level][1] * NARROW
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

    def _bundle(self, wanted: Mask) -> tuple[Bundle, Listed, Indices] | None:
        """The part that is known so far, of which only some points are wanted, and these points."""
        seen = self._seen[self._frames]
        points = np.flatnonzero(wanted & (seen.sum(axis=0) >= 2))
        if len(points) < LEAST_SHARED:
            return None
        frames, columns = np.nonzero(seen[:, points])
        x, y = self._places[self._frames][:, points][frames, columns].T.copy()
        by_frame = Listed.sorted_by(frames, len(seen), columns, x, y, np.ones(len(x)))
        listed = by_frame.transposed(len(points))
        noise = StudentNoise((AGREEING_DISTANCE / 2) ** 2, 4.0)
        part = Bundle(self._cameras.of(self._frames), self._shape[points], noise, 0.0)
        return part, listed, points


def _float(values: ArrayLike) -> Numbers:
    return np.asarray(values, np.float64)


def _angles(one: Numbers, other: Numbers) -> Numbers:
    """Angles `(n,)` rad between vectors `(n, 3)`."""
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    angles: Numbers = np.arctan2(sine, np.sum(one * other, axis=1))
    return angles
