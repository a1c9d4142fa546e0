"""Points in the picture as a feature node: where each one is and what it looks like, by identity.

F = {(u_i, v_i, a_i)} of RSMCM §4.3. A tracker that follows single points meets here what knows how all of
them move together.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..core.bounds import POSITIVE, SHARE, check_bounds
from ..core.frame import Frame, GivenPoints
from ..core.gaussian_message import GaussianMessage
from ..core.pictures import draw_region, grey_of
from ..core.short_repr import short_repr
from .patches import Patches, sample_patches
from .search import Before, find_points

Numbers = NDArray[np.float64]

FARTHEST = 1e7  # px: coordinates beyond are taken for damage; their squares would drown everything else


def check_points(name: str, points: NDArray[np.float64], *, half: bool = False) -> None:
    """Refuse points `(n_frames, n_points, 2)` px that are neither positions nor missing, which is NaN twice.

    Where `half` is true, one coordinate alone will do.

    Raises
    ------
    ValueError
        that names the first such point of `name`: it is infinite or farther off than `FARTHEST`, or has one
        coordinate only.
    """
    missing = np.isnan(points)
    for wrong, expected in (
        (np.abs(points) > FARTHEST, f"finite px up to {FARTHEST:g}, NaN where missing"),
        ((missing[..., :1] != missing) & (not half), "both coordinates or none"),
    ):
        if wrong.any():
            frame, point = np.argwhere(wrong.any(axis=2))[0]
            place = f"point {point} of frame {frame} (both from 0)"
            raise ValueError(f"{name}: got {points[frame, point].tolist()} at {place}, expected {expected}")


PLANE = 2

COLOUR = (60, 220, 60)  # BGR, of points that are drawn
NOWHERE = GivenPoints(np.zeros((0, PLANE)), np.zeros(0, np.int64))  # no points


@short_repr
@dataclass(frozen=True, eq=False)
class View:
    """A picture that has been searched, and what was found in it."""

    time: float  # s, of the frame
    found: GivenPoints  # points that were found, or were given
    grey: NDArray[np.uint8] | None  # (height, width); None where points were given instead of a picture
    noise: float  # px, standard deviation of each coordinate of points that were given
    patch: int  # px, side of the patches that are cut from it

    def patches_at(self, positions: Numbers) -> NDArray[np.float32]:
        """Grey values `(n, patch, patch)` about `positions`, `(n, 2)` px; there has to be a picture."""
        assert self.grey is not None
        return sample_patches(self.grey, positions, self.patch)


@short_repr
@dataclass(frozen=True, eq=False)
class PointMessage:
    """Independent Gaussians over positions by identity, and what goes with them.

    `view` is this frame's, of the evidence, or that of the frame which a tracker's message comes from, to
    search back there. It is not saved: who goes on with a saved message has the frame.
    """

    positions: GaussianMessage  # px; see `GaussianMessage`
    patches: Patches | None = None  # what points look like; also of points whose position is not known
    view: View | None = field(default=None, metadata={"saved": False})
    # (n,): the point that each is taken for, the smallest of its group
    same_as: NDArray[np.int64] | None = None

    @classmethod
    def uniform(cls) -> Self:
        """The constant 1, which mentions nothing."""
        return cls(GaussianMessage.uniform(PLANE))

    @property
    def log_mass(self) -> float:
        """Log of the integral over all positions; see `GaussianMessage.log_mass`."""
        return self.positions.log_mass

    def __mul__(self, other: Self) -> Self:
        """Positions multiply; of two views the later one stays, two groupings keep the smaller numbers.

        A `ValueError`, if both say what points look like: appearance is one tracker's.
        """
        if self.patches is not None and other.patches is not None:
            raise ValueError("patches: got them from two chains at one feature, expected them from one")
        positions = self.positions * other.positions
        views = [view for view in (self.view, other.view) if view is not None]
        return replace(
            self,
            positions=positions,
            patches=other.patches if self.patches is None else self.patches,
            view=max(views, key=lambda view: view.time) if views else None,
            same_as=_grouped(positions.identities, self, other),
        )


def _grouped(
    identities: NDArray[np.int64], one: PointMessage, other: PointMessage
) -> NDArray[np.int64] | None:
    """`same_as` of a product that mentions `identities`."""
    if one.same_as is None and other.same_as is None:
        return None
    groups = identities.copy()
    for message in (one, other):
        if message.same_as is not None:
            place = np.searchsorted(identities, message.positions.identities)
            groups[place] = np.minimum(groups[place], message.same_as)
    return groups


@short_repr
@dataclass(frozen=True)
class PointTracks:
    """Feature node of points in the picture, shared by trackers and by what knows how points move together.

    Parameters
    ----------
    patch
        px, odd: side of the patches that say what a point looks like.
    noise
        px, standard deviation of each coordinate of points that are given; see `noise_of_tracks`.
    false_alarms
        share of the windows without the point in which something is as like it as is asked for; what has a
        rival, or leads back to another place in the picture before, is refused as well.
    farthest
        px from the middle of a prior beyond which nothing is searched.
    """

    patch: int = 5
    noise: float = 1.0
    false_alarms: float = 0.05
    farthest: float = 24.0
    name: str = "points"

    searches = True

    def __post_init__(self) -> None:
        if self.patch < 3 or self.patch % 2 == 0:
            raise ValueError(f"patch: got {self.patch} px, expected an odd number from 3")
        check_bounds(self, {"false_alarms": SHARE, "farthest": POSITIVE, "noise": POSITIVE})

    def uniform(self) -> PointMessage:
        """The message that mentions no point."""
        return PointMessage.uniform()

    def evidence(self, frame: Frame, prior: PointMessage) -> PointMessage:
        """Where the frame shows points of `prior`; or all points that are given with the frame.

        A given point is N(z; F, noise^2 I), whatever the prior; one of which one coordinate is known says
        nothing of the other. Otherwise every point of which `prior` knows the patch, and the place to a
        standard deviation of `farthest`, is searched for by normalised correlation. One that is found is area
        * N(z; F, R), as against being anywhere in the picture; one that is not found is no information.
        """
        if frame.points is not None:
            return self._given(frame.points, frame.time)
        if frame.image is None:
            return self.uniform()
        grey = grey_of(frame.image)
        positions, found = self._found(grey, prior)
        return PointMessage(positions, view=View(frame.time, found, grey, self.noise, self.patch))

    def _found(self, grey: NDArray[np.uint8], prior: PointMessage) -> tuple[GaussianMessage, GivenPoints]:
        """Points of `prior` that are found in the picture."""
        identities, mean, covariance = prior.positions.moments
        if prior.patches is None:
            return GaussianMessage.uniform(PLANE), NOWHERE
        known = np.isin(identities, prior.patches.identities)
        known &= 0.5 * np.trace(covariance, axis1=1, axis2=2) <= self.farthest**2
        if not known.any():
            return GaussianMessage.uniform(PLANE), NOWHERE
        identities, mean, covariance = identities[known], mean[known], covariance[known]
        patches = prior.patches.pixels[np.searchsorted(prior.patches.identities, identities)]
        found = find_points(
            grey, patches, mean, covariance, self.false_alarms, self.farthest, _before(prior.view, identities)
        )
        seen, position = identities[found.seen], found.position
        positions = GaussianMessage.from_moments(seen, position, found.covariance)
        positions = replace(positions, log_scale=positions.log_scale + np.log(grey.size))
        return positions, GivenPoints(position, seen)

    def draw(self, picture: NDArray[np.uint8], belief: PointMessage) -> None:
        """Draw into a BGR picture where the points are to 90 %."""
        _, means, covariances = belief.positions.moments
        for mean, covariance in zip(means, covariances, strict=True):
            draw_region(picture, mean, covariance, COLOUR)

    def _given(self, points: GivenPoints, time: float) -> PointMessage:
        known = ~np.isnan(points.positions)
        covariance = np.broadcast_to(self.noise**2 * np.eye(PLANE), (len(known), PLANE, PLANE))
        whole = np.where(known, points.positions, 0.0)
        positions = GaussianMessage.from_moments(points.identities, whole, covariance)
        if not known.all():  # integrated over what is not known, which is 0 above
            information = positions.information * (known[:, :, None] & known[:, None, :])
            integrated = np.count_nonzero(~known, axis=1) * np.log(self.noise * np.sqrt(2 * np.pi))
            positions = replace(
                positions, information=information, log_scale=positions.log_scale + integrated
            )
        return PointMessage(positions, view=View(time, points, None, self.noise, self.patch))


def _before(view: View | None, identities: NDArray[np.int64]) -> Before | None:
    """Where a picture showed points of these numbers; `None` if there is no picture."""
    if view is None or view.grey is None:
        return None
    shown = np.isin(identities, view.found.identities)
    position = np.zeros((len(identities), PLANE))
    position[shown] = view.found.positions[np.searchsorted(view.found.identities, identities[shown])]
    return Before(view.grey, shown, position)


def frames_of_tracks(
    tracks: NDArray[np.float64], numbers: range | None = None, rate: float = 25.0
) -> list[Frame]:
    """Frames that hold the points of tracks `(n_frames, n_tracks, 2)` px, NaN where missing; one may be.

    Identities are the tracks' columns; `numbers` of frames are 1, 2, ... by default, `rate` is frames per
    second.
    """
    frames = []
    for number, points in zip(numbers or range(1, len(tracks) + 1), tracks, strict=True):
        seen = np.flatnonzero(~np.isnan(points).all(axis=1)).astype(np.int64)
        frames.append(Frame(None, (number - 1) / rate, number, GivenPoints(points[seen], seen)))
    return frames


def noise_of_tracks(frames: Iterable[Frame]) -> float:
    """Standard deviation of each coordinate of the points that are given with frames, px.

    Estimated from third differences, which a motion that is smooth from frame to frame does not enter: their
    variance is 20 times that of independent noise. The median over all of them is not moved by tracks that
    jump or slip. Frames are taken to be evenly spaced. At least a millionth of the points' spread; a
    hundredth of it when no track lasts four frames.

    Raises
    ------
    ValueError
        if no frame has points.
    """
    given = [frame.points for frame in frames if frame.points is not None]
    if not any(len(points.identities) for points in given):
        raise ValueError("frames: got none with points, expected some")
    places = np.concatenate([points.positions for points in given])
    spread = float(np.sqrt(np.nanvar(places, axis=0).sum())) or 1.0
    off = []
    for four in zip(given, given[1:], given[2:], given[3:], strict=False):
        common = four[0].identities
        for points in four[1:]:
            common = np.intersect1d(common, points.identities, assume_unique=True)
        a, b, c, d = (points.positions[np.searchsorted(points.identities, common)] for points in four)
        off.append(np.abs(d - a + 3 * (b - c)).ravel())
    thirds = np.concatenate(off) if off else np.zeros(0)
    thirds = thirds[~np.isnan(thirds)]
    if not len(thirds):
        return 0.01 * spread
    return float(max(np.median(thirds) / (0.6745 * np.sqrt(20)), 1e-6 * spread))
