"""EM for probabilistic PCA of shape: 3-D points whose places are linear in Gaussian weights, seen in 2-D.

Torresani, Hertzmann and Bregler (2008): in frame t, point j is seen at c_t R_t (v_j0 + sum_k z_tk v_jk) +
l_t plus noise of variance sigma^2, R_t the first two rows of a rotation and z_t ~ N(0, I). Sums over a
frame's points are taken once an iteration, so that steps on poses do not depend on the number of points.

Where we depart from the paper: poses climb the likelihood with the weights integrated out (ECME) instead of
its bound, by damped Gauss-Newton steps that move weights and pose together; weights are let go of N(0, I) in
the M-step and brought back to it by changing the bases (parameter-expanded EM); and bases have a prior.

Smoothly, weights of modes are first-order autoregressive, z_t = a z_t-1 + noise, each N(0, 1) by itself:
correlations a are learned by EM (Shumway and Stoffer 1982). Turns are a walk whose steps are a walk: second
differences of rotations are N(0, s^2 I). Poses then climb the posterior with the weights of all frames
integrated out, all frames together. Frames that are left out count as none.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ....models.numerics.rotations import cross_matrices, exponential, logarithm, nearest_rotation
from ...optimisation import Anderson, Damping, levenberg_marquardt

Array = NDArray[np.float64]

LEAST_NOISE = 3e-3
"""Of the spread of points: no film shows them better (0.15 px for 50). Below, what is left out is fitted."""

ALIKE = 10.0  # so many frames of a video count as one independent frame; power of the bases' prior
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
LONGEST_TURN, LONGEST_GROWTH = 0.3, 0.3  # of one step: rad, and change of the logarithm of scale
RIDGE = 1e-9  # of the mean information on a point: points that frames leave open stay where they are
_TURNS = cross_matrices(np.eye(3))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Positions about their frame's middle and in units of their spread, 0 where not `seen` (1 or 0).

    `(n_frames, n_points, 2)`; `patterns` `(n_patterns, n_points)` are the different rows of `seen`, and
    `pattern_of_frame` is which one a frame has.
    """

    positions: Array
    seen: Array
    patterns: Array
    pattern_of_frame: NDArray[np.int64]

    @classmethod
    def of(cls, positions: Array) -> Self:
        """Return the tracks of positions that are NaN where not seen."""
        seen = ~np.isnan(positions[..., 0])
        patterns, pattern_of_frame = np.unique(seen.astype(np.float64), axis=0, return_inverse=True)
        return cls(
            np.where(seen[..., None], positions, 0.0),
            seen.astype(np.float64),
            patterns,
            pattern_of_frame.ravel(),
        )

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.seen)

    @property
    def count(self) -> float:
        """How many coordinates were seen."""
        return 2 * float(self.seen.sum())


@dataclass(frozen=True, eq=False)
class State:
    """Shape, poses and noise.

    Bases `(n_bases, n_points, 3)`, the mean shape first; rotations `(n_frames, 3, 3)`, scales `(n_frames,)`,
    translations `(n_frames, 2)`; variance of a coordinate; damping `(n_frames,)` of the next Gauss-Newton
    step.
    """

    bases: Array
    rotations: Array
    scales: Array
    translations: Array
    noise: float
    damping: Array

    def begun(self, **changes: Any) -> Self:
        """Return the state with these changes, before the first step."""
        return replace(self, damping=np.full(len(self.scales), FIRST_DAMPING), **changes)

    @property
    def seen_axes(self) -> Array:
        """c R: `(n_frames, 2, 3)`, the part of the pose that is seen."""
        return self.scales[:, None, None] * self.rotations[:, :2]


@dataclass(frozen=True, eq=False)
class WeightPosterior:
    """Posterior of the weights of modes in each frame, and the log likelihood `(n_frames,)` without them.

    Mean `(n_frames, n_modes)` with covariance; `products` `(n_frames, n_bases, n_bases)` and `sums`
    `(n_frames, 2, n_bases)` of bases as they are seen, over points.
    """

    mean: Array
    covariance: Array
    log_likelihood: Array
    products: Array
    sums: Array

    @property
    def extended(self) -> Array:
        """`(n_frames, n_bases)`: with the weight 1 of the mean shape in front."""
        return np.concatenate([np.ones((len(self.mean), 1)), self.mean], axis=1)


@dataclass(frozen=True, eq=False)
class PointSums:
    """Sums over the points that a frame shows: of products of (1, v_j), of positions times these, of squares.

    `points` `(n_frames or 1, 1 + 3 n_bases, 1 + 3 n_bases)`, basis by basis, `positions`
    `(n_frames, 2, 1 + 3 n_bases)`, `squares` `(n_frames,)`.
    """

    points: Array
    positions: Array
    squares: Array


def point_sums(tracks: Tracks, bases: Array) -> PointSums:
    """Return the sums for these bases."""
    n_bases, n_points = bases.shape[:2]
    flat = np.ones((n_points, 1 + 3 * n_bases))
    flat[:, 1:] = bases.transpose(1, 0, 2).reshape(n_points, -1)
    size = flat.shape[1]
    products = (flat[:, :, None] * flat[:, None, :]).reshape(n_points, -1)
    points = (tracks.patterns @ products).reshape(-1, size, size)
    if len(points) > 1:
        points = points[tracks.pattern_of_frame]
    positions = np.matmul(tracks.positions.transpose(0, 2, 1), flat)
    return PointSums(points, positions, np.sum(tracks.positions**2, axis=(1, 2)))


def e_step(state: State, sums: PointSums) -> WeightPosterior:
    """Return z_t | y_t ~ N((A'A + sigma^2 I)^-1 A'y, sigma^2 (A'A + sigma^2 I)^-1), A = c R V (E-step)."""
    n, n_bases, noise = len(state.scales), len(state.bases), state.noise
    axes, shift = state.seen_axes, state.translations
    squared = np.matmul(axes.transpose(0, 2, 1), axes).reshape(n, 1, 9)
    by_axes = sums.points[:, 1:, 1:].reshape(-1, n_bases, 3, n_bases, 3).transpose(0, 2, 4, 1, 3)
    gram = np.matmul(squared, by_axes.reshape(-1, 9, n_bases**2)).reshape(n, n_bases, n_bases)
    middle = np.matmul(axes, sums.points[:, 0, 1:].reshape(-1, n_bases, 3).transpose(0, 2, 1))
    product = np.einsum("nca,ncka->nk", axes, sums.positions[..., 1:].reshape(n, 2, n_bases, 3))
    count, total = sums.points[:, 0, 0], sums.positions[..., 0]
    residual = product - np.matmul(shift[:, None], middle)[:, 0] - gram[:, 0]
    rigid = (
        sums.squares
        - 2 * np.sum(shift * (total - middle[..., 0]), axis=1)
        + count * np.sum(shift**2, axis=1)
        - 2 * product[:, 0]
        + gram[:, 0, 0]
    )
    inverse = np.linalg.inv(gram[:, 1:, 1:] + noise * np.eye(n_bases - 1))
    mean = np.matmul(inverse, residual[:, 1:, None])[..., 0]
    squares = rigid - np.sum(residual[:, 1:] * mean, axis=1)
    log_volume = -np.linalg.slogdet(inverse)[1] - (n_bases - 1) * np.log(noise)
    log_likelihood = -0.5 * (2 * count * np.log(2 * np.pi * noise) + log_volume + squares / noise)
    return WeightPosterior(mean, noise * inverse, log_likelihood, gram, middle)


def pose_step(state: State, sums: PointSums, posterior: WeightPosterior) -> tuple[State, WeightPosterior]:
    """Take one damped Gauss-Newton step of every pose whose likelihood gains by it."""
    normal, pull = pose_equations(state, sums, posterior)
    every = np.arange(6)
    diagonal = normal[:, every, every]
    normal[:, every, every] += state.damping[:, None] * diagonal + RIDGE * diagonal.max(axis=1)[:, None]
    step: Array = np.linalg.solve(normal, pull[..., None])[..., 0].astype(np.float64)
    moved = replace(moved_poses(state, step), damping=np.maximum(state.damping / 10, LEAST_DAMPING))
    reached = e_step(moved, sums)
    better = reached.log_likelihood >= posterior.log_likelihood
    stay = replace(state, damping=np.minimum(state.damping * 10, MOST_DAMPING))
    return chosen_poses(better, moved, stay), chosen(
        better, reached, posterior, [each.name for each in fields(posterior)]
    )


def moved_poses(state: State, step: Array) -> State:
    """Return the state after a step `(n_frames, 6)`, which is cut to `LONGEST_TURN` and `LONGEST_GROWTH`."""
    length = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
    turns = step[:, :3] * np.minimum(1, LONGEST_TURN / np.maximum(length, LONGEST_TURN))
    return replace(
        state,
        rotations=exponential(turns) @ state.rotations,
        scales=state.scales * np.exp(np.clip(step[:, 3], -LONGEST_GROWTH, LONGEST_GROWTH)),
        translations=state.translations + step[:, 4:],
    )


def pose_equations(state: State, sums: PointSums, posterior: WeightPosterior) -> tuple[Array, Array]:
    """Return curvature `(n_frames, 6, 6)` and gradient `(n_frames, 6)` of log likelihoods, times the noise.

    By turn (R <- exp([w]x) R), logarithm of scale and translation. The gradient is that of the likelihood
    without the weights (Fisher's identity), the curvature that of poses after the weights are eliminated
    from a joint step.
    """
    n, n_bases = len(state.scales), len(state.bases)
    axes, extended = state.seen_axes, posterior.extended
    turned = state.scales[:, None, None, None] * np.einsum("iab,nbc->niac", _TURNS[:, :2], state.rotations)

    # d position / d (w, log c) is linear in (1, v_j): its coefficients
    changes = np.concatenate([turned, axes[:, None]], axis=1)
    rows = np.zeros((n, 4, 2, sums.points.shape[-1]))
    rows[..., 1:] = (changes[:, :, :, None] * extended[:, None, None, :, None]).reshape(n, 4, 2, -1)
    weighted = np.matmul(rows.reshape(n, 8, -1), sums.points).reshape(rows.shape)
    normal = np.zeros((n, 6, 6))
    normal[:, :4, :4] = np.matmul(weighted.reshape(n, 4, -1), rows.reshape(n, 4, -1).transpose(0, 2, 1))
    normal[:, :4, 4:] = weighted[..., 0]
    normal[:, 4:, :4] = weighted[..., 0].transpose(0, 2, 1)
    normal[:, 4, 4] = normal[:, 5, 5] = sums.points[:, 0, 0]
    with_modes = np.concatenate(
        [
            np.einsum("nicka,nca->nik", weighted[..., 4:].reshape(n, 4, 2, -1, 3), axes),
            posterior.sums[..., 1:],
        ],
        axis=1,
    )
    normal -= with_modes @ posterior.covariance @ with_modes.transpose(0, 2, 1) / state.noise

    residual = sums.positions - weighted[:, 3] - state.translations[..., None] * sums.points[:, :1]
    pull = np.concatenate(
        [np.matmul(rows.reshape(n, 4, -1), residual.reshape(n, -1, 1))[..., 0], residual[..., 0]], axis=1
    )
    uncertain = _uncertain_shape(sums, posterior, n_bases)
    pull[:, :4] -= np.einsum("nca,nab,nicb->ni", axes, uncertain, changes, optimize=True)
    return normal, pull


def _uncertain_shape(sums: PointSums, posterior: WeightPosterior, n_bases: int) -> Array:
    """`(n_frames, 3, 3)`: the part of sum_j E[s_j s_j'] that comes from the covariance of the weights."""
    n, n_modes = posterior.mean.shape
    if not n_modes:
        return np.zeros((n, 3, 3))
    products = sums.points[:, 1:, 1:].reshape(-1, n_bases, 3, n_bases, 3)[:, 1:, :, 1:]
    by_modes = products.transpose(0, 1, 3, 2, 4).reshape(-1, n_modes**2, 9)
    flat = posterior.covariance.reshape(n, 1, n_modes**2)
    summed: Array = np.matmul(flat, by_modes).reshape(n, 3, 3)
    return summed


OfFrames = TypeVar("OfFrames", State, WeightPosterior)


def chosen_poses(first: NDArray[np.bool_], one: State, other: State) -> State:
    """Return the state `other` with the poses of `one` in the frames `first` `(n_frames,)`."""
    return chosen(first, one, other, ("rotations", "scales", "translations", "damping"))


def chosen(first: NDArray[np.bool_], one: OfFrames, other: OfFrames, names: Iterable[str]) -> OfFrames:
    """Return `other` with these of the arrays of `one` in the frames `first`."""

    def mixed(name: str) -> Any:
        new, old = getattr(one, name), getattr(other, name)
        return np.where(first.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return replace(other, **{name: mixed(name) for name in names})


def basis_covariance(bases: Array, axes: Array) -> Array:
    """Return the prior covariance `(n_bases, n_bases)` of a point's bases along any axis.

    Where an object hardly turns, its likelihood grows with its depth: whatever does not fit the model is
    best explained by deep shapes that turn by a trifle. By the prior a basis is about as deep as it
    is wide; it is taken to the power `ALIKE`, since successive frames err alike. The mean is independent of
    the modes.
    """
    seen = np.matmul(axes.transpose(0, 2, 1), axes).mean(axis=0)
    scale = np.trace(seen) / 2
    n_points = bases.shape[1]
    product = np.einsum("kja,ab,ljb->kl", bases, seen / scale, bases, optimize=True)
    covariance: Array = product / (2 * n_points)
    covariance[0, 1:] = covariance[1:, 0] = 0
    return covariance + np.eye(len(covariance)) * LEAST_NOISE**2


def log_prior(bases: Array, covariance: Array) -> float:
    """Return log density of the bases, tempered, less a constant."""
    squares = np.einsum("kja,lja->kl", bases, bases)
    return -0.5 * ALIKE * float(np.sum(np.linalg.inv(covariance) * squares))


def shape_step(
    state: State, tracks: Tracks, posterior: WeightPosterior, covariance: Array
) -> tuple[State, Array]:
    """Update bases by the normal equations of each point, then the noise (M-step).

    Returns the state and the prior's covariance in terms of the new modes.
    """
    n_bases, n_points = state.bases.shape[:2]
    axes, extended = state.seen_axes, posterior.extended
    second = extended[:, :, None] * extended[:, None, :]
    second[:, 1:, 1:] += posterior.covariance
    squared = np.matmul(axes.transpose(0, 2, 1), axes)
    if tracks.seen.all():  # all points have the same normal matrix
        product = second.reshape(len(second), -1).T @ squared.reshape(len(squared), -1)
        together = product.reshape(1, n_bases, n_bases, 3, 3).transpose(0, 1, 3, 2, 4)
    else:
        products = np.einsum("nkl,nab->nkalb", second, squared)
        together = tracks.seen.T @ products.reshape(len(products), -1)
    normal = together.reshape(-1, 3 * n_bases, 3 * n_bases)
    centred = (tracks.positions - state.translations[:, None]) * tracks.seen[..., None]
    coefficients = np.einsum("nk,nca->ncka", extended, axes).reshape(-1, 3 * n_bases)
    right = centred.transpose(1, 0, 2).reshape(n_points, -1) @ coefficients
    prior = np.kron(ALIKE * state.noise * np.linalg.inv(covariance), np.eye(3))
    before = state.bases.transpose(1, 0, 2).reshape(n_points, -1, 1)
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2).mean() * np.eye(3 * n_bases)
    pull = right[..., None] - np.matmul(normal + prior, before)
    flat = before + np.matmul(np.linalg.inv(normal + prior + ridge), pull)
    squares = np.sum(centred**2) + np.sum(flat * (np.matmul(normal, flat) - 2 * right[..., None]))
    bases = flat.reshape(n_points, n_bases, 3).transpose(1, 0, 2).copy()
    noise = max(float(squares) / tracks.count, LEAST_NOISE**2)
    if n_bases > 1:
        middle = posterior.mean.mean(axis=0)
        away = posterior.mean - middle
        root = np.linalg.cholesky(away.T @ away / len(away) + posterior.covariance.mean(axis=0))
        bases[0] += np.tensordot(middle, bases[1:], 1)
        bases[1:] = np.tensordot(root.T, bases[1:], 1)
        covariance = covariance.copy()
        covariance[1:, 1:] = root.T @ covariance[1:, 1:] @ root
    return replace(state, bases=bases, noise=noise), covariance


def run_em(
    tracks: Tracks, state: State, iterations: int, tolerance: float, on_iteration: Callable[[], None]
) -> tuple[State, list[float]]:
    """Run EM until it gains less than `tolerance` nats a coordinate, or for so many iterations.

    Extrapolated from the last iterations (Anderson); what lowers the likelihood is taken back. Also returns
    the log likelihood with the prior before each iteration that counts, which never falls.
    """
    covariance = basis_covariance(state.bases, state.seen_axes)
    acceleration = Anderson()
    plain, extrapolated = state, False
    history: list[float] = []
    for _ in range(iterations):
        sums = point_sums(tracks, state.bases)
        found = e_step(state, sums)
        reached = float(found.log_likelihood.sum()) + log_prior(state.bases, covariance)
        if extrapolated and not reached >= history[-1]:
            state, extrapolated = plain, False
            acceleration.forget()
            continue
        history.append(reached)
        if len(history) > 1 and history[-1] - history[-2] < tolerance * tracks.count:
            break
        before = state
        state, found = pose_step(state, sums, found)
        plain, covariance = shape_step(state, tracks, found, covariance)
        state = _from_vector(acceleration.propose(_as_vector(before), _as_vector(plain)), plain)
        extrapolated = state is not plain
        on_iteration()
    else:
        state = plain  # the last proposal was not looked at
    return state, history


def _as_vector(state: State) -> Array:
    """All numbers of a state that EM changes; they are all about as large."""
    parts = (state.bases, state.rotations, np.log(state.scales), state.translations, np.log([state.noise]))
    return np.concatenate([part.reshape(-1) for part in parts])


def _from_vector(vector: Array, like: State) -> State:
    """The state of a vector, with the nearest rotations."""
    sizes = np.cumsum([like.bases.size, like.rotations.size, like.scales.size, like.translations.size])
    bases, rotations, scales, translations, noise = np.split(vector, sizes)
    return replace(
        like,
        bases=bases.reshape(like.bases.shape),
        rotations=nearest_rotation(rotations.reshape(like.rotations.shape)),
        scales=np.exp(scales),
        translations=translations.reshape(like.translations.shape),
        noise=max(float(np.exp(noise[0])), LEAST_NOISE**2),
    )


def log_likelihood(tracks: Tracks, state: State) -> float:
    """Return the log likelihood, nats, in the unit of the tracks, weights integrated out."""
    return float(e_step(state, point_sums(tracks, state.bases)).log_likelihood.sum())


SMOOTH_FRAMES = 5  # fewer have too few second differences
ITERATIONS = 40
DAMPING = Damping(1e-4, most=1e6)
MOST_STEPS = 20  # that are tried, with more and more damping
MOST_CORRELATION = 0.9999
LEAST_SPREAD = 1e-4  # of second differences of turns, rad: finer ones no film shows
WINDOW = 200  # frames from which the spread of turns is learned; its posterior takes the cube of their number


def smoothed(tracks: Tracks, state: State, on_iteration: Callable[[], None]) -> tuple[State, WeightPosterior]:
    """Return the state and its weights after EM with the prior of smoothness; frames' own log likelihoods."""
    correlations, spread = np.zeros(len(state.bases) - 1), None
    prior, damping = basis_covariance(state.bases, state.seen_axes), DAMPING.first
    for _ in range(ITERATIONS):
        sums = point_sums(tracks, state.bases)
        found = smooth_weights(state, sums, correlations)[0]
        normal, pull = (each / state.noise for each in pose_equations(state, sums, found))
        spread = _spread_of_turns(state.rotations, normal, spread)
        state, damping = _turned(state, sums, correlations, spread, normal, pull, damping)
        found, cross, _ = smooth_weights(state, sums, correlations)
        correlations, modes = _correlations(found, cross)
        state, prior = shape_step(state, tracks, found, prior)
        state.bases[1:] = np.tensordot(modes.T, state.bases[1:], 1)
        prior[1:, 1:] = modes.T @ prior[1:, 1:] @ modes
        on_iteration()
    return state, smooth_weights(state, point_sums(tracks, state.bases), correlations)[0]


def smooth_weights(
    state: State, sums: PointSums, correlations: Array
) -> tuple[WeightPosterior, Array, float]:
    """Smooth the weights: posterior given all frames, covariances with the frame before, log likelihood.

    Information is block tridiagonal: elimination forward, and back (Rauch, Tung and Striebel 1965).
    """
    alone = e_step(state, sums)
    n, n_modes = alone.mean.shape
    innovation = 1 - correlations**2
    own = alone.products[:, 1:, 1:] / state.noise
    pull = np.matmul(own + np.eye(n_modes), alone.mean[..., None])[..., 0]
    information = own + np.diag((1 + correlations**2) / innovation)
    information[[0, -1]] = own[[0, -1]] + np.diag(1 / innovation)
    outer = -correlations / innovation
    inverses, means = np.empty_like(own), pull.copy()
    for frame in range(n):
        reduced = information[frame]
        if frame:
            reduced = reduced - outer[:, None] * inverses[frame - 1] * outer
            means[frame] -= outer * (inverses[frame - 1] @ means[frame - 1])
        inverses[frame] = np.linalg.inv(reduced)
    covariances, cross = inverses.copy(), np.zeros_like(inverses)
    means[-1] = inverses[-1] @ means[-1]
    for frame in range(n - 2, -1, -1):
        gain = inverses[frame] * outer
        means[frame] = inverses[frame] @ (means[frame] - outer * means[frame + 1])
        cross[frame + 1] = -covariances[frame + 1] @ gain.T
        covariances[frame] += gain @ covariances[frame + 1] @ gain.T
    # against weights that know nothing of each other
    gained = np.sum(pull * (means - alone.mean)) + np.linalg.slogdet(inverses)[1].sum()
    gained += np.linalg.slogdet(own + np.eye(n_modes))[1].sum() - (n - 1) * np.log(innovation).sum()
    likelihood = float(alone.log_likelihood.sum() + gained / 2)
    return replace(alone, mean=means, covariance=covariances), cross, likelihood


def _correlations(posterior: WeightPosterior, cross: Array) -> tuple[Array, Array]:
    """Correlations of successive weights, and the modes (columns) in terms of those of `shape_step`."""
    away = posterior.mean - posterior.mean.mean(axis=0)
    squares = away[:, :, None] * away[:, None] + posterior.covariance
    white = np.linalg.inv(np.linalg.cholesky(squares.mean(axis=0)))
    successive = white @ ((away[1:].T @ away[:-1] + cross[1:].sum(axis=0)) @ white.T)
    both = white @ ((squares[1:] + squares[:-1]).sum(axis=0) / 2) @ white.T
    modes = np.linalg.eigh((successive + successive.T) / 2)[1]
    ratio = np.diag(modes.T @ successive @ modes) / np.diag(modes.T @ both @ modes)
    return np.clip(ratio, 0, MOST_CORRELATION), modes


def second_differences(rotations: Array) -> Array:
    """Return second differences of rotations about the camera's axes, `(n_frames - 2, 3)` rad."""
    turns = logarithm(rotations[1:] @ rotations[:-1].transpose(0, 2, 1))
    return np.diff(turns, axis=0)


def _differences(n: int) -> sparse.csr_matrix:
    """`(3 (n - 2), 3 n)`: second differences of turns, to first order."""
    rows = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    return sparse.csr_matrix(sparse.kron(rows, sparse.eye(3)))


def _spread_of_turns(rotations: Array, normal: Array, spread: float | None) -> float:
    """Variance of second differences, expected under their posterior by the spread before; rad^2."""
    n = min(len(rotations), WINDOW)
    about, rest = normal[:n, :3, :3], normal[:n, 3:, 3:]
    information = about - normal[:n, :3, 3:] @ np.linalg.solve(rest, normal[:n, 3:, :3])
    rows = _differences(n)
    whole = sparse.block_diag(list(information)).toarray()
    whole[np.diag_indices_from(whole)] += 1.0  # known to a radian before
    if spread is not None:
        whole += (rows.T @ rows).toarray() / spread
    uncertain = np.sum(rows.toarray() * (rows @ np.linalg.inv(whole))) / rows.shape[0]
    return max(float(np.mean(second_differences(rotations) ** 2)) + float(uncertain), LEAST_SPREAD**2)


def _turned(
    state: State,
    sums: PointSums,
    correlations: Array,
    spread: float,
    normal: Array,
    pull: Array,
    damping: float,
) -> tuple[State, float]:
    """One step of all poses together, and the damping of the next."""

    def posterior(at: State) -> float:
        squares = float(np.sum(second_differences(at.rotations) ** 2))
        return smooth_weights(at, sums, correlations)[2] - squares / (2 * spread)

    def linearised(at: State) -> Callable[[float], State | None]:
        n, before = len(normal), posterior(at)
        rows = _differences(n)
        turns = sparse.kron(sparse.eye(n), sparse.eye(6, 3))
        smooth_pull = (turns @ (rows.T @ second_differences(at.rotations).ravel()) / spread).reshape(n, 6)
        right = (pull - smooth_pull).ravel()
        smooth = turns @ (rows.T @ rows) @ turns.T / spread
        diagonal = np.diagonal(normal, axis1=1, axis2=2)
        ridge = RIDGE * diagonal.max(axis=1)[:, None]

        def step(damping: float) -> State | None:
            added = (damping * diagonal + ridge).ravel()
            whole = smooth + sparse.block_diag(list(normal)) + sparse.diags(added)
            change = spsolve(sparse.csc_matrix(whole), right, permc_spec="NATURAL").reshape(n, 6)
            moved = moved_poses(at, change)
            return moved if posterior(moved) >= before else None

        return step

    damped = replace(DAMPING, first=damping)
    reached, after = levenberg_marquardt(state, linearised, lambda *_: True, damped, most_steps=MOST_STEPS)
    return reached, DAMPING.first if reached is state else after
