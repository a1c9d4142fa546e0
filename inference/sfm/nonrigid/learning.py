"""Non-rigid structure from motion: the shape of a deforming object, and its poses, from 2-D point tracks.

`learn_shape` is given the number of bases; `choose_bases` finds it by positions that were withheld;
`learn_associated` also finds which partial tracks show one point. EM starts from rigid shapes, to which modes
are added, and from rotations that a factorisation has to fulfil whatever the deformation is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....models.numerics.rotations import nearest_rotation
from ....models.points.point_tracks import check_points
from ...optimisation import Damping, levenberg_marquardt
from ..affine_camera import euclidean, scaled_rotations
from ..factor_analysis.factorisation import factorise
from .em import (
    FIRST_DAMPING,
    LEAST_NOISE,
    SMOOTH_FRAMES,
    State,
    Tracks,
    WeightPosterior,
    chosen_poses,
    e_step,
    log_likelihood,
    point_sums,
    run_em,
    smoothed,
)
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

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

USUAL_DEPTH = 0.7  # of objects that hardly turn, in root mean squares of their width and height
RIGID_ITERATIONS = 60
SMOOTH = np.radians(5)  # standard deviation of a turn from frame to frame, where it is doubtful which way
DOUBT = 100.0  # the likelihood of a rigid object is divided by this for a deforming one
TURNED_OVER = np.radians(15)  # poses that differ by so much are two ways of seeing the same picture
TOLERANCE = 1e-5  # nats a coordinate, for what comes before the last climb


def rigid_states(tracks: Tracks, positions: Array, on_iteration: Callable[[], None]) -> list[State]:
    """Return rigid motions: that of the factorisation, and one with smooth turns.

    Sudden turns of about 180 degrees explain a flat object's picture as well.
    """
    rigid, _ = run_em(tracks, rigid_start(positions), RIGID_ITERATIONS, TOLERANCE, on_iteration)
    smooth = with_smooth_turns(tracks, rigid)
    if smooth is None:
        return [rigid]
    return [rigid, run_em(tracks, smooth, RIGID_ITERATIONS, TOLERANCE, on_iteration)[0]]


def shape_seen_from(positions: Array, rotations: Array) -> State:
    """Return the best rigid shape under given rotations; `positions` are complete and centred."""
    n_frames, n_points, _ = positions.shape
    axes = rotations[:, :2].reshape(-1, 3)
    rows = positions.transpose(0, 2, 1).reshape(-1, n_points)
    shape: Array = np.asarray(np.linalg.lstsq(axes, rows)[0].T, np.float64)
    left = positions - shape @ rotations[:, :2].transpose(0, 2, 1)
    noise = max(float(np.mean(left**2)), LEAST_NOISE**2)
    damping = np.full(n_frames, FIRST_DAMPING)
    return State(shape[None].copy(), rotations, np.ones(n_frames), np.zeros((n_frames, 2)), noise, damping)


def rigid_start(positions: Array) -> State:
    """Return a rigid shape and its poses from factorisation `(n_frames, n_points, 2)`, NaN where not seen."""
    found = factorise(positions)
    metric = euclidean(found.cameras, found.shape, found.camera_covariance)
    shape, cameras = metric.shape, metric.cameras
    if not metric.determined:
        shape = _usual_depth(found.cameras, found.shape)
        fitted = np.linalg.lstsq(np.column_stack([shape, np.ones(len(shape))]), found.shape)[0]
        cameras = np.concatenate([found.cameras[..., :3] @ fitted[:3].T, found.cameras[..., 3:]], axis=2)
    scales, rotations = scaled_rotations(cameras[..., :3])
    noise = max(found.rmse, LEAST_NOISE) ** 2
    damping = np.full(len(scales), FIRST_DAMPING)
    return State(shape[None].copy(), rotations, scales, cameras[..., 3].copy(), noise, damping)


def _usual_depth(cameras: Array, shape: Array) -> Array:
    """The shape as cameras see it on average, with a depth that they leave open, of usual size."""
    mean = cameras[..., :3].mean(axis=0)
    unseen = np.linalg.svd(mean)[2][2]
    front, depth = shape @ mean.T, shape @ unseen
    plane = np.column_stack([front, np.ones(len(front))])
    depth = depth - plane @ np.linalg.lstsq(plane, depth)[0]
    front = front - front.mean(axis=0)
    size = np.sqrt(np.mean(front**2)) * USUAL_DEPTH
    deviation = np.sqrt(np.mean(depth**2))
    return np.column_stack([front, depth * (size / deviation if deviation > LEAST_NOISE else 0.0)])


def with_modes(tracks: Tracks, state: State, count: int) -> State:
    """Return the state with more modes: principal components of the residuals, in the picture plane.

    Depth follows from the other frames as soon as EM goes on.
    """
    found = e_step(state, point_sums(tracks, state.bases))
    axes = state.seen_axes
    shapes = np.tensordot(found.extended, state.bases, 1)
    left = tracks.positions - state.translations[:, None] - np.matmul(shapes, axes.transpose(0, 2, 1))
    left *= tracks.seen[..., None]
    displacement = np.matmul(left, axes / state.scales[:, None, None] ** 2).reshape(tracks.n_frames, -1)
    share = tracks.seen.mean()
    values, vectors = np.linalg.eigh(displacement.T @ displacement / (share**2 * tracks.n_frames))
    modes = (vectors * np.sqrt(np.maximum(values, 0)))[:, : -count - 1 : -1].T
    bases = np.concatenate([state.bases, modes.reshape(count, -1, 3)])
    return state.begun(bases=bases)


def without_modes(state: State, n_bases: int) -> State:
    """Return the state with the largest modes only, so many bases in all."""
    flat = state.bases[1:].reshape(len(state.bases) - 1, -1)
    order = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    modes = np.tensordot(order.T[: n_bases - 1], state.bases[1:], 1)
    return state.begun(bases=np.concatenate([state.bases[:1], modes]))


# --- which way it turns -------------------------------------------------------------------------------------


def with_smooth_turns(tracks: Tracks, state: State) -> State | None:
    """Return the state with mirrored rotations where turns become smooth; `None` if they are.

    Under orthography a flat object appears the same as its mirror image behind it, R -> F R F_n with F a
    reflection in depth and F_n one of the object through its plane. The best sequence is found by Viterbi's
    algorithm.
    """
    centred = state.bases[0] - state.bases[0].mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    mirror = np.eye(3) - 2 * np.outer(normal, normal)
    mirrored = replace(state, rotations=np.diag([1.0, 1.0, -1.0]) @ state.rotations @ mirror)
    sums = point_sums(tracks, state.bases)
    likelihoods = np.stack([e_step(each, sums).log_likelihood for each in (state, mirrored)], axis=1)
    rotations = np.stack([state.rotations, mirrored.rotations], axis=1)
    turned_over = _smoothest(likelihoods / DOUBT, rotations) == 1
    if turned_over.all() or not (_angles(*rotations[turned_over].swapaxes(0, 1)) > TURNED_OVER).any():
        return None
    return chosen_poses(turned_over, mirrored, state).begun()


def _smoothest(likelihoods: Array, rotations: Array) -> NDArray[np.int64]:
    """Which of two rotations `(n_frames, 2, 3, 3)` each frame has; turns have standard deviation `SMOOTH`."""
    score, origins = likelihoods[0], []
    for before, now, likelihood in zip(rotations[:-1], rotations[1:], likelihoods[1:], strict=True):
        turns = _angles(before[:, None], now[None])
        through = score[:, None] - 0.5 * (turns / SMOOTH) ** 2
        origins.append(through.argmax(axis=0))
        score = through.max(axis=0) + likelihood
    path = [int(score.argmax())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    return np.array(path[::-1])


def _angles(one: Array, other: Array) -> Array:
    """Angles `(...,)` rad between rotations `(..., 3, 3)`."""
    angles: Array = np.arccos(np.clip((np.sum(one * other, axis=(-2, -1)) - 1) / 2, -1, 1))
    return angles


STEPS, MOST_TRIED = 100, 2000  # steps that are taken, and tried, at most
ROWS_DAMPING = Damping(1e-2, rise=4.0)
LEAST_GAIN = 1e-7  # of the sum of squares, as a share: below this nothing more is to be had
ROWS_RIDGE = 1e-9  # of the mean diagonal: the axes of space are free, and with them three directions of Q
LEAST_RANK = 3
LEAST_STRENGTH = 1e-6  # singular values below this share of the largest are rounding
RANDOM_STARTS, SEED = 4, 0


def rotations_of_rank(positions: Array, ranks: set[int]) -> list[Array]:
    """Return rotations `(n_frames, 3, 3)`, two for each rank, by the method of Levenberg and Marquardt.

    One starts from the three strongest columns, the other one is the best of some that start from random
    ones: there are local optima. Positions `(n_frames, n_points, 2)` are about the middle of each frame, in
    units of their spread, complete; of fewer than three singular vectors there are no rotations.
    """
    n_frames, n_points, _ = positions.shape
    left, values, _ = np.linalg.svd(positions.transpose(0, 2, 1).reshape(-1, n_points), full_matrices=False)
    random = np.random.default_rng(SEED)
    found = []
    strong = int(np.count_nonzero(values > LEAST_STRENGTH * values[0]))
    for rank in sorted({min(rank, strong) for rank in ranks if strong >= LEAST_RANK}):
        motion = left[:, :rank] * np.sqrt(2 * n_frames * values[:rank] / values[0])
        motion = motion.reshape(n_frames, 2, rank)
        found.append(_rotations(_corrected(motion, np.eye(rank, 3)).rows))
        firsts = random.standard_normal((RANDOM_STARTS, rank, 3)) / np.sqrt(rank)
        solved = [_corrected(motion, first) for first in firsts]
        found.append(_rotations(min(solved, key=lambda each: each.squares).rows))
    return found


class _Corrected(NamedTuple):
    """A correction Q, rows `(n_frames, 2, 3)`, how they violate orthonormality, and the squares of that."""

    correction: Array
    rows: Array
    violations: Array
    squares: float


def _corrected(motion: Array, first: Array) -> _Corrected:
    """Rows near orthonormality, `motion` `(n_frames, 2, r)` times Q, from a first Q `(r, 3)`."""

    def at(correction: Array) -> _Corrected:
        rows = motion @ correction
        violations = _violations(rows)
        return _Corrected(correction, rows, violations, float(violations @ violations))

    def linearised(here: _Corrected) -> Callable[[float], _Corrected | None]:
        jacobian = _derivatives(motion, here.rows)
        normal, pull = jacobian.T @ jacobian, jacobian.T @ here.violations
        diagonal = np.diag(normal)

        def step(damping: float) -> _Corrected | None:
            damped = normal + np.diag(damping * diagonal + ROWS_RIDGE * diagonal.mean())
            reached = at(here.correction - np.linalg.solve(damped, pull).reshape(first.shape))
            return reached if reached.squares < here.squares else None

        return step

    taken = count(1)
    return levenberg_marquardt(
        at(first),
        linearised,
        lambda before, after: (
            next(taken) == STEPS or before.squares - after.squares <= LEAST_GAIN * before.squares
        ),
        ROWS_DAMPING,
        most_steps=MOST_TRIED,
    )[0]


def _violations(rows: Array) -> Array:
    """`(3 n_frames,)`: a a' - 1, b b' - 1, sqrt(2) a b'."""
    gram = rows @ rows.transpose(0, 2, 1)
    return np.concatenate([gram[:, 0, 0] - 1, gram[:, 1, 1] - 1, np.sqrt(2) * gram[:, 0, 1]])


def _derivatives(motion: Array, rows: Array) -> Array:
    """`(3 n_frames, 3 r)`: of the violations by Q."""
    first, second = motion[:, 0, :, None], motion[:, 1, :, None]
    one, other = rows[:, 0, None], rows[:, 1, None]
    parts = [2 * first * one, 2 * second * other, np.sqrt(2) * (first * other + second * one)]
    return np.concatenate(parts).reshape(3 * len(rows), -1)


def _rotations(rows: Array) -> Array:
    """The rotations whose first two rows are nearest to `(n_frames, 2, 3)`."""
    whole = np.concatenate([rows, np.cross(rows[:, 0], rows[:, 1])[:, None]], axis=1)
    # the third row does not enter: it is perpendicular to both
    return nearest_rotation(whole)


BASES_OF_POSES = 12
"""Poses are looked for with so many at least: what bases leave is else explained by turns never made."""
FIRST_ROUND, SECOND_ROUND, PRUNING_ROUND = 40, 100, 40  # iterations
KEPT = 3  # starts that go on to the second round
SAME = 0.01  # shapes that differ by so little, as `shape_error` measures, are one optimum
NEARLY = 0.05  # optima are as good as each other if their noise differs by no more than this share
RANKS = (6, 9, 15, 24)  # of factorisations whose rotations are tried, beside thrice the numbers of bases


def search(
    tracks: Tracks,
    positions: Array,
    bases: int,
    most: int,
    iterations: int,
    tolerance: float,
    on_iteration: Callable[[], None],
) -> tuple[State, list[float], list[tuple[float, State]]]:
    """Climb from many starts, with more modes than are asked for, and go on with the best.

    Gives the likeliest state, the history of its last climb, and others that are nearly as likely.
    A model with few modes explains finer deformations by turns of the object; the likelihood then prefers
    wrong poses to true ones. Modes that do not pay by the criterion of Hannan and Quinn (1979) are taken
    away at the end. There will be `bases` at least, and the tracks determine `most`.
    """

    def climbed(state: State, rounds: int) -> State:
        return run_em(tracks, state, rounds, TOLERANCE, on_iteration)[0]

    size = max(bases, min(BASES_OF_POSES, most))
    rigid = rigid_states(tracks, positions, on_iteration)
    first = [climbed(with_modes(tracks, each, size - 1), FIRST_ROUND) for each in rigid]
    filled = _filled(tracks, _best_first(tracks, first)[0][1])
    ranks = {rank for rank in (*RANKS, 3 * bases, 3 * size) if rank <= 3 * size}
    for rotations in rotations_of_rank(filled, ranks):
        start = with_modes(tracks, shape_seen_from(filled, rotations), size - 1)
        first.append(climbed(start, FIRST_ROUND))
    second = [climbed(state, SECOND_ROUND) for _, state in _best_first(tracks, first)[:KEPT]]
    (likelihood, best), *rest = _best_first(tracks, second)
    nearly = -tracks.count * float(np.log1p(-NEARLY))
    others = [(likelihood - other, state) for other, state in rest if likelihood - other < nearly]
    best = _pruned(tracks, best, bases, climbed)
    state, history = run_em(tracks, best, iterations, tolerance, on_iteration)
    return state, history, others


def _pruned(tracks: Tracks, state: State, bases: int, climbed: Callable[[State, int], State]) -> State:
    """The state without modes that do not pay; half of those beyond `bases` are tried at a time."""
    likelihood = log_likelihood(tracks, state)
    while len(state.bases) > bases:
        fewer = bases + (len(state.bases) - bases) // 2
        tried = climbed(without_modes(state, fewer), PRUNING_ROUND)
        reached = log_likelihood(tracks, tried)
        saved = _free_numbers(state) - _free_numbers(tried)
        if likelihood - reached > saved * np.log(np.log(tracks.n_frames)):
            return state
        state, likelihood = tried, reached
    return state


def _free_numbers(state: State) -> float:
    """Of the bases; modes may be turned among each other."""
    modes = len(state.bases) - 1
    return state.bases.size - modes * (modes - 1) / 2


def _filled(tracks: Tracks, state: State) -> Array:
    """Positions about the middles of all points, those that were not seen as the state has them."""
    predicted = whole_shapes(tracks, state)[..., :2] + state.translations[:, None]
    complete = np.where(tracks.seen[..., None] > 0, tracks.positions, predicted)
    centred: Array = complete - complete.mean(axis=1, keepdims=True)
    return centred


def whole_shapes(tracks: Tracks, state: State) -> Array:
    """Return shapes `(n_frames, n_points, 3)` in the camera's axes, from the object's origin."""
    return shapes_of(state, e_step(state, point_sums(tracks, state.bases)))


def shapes_of(state: State, posterior: WeightPosterior) -> Array:
    """Return the shapes for known weights."""
    shapes = np.tensordot(posterior.extended, state.bases, 1) @ state.rotations.transpose(0, 2, 1)
    return state.scales[:, None, None] * shapes


def _best_first(tracks: Tracks, states: Sequence[State]) -> list[tuple[float, State]]:
    """States with their log likelihoods, the likeliest first, each optimum only once."""
    different: list[tuple[float, State]] = []
    shapes: list[Array] = []
    ranked = sorted(((log_likelihood(tracks, each), each) for each in states), key=lambda each: -each[0])
    for likelihood, state in ranked:
        shape = whole_shapes(tracks, state)
        if all(shape_error(shape, other) > SAME for other in shapes):
            different.append((likelihood, state))
            shapes.append(shape)
    return different


ROUNDING = 1e-8  # of the largest coordinate: what differs by less does not differ
LEAST_FRAMES = 3  # that a point is seen in, and that there are; two views leave depth open
LEAST_POINTS = 4  # of a frame, for its pose to be known
LEAST_WIDTH = 1e-3  # of the points of a frame, over their length: points of any film err by more


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

    See `em` for the model and the steps, `search` for additional modes. Without `smooth` the order of frames
    matters only for ambiguous rotations of a flat object. Equal tracks give equal bytes.

    Parameters
    ----------
    tracks
        `(n_frames, n_points, 2)` px, NaN where a point was not seen.
    bases
        number of morph bases including the mean shape, 2 or more.
    iterations, tolerance
        of the last ascent: maximum number, and gain in nats per coordinate below which it stops.
    smooth
        frames are successive: weights and rotations are smoothed at the end, with a learned process noise.
        Covariances, history and log likelihood are those without smoothing.
    on_iteration
        is called after every iteration.

    Raises
    ------
    ValueError
        if tracks have another shape, infinities, or single coordinates; there are fewer than 3 frames with 4
        points (5 for `smooth`), or points seen in fewer than 3 of them; or bases are fewer than 2, or more
        than the tracks determine, min(2 n_frames, n_points - 1) / 3.
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
    if not unit > ROUNDING * np.nanmax(np.abs(positions)):
        raise ValueError("tracks: got points that all lie in one place, expected a shape")
    centred /= unit
    observed = Tracks.of(centred)
    state, history, others = search(
        observed, centred, bases, most_bases(centred), iterations, tolerance, on_iteration
    )
    if smooth:
        state, weights = smoothed(observed, state, on_iteration)
    else:
        weights = e_step(state, point_sums(observed, state.bases))
    unlike = [(gap, whole_shapes(observed, other)) for gap, other in others]
    return _in_pixels(observed, state, weights, history, unlike, bases, unit, middles, determined)


def _check(positions: Array, bases: int) -> NDArray[np.bool_]:
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
    shown = positions[determined]
    off = np.nan_to_num(shown - np.nanmean(shown, axis=1, keepdims=True))
    squares = np.linalg.eigvalsh(np.einsum("tnc,tnd->tcd", off, off))
    if (squares[:, 0] <= LEAST_WIDTH**2 * squares[:, 1]).all() and (squares[:, 1] > 0).any():
        raise ValueError("tracks: got points on a line in every frame, expected some that span a plane")
    most = most_bases(shown)
    if most < 2:
        raise ValueError(f"tracks: got {n_points} points, expected 7 at least")
    if not 2 <= bases <= most:
        raise ValueError(f"bases: got {bases}, expected 2 to {most} for {n_frames} frames, {n_points} points")
    return determined


def most_bases(positions: Array) -> int:
    """Return how many bases positions `(n_frames, n_points, 2)` can determine: each adds 3 to their rank."""
    n_frames, n_points = positions.shape[:2]
    return int(min(2 * n_frames, n_points - 1)) // 3


def _in_pixels(
    tracks: Tracks,
    state: State,
    posterior: WeightPosterior,
    history: list[float],
    others: list[tuple[float, Array]],
    n_bases: int,
    unit: float,
    middles: Array,
    determined: NDArray[np.bool_],
) -> NonrigidShape:
    """The result in px and in the axes and order that `NonrigidShape` promises."""
    turn = nearest_rotation(state.rotations.mean(axis=0))
    bases, rotations = state.bases @ turn.T, state.rotations @ turn.T
    centroids = bases.mean(axis=1)
    axes = state.scales[:, None, None] * rotations[:, :2]
    translations = state.translations + np.einsum("nca,nk,ka->nc", axes, posterior.extended, centroids)
    bases = bases - centroids[:, None]
    if not convex(bases[0]):
        bases, rotations = bases * MIRRORED, MIRRORED[:, None] * rotations * MIRRORED
    flat = bases[1:, :, :2].reshape(len(bases) - 1, -1)
    order = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    bases[1:] = np.tensordot(order.T, bases[1:], 1)
    size = float(np.sqrt(np.mean(np.sum(bases[0, :, :2] ** 2, axis=1))))

    bases = bases / size
    noise = unit * float(np.sqrt(state.noise))
    weights = posterior.mean @ order
    spread = order.T @ posterior.covariance @ order
    scales = state.scales * size * unit
    translations = translations * unit + middles
    seen = tracks.seen > 0
    poses = posed(rotations, translations, scales, weights)
    shapes = shapes_of(state, posterior)

    def everywhere(values: Array) -> Array:
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
        rmse=unit * float(np.sqrt(_squared_error(tracks, state, posterior) / tracks.count)),
        log_likelihood=float(posterior.log_likelihood.sum()) - tracks.count * float(np.log(unit)),
        history=tuple(value - tracks.count * float(np.log(unit)) for value in history),
        frame_determined=determined,
        frame_covariances=everywhere(frame_covariances(bases, poses, seen, noise)),
        basis_covariances=basis_covariances(bases, poses, weights, spread, seen, noise),
        rivals=tuple(Rival(gap, shape_error(other, shapes)) for gap, other in others),
    )


def _squared_error(tracks: Tracks, state: State, posterior: WeightPosterior) -> float:
    """What the mean shapes leave of the positions."""
    shapes = np.tensordot(posterior.extended, state.bases, 1)
    predicted = shapes @ state.seen_axes.transpose(0, 2, 1) + state.translations[:, None]
    return float(np.sum(tracks.seen[..., None] * (tracks.positions - predicted) ** 2))


WITHHELD = 0.1  # share of the positions; the model is learned from the others
LEAST_LEFT = 5  # positions that a frame or a point keeps at least, where it has them: enough for a pose
MOST_BASES = 8
BLOCKS = 20  # of successive frames, whose errors are alike: what they differ by is the spread of an error


@dataclass(frozen=True, eq=False)
class BasesChoice:
    """Errors at positions that were withheld, for the numbers of bases that were tried.

    Parameters
    ----------
    bases, candidates
        the number that was chosen, and `(n,)` numbers that were tried.
    errors
        `(n,)` px: root mean square of a coordinate at withheld positions.
    """

    bases: int
    candidates: tuple[int, ...]
    errors: Array


def choose_bases(
    tracks: ArrayLike,
    candidates: Sequence[int] | None = None,
    *,
    on_iteration: Callable[[], None] = lambda: None,
) -> BasesChoice:
    """Choose the number of bases by cross-validation: the smallest within one standard error of the best.

    A tenth of all positions, drawn at random once for all candidates, is withheld and predicted by shapes
    learned from the rest (the one-standard-error rule of Hastie, Tibshirani and Friedman 2009, section 7.10,
    with differences to the best candidate, paired by blocks of frames). `candidates` are 2 to 8 by default,
    as far as the tracks determine so many; other arguments and errors are those of `learn_shape`.
    """
    positions = np.array(tracks, np.float64)
    _check(positions, 2)
    hidden = withheld(positions)
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
    return BasesChoice(candidates[chosen], tuple(candidates), np.sqrt(means))


def withheld(positions: Array) -> NDArray[np.bool_]:
    """Return which observed positions are withheld, `(n_frames, n_points)` bool."""
    seen = ~np.isnan(positions[..., 0])
    draws = np.where(seen, np.random.default_rng(SEED).random(seen.shape), 2.0)
    # those that a frame, or a point, has to keep are the ones with the largest draws among what was seen
    hidden = seen & (draws < WITHHELD)
    for axis in (0, 1):
        rank = np.argsort(np.argsort(np.where(seen, -draws, 1.0), axis=axis), axis=axis)
        hidden &= rank >= LEAST_LEFT
    return hidden


ALIKE = 3.0
"""Mean squared distance of a coordinate from where the other track expects it, in units of what is stated. It
is 1 for one point; 3 is the 95 % point of the mean of two squares, as few as are free where errors are alike
over time."""
SHARP = 0.1  # places are expected to this share of the object's size, or tracks cannot be distinguished
ROUNDS = 3


def learn_associated(positions: Array, bases: int, *, associate: bool) -> tuple[NonrigidShape, Indices]:
    """Learn a shape from tracks `(n_frames, n_tracks, 2)` px, NaN where not seen.

    With `associate`, pairs of tracks that were never seen at once, of which each lies where the shape
    expects the other and no other one lies nearer, are united, and the shape is learned again. Also gives
    the point of each track, -1 where that is too short. A `ValueError` as of `learn_shape`.
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
    return shape, point


def _long_enough(positions: Array) -> Indices:
    """A point for each track that is seen in enough frames which show enough of the others."""
    seen = ~np.isnan(positions[..., 0])
    keeps = np.ones(seen.shape[1], np.bool_)
    while True:
        frames = seen[:, keeps].sum(axis=1) >= LEAST_POINTS
        enough = keeps & (seen[frames].sum(axis=0) >= LEAST_FRAMES)
        if not enough.any():
            return np.arange(len(keeps))  # `learn_shape` raises the error
        if (enough == keeps).all():
            return np.where(keeps, np.cumsum(keeps) - 1, -1)
        keeps = enough


def _merged(positions: Array, point: Indices) -> Array:
    """`(n_frames, n_points, 2)`: of each frame the track that shows the point, if there is one."""
    merged = np.full((len(positions), point.max() + 1, 2), np.nan)
    for track in np.flatnonzero(point >= 0):
        seen = ~np.isnan(positions[:, track, 0])
        merged[seen, point[track]] = positions[seen, track]
    return merged


def _pairs(positions: Array, shape: NonrigidShape) -> list[tuple[int, int]]:
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
