"""Non-rigid structure from motion: the shape of a deforming object, and its poses, from 2-D point tracks."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....models.numerics.rotations import nearest_rotation
from ....models.points.point_arrays import check_points
from .comparison import MIRRORED, shape_error
from .em import Numbers, State, Tracks, WeightPosterior, e_step, point_sums
from .search import Found, search, shapes_of, whole_shapes
from .shape import NonrigidShape, Rival, convex, posed
from .smoothness import LEAST_FRAMES as SMOOTH_FRAMES
from .smoothness import smoothed
from .uncertainty import basis_covariances, frame_covariances

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
