"""Which cameras of a perspective structure are known: those that are found again from others' points.

A bundle adjustment ends in an optimum, whether or not another one explains as much. So the structure is built
up again from two views: each camera is placed without a start by the points that those before it determine,
and by halves of these points. Placements from halves scatter about the one from all points as that does about
the truth (Shao, Wu, "A general theory for jackknife variance estimation", 1989); and where a rival placement
explains as much, one of the halves prefers it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from ....models.core.short_repr import short_repr
from ....models.numerics.rotations import exponential, logarithm
from ..factor_analysis.observations import Array, SparseObservations
from .bundle_adjustment import Bundle, retriangulated

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

NARROW = np.radians(1.5)  # angle between the outermost rays to a point below which its depth is not known
WIDE = np.radians(15.0)  # and from which a wider one makes it no better known
LEAST_TYING = 6  # points that tie cameras to each other: twice what a camera needs
LEAST_SHARED = 2 * LEAST_TYING  # points from which a camera is placed: each half has to tie it
MOST_SHARED = 200  # of these that are used: more hardly move it
LEAST_VIEWS = 3  # of a piece: two agree about any points
SPLITS = 5  # into halves: a rival that every second one prefers is missed once in 1000 times
TURN = np.radians(2.0)  # between the placement of a half and the camera
SURE, SAMPLES = 0.999, 300  # probability of a sample without outlier, and samples at most
SAMPLED = 4  # points of a sample
LEAST_REACH = 0.1  # px: nearer than that is no outlier, but may be rounding of a placement by four points
ALIKE = 0.1  # of a camera's agreeing points: from so many others a rival placement, by WIDE or more, counts


class Piece(NamedTuple):
    """Cameras that are found from each other's points, and the points that these determine."""

    frames: Mask  # (n_frames,)
    points: Mask  # (n_points,)
    shape: Array  # (n_points, 3): where its cameras have them


def known_frames(places: Array, observed: Mask, agreeing: Mask, bundle: Bundle, within: float = TURN) -> Mask:
    """Return `(n_frames,)` whether each camera of the bundle is known in relation to most others that are.

    Halves of points have to place it `within` an angle, rad, of where it is. Of places
    `(n_frames, n_points, 2)` px some are `observed` `(n_frames, n_points)`, and some of these are `agreeing`
    with the bundle.
    """
    places = places - bundle.cameras.principal
    film = _Film(places, observed, agreeing, bundle, within, np.random.default_rng(0))
    left, pieces = np.count_nonzero(agreeing, axis=1), []
    while left.max(initial=0) >= LEAST_SHARED:
        seed = int(left.argmax())
        piece = film.piece(seed)
        left[seed] = 0
        if piece is not None:
            left[piece.frames] = 0
            pieces.append(piece)
    known = max(film.joined(pieces), key=lambda piece: np.count_nonzero(piece.frames), default=None)
    return np.zeros(len(places), np.bool_) if known is None or film.looks_alike(known) else known.frames


@short_repr
@dataclass(frozen=True, eq=False)
class _Film:
    """What is seen, px from the principal point, and its bundle; see `known_frames`."""

    places: Array
    observed: Mask
    agreeing: Mask
    bundle: Bundle
    within: float  # rad: between the placement of a half and the camera
    generator: np.random.Generator

    def piece(self, seed: int) -> Piece | None:
        """Return the piece that grows from a frame and the one that shows most of its points by parallax.

        `None` if these two cameras are not found from the points of the others.
        """
        angles = self._angles_to(seed)
        begun = np.isin(np.arange(len(angles)), [seed, int(angles.argmax())])
        piece = self.grown(begun) if angles.any() else None
        if piece is None or np.count_nonzero(piece.frames) < LEAST_VIEWS:
            return None
        for first in np.flatnonzero(begun).tolist():
            this = np.arange(len(angles)) == first
            if not self._found_again(first, *self._determined(piece.frames & ~this, this)):
                return None
        return piece

    def grown(self, piece: Mask) -> Piece:
        """Return a piece with the cameras that are found from its points."""
        tried = np.full(len(piece), LEAST_SHARED - 1)
        while True:
            points, shape = self._determined(piece, ~piece)
            shown = np.count_nonzero(self.agreeing & points, axis=1)
            more = np.flatnonzero(~piece & (shown > tried))
            tried[more] = shown[more]
            found = [frame for frame in more.tolist() if self._found_again(frame, points, shape)]
            if not found:
                return Piece(piece, *self._determined(piece, piece))
            piece = piece | np.isin(np.arange(len(piece)), found)

    def joined(self, pieces: Sequence[Piece]) -> list[Piece]:
        """Return the pieces, those as one that are tied to each other."""
        for one, other in combinations(pieces, 2):
            if self._tied(one, other):
                rest = [each for each in pieces if each is not one and each is not other]
                return self.joined([self.grown(one.frames | other.frames), *rest])
        return list(pieces)

    def _tied(self, one: Piece, other: Piece) -> bool:
        """Whether both place two cameras alike, or one, which a mirrored piece does as well, and points."""
        both = one.frames & other.frames
        if np.count_nonzero(both) > 1:
            return True
        agreeing, observed = np.zeros((2, len(both)), np.int64)
        for here, there in ((one, other), (other, one)):
            shown = there.frames[:, None] & ~here.frames[:, None] & here.points
            agreeing += np.count_nonzero(self.agreeing & shown, axis=1)
            observed += np.count_nonzero(self.observed & shown, axis=1)
            for frame in np.flatnonzero(there.frames & (agreeing >= LEAST_TYING)).tolist():
                points = np.flatnonzero(self.observed[frame] & here.points)
                both[frame] |= self._placed(frame, points, here.shape)
        agreeing, observed = agreeing.sum() - agreeing, observed.sum() - observed
        return bool((both & (agreeing >= LEAST_TYING) & (2 * agreeing > observed)).any())

    def looks_alike(self, piece: Piece) -> bool:
        """Whether what disagrees in a camera of the piece places it on another side, which looks alike.

        Then features of one side are taken for those of the other, and any camera may be on either.
        """
        for frame in np.flatnonzero(piece.frames).tolist():
            shown = self.observed[frame] & piece.points
            rest = np.flatnonzero(shown & ~self.agreeing[frame])
            least = max(LEAST_TYING, ALIKE * (np.count_nonzero(shown) - len(rest)))
            if len(rest) < least:
                continue
            least = max(least, self._more_than_chance(frame, rest))
            found = self._placement(piece.shape[rest], self.places[frame, rest])
            if found is not None and len(found[1]) >= least and self._off(frame, found[0]) > WIDE:
                return True
        return False

    def _more_than_chance(self, frame: int, points: Indices) -> int:
        """Number of points that hardly agree with the best of `SAMPLES` placements if they lie anywhere."""
        width, height = np.ptp(self.places[frame, points], axis=0)
        share = min(1.0, np.pi * self._reach**2 / max(width * height, 1.0))
        beyond = binom.isf((1 - SURE) / SAMPLES, len(points) - SAMPLED, share)
        return SAMPLED + 1 + int(beyond)

    @property
    def _reach(self) -> float:
        """Distance px from a placement's points beyond which places do not agree with it."""
        return max(self.bundle.noise.reach, LEAST_REACH)

    def _angles_to(self, frame: int) -> Array:
        """Sums over shared points of angles between the rays of a frame and others `(n_frames,)`."""
        points = np.flatnonzero(self.agreeing[frame])
        centres, shape = self.bundle.cameras.centres, self.bundle.shape[points]
        both = self.agreeing[:, points]
        rays = shape - centres[:, None]
        angles = np.where(both, np.minimum(angles_between(rays, rays[frame]), WIDE), 0)
        enough = np.count_nonzero(both, axis=1) >= LEAST_SHARED
        enough[frame] = False
        sums: Array = np.where(enough, angles.sum(axis=1), 0)
        return sums

    def _determined(self, piece: Mask, shown: Mask) -> tuple[Mask, Array]:
        """Which points of frames `shown` a piece determines, and where `(n_points, 3)` it has them."""
        seen, shape = self.agreeing & piece[:, None], self.bundle.shape.copy()
        wanted = self.observed[shown].any(axis=0)
        points = np.flatnonzero(wanted & (np.count_nonzero(seen, axis=0) > 1))
        frames, columns = np.nonzero(seen[:, points])
        x, y = self.places[frames, points[columns]].T.copy()
        listed = SparseObservations.sorted_by(frames, len(seen), columns, x, y, np.ones(len(x)))
        begun = replace(self.bundle, shape=shape[points])
        shape[points] = retriangulated(listed.transposed(len(points)), begun)
        centres, seen = self.bundle.cameras.centres, seen[:, points]
        first, last = seen.argmax(axis=0), len(seen) - 1 - seen[::-1].argmax(axis=0)
        rays = [shape[points] - centres[each] for each in (first, last)]
        determined = np.zeros(len(shape), np.bool_)
        determined[points] = angles_between(*rays) > NARROW
        return determined, shape

    def _found_again(self, frame: int, points: Mask, shape: Array) -> bool:
        """Whether halves of these points place a camera where it is."""
        shown = np.flatnonzero(self.observed[frame] & points)
        if len(shown) < LEAST_SHARED:
            return False
        halves: Iterable[Indices] = chain.from_iterable(
            np.array_split(self.generator.permutation(shown)[:MOST_SHARED], 2) for _ in range(SPLITS)
        )
        return all(self._placed(frame, half, shape) for half in halves)

    def _placed(self, frame: int, points: Indices, shape: Array) -> bool:
        """Whether these points place a camera where it is."""
        found = self._placement(shape[points], self.places[frame, points])
        return found is not None and self._off(frame, found[0]) <= self.within

    def _off(self, frame: int, rotation: Array) -> float:
        """Angle rad between a rotation and a camera's."""
        off = rotation @ self.bundle.cameras.rotations[frame].T
        return float(np.linalg.norm(logarithm(off[None])))

    def _placement(self, shape: Array, seen: Array) -> tuple[Array, Indices] | None:
        """Rotation `(3, 3)` of a camera that sees points `(n, 3)` at `(n, 2)` px, and which of them agree."""
        curvature = self.bundle.cameras.curvature
        try:
            found, turn, translation, agreeing = cv2.solvePnPRansac(
                shape, seen * curvature, np.eye(3), None, confidence=SURE, iterationsCount=SAMPLES,
                reprojectionError=self._reach * curvature, flags=cv2.SOLVEPNP_AP3P,
            )  # fmt: skip
            if not found or agreeing is None:
                return None
            good = np.asarray(agreeing[:, 0], np.int64)
            turn, _ = cv2.solvePnPRefineLM(
                shape[good], seen[good] * curvature, np.eye(3), None, turn, translation
            )
        except cv2.error:  # points that are nearly in one place or on a line
            return None
        return exponential(np.asarray(turn, np.float64).T)[0], good


def angles_between(one: Array, other: Array) -> Array:
    """Angles rad between vectors `(..., 3)`."""
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    angles: Array = np.arctan2(sine, np.sum(one * other, axis=-1))
    return angles
