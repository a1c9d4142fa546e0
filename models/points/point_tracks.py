"""Points in the picture as a feature node: where each one is and what it looks like, by identity.

F = {(u_i, v_i, a_i)} of RSMCM §4.3. A tracker that follows single points meets here what knows how all of
them move together.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Count, NotNegative, Positive, Shape, Share, at_least, checked
from ..core.frame import Frame, GivenPoints
from ..core.gaussian_message import GaussianMessage
from ..core.identities import find, places_of
from ..core.pictures import grey_of
from ..core.short_repr import short_repr
from .patches import Patches, sample_patches
from .search import PreviousView, find_points

Array = NDArray[np.float64]

MAX_COORDINATE = 1e7  # px: coordinates beyond are taken for damage; their squares would drown everything else


def check_points(name: str, points: NDArray[np.float64], *, allow_single: bool = False) -> None:
    """Check that points `(n_frames, n_points, 2)` px are positions, or NaN twice if missing.

    With `allow_single` one coordinate of a point may be missing.

    Raises
    ------
    ValueError
        naming the first wrong point of `name`: infinite, beyond `MAX_COORDINATE`, or with one coordinate.
    """
    missing = np.isnan(points)
    for wrong, expected in (
        (np.abs(points) > MAX_COORDINATE, f"finite px up to {MAX_COORDINATE:g}, NaN where missing"),
        ((missing[..., :1] != missing) & (not allow_single), "both coordinates or none"),
    ):
        if wrong.any():
            frame, point = np.argwhere(wrong.any(axis=2))[0]
            place = f"point {point} of frame {frame} (both from 0)"
            raise ValueError(f"{name}: got {points[frame, point].tolist()} at {place}, expected {expected}")


PLANE = 2

NO_POINTS = GivenPoints(np.zeros((0, PLANE)), np.zeros(0, np.int64))  # no points


@short_repr
@dataclass(frozen=True, eq=False)
class View:
    """A picture that has been searched, and the points that were found."""

    time: float  # s, of the frame
    points: GivenPoints  # that were found, or were given with the frame
    # None where points were given instead of a picture
    grey: Annotated[NDArray[np.uint8], Shape("height", "width")] | None
    noise: NotNegative  # px, standard deviation of each coordinate of points that were given
    patch_size: Count  # px, side of the patches that are cut from it

    def patches_at(self, positions: Array) -> NDArray[np.float32]:
        """Return grey values `(n, patch_size, patch_size)` about `positions` `(n, 2)` px of the picture."""
        assert self.grey is not None
        return sample_patches(self.grey, positions, self.patch_size)


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class PointMessage:
    """Independent Gaussians over positions by identity, with patches and the searched image.

    `view` is the image of this frame in the evidence, and of the last frame in a tracker's message, for the
    backward check. It is not saved.
    """

    positions: GaussianMessage  # px; see `GaussianMessage`
    patches: Patches | None = None  # also of points without a position
    view: View | None = field(default=None, metadata={"saved": False})
    # (n,): the point that each is taken for, the smallest of its group
    same_as: NDArray[np.int64] | None = None

    @classmethod
    def uniform(cls) -> Self:
        """Return the constant 1, with no points."""
        return cls(GaussianMessage.uniform(PLANE))

    @property
    def gaussians(self) -> GaussianMessage:
        """Positions, px."""
        return self.positions

    def with_gaussians(self, gaussians: GaussianMessage) -> Self:
        """Return the message with other Gaussians of positions."""
        return replace(self, positions=gaussians)

    @property
    def log_mass(self) -> float:
        """Return the log of the integral over all positions; see `GaussianMessage.log_mass`."""
        return self.positions.log_mass

    def __mul__(self, other: Self) -> Self:
        """Multiply positions; keep the later view and the smaller identities of `same_as`.

        Raises `ValueError` if both have patches: the appearance is one tracker's.
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
    """Return `same_as` of a product over `identities`."""
    if one.same_as is None and other.same_as is None:
        return None
    groups = identities.copy()
    for message in (one, other):
        if message.same_as is not None:
            place = places_of(identities, message.positions.identities)
            groups[place] = np.minimum(groups[place], message.same_as)
    return groups


@checked
@short_repr
@dataclass(frozen=True)
class PointTracks:
    """Feature node of points in the image, shared by trackers and models of their joint motion.

    Parameters
    ----------
    patch_size
        px, odd: side of the square patches.
    noise
        px, standard deviation of each coordinate of points given with frames; see `noise_of_tracks`.
    false_alarm_rate
        share of search windows without the point in which another position passes the test of correlation.
        Ambiguous matches, and those that fail the backward check, are rejected as well.
    search_radius
        px, largest distance from the mean of the prior at which a point is searched for.
    """

    patch_size: Annotated[int, at_least(3)] = 5
    noise: Positive = 1.0
    false_alarm_rate: Share = 0.05
    search_radius: Positive = 24.0
    name: str = "points"

    searches = True

    def __post_init__(self) -> None:
        if self.patch_size % 2 == 0:
            raise ValueError(f"patch_size: got {self.patch_size}, expected an odd number")

    def uniform(self) -> PointMessage:
        """Return the message without points."""
        return PointMessage.uniform()

    def evidence(self, frame: Frame, prior: PointMessage) -> PointMessage:
        """Return the likelihood of positions, of points given with the frame or found near the `prior`.

        A given point is N(z; F, noise^2 I), whatever the prior; a missing coordinate adds nothing. Otherwise
        each point of `prior` with a patch and a standard deviation of at most `search_radius` is searched for
        by normalised correlation. A found point is area * N(z; F, R), relative to the uniform density over
        the image; a point that is not found adds no information.
        """
        if frame.points is not None:
            return self._given(frame.points, frame.time)
        if frame.image is None:
            return self.uniform()
        grey = grey_of(frame.image)
        positions, found = self._search(grey, prior)
        return PointMessage(positions, view=View(frame.time, found, grey, self.noise, self.patch_size))

    def _search(self, grey: NDArray[np.uint8], prior: PointMessage) -> tuple[GaussianMessage, GivenPoints]:
        """Return the points of `prior` that are found in the picture."""
        identities, mean, covariance = prior.positions.moments
        if prior.patches is None:
            return GaussianMessage.uniform(PLANE), NO_POINTS
        patch, known = find(prior.patches.identities, identities)
        known &= 0.5 * np.trace(covariance, axis1=1, axis2=2) <= self.search_radius**2
        if not known.any():
            return GaussianMessage.uniform(PLANE), NO_POINTS
        identities, mean, covariance = identities[known], mean[known], covariance[known]
        patches = prior.patches.pixels[patch[known]]
        found = find_points(
            grey,
            patches,
            mean,
            covariance,
            self.false_alarm_rate,
            self.search_radius,
            _previous_view(prior.view, identities),
        )
        seen, position = identities[found.seen], found.position
        positions = GaussianMessage.from_moments(seen, position, found.covariance)
        positions = replace(positions, log_scale=positions.log_scale + np.log(grey.size))
        return positions, GivenPoints(position, seen)

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
        return PointMessage(positions, view=View(time, points, None, self.noise, self.patch_size))


def _previous_view(view: View | None, identities: NDArray[np.int64]) -> PreviousView | None:
    """Return the positions of points in the last picture; `None` without one."""
    if view is None or view.grey is None:
        return None
    place, shown = find(view.points.identities, identities)
    position = np.zeros((len(identities), PLANE))
    position[shown] = view.points.positions[place[shown]]
    return PreviousView(view.grey, shown, position)


@checked
def frames_of_tracks(
    tracks: Annotated[NDArray[np.float64], Shape("n_frames", "n_tracks", 2, finite=False)],
    numbers: range | None = None,
    rate: Positive = 25.0,
) -> list[Frame]:
    """Return frames with the points of tracks `(n_frames, n_tracks, 2)` px, NaN where one is missing.

    Identities are the tracks' columns; `numbers` of frames are 1, 2, ... by default; `rate` in frames a
    second.
    """
    numbers = numbers or range(1, len(tracks) + 1)
    if len(numbers) != len(tracks):
        raise ValueError(f"numbers: got {len(numbers)}, expected one for each of {len(tracks)} frames")
    if np.isinf(tracks).any():
        raise ValueError("tracks: got infinity, expected px, or NaN where a point is missing")
    frames = []
    for number, points in zip(numbers, tracks, strict=True):
        seen = np.flatnonzero(~np.isnan(points).all(axis=1)).astype(np.int64)
        frames.append(Frame(None, (number - 1) / rate, number, GivenPoints(points[seen], seen)))
    return frames


@checked
def noise_of_tracks(frames: Iterable[Frame]) -> float:
    """Estimate the standard deviation of each coordinate of the points that are given with frames, px.

    By third differences, in which smooth motion cancels and whose variance is 20 times that of independent
    noise; the median is robust to tracks that jump or slip. Frames are assumed to be evenly spaced. At least
    a millionth of the points' standard deviation; a hundredth of it if no track lasts four frames.

    Raises
    ------
    ValueError
        if no frame has points.
    """
    frames = list(frames)
    if not all(isinstance(frame, Frame) for frame in frames):
        raise TypeError("frames: got something else, expected an iterable of Frame")
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
        a, b, c, d = (points.positions[places_of(points.identities, common)] for points in four)
        off.append(np.abs(d - a + 3 * (b - c)).ravel())
    thirds = np.concatenate(off) if off else np.zeros(0)
    thirds = thirds[~np.isnan(thirds)]
    if not len(thirds):
        return 0.01 * spread
    return float(max(np.median(thirds) / (0.6745 * np.sqrt(20)), 1e-6 * spread))
