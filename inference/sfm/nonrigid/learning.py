"""Non-rigid structure from motion: the shape of a deforming object, and its poses, from 2-D point tracks.

`learn_shape` is given the number of bases; `choose_bases` finds it by positions that were withheld;
`learn_associated` also finds which partial tracks show one point.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....models.numerics.rotations import nearest_rotation
from ....models.points.point_tracks import check_points
from .em import State, Tracks, WeightPosterior, e_step, point_sums
from .search import Found, search, shapes_of, whole_shapes
from .shape import (
    MIRRORED,
    NonrigidShape,
    Rival,
    basis_covariances,
    convex,
    frame_covariances,
    posed,
    shape_error,
    without_triangles,
)
from .smoothness import SMOOTH_FRAMES, smoothed

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

LEAST_FRAMES = 3
"""That a point is seen in, and that there are; two views leave depth open."""
LEAST_POINTS = 4
"""Of a frame, for its pose to be known."""


def learn_shape(
    tracks: ArrayLike,
    bases: int,
    *,
    iterations: int = 300,
    tolerance: float = 1e-6,
    smooth: bool = False,
    on_iteration: Callable[[], None] = lambda: None,
) -> NonrigidShape:
    """Learn a deformable shape by EM for probabilistic PCA (Torresani, Hertzmann and Bregler 2008).

    See `em` for the model and the steps, `search` for where they start, and for modes beyond those that are
    asked for. Without `smooth` the frames' order matters only where a flat object's turns are doubtful. Equal
    tracks give equal bytes.

    Parameters
    ----------
    tracks
        `(n_frames, n_points, 2)` px, NaN where a point was not seen.
    bases
        number of morph bases with the mean shape, 2 or more: one less than modes of deformation.
    iterations, tolerance
        of the last climb: at most so many, until one gains less than so many nats a coordinate.
    smooth
        frames are successive: weights and turns are smoothed at the end, by as much as the tracks tell, see
        `smoothness`. Covariances, history and log likelihood are of frames by themselves.
    on_iteration
        is called after every iteration.

    Raises
    ------
    ValueError
        if tracks have another shape, infinities, or half positions; there are fewer than 3 frames with 4
        points (5 for `smooth`), or points seen in fewer than 3 of them; or bases are fewer than 2, or more
        than the tracks can tell apart, min(2 n_frames, n_points - 1) / 3.
    """
    positions = np.array(tracks, np.float64)
    determined = _check(positions, bases)
    if smooth and determined.sum() < SMOOTH_FRAMES:
        raise ValueError(
            f"tracks: got {determined.sum()} frames that show {LEAST_POINTS} points or more, expected "
            f"{SMOOTH_FRAMES} at least for smooth weights and turns"
        )
    middles = np.nanmean(positions[determined], axis=1)
    centred = positions[determined] - middles[:, None]
    unit = float(np.sqrt(np.nanmean(centred**2)))
    if not unit > 0:
        raise ValueError("tracks: got points that all lie in one place, expected a shape")
    centred /= unit
    observed = Tracks.of(centred)
    found = search(observed, centred, bases, most_bases(centred), iterations, tolerance, on_iteration)
    state = found.state
    if smooth:
        state, weights = smoothed(observed, state, on_iteration)
    else:
        weights = e_step(state, point_sums(observed, state.bases))
    return _in_pixels(observed, replace(found, state=state), weights, bases, unit, middles, determined)


def _check(positions: Numbers, bases: int) -> NDArray[np.bool_]:
    """Refuse what cannot be learned from; `(n_frames,)` which frames can be."""
    if positions.ndim != 3 or positions.shape[2] != 2:
        raise ValueError(f"tracks: got {positions.shape}, expected (n_frames, n_points, 2) px")
    check_points("tracks", positions)
    seen = ~np.isnan(positions[..., 0])
    determined: NDArray[np.bool_] = seen.sum(axis=1) >= LEAST_POINTS
    n_frames, n_points = int(determined.sum()), positions.shape[1]
    if n_frames < LEAST_FRAMES:
        raise ValueError(
            f"tracks: got {n_frames} frames that show {LEAST_POINTS} points or more, "
            f"expected {LEAST_FRAMES} at least"
        )
    views = seen[determined].sum(axis=0)
    if views.min() < LEAST_FRAMES:
        raise ValueError(
            f"tracks: got point {views.argmin()} in {views.min()} frames, expected {LEAST_FRAMES} at least"
        )
    most = most_bases(positions[determined])
    if most < 2:
        raise ValueError(f"tracks: got {n_points} points, expected 7 at least")
    if not 2 <= bases <= most:
        raise ValueError(f"bases: got {bases}, expected 2 to {most} for {n_frames} frames, {n_points} points")
    return determined


def most_bases(positions: Numbers) -> int:
    """How many bases positions `(n_frames, n_points, 2)` can tell apart: each adds three to their rank."""
    n_frames, n_points = positions.shape[:2]
    return int(min(2 * n_frames, n_points - 1)) // 3


def _in_pixels(
    tracks: Tracks,
    search: Found,
    found: WeightPosterior,
    n_bases: int,
    unit: float,
    middles: Numbers,
    determined: NDArray[np.bool_],
) -> NonrigidShape:
    """The result in px and in the axes and order that `NonrigidShape` promises."""
    state = search.state
    turn = nearest_rotation(state.rotations.mean(axis=0))
    bases, rotations = state.bases @ turn.T, state.rotations @ turn.T
    centroids = bases.mean(axis=1)
    axes = state.scales[:, None, None] * rotations[:, :2]
    translations = state.translations + np.einsum("nca,nk,ka->nc", axes, found.extended, centroids)
    bases = bases - centroids[:, None]
    if not convex(bases[0]):
        bases, rotations = bases * MIRRORED, MIRRORED[:, None] * rotations * MIRRORED
    flat = bases[1:, :, :2].reshape(len(bases) - 1, -1)
    order = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    bases[1:] = np.tensordot(order.T, bases[1:], 1)
    size = float(np.sqrt(np.mean(np.sum(bases[0, :, :2] ** 2, axis=1))))

    bases = bases / size
    noise = unit * float(np.sqrt(state.noise))
    weights = found.mean @ order
    spread = order.T @ found.covariance @ order
    scales = state.scales * size * unit
    translations = translations * unit + middles
    seen = tracks.seen > 0
    poses = posed(rotations, translations, scales, weights)
    shapes = shapes_of(state, found)

    def everywhere(values: Numbers) -> Numbers:
        whole = np.full((len(determined), *values.shape[1:]), np.nan)
        whole[determined] = values
        return whole

    return NonrigidShape(
        bases=bases[:n_bases],
        weights=everywhere(weights[:, : n_bases - 1]),
        details=bases[n_bases:],
        detail_weights=everywhere(weights[:, n_bases - 1 :]),
        rotations=everywhere(rotations),
        scales=everywhere(scales),
        translations=everywhere(translations),
        noise=noise,
        rmse=unit * float(np.sqrt(_squared_error(tracks, state, found) / tracks.count)),
        log_likelihood=float(found.log_likelihood.sum()) - tracks.count * float(np.log(unit)),
        history=tuple(value - tracks.count * float(np.log(unit)) for value in search.history),
        frame_determined=determined,
        frame_covariances=everywhere(frame_covariances(bases, poses, seen, noise)),
        basis_covariances=basis_covariances(bases, poses, weights, spread, seen, noise),
        rivals=tuple(
            Rival(gap, shape_error(whole_shapes(tracks, other), shapes)) for gap, other in search.others
        ),
    )


def _squared_error(tracks: Tracks, state: State, found: WeightPosterior) -> float:
    """What the mean shapes leave of the positions."""
    shapes = np.tensordot(found.extended, state.bases, 1)
    predicted = shapes @ state.seen_axes.transpose(0, 2, 1) + state.translations[:, None]
    return float(np.sum(tracks.seen[..., None] * (tracks.positions - predicted) ** 2))


WITHHELD = 0.1
"""Share of the positions; the model is learned from the others."""
LEAST_LEFT = 5
"""Positions that a frame or a point keeps at least, where it has them: enough for a pose."""
MOST_BASES = 8
BLOCKS = 20
"""Of successive frames, whose errors are alike: what they differ by is the spread of an error."""


@dataclass(frozen=True, eq=False)
class BasesChoice:
    """Errors at positions that were withheld.

    Parameters
    ----------
    bases
        the number that was chosen.
    candidates
        `(n,)` numbers of bases that were tried.
    errors
        `(n,)` px: root mean square of a coordinate at withheld positions.
    excess
        `(n,)` px^2: by how much the mean square is above that of the best candidate.
    excess_errors
        `(n,)` px^2: standard error of this, from blocks of frames.
    """

    bases: int
    candidates: tuple[int, ...]
    errors: Numbers
    excess: Numbers
    excess_errors: Numbers


def choose_bases(
    tracks: ArrayLike,
    candidates: Sequence[int] | None = None,
    *,
    seed: int = 0,
    on_iteration: Callable[[], None] = lambda: None,
) -> BasesChoice:
    """Number of bases by cross-validation: the fewest that are no worse than the best by one standard error.

    A tenth of all positions, drawn at random once for all candidates, is withheld and predicted by shapes
    learned from the rest (the one-standard-error rule of Hastie, Tibshirani and Friedman 2009, section 7.10,
    with differences to the best candidate, paired by blocks of frames).

    Parameters
    ----------
    tracks
        as for `learn_shape`.
    candidates
        numbers of bases; 2 to 8 by default, as far as the tracks can tell so many apart.
    seed
        of which positions are withheld.
    on_iteration
        as for `learn_shape`.

    Raises
    ------
    ValueError
        as `learn_shape` does.
    """
    positions = np.array(tracks, np.float64)
    hidden = withheld(positions, seed)
    partial = positions.copy()
    partial[hidden] = np.nan
    if candidates is None:
        candidates = range(2, min(MOST_BASES, most_bases(partial)) + 1)
    squares = []
    for bases in candidates:
        learned = learn_shape(partial, bases, on_iteration=on_iteration)
        predicted = without_triangles(learned.bases).project(learned.poses)
        squares.append(np.where(hidden, np.sum((predicted - positions) ** 2, axis=2) / 2, 0.0))
    blocks = np.array_split(np.arange(len(positions)), min(BLOCKS, len(positions)))
    sums = np.array([[each[block].sum() for block in blocks] for each in squares])
    total = hidden.sum()
    means = sums.sum(axis=1) / total
    away = sums - sums[means.argmin()]
    excess = away.sum(axis=1) / total
    spread = np.sqrt(len(blocks)) * away.std(axis=1, ddof=1) / total
    chosen = int(np.flatnonzero(excess <= spread)[0])
    return BasesChoice(candidates[chosen], tuple(candidates), np.sqrt(means), excess, spread)


def withheld(positions: Numbers, seed: int) -> NDArray[np.bool_]:
    """`(n_frames, n_points)`: which positions that were seen are not to be learned from."""
    seen = ~np.isnan(positions[..., 0])
    draws = np.where(seen, np.random.default_rng(seed).random(seen.shape), 2.0)
    # those that a frame, or a point, has to keep are the ones with the largest draws among what was seen
    hidden = seen & (draws < WITHHELD)
    for axis in (0, 1):
        rank = np.argsort(np.argsort(np.where(seen, -draws, 1.0), axis=axis), axis=axis)
        hidden &= rank >= LEAST_LEFT
    return hidden


ALIKE = 3.0
"""Mean squared distance of a coordinate from where the other track expects it, in units of what is stated.

It is 1 for one point, if covariances are honest. Its errors are alike over time, so that the mean over a
short track spreads as a chi-square of few degrees of freedom would: 3 is its 95 % point for two of them.
"""
SHARP = 0.1
"""Places are expected to this share of the object's size, or another track cannot be told from them."""
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class AssociatedShape:
    """A shape, and the tracks that show its points.

    Parameters
    ----------
    shape
        the shape.
    point_of_track
        `(n_tracks,)` int64; -1 where a track is too short.
    """

    shape: NonrigidShape
    point_of_track: Indices


def learn_associated(positions: Numbers, bases: int, *, associate: bool) -> AssociatedShape:
    """Learn a shape from tracks, of which some may show one point one after the other.

    Parameters
    ----------
    positions
        `(n_frames, n_tracks, 2)` px, NaN where not seen.
    bases
        for `learn_shape`, fewer if the tracks cannot tell so many apart.
    associate
        whether tracks are united: pairs that were never seen at once, of which each lies where the shape
        expects the other and no other one lies nearer. Then the shape is learned again, until none are left.

    Raises
    ------
    ValueError
        as `learn_shape` does.
    """
    point = _long_enough(positions)
    for _ in range(ROUNDS):
        merged = _merged(positions, point)
        shape = learn_shape(merged, bases)
        pairs = _pairs(merged, shape) if associate else []
        if not pairs:
            break
        for one, other in pairs:
            point[point == other] = one
        point[point >= 0] = np.unique(point[point >= 0], return_inverse=True)[1]
    else:
        shape = learn_shape(_merged(positions, point), bases)
    return AssociatedShape(shape, point)


def _long_enough(positions: Numbers) -> Indices:
    """A point for each track that is seen in enough frames which show enough of the others."""
    seen = ~np.isnan(positions[..., 0])
    keeps = np.ones(seen.shape[1], np.bool_)
    while True:
        frames = seen[:, keeps].sum(axis=1) >= LEAST_POINTS
        enough = keeps & (seen[frames].sum(axis=0) >= LEAST_FRAMES)
        if not enough.any():
            return np.arange(len(keeps))  # it is for `learn_shape` to say what is missing
        if (enough == keeps).all():
            return np.where(keeps, np.cumsum(keeps) - 1, -1)
        keeps = enough


def _merged(positions: Numbers, point: Indices) -> Numbers:
    """`(n_frames, n_points, 2)`: of each frame the track that shows the point, if there is one."""
    merged = np.full((len(positions), point.max() + 1, 2), np.nan)
    for track in np.flatnonzero(point >= 0):
        seen = ~np.isnan(positions[:, track, 0])
        merged[seen, point[track]] = positions[seen, track]
    return merged


def _pairs(positions: Numbers, shape: NonrigidShape) -> list[tuple[int, int]]:
    """Pairs of points that are one, the smaller number first; no point is in two of them."""
    seen = ~np.isnan(positions[..., 0]) & shape.frame_determined[:, None]
    apart = (seen.T.astype(np.float64) @ seen) > 0
    means = shape.shapes()[..., :2]
    covariances = shape.shape_covariances()[..., :2, :2]
    covariances[..., [0, 1], [0, 1]] += shape.noise**2
    size = float(np.nanmean(shape.scales))
    n_points = positions.shape[1]
    distance = np.full((n_points, n_points), np.inf)
    for track in range(n_points):
        times = np.flatnonzero(seen[:, track])
        others = np.flatnonzero(~apart[track])
        if not len(times) or not len(others):
            continue
        away = positions[times, track][:, None] - means[np.ix_(times, others)]
        spread = covariances[np.ix_(times, others)]
        squares = np.einsum("tni,tnij,tnj->tn", away, np.linalg.inv(spread), away) / 2
        sharp = np.trace(spread, axis1=2, axis2=3).mean(axis=0) < 2 * (SHARP * size) ** 2
        distance[track, others] = np.where(sharp, squares.mean(axis=0), np.inf)
    distance = np.maximum(distance, distance.T)
    nearest = distance.argmin(axis=1)
    every = np.arange(n_points)
    mutual = (nearest[nearest] == every) & (distance[every, nearest] < ALIKE) & (every < nearest)
    return [(int(one), int(nearest[one])) for one in np.flatnonzero(mutual)]
