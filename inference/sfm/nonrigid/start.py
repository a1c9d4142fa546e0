"""Where EM for deforming shapes starts: a rigid shape, modes that are added to it, or taken away."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..affine_camera import euclidean, scaled_rotations
from ..factor_analysis.factorisation import factorise
from .em import FIRST_DAMPING, LEAST_NOISE, Numbers, State, Tracks, chosen_poses, e_step, point_sums, run_em

USUAL_DEPTH = 0.7
"""Of objects that do not turn enough to show it, in root mean squares of their width and height."""

RIGID_ITERATIONS = 60

SMOOTH = np.radians(5)
"""Standard deviation of an object's turn from frame to frame, where it is doubtful which way it turns."""

DOUBT = 100.0
"""Of a deforming object the likelihood of a rigid one says so many times less than it seems."""

TURNED_OVER = np.radians(15)
"""Poses that differ by so much are two ways of seeing the same picture."""

TOLERANCE = 1e-5
"""Nats a coordinate, for what comes before the last climb."""


def rigid_states(tracks: Tracks, positions: Numbers, on_iteration: Callable[[], None]) -> list[State]:
    """Rigid motions: as factorisation gives it, and with smooth turns where they are not.

    Sudden turns of about 180 degrees explain a flat object's picture as well.

    Parameters
    ----------
    tracks, positions
        the same, `positions` `(n_frames, n_points, 2)` with NaN where not seen.
    """
    rigid, _ = run_em(tracks, rigid_start(positions), RIGID_ITERATIONS, TOLERANCE, on_iteration)
    smooth = smoothed(tracks, rigid)
    if smooth is None:
        return [rigid]
    return [rigid, run_em(tracks, smooth, RIGID_ITERATIONS, TOLERANCE, on_iteration)[0]]


def shape_seen_from(positions: Numbers, rotations: Numbers) -> State:
    """The rigid shape that fits best under given rotations; `positions` are complete and about middles."""
    n_frames, n_points, _ = positions.shape
    axes = rotations[:, :2].reshape(-1, 3)
    rows = positions.transpose(0, 2, 1).reshape(-1, n_points)
    shape: Numbers = np.asarray(np.linalg.lstsq(axes, rows)[0].T, np.float64)
    left = positions - shape @ rotations[:, :2].transpose(0, 2, 1)
    noise = max(float(np.mean(left**2)), LEAST_NOISE**2)
    damping = np.full(n_frames, FIRST_DAMPING)
    return State(shape[None].copy(), rotations, np.ones(n_frames), np.zeros((n_frames, 2)), noise, damping)


def rigid_start(positions: Numbers) -> State:
    """A rigid shape and its poses from factorisation `(n_frames, n_points, 2)`, NaN where not seen."""
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


def _usual_depth(cameras: Numbers, shape: Numbers) -> Numbers:
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
    """The state with more modes, the principal ones of what is left of positions, put into the picture plane.

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
    return replace(state, bases=bases, damping=np.full(tracks.n_frames, FIRST_DAMPING))


def without_modes(state: State, n_bases: int) -> State:
    """The state with the largest modes only, so many bases in all."""
    flat = state.bases[1:].reshape(len(state.bases) - 1, -1)
    order = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    modes = np.tensordot(order.T[: n_bases - 1], state.bases[1:], 1)
    return replace(
        state,
        bases=np.concatenate([state.bases[:1], modes]),
        damping=np.full(len(state.scales), FIRST_DAMPING),
    )


# --- which way it turns -------------------------------------------------------------------------------------


def smoothed(tracks: Tracks, state: State) -> State | None:
    """The state with each frame's rotation or its mirror image, so that turns are smooth; `None` if they are.

    Under orthography a flat object appears the same as its mirror image behind it, R -> F R F_n with F a
    reflection in depth and F_n one of the object through its plane. For one that is not quite flat, one of
    the two is more likely, though not always the true one if it deforms. The best sequence is found by
    Viterbi's algorithm.
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
    smooth = chosen_poses(turned_over, mirrored, state)
    return replace(smooth, damping=np.full(tracks.n_frames, FIRST_DAMPING))


def _smoothest(likelihoods: Numbers, rotations: Numbers) -> NDArray[np.int64]:
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


def _angles(one: Numbers, other: Numbers) -> Numbers:
    """Angles `(...,)` rad between rotations `(..., 3, 3)`."""
    angles: Numbers = np.arccos(np.clip((np.sum(one * other, axis=(-2, -1)) - 1) / 2, -1, 1))
    return angles
