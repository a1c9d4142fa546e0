"""Tests whether the motion of tracks shows depth: a flat shape, parallax, a plane, a rotating camera.

Images of a plane, and images of a camera that rotates and zooms in place, are related by homographies
(Hartley and Zisserman, Multiple View Geometry, 2nd edition, 13.1 and 8.4). Only the residual of a homography,
parallax, shows depth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from ...models.numerics.rotations import exponential
from .factor_analysis.em import LEAST_NOISE
from .factor_analysis.factorisation import NEAR, Factorisation, variable_projection
from .factor_analysis.initialisation import RANK, freedom
from .factor_analysis.observations import Observations, determined

Array = NDArray[np.float64]

Kind = Literal["still", "similarity", "rotation", "plane", "unknown"]
"""The plainest thing that explains tracks about as well as homographies do, however well that is: nothing
moves; shifts, turns and zooms of the picture; a camera that turns and zooms where it stands; one plane; too
few tracks are long enough to tell."""

MOST_PAIRS = 12
LEAST_SHARED = 8  # tracks of two pictures: twice those that any homography goes through
AS_WELL = 1.5
"""Variance about a plainer map, in that about the best homography, up to which it explains as much: lenses
are no pinholes, and the ratio of two estimates from a dozen points varies by a third."""
NEARLY_ALL = 0.3
"""Share of what a similarity leaves that a camera which turns may leave: a tenth where the middle of its
picture is some way off that of the points, of a plane two thirds and more."""
MOST = 0.8  # share of the tracks that are believed: some of a tracker's jump to other points
TRIMMED_STEPS = 5
ROUNDING = 1e-12  # variance, in squares of the tracks' extent, that is none
FOCAL_LENGTHS = (0.7, 3.0)  # in the tracks' extent: where the search for a camera that turns begins
SHORTEST, LONGEST = 0.4, 100.0  # in the tracks' extent: wider, a camera that turns explains planes, too
MOST_LOOKED_AT = 8  # pictures, or pairs of them, from which the motion is estimated where there are no tracks
LEAST_MOTION = 2.0
"""px: by as much half of the features of two pictures differ if there is depth to see. Of any two in five
films of cameras that stand it was 0 to 1.04, of most in five of cameras that move 20 and more."""
FEATURES = 500
FEWEST_MATCHES = 10


@dataclass(frozen=True)
class Motion:
    """What tracks show.

    Parameters
    ----------
    kind
        see `Kind`.
    tracks, life, per_frame
        how many are seen at all, median number of frames in which one is, and median px from a frame to the
        next.
    parallax
        px: root mean square distance between points and where homographies have them, median over pairs of
        pictures far apart; NaN where too few points are shared.
    """

    kind: Kind
    tracks: int
    life: float
    per_frame: float
    parallax: float


def motion_of(tracks: Array, most: float = MOST) -> Motion:
    """Return the kind of motion of tracks `(n_frames, n_tracks, 2)` px, NaN where they are not seen.

    `most` is the share of the tracks of a pair of images that is used, those with the smallest residuals.
    """
    seen = ~np.isnan(tracks[..., 0])
    lives = seen.sum(axis=0)
    lives = lives[lives > 0]
    steps = np.linalg.norm(np.diff(tracks, axis=0), axis=2)
    steps = steps[np.isfinite(steps)]
    pairs = far_pairs(seen)
    kind, parallax = _kind(tracks, seen, pairs, most)
    return Motion(
        kind,
        len(lives),
        float(np.median(lives)) if len(lives) else 0.0,
        float(np.median(steps)) if len(steps) else float("nan"),
        parallax,
    )


def picture_motion(pictures: Sequence[NDArray[np.uint8]]) -> float:
    """Return median px by which ORB features move from a picture to the next; NaN where hardly any are found
    again."""
    pairs = list(pairwise(pictures))
    chosen = np.linspace(0, len(pairs) - 1, min(MOST_LOOKED_AT, len(pairs))).round().astype(int)
    features = [(_orb_features(pairs[k][0]), _orb_features(pairs[k][1])) for k in chosen]
    moved = np.concatenate([np.zeros(0), *(_matched_distances(one, other) for one, other in features)])
    return float(np.median(moved)) if len(moved) >= FEWEST_MATCHES else math.nan


def stands_still(pictures: Sequence[NDArray[np.uint8]]) -> bool:
    """Whether half of the ORB features of every picture are in one place in most others: no depth is seen.

    Of a film `MOST_LOOKED_AT` pictures are compared. Where hardly any feature is found again, it is false.
    """
    chosen = np.linspace(0, len(pictures) - 1, min(MOST_LOOKED_AT, len(pictures))).round().astype(int)
    features = [_orb_features(pictures[k]) for k in chosen]
    moved = np.full((len(chosen), len(chosen)), np.nan)
    for one, other in combinations(range(len(chosen)), 2):
        distances = _matched_distances(features[one], features[other])
        found = np.median(distances) if len(distances) >= FEWEST_MATCHES else np.inf
        moved[one, other] = moved[other, one] = found
    return bool(np.all(np.nanmedian(moved, axis=1) < LEAST_MOTION))


def _orb_features(picture: NDArray[np.uint8]) -> tuple[Array, NDArray[np.uint8]]:
    """Return places `(n, 2)` px, and descriptors `(n, 32)`."""
    points, words = cv2.ORB.create(FEATURES).detectAndCompute(picture, None)
    if words is None:
        return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
    return np.array([point.pt for point in points]), words.astype(np.uint8, copy=False)


def _matched_distances(one: tuple[Array, NDArray[np.uint8]], other: tuple[Array, NDArray[np.uint8]]) -> Array:
    """Return px between the features of two pictures that are each other's nearest."""
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(one[1], other[1])
    pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches], np.int64).reshape(-1, 2)
    distances: Array = np.linalg.norm(one[0][pairs[:, 0]] - other[0][pairs[:, 1]], axis=1)
    return distances


def far_pairs(seen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return pairs of frames as far apart as half of the usual number of `seen` tracks allows."""
    enough = max(LEAST_SHARED, float(np.median(seen.sum(axis=1))) / 2)
    lag = len(seen) // 2
    while lag:
        firsts = np.flatnonzero(np.count_nonzero(seen[:-lag] & seen[lag:], axis=1) >= enough)
        if len(firsts):
            chosen = np.linspace(0, len(firsts) - 1, min(MOST_PAIRS, len(firsts))).round().astype(int)
            return [(int(first), int(first) + lag) for first in firsts[chosen]]
        lag //= 2
    return []


def variance_over_shape(places: Array, residuals: Array, most: float = MOST) -> float:
    """Return the variance about homographies over that about a shape in depth; NaN if unknown.

    Where homographies do as well, the fitted depth is something else. Places `(n_frames, n_points,
    2)` px are NaN where not seen, residuals are what the shape leaves; of a pair of pictures `most` of the
    points count.
    """
    seen = ~np.isnan(places[..., 0])
    left = in_depth = 0.0
    for one, other in far_pairs(seen):
        both = seen[one] & seen[other]
        chosen, off = _homography(places[one, both], places[other, both], most)
        left += float(np.sum(off**2)) * off.size / max(off.size - 8, 1)
        squares = np.sum(residuals[[one, other]][:, both] ** 2, axis=(0, 2))
        in_depth += float(np.sum(np.sort(squares)[: len(chosen)]))
    return left / in_depth if in_depth > 0 else float("nan")


def _kind(
    tracks: Array, seen: NDArray[np.bool_], pairs: list[tuple[int, int]], most: float
) -> tuple[Kind, float]:
    """The plainest explanation, and the parallax."""
    if not pairs:
        return "unknown", float("nan")
    known = tracks[seen]
    low, high = known.min(axis=0), known.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    sums = np.zeros(4)  # variances about a homography, no motion, a similarity, a camera that turns
    parallax = []
    for one, other in pairs:
        both = seen[one] & seen[other]
        before, after = tracks[one, both] - middle, tracks[other, both] - middle
        chosen, off = _homography(before, after, most)
        before, after = before[chosen], after[chosen]
        parallax.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
        sums += [
            np.sum(squares) / (off.size - freedom)
            for squares, freedom in (
                (off**2, 8),
                ((after - before) ** 2, 0),
                (_off_similarity(before, after) ** 2, 4),
                (_off_rotation(before, after, size) ** 2, 5),
            )
        ]
    homography, still, similarity, rotation = sums
    amount = float(np.median(parallax))
    none = ROUNDING * size**2 * len(pairs)
    if similarity <= AS_WELL * max(homography, none):
        return "still" if still <= AS_WELL * max(similarity, none) else "similarity", amount
    if rotation - homography <= NEARLY_ALL * (similarity - homography):
        return "rotation", amount
    return "plane", amount


def _homography(before: Array, after: Array, most: float = MOST) -> tuple[NDArray[np.intp], Array]:
    """Most of the points, those that a homography explains best, and what it leaves."""
    count = max(int(np.ceil(most * len(before))), min(len(before), LEAST_SHARED))
    found, _ = cv2.findHomography(before, after, cv2.LMEDS)
    chosen, off = np.arange(len(before)), np.zeros_like(after)
    for _ in range(TRIMMED_STEPS):
        if found is None:  # all in one place
            break
        off = after - np.asarray(cv2.perspectiveTransform(before[None], found)[0], np.float64)
        chosen = np.argsort(np.sum(off**2, axis=1), kind="stable")[:count]
        found, _ = cv2.findHomography(before[chosen], after[chosen], 0)
    return chosen, off[chosen]


def _off_similarity(before: Array, after: Array) -> Array:
    """What the best shift, turn and zoom of the picture leaves."""
    one, other = (places @ [1, 1j] for places in (before, after))
    design = np.column_stack([one, np.ones(len(one))])
    left = other - design @ np.linalg.lstsq(design, other)[0]
    return np.column_stack([left.real, left.imag])


def _off_rotation(before: Array, after: Array, size: float) -> Array:
    """What the best camera leaves that turns and zooms: f' (r_1 d, r_2 d) / (r_3 d), d = (before, f)."""

    def off(parameters: Array, focal: float) -> Array:
        first, second = focal * parameters[3:]
        seen = np.column_stack([before, np.full(len(before), first)]) @ exponential(parameters[None, :3])[0].T
        left: Array = second * seen[:, :2] / seen[:, 2:] - after
        return left.ravel()

    across, down = (after - before).mean(axis=0) / size
    fits = []
    for focal in FOCAL_LENGTHS:
        turn = np.clip([-down / focal, across / focal, 0.0], -1.5, 1.5)
        low, high = SHORTEST / focal, LONGEST / focal
        bounds = ([-np.pi] * 3 + [low] * 2, [np.pi] * 3 + [high] * 2)
        start = np.array([*turn, 1.0, 1.0])
        fits.append(least_squares(off, start, bounds=bounds, args=(focal * size,), max_nfev=60))
    best: Array = min(fits, key=lambda fit: fit.cost).fun
    return best.reshape(-1, 2)


PRECISION = 1e-4
MOST_STEPS = 60


@dataclass(frozen=True)
class Depth:
    """How much better than a flat shape one in depth explains the observations.

    `gain` is the squared error that the third direction takes away, in variances of the noise, `needed` what
    it has to take away: log(numbers observed) for each number that it needs.
    """

    gain: float
    needed: float

    @property
    def determined(self) -> bool:
        """Whether there is depth in what was seen."""
        return self.gain > self.needed


def depth(positions: ArrayLike, weights: ArrayLike | None, factorisation: Factorisation) -> Depth:
    """Compare the best shape in depth with the best flat one, by Schwarz's criterion (BIC).

    Before a static camera, under a motion in the picture plane, or of a flat scene, positions (less their
    mean) have rank 2, and a third direction fits noise. It has 2 n_frames + n_points - 6 numbers; fitting
    noise, they take away at most about twice as many variances, so that log(numbers observed) for each
    leaves room. Errors of a tracker that last may still pass for depth. Arguments and errors are those of
    `factorise`, which gave `factorisation`.
    """
    observations = Observations.from_arrays(positions, weights)
    frames, points = determined(observations, apart=factorisation.coherent)
    part = observations.only(frames, points)
    needed = float(2 * frames.sum() + points.sum() - 2 * RANK) * float(np.log(2 * part.count))
    left = freedom(part)
    if left <= 0:  # everything is fitted, and nothing is left to estimate the noise from
        return Depth(0.0, needed)
    cameras = observations.scaled(factorisation.cameras)
    fitted = partial(variable_projection, part, damping=NEAR, tolerance=PRECISION, most_steps=MOST_STEPS)
    deep = fitted(cameras)
    noise = max(deep.error / left, LEAST_NOISE**2)
    cameras[..., 2] = 0  # the axis that moves points least
    flat = fitted(cameras, rank=2, enough=deep.error + needed * noise)
    return Depth((flat.error - deep.error) / noise, needed)
