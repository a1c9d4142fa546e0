"""Where to start: from the window that shows a rigid motion best, or the SVD of a mean-filled matrix."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import svds

from .em import (
    LEAST_NOISE,
    CameraPrior,
    ObservationSums,
    camera_moments,
    estimate_cameras,
    first_prior,
    shape_moments,
    squared_error,
)
from .kernels import invert_information
from .observations import LEAST_POINTS, Array, Observations

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

RANK = 3
WINDOW_POINTS = 6  # a window counts if it shows at least so many points throughout
MOSTLY = 0.5  # if this share of the points is seen throughout, the window is the whole
SAMPLE = 100  # numbers of a window's rows and points by which it is judged, at most
LARGE = 50  # tables of more rows and columns than this have their first singular vectors found by iteration
CANDIDATES = 4  # so many windows of each length are judged closely
VIEWS = 3  # frames that show a point, for it to come in
ROUNDS, LAST_ROUNDS = 3, 10  # of refinement, after frames or points came in, and at the end
RIDGE = 1e-9
FORESIGHT = 3.0  # variance up to which frames are predicted together, over that of the best one


@dataclass(frozen=True)
class _Terms:
    """On which frames (that show `points`) and points (that deviate by `spread`, in the shape's) come in."""

    points: int
    strength: float
    spread: float


TERMS = (_Terms(6, 0.3, 0.3), _Terms(5, 0.1, 0.5), _Terms(4, 0.02, 1.0))
"""Strict at first, so that what comes in early is right."""


def mean_filled(observations: Observations) -> tuple[Array, Array]:
    """Return cameras and shape from the SVD of the mean-filled matrix of positions: the published start."""
    listed = observations.by_point
    seen = np.maximum(np.diff(listed.edges), 1)
    n_frames, n_points = observations.n_frames, observations.n_points
    table = np.empty((n_frames, 2, n_points))
    for row, values in enumerate((listed.x, listed.y)):
        table[:, row] = np.bincount(listed.own, values, n_points) / seen
        table[listed.other, row, listed.own] = values
    return factored(table.reshape(2 * n_frames, n_points))


def factored(table: Array) -> tuple[Array, Array]:
    """Return the best cameras `(n_frames, 2, 4)` and white shape for a table `(2 n_frames, n_points)`."""
    middle = table.mean(axis=1, keepdims=True)
    rows, values, columns = _leading(table - middle)
    n_points, rank = table.shape[1], len(values)
    linear, shape = np.zeros((len(table), RANK)), np.zeros((n_points, RANK))
    linear[:, :rank] = rows[:, :rank] * values[:rank] / np.sqrt(n_points)
    shape[:, :rank] = columns[:rank].T * np.sqrt(n_points)
    cameras = np.concatenate([linear, middle], axis=1).reshape(-1, 2, 4)
    return cameras, shape


def _leading(table: Array) -> tuple[Array, Array, Array]:
    """The first three singular vectors and values of a table, as `numpy.linalg.svd` gives them."""
    if min(table.shape) < LARGE:
        rows, values, columns = np.linalg.svd(table, full_matrices=False)
    else:
        rows, values, columns = svds(table, k=RANK, v0=np.ones(min(table.shape)))
        rows, values, columns = rows[:, ::-1], values[::-1], columns[::-1]
    return rows[:, :RANK], values[:RANK], columns[:RANK]


@dataclass(eq=False)
class _PartialStructure:
    """A structure that grows: its frames and points so far, in the gauge of a white shape."""

    cameras: Array
    shape: Array
    frames: Mask
    points: Mask
    noise: float
    prior: CameraPrior | None
    camera_covariance: Array


def grown(observations: Observations, *, coherent: bool) -> tuple[Array, Array, Mask, Mask]:
    """Grow cameras and shape from a window by resection and intersection.

    Frames come in as soon as they show enough known points, points as soon as known cameras determine them.
    What is known is refined after every round; with coherence by the smoother, which also predicts the next
    cameras where growing would end otherwise. Where no window shows six points throughout, the mean-filled
    matrix has to do.
    """
    n_frames, n_points = observations.n_frames, observations.n_points
    window = _best_window(observations)
    if window is None:
        cameras, shape = mean_filled(observations)
        return cameras, shape, np.ones(n_frames, bool), np.diff(observations.by_point.edges) > 1
    first, end, members = window
    cameras, shape = np.zeros((n_frames, 2, 4)), np.zeros((n_points, RANK))
    cameras[first:end], shape[members] = factored(_full_table(observations, np.arange(first, end), members))
    frames, points = np.zeros(n_frames, bool), np.zeros(n_points, bool)
    frames[first:end], points[members] = True, True
    noise = _noise(observations.only(frames, points), cameras, shape)
    prior = first_prior(cameras[first:end], coherent=True) if coherent else None
    known = _PartialStructure(cameras, shape, frames, points, noise, prior, np.zeros((n_frames, 4, 4)))
    alone = True
    while True:
        for terms in TERMS:
            while _intersect(observations, known, terms) | _resect(observations, known, terms):
                _refine(observations, known, ROUNDS)
                alone = False
        if not coherent or known.frames.all():
            break
        _refine(observations, known, LAST_ROUNDS)
        # with coherence, frames come in that the motion of the known ones predicts best
        variance = np.where(known.frames, np.inf, np.einsum("tjj->t", known.camera_covariance))
        known.frames |= variance <= FORESIGHT * variance.min()
        alone = False
    if not alone:
        _refine(observations, known, LAST_ROUNDS)
    return known.cameras, known.shape, known.frames, known.points


def _best_window(observations: Observations) -> tuple[int, int, Indices] | None:
    """Frames `first:end` and the points seen in all of them, whose third direction stands out most."""
    listed, n_frames = observations.by_point, observations.n_frames
    starts = np.ones(observations.count, bool)
    starts[1:] = (np.diff(listed.own) != 0) | (np.diff(listed.other) != 1)
    first_of_run = np.flatnonzero(starts)
    lengths = np.diff(np.append(first_of_run, observations.count))
    run_point, run_frame = listed.own[first_of_run], listed.other[first_of_run]
    whole = np.flatnonzero(lengths == n_frames)
    if len(whole) >= max(WINDOW_POINTS, MOSTLY * observations.n_points):
        return 0, n_frames, run_point[whole]
    best, best_score = None, -np.inf
    for length in _window_lengths(n_frames):
        long = lengths >= length
        count = np.zeros(n_frames + 1)
        np.add.at(count, run_frame[long], 1)
        np.add.at(count, run_frame[long] + lengths[long] - length + 1, -1)
        count = np.cumsum(count[: n_frames - length + 1])
        for first in _apart(count, CANDIDATES, max(1, length // 2)):
            if count[first] < WINDOW_POINTS:
                continue
            covers = long & (run_frame <= first) & (run_frame + lengths >= first + length)
            members = run_point[covers]
            score = _clearness(observations, first, length, members)
            if score > best_score:
                best, best_score = (int(first), int(first + length), members), score
    return best


def _window_lengths(n_frames: int) -> list[int]:
    """Window lengths to try, about half as long again each time."""
    lengths, length = [], 3
    while length < n_frames:
        lengths.append(length)
        length = length + max(1, length // 2)
    return [*lengths, n_frames]


def _apart(count: Array, wanted: int, distance: int) -> list[int]:
    """Places of the largest counts, none closer than `distance` to another."""
    places: list[int] = []
    left = count.astype(np.float64)
    while len(places) < wanted and left.max(initial=0) > 0:
        place = int(np.argmax(left))
        places.append(place)
        left[max(0, place - distance) : place + distance + 1] = 0
    return places


def _full_table(observations: Observations, frames: Indices, members: Indices) -> Array:
    """Positions `(2 len(frames), n_members)` of points seen from the first of these frames to the last."""
    listed, n_frames = observations.by_point, observations.n_frames
    # observations of a point are in the order of frames, so those of a stretch lie side by side
    begins = np.searchsorted(listed.own * n_frames + listed.other, members * n_frames + frames[0])
    places = begins + (frames - frames[0])[:, None]
    return np.stack([listed.x[places], listed.y[places]], axis=1).reshape(2 * len(frames), -1)


def _clearness(observations: Observations, first: int, length: int, members: Indices) -> float:
    """How far the third singular value stands out of the largest that the noise, as rank 3 leaves it, has."""
    # of large windows a sample of frames and points will do
    frames = first + np.unique(np.linspace(0, length - 1, min(length, SAMPLE // 2)).astype(np.int64))
    table = _full_table(observations, frames, members[:: -(-len(members) // SAMPLE)])
    rows, columns = table.shape
    values = np.linalg.svd(table - table.mean(axis=1, keepdims=True), compute_uv=False)
    noise = float(np.sum(values[RANK:] ** 2)) / max((rows - RANK) * (columns - RANK - 1), 1)
    signal = float(values[RANK - 1] ** 2) * 2 * length * len(members) / (rows * columns)
    expected = noise * (np.sqrt(2 * length) + np.sqrt(len(members))) ** 2
    return float(signal / (expected + 1e-12 * values[0] ** 2 + 1e-300))


def _resect(observations: Observations, partial: _PartialStructure, terms: "_Terms") -> bool:
    """Add frames whose camera the known points determine about as well as that of the best one left."""
    part = observations.only(~partial.frames, partial.points)
    sums = ObservationSums(part.by_frame, part.n_points)
    information, vector = sums.of_frames(partial.shape, shape_moments(partial.shape))
    strength = np.linalg.eigvalsh(information)[:, 0]
    strength[np.diff(part.by_frame.edges) < terms.points] = 0
    chosen = strength >= max(terms.strength, 0.5 * strength.max(initial=0))
    partial.cameras[chosen] = np.linalg.solve(information[chosen], vector[chosen]).transpose(0, 2, 1)
    partial.frames |= chosen
    return bool(chosen.any())


def _intersect(observations: Observations, partial: _PartialStructure, terms: "_Terms") -> bool:
    """Add points that known cameras determine well enough."""
    part = observations.only(partial.frames, ~partial.points)
    sums = ObservationSums(part.by_frame, part.n_points)
    information, vector, _ = sums.of_points(partial.cameras, camera_moments(partial.cameras))
    strength = np.linalg.eigvalsh(information)[:, 0]
    chosen = (np.diff(part.by_point.edges) >= VIEWS) & (strength * terms.spread**2 > partial.noise)
    if chosen.any():
        partial.shape[chosen] = np.linalg.solve(information[chosen], vector[chosen][..., None])[..., 0]
        partial.points |= chosen
    return bool(chosen.any())


def _refine(observations: Observations, partial: _PartialStructure, rounds: int) -> None:
    """Estimate cameras and points in turns, in the gauge of a white shape; and the noise variance."""
    part = observations.only(partial.frames, partial.points)
    points = np.diff(part.by_point.edges) > 0
    all_frames = np.ones(len(partial.cameras), bool)
    views = part.by_frame if partial.prior is None else observations.only(all_frames, partial.points).by_frame
    resected = np.diff(views.edges) >= LEAST_POINTS
    of_views, of_part = ObservationSums(views, part.n_points), ObservationSums(part.by_frame, part.n_points)
    for _ in range(rounds):
        cameras, shape = whitened(partial.cameras, partial.shape, points)
        information, vector = of_views.of_frames(shape, shape_moments(shape))
        if partial.prior is None:
            covariance, _ = invert_information(information[resected], np.full(4, RIDGE), 1.0)
            cameras[resected] = (covariance @ vector[resected]).transpose(0, 2, 1)
        else:
            noise = max(partial.noise, LEAST_NOISE**2)
            partial.prior = estimate_cameras(information, vector, noise, partial.prior).better
            estimate = estimate_cameras(information, vector, noise, partial.prior)
            cameras, partial.camera_covariance = estimate.cameras, estimate.covariance
        information, vector, _ = of_part.of_points(cameras, camera_moments(cameras))
        covariance, _ = invert_information(information[points], np.full(RANK, RIDGE), 1.0)
        shape[points] = np.einsum("ijk,ik->ij", covariance, vector[points])
        partial.cameras, partial.shape = cameras, shape
    partial.noise = _noise(part, partial.cameras, partial.shape)


def _noise(part: Observations, cameras: Array, shape: Array) -> float:
    """Noise variance that is left by cameras and shape."""
    error = squared_error(part.by_frame, cameras, shape)
    return error / max(freedom(part), 0.05 * part.count)


def freedom(observations: Observations) -> float:
    """Return the degrees of freedom: numbers observed less 8 a frame and 3 a point, plus 12 of the gauge."""
    frames = np.minimum(np.diff(observations.by_frame.edges), 4).sum()
    points = np.minimum(2 * np.diff(observations.by_point.edges), RANK).sum()
    return float(observations.numbers - 2 * frames - points + 12)


def whitened(cameras: Array, shape: Array, points: Mask) -> tuple[Array, Array]:
    """Whiten the shape, so that `points` have mean 0 and covariance I, and cameras to match."""
    return regauged(cameras, shape, *whitening(shape[points]))


def whitening(shape: Array) -> tuple[Array, Array]:
    """Return the mean `(3,)` of points and a root `(3, 3)` of their covariance, longest axis first."""
    values, axes = np.linalg.eigh(np.cov(shape.T, bias=True))
    change: Array = (axes * np.sqrt(np.maximum(values, 1e-12 * values[-1] + 1e-300)))[:, ::-1]
    return shape.mean(axis=0), change


def regauged(cameras: Array, shape: Array, mean: Array, change: Array) -> tuple[Array, Array]:
    """Return cameras and shape, with old shape = mean + change new shape."""
    moved = np.concatenate([cameras[..., :3] @ change, cameras[..., 3:]], axis=2)
    moved[..., 3] += cameras[..., :3] @ mean
    return moved, np.ascontiguousarray(np.linalg.solve(change, (shape - mean).T).T, np.float64)
