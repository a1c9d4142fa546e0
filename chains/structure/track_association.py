"""Association of partial tracks: tracks that show the same point by the shape become one.

A point that was lost and found again has several tracks. The RSMCM paper (§4.3) lets the shape decide which
belong together, but gives no equations; these are ours. Cameras and points of all tracks, each a point of its
own, have a joint posterior, under noise that is in part drift. Pairs that are probably at one place are
united, the surest first, and the posterior is conditioned on that, so that each union makes the next one
surer. Ambiguous pairs wait until they no longer are. At the end every track is tested against every point,
without its own observations, and is kept where it surely belongs.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array, triu
from scipy.special import expit

from ...inference.sfm.factor_analysis.em import homogeneous
from ...inference.sfm.factor_analysis.factorisation import Factorisation, factorise, factorise_robustly
from ...inference.sfm.factor_analysis.observations import Observations, SparseObservations, as_arrays
from .kernels import assign_tracks, camera_coupling, same_point_gains, track_information

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)  # of the variance, that may be drift
MEMORIES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0)  # frames in which drift may be forgotten
STEPS, PRECISION = 50, 1e-3  # of the variance of the noise: at most so many, to this share
MOST_RESIDUALS = 10_000  # of more, those of every n-th point give variances to 1 or 2 %
ROUNDING = 1e-12  # share of the squares of positions below which errors are rounding


@dataclass(frozen=True)
class CorrelatedNoise:
    """Errors of a track along one axis: white noise plus a first-order Gauss-Markov process, px^2.

    A template that has slipped off its point stays off it for some frames (`memory`, in which the
    correlation of drift falls to 1/e). Taken for white, such errors make a short track seem surer than it
    is.
    """

    white: float
    drift: float
    memory: float

    @property
    def decay(self) -> float:
        """Correlation of drift from one frame to the next."""
        return float(np.exp(-1 / self.memory))

    def scaled(self, factor: float) -> "CorrelatedNoise":
        """Return the same with variances times a factor."""
        return CorrelatedNoise(factor * self.white, factor * self.drift, self.memory)

    def information(self, tracks: SparseObservations, cameras: Array) -> tuple[Array, Array, Array, Array]:
        """Return the information of tracks about their points, for known cameras `(n_frames, 2, 4)`.

        -2 log p(track | its point S) = quadratic - 2 vector . S + S . information S + determinant +
        constant; the four are `(n_tracks, 3, 3)`, `(n_tracks, 3)`, `(n_tracks,)`, `(n_tracks,)`.
        """
        terms: tuple[Array, Array, Array, Array] = track_information(
            tracks, np.ascontiguousarray(cameras), self.white, self.drift, self.decay
        )
        return terms


def estimate_correlated_noise(
    tracks: SparseObservations, cameras: Array, point_of_track: NDArray[np.int64], prior: Array
) -> CorrelatedNoise:
    """Find the noise under which the tracks are likeliest, whatever the points are (restricted likelihood).

    The points, whose covariance about the origin is `prior` `(3, 3)`, are integrated out, so that what
    fitting them takes from the residuals is accounted for.
    """
    every = int(np.ceil(2 * len(tracks.x) / MOST_RESIDUALS))
    if every > 1:
        tracks = tracks.only(point_of_track % every == 0, np.ones(len(cameras), np.bool_))
        point_of_track = point_of_track // every
    n_points = int(point_of_track.max()) + 1
    count = 2 * len(tracks.x)
    root = np.linalg.cholesky(prior)
    membership = certain(point_of_track, n_points)
    found: list[tuple[float, CorrelatedNoise]] = []
    for share in SHARES:
        for memory in MEMORIES if share else MEMORIES[:1]:
            noise = CorrelatedNoise(1 - share, share, memory)
            information, vector, quadratic, determinant = noise.information(tracks, cameras)
            whole, sums = pooled(membership, information), pooled(membership, vector)
            # in the axes in which prior and observations of a point are diagonal
            values, axes = np.linalg.eigh(root.T @ whole @ root)
            squares = np.square(np.einsum("nji,kj,nk->ni", axes, root, sums))
            scale, left = _likeliest_scale(float(quadratic.sum()), values, squares, count)
            log_likelihood = -0.5 * (
                determinant.sum()
                + (count - values.size) * np.log(scale)
                + np.log(values + scale).sum()
                + left / scale
            )
            # of a drift, share and memory are found as well (BIC)
            found.append((float(log_likelihood) - (np.log(count) if share else 0.0), noise.scaled(scale)))
    return max(found, key=lambda each: each[0])[1]


def _likeliest_scale(total: float, values: Array, squares: Array, count: int) -> tuple[float, float]:
    """Likeliest variance of the noise of y = A s + noise, s ~ N(0, I), and the squares that are left then.

    `total` = y.y, `values` of A'A and `squares` of A'y along its axes.
    """
    scale = 1.0
    for _ in range(STEPS):
        before = scale
        explained = squares / (values + scale)
        left = total - float(explained.sum())
        errors = left - scale * float((explained / (values + scale)).sum())
        scale = max(errors / max(count - float((values / (values + scale)).sum()), 1.0), ROUNDING * total)
        if abs(scale - before) <= PRECISION * scale:
            break
    return scale, left


LEAST_CORRELATION = 1e-8  # of the noise of two frames, that counts
RIDGE = 1e-7  # added to the cameras' information, of unit diagonal, for what rounding takes away


def covariance_of_points(
    observations: Observations,
    fit: Factorisation,
    point_of_track: Indices,
    noise: CorrelatedNoise,
    chosen: Indices,
) -> Array:
    """Return covariance `(n, 3, n, 3)` of chosen points `(n,)`, with cameras uncertain as well (Laplace).

    `point_of_track` `(n_tracks,)` names points in the order of the observations; `fit` is in px, `noise` in
    the units of the observations.
    """
    tracks, n_points, n_frames = observations.by_point, len(fit.shape), observations.n_frames
    cameras = observations.scaled(fit.cameras)
    own, cross = camera_coupling(
        tracks, point_of_track, homogeneous(fit.shape), cameras, noise.white, noise.drift, noise.decay,
        LEAST_CORRELATION,
    )  # fmt: skip
    information, _, _, _ = noise.information(tracks, cameras)
    whole = np.tile(np.eye(3), (n_points, 1, 1))
    np.add.at(whole, point_of_track, information)
    inverse = np.linalg.inv(whole)
    size = 4 * n_frames
    own = own.reshape(size, size) + camera_precision(fit, n_frames) * observations.scale**2
    coupling = cross.reshape(2 * size, n_points, 3).transpose(1, 0, 2)
    halves = np.matmul(coupling, np.linalg.cholesky(inverse)).transpose(1, 0, 2).reshape(2 * size, -1)
    marginal = -(halves @ halves.T)
    marginal[:size, :size] += own
    marginal[size:, size:] += own
    # all cameras can move together with all points, which only the points' prior limits
    unit = 1 / np.sqrt(np.diag(marginal))
    marginal *= unit[:, None] * unit
    marginal[np.diag_indices(2 * size)] += RIDGE
    root = np.linalg.cholesky(marginal)
    through = np.matmul(coupling[chosen], inverse[chosen]).transpose(1, 0, 2).reshape(2 * size, -1)
    part = solve_triangular(root, unit[:, None] * through, lower=True)
    covariance = (part.T @ part).reshape(len(chosen), 3, len(chosen), 3)
    diagonal = np.arange(len(chosen))
    covariance[diagonal, :, diagonal] += inverse[chosen]
    return covariance


def camera_precision(fit: Factorisation, n_frames: int) -> Array:
    """Return prior information `(4 n_frames, 4 n_frames)` 1/px^2 of a row of the cameras at all times."""
    if not fit.coherent:
        return np.diag(np.tile(1 / np.repeat(fit.motion_noise[0], (3, 1)), n_frames))
    linear, shift = (motion_precision(fit.motion_noise[:, k], n_frames) for k in range(2))
    precision = np.zeros((n_frames, 4, n_frames, 4))
    for number in range(3):
        precision[:, number, :, number] = linear
    precision[:, 3, :, 3] = shift
    return precision.reshape(4 * n_frames, 4 * n_frames)


def motion_precision(variances: Array, n_frames: int) -> Array:
    """Return information `(n_frames, n_frames)` that eq. (19) holds of one number m at all times.

    `variances` are those of eps_1, eps_2 and eps_3. Eq. (19) without its derivatives: the third difference
    of m is (eps_3 + its last value) / 2 plus the first difference of eps_2 plus the second difference of
    eps_1.
    """
    count = n_frames - 3
    if count < 1:
        return np.zeros((n_frames, n_frames))
    noise = np.zeros((count, count))
    for weights, variance in (
        ((0.5, 0.5), variances[2]),
        ((-1, 1), variances[1]),
        ((1, -2, 1), variances[0]),
    ):
        band = np.zeros((count, count + len(weights) - 1))
        for k, weight in enumerate(weights):
            band += weight * np.eye(*band.shape, k)
        noise += variance * band @ band.T
    noise[np.diag_indices(count)] *= 1 + 1e-6
    rows = solve_triangular(np.linalg.cholesky(noise), np.diff(np.eye(n_frames), 3, axis=0), lower=True)
    return rows.T @ rows


LEAST_WEIGHT = 1e-3  # of a position that is pooled from tracks: less is none


def certain(point: Indices, n_points: int) -> csr_array:
    """Return memberships `(n_tracks, n_points)`, 0 or 1, of the tracks' points; none where it is -1."""
    shown = point >= 0
    edges = np.concatenate([[0], np.cumsum(shown)])
    return csr_array((np.ones(edges[-1]), point[shown], edges), shape=(len(point), n_points))


def pooled(membership: csr_array, values: Array) -> Array:
    """Return sums `(n_points, ...)` of the tracks' `(n_tracks, ...)` information, by memberships."""
    sums = np.asarray(membership.T @ values.reshape(len(values), -1), np.float64)
    return sums.reshape(membership.shape[1], *values.shape[1:])


def pooled_positions(membership: csr_array, positions: Array, weights: Array) -> tuple[Array, Array]:
    """Return positions `(n_frames, n_points, 2)` px and weights `(n_frames, n_points)` pooled over tracks."""
    known = ~np.isnan(positions)
    weight = weights[..., None] * known
    each = pooled(membership, weight.transpose(1, 0, 2)).transpose(1, 0, 2)
    sums = pooled(membership, (weight * np.where(known, positions, 0.0)).transpose(1, 0, 2))
    each[each < LEAST_WEIGHT] = 0
    with np.errstate(invalid="ignore"):
        return sums.transpose(1, 0, 2) / np.where(each > 0, each, np.nan), each.max(axis=2)


MOST_SHARE, LEAST_SHARE, SHARE_STEPS = 0.1, 1e-9, 50  # of pairs at one place: most, least, steps of EM


def log_odds_of_new(gains: Array, apart: NDArray[np.bool_]) -> float:
    """Return the log prior odds that a pair of points is two and not one, learned by EM.

    Different points may be there, too: as often as pairs that are two for sure, `apart`. `gains`
    `(n_pairs,)` are logs of how much likelier a pair is if it is at one place than if it is not.
    """
    share = max(_share_in_one_place(gains[~apart]) - _share_in_one_place(gains[apart]), LEAST_SHARE)
    return float(np.log((1 - share) / share))


def _share_in_one_place(gains: Array) -> float:
    share = MOST_SHARE if len(gains) else 0.0
    for _ in range(SHARE_STEPS):
        if share <= LEAST_SHARE:
            break
        share = min(float(expit(gains + np.log(share / (1 - share))).mean()), MOST_SHARE)
    return share


NEW_POINT = 0.1  # prior probability that a track shows a point that no other one shows, at the least
MARGINS = (3.0, 1.5, 0.0)  # nats by which a union has to be likelier than what it excludes, round by round
MOST_ROUNDS = 6
SOFT_ROUNDS = 4
ITERATIONS, LAST_ITERATIONS = 50, 500  # of EM after each change of who shows what, and at the end
SURE = 0.99  # probability from which a track is assigned to a point
DETERMINED = 0.15  # share of the spread of all points to which one has to be known in all frames
MOSTLY = 0.5  # share of the tracks from which being the only one of a point is what is to be expected
LEAST_VIEWS = 2  # frames of a track that is a point of its own: fewer leave its depth open
FAR = 64.0  # squared standard deviations: a point is not tried for a track whose middle is farther than eight
TORN = 0.05  # product of probabilities from which a track is torn between two points
MOST_TOGETHER = 500  # tracks with most observations that have a joint posterior; others are only assigned
AT_ONCE = 0.05  # unions between two comparisons of all pairs, as a share of the points


@dataclass(frozen=True, eq=False)
class TrackAssociation:
    """Cameras and points in a factorisation, and the tracks that show them.

    `point_of_track` `(n_tracks,)` is -1 where it is not sure enough what a track shows; `trusted`
    `(n_frames, n_tracks)` are positions that are taken to be right.
    """

    factorisation: Factorisation
    point_of_track: Indices
    trusted: NDArray[np.bool_]


def associate_tracks(
    positions: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    coherence: bool = False,
    outliers: bool = True,
    start: Factorisation | None = None,
) -> TrackAssociation:
    """Find points, cameras, and which tracks belong to which point.

    Arguments and errors are those of `factorise_robustly`. Who shows what is decided by positions that are
    known; cameras and points are found from all.
    """
    where, weight = as_arrays(positions, weights)
    where = np.where(weight[..., None] > 0, where, 0.0)
    robust = factorise_robustly(where, weight, coherence=coherence, outliers=outliers, start=start)
    trusted = robust.weights * robust.trusted
    whole = ~np.isnan(where).any(axis=2)
    kept, fit = robust.consistent & (trusted * whole > 0).any(axis=0), robust.factorisation
    point = np.full(len(kept), -1)
    try:
        # what is trusted counts, so that no track is refused for a position that is wrong
        association = _Association(where[:, kept], trusted[:, kept], fit.of_points(kept))
        association.unite()
        fit, point[kept] = association.soft_assignment()
    except ValueError:  # what is joined is too little to be a structure, or falls apart: nothing is
        fit = fit.of_points(kept)
        point[kept] = np.arange(np.count_nonzero(kept))
    return TrackAssociation(fit, point, robust.trusted)


class _Association:
    """State of the association, in the units of `Observations`."""

    def __init__(self, positions: Array, weights: Array, fit: Factorisation) -> None:
        whole = np.asarray(~np.isnan(positions).any(axis=2))
        self._all = positions, weights
        self._positions, self._weights = np.where(whole[..., None], positions, 0.0), weights * whole
        positions, weights = self._positions, self._weights
        self._fit = self._apart = fit
        self._observations = Observations.from_arrays(positions, weights)
        self._tracks = self._observations.by_point
        n_tracks = positions.shape[1]
        self._counts = np.diff(self._tracks.edges)
        self._seen = np.zeros((n_tracks, self._observations.n_frames))
        self._seen[self._tracks.own, self._tracks.other] = 1
        self._point = np.arange(n_tracks)
        self._membership = certain(self._point, n_tracks)
        self._log_new = np.inf
        """Log prior odds of a new point against a certain one of those that there may be."""

    # --- given the present cameras ---

    @property
    def _cameras(self) -> Array:
        """In the units of the observations."""
        return self._observations.scaled(self._fit.cameras)

    def _population(self) -> tuple[Array, Array]:
        """Mean `(3,)` and covariance `(3, 3)` of the points that are well seen."""
        seen = self._membership.T @ self._counts
        well = seen >= min(8.0, np.median(seen[seen > 0]))
        shape = self._fit.shape[well]
        return shape.mean(axis=0), 1.5 * np.cov(shape.T) + 1e-6 * np.eye(3)

    def _noise(self) -> CorrelatedNoise:
        mean, covariance = self._population()
        return estimate_correlated_noise(
            self._tracks, self._cameras, self._point, covariance + np.outer(mean, mean)
        )

    @property
    def _white_noise(self) -> CorrelatedNoise:
        """As the fit has it."""
        unit = self._observations.scale**2 * self._observations.weight_unit
        return CorrelatedNoise(self._fit.noise_variance / unit, 0.0, 1.0)

    # --- unions ---

    def unite(self) -> None:
        """Take tracks for one point, round by round, until nothing changes."""
        number = -1
        for _ in range(MOST_ROUNDS):
            before = self._point
            point, number = self._united(min(number + 1, len(MARGINS) - 1))
            self._regroup(point)
            if MARGINS[number] == 0:
                self._reassign()
                if np.array_equal(self._point, before):
                    return

    def _united(self, number: int) -> tuple[Indices, int]:
        """Point of each track after all unions of the next margin that allows any, and which one this is."""
        chosen = np.sort(np.argsort(-(self._membership.T @ self._counts), kind="stable")[:MOST_TOGETHER])
        covariance = covariance_of_points(self._observations, self._fit, self._point, self._noise(), chosen)
        seen = np.zeros((len(chosen), self._observations.n_frames))
        place = np.full(self._fit.shape.shape[0], -1)
        place[chosen] = np.arange(len(chosen))
        inside = place[self._point[self._tracks.own]]
        seen[inside[inside >= 0], self._tracks.other[inside >= 0]] = 1
        _, population = self._population()
        mean, apart, spread = self._fit.shape[chosen], seen @ seen.T > 0, 2 * population
        gains = np.empty(apart.shape)
        same_point_gains(mean, covariance, np.eye(len(mean), dtype=bool), spread, gains)
        first, second = np.triu_indices(len(mean), 1)
        # of all tracks: those that are one already are no longer among the pairs
        self._log_new = min(self._log_new, log_odds_of_new(gains[first, second], apart[first, second]))
        group = unite_points(mean, covariance, apart, spread, self._log_new, MARGINS[number])
        while MARGINS[number] > 0 and (group == np.arange(len(group))).all():
            number += 1
            group = unite_points(mean, covariance, apart, spread, self._log_new, MARGINS[number])
        target = np.arange(len(place))
        target[chosen] = chosen[group]
        return target[self._point], number

    # --- assignment given cameras ---

    def _assigned(self, membership: csr_array, noise: CorrelatedNoise, *, hard: bool) -> csr_array:
        """Membership after one turn of all tracks, short ones first."""
        tracks = self._tracks
        information, vector, _, _ = noise.information(tracks, self._cameras)
        mean, covariance = self._population()
        prior = np.asarray(np.linalg.inv(covariance), np.float64)
        order = np.argsort(self._counts, kind="stable")
        # a track is the only one of a point as often as others are
        alone = np.count_nonzero(np.bincount(membership.indices[membership.data > TORN]) == 1)
        n, n_points = membership.shape
        odds = max((alone + 1) / (n - alone + 1), NEW_POINT / (1 - NEW_POINT))
        pull: Array = prior @ mean
        track_alone = log_partition(information + prior, vector + pull) - log_partition(prior, pull)
        whole, sums = pooled(membership, information) + prior, pooled(membership, vector) + pull
        covariances = np.ascontiguousarray(np.linalg.inv(whole))
        means = np.einsum("pij,pj->pi", covariances, sums)
        others = np.asarray(membership.sum(axis=0), np.float64)
        found, counts = assign_tracks(
            order, tracks, information, vector, track_alone, np.ascontiguousarray(self._cameras),
            noise.white + noise.drift, FAR, float(np.log(n_points * odds)), hard,
            membership.indptr.astype(np.int64), membership.indices.astype(np.int64), membership.data,
            others, whole, sums, means, covariances, log_partition(whole, sums),
            pooled(membership, self._seen),
        )  # fmt: skip
        points, shares = found[:, 0].astype(np.int64), found[:, 1]
        own = np.repeat(order, counts[order])
        return csr_array((shares, (own, points)), shape=membership.shape)

    def _reassign(self) -> None:
        """Move tracks to the points that they fit best."""
        membership, noise = self._membership, self._noise()
        for _ in range(3):
            membership = self._assigned(membership, noise, hard=True)
        alone = np.diff(membership.indptr) == 0
        point = np.empty(len(alone), np.int64)
        point[~alone] = membership.indices
        point[alone] = membership.shape[1] + np.arange(np.count_nonzero(alone))
        self._regroup(point)

    def _regroup(self, point: Indices) -> None:
        """Renumber the points in the order of their first tracks, and fit again."""
        _, first, number = np.unique(point, return_index=True, return_inverse=True)
        self._point = np.argsort(np.argsort(first))[number]
        self._refit(certain(self._point, self._point.max() + 1))

    def _refit(self, membership: csr_array, iterations: int = ITERATIONS) -> None:
        positions, weights = pooled_positions(membership, self._positions, self._weights)
        self._membership = membership
        shape, spread = self._points_given_cameras(membership)
        self._fit = factorise(
            positions,
            weights,
            coherence=self._fit.coherent,
            iterations=iterations,
            start=replace(self._fit, shape=shape, shape_covariance=spread),
        )

    def _points_given_cameras(self, membership: csr_array) -> tuple[Array, Array]:
        information, vector, _, _ = self._white_noise.information(self._tracks, self._cameras)
        whole = np.eye(3) + pooled(membership, information)
        inverse = np.asarray(np.linalg.inv(whole), np.float64)
        shape: Array = np.einsum("pij,pj->pi", inverse, pooled(membership, vector))
        return shape, inverse

    # --- the end ---

    def soft_assignment(self) -> tuple[Factorisation, Indices]:
        """Let tracks belong to points in part, and leave out points that they do not determine."""
        noise = self._noise()
        for _ in range(SOFT_ROUNDS):
            membership = self._membership[:, self._determined(self._membership, noise)]
            membership = self._without_duplicates(membership, noise)
            membership = self._assigned(membership, noise, hard=False)
            self._refit(membership[:, membership.sum(axis=0) > 0.5])
        return self._result(noise)

    def _without_duplicates(self, membership: csr_array, noise: CorrelatedNoise) -> csr_array:
        """Memberships after points between which the same tracks are torn have become one."""
        information, vector, _, _ = noise.information(self._tracks, self._cameras)
        mean, covariance = self._population()
        prior = np.asarray(np.linalg.inv(covariance), np.float64)
        pull: Array = prior @ mean
        while True:
            shared = triu(membership.T @ membership, 1).tocoo()
            torn = shared.data > TORN
            first, second = shared.row[torn], shared.col[torn]
            whole, sums = pooled(membership, information), pooled(membership, vector)
            busy = pooled(membership, self._seen)
            alone = log_partition(whole + prior, sums + pull)
            together = log_partition(whole[first] + whole[second] + prior, sums[first] + sums[second] + pull)
            gains = together - alone[first] - alone[second] + log_partition(prior, pull)
            gains[(busy[first] * busy[second]).sum(axis=1) > 0.5] = -np.inf
            target, touched = np.arange(membership.shape[1]), np.zeros(membership.shape[1], bool)
            for k in np.argsort(-gains, kind="stable"):
                if gains[k] < self._log_new:
                    break
                if not touched[[first[k], second[k]]].any():
                    target[second[k]] = first[k]
                touched[[first[k], second[k]]] = True
            if not touched.any():
                return membership
            kept, number = np.unique(target, return_inverse=True)
            membership = membership @ certain(number, len(kept))

    def _determined(self, membership: csr_array, noise: CorrelatedNoise) -> NDArray[np.bool_]:
        """Whether tracks determine each point, in every frame."""
        information, _, _, _ = noise.information(self._tracks, self._cameras)
        _, covariance = self._population()
        whole = np.linalg.inv(covariance) + pooled(membership, information)
        rows = self._cameras[..., :3]
        variance = np.einsum("tcj,pjk,tck->tp", rows, np.linalg.inv(whole), rows, optimize=True)
        spread = np.einsum("tcj,jk,tck->t", rows, covariance, rows)
        known: NDArray[np.bool_] = (variance < DETERMINED**2 * spread[:, None]).all(axis=0)
        return known

    def _result(self, noise: CorrelatedNoise) -> tuple[Factorisation, Indices]:
        membership = self._membership
        point = membership.argmax(axis=1)
        sure = membership.max(axis=1).toarray() > SURE
        # of points that are alike tracks are never sure: the one with most information stays with its point
        anchors = membership.multiply(self._counts[:, None]).tocsr().argmax(axis=0)
        own = point[anchors] == np.arange(membership.shape[1])
        sure[anchors[own]] = True
        point = np.where(sure, point, -1)
        own &= self._determined(certain(point, membership.shape[1]), noise)
        point = np.where(sure & own[point], (np.cumsum(own) - 1)[point], -1)
        membership = membership[:, own]
        unsure = (point < 0) & (self._counts >= LEAST_VIEWS)
        alone = np.count_nonzero(np.bincount(point[point >= 0]) == 1)
        if alone + np.count_nonzero(unsure) > MOSTLY * len(point):
            # where most tracks are the only ones of their points, so is an unsure one
            n_points = membership.shape[1] + np.count_nonzero(unsure)
            point[unsure] = np.arange(membership.shape[1], n_points)
            membership = certain(point, n_points)
            self._fit = self._apart  # its cameras were fitted to all of them
        self._positions, self._weights = self._all
        self._refit(membership, LAST_ITERATIONS)
        return self._fit, point


def log_partition(information: Array, vector: Array) -> Array:
    """Return the log integral of exp(vector . x - x . information x / 2) over 3-D x, without log(2 pi)."""
    solved = np.linalg.solve(information, vector[..., None])[..., 0]
    result: Array = 0.5 * ((vector * solved).sum(axis=-1) - np.linalg.slogdet(information)[1])
    return result


def unite_points(
    mean: Array,
    covariance: Array,
    apart: NDArray[np.bool_],
    spread: Array,
    log_new: float,
    margin: float,
) -> Indices:
    """Take points for one, the surest first, and condition all others on it.

    Of the points' joint posterior, mean `(n, 3)` and covariance `(n, 3, n, 3)`. Points that are `apart` `(n,
    n)` are different for sure, and differ by a draw of covariance `spread` `(3, 3)`. A union has to be
    likelier than chance by `log_new`, and waits if another one that excludes it is likelier, or less likely
    by no more than `margin`. Returns for each point the smallest number of those that it is one with.
    """
    n = len(mean)
    mean, covariance, apart = mean.copy(), covariance.copy(order="C"), apart.copy()
    flat = covariance.reshape(3 * n, 3 * n)
    group, alive = np.arange(n), np.ones(n, bool)
    gains = np.empty((n, n))
    while True:
        same_point_gains(mean, covariance, apart | ~alive | ~alive[:, None], spread, gains)
        pairs = _unambiguous(gains, apart, log_new, margin)
        if not pairs:
            return group
        rows = np.concatenate([3 * i + np.arange(3) for i, _ in pairs])
        others = np.concatenate([3 * j + np.arange(3) for _, j in pairs])
        reach = flat[:, rows] - flat[:, others]
        between = reach[rows] - reach[others]
        between[np.diag_indices(len(rows))] += 1e-12 * np.trace(between) / len(rows)
        pull = np.linalg.solve(between, reach.T).T
        mean = (mean.reshape(-1) - pull @ (mean.reshape(-1)[rows] - mean.reshape(-1)[others])).reshape(n, 3)
        flat -= pull @ reach.T
        for i, j in pairs:
            group[group == j] = i
            alive[j] = False
            apart[i] |= apart[j]
            apart[:, i] |= apart[:, j]


def _unambiguous(
    gains: Array, apart: NDArray[np.bool_], log_new: float, margin: float
) -> list[tuple[int, int]]:
    """Unions to be made at once: no point is in two of them."""
    n = len(gains)
    first, second = np.nonzero(np.triu(gains > log_new, 1))
    order = np.argsort(-gains[first, second], kind="stable")
    touched = np.zeros(n, bool)
    pairs: list[tuple[int, int]] = []
    for k in order:
        i, j = int(first[k]), int(second[k])
        if touched[i] or touched[j]:
            continue
        rivals = [
            apart[there, close] | (gains[there, close] < 0)
            for here, there in ((i, j), (j, i))
            for close in [_close(gains[here], there, margin)]
        ]
        if any(each.any() for each in rivals):
            continue
        touched[i] = touched[j] = True
        pairs.append((i, j))
        if len(pairs) >= AT_ONCE * n:
            break
    return pairs


def _close(gains: Array, chosen: int, margin: float) -> Indices:
    """Others that are nearly as likely as the chosen one, or likelier."""
    near = gains > gains[chosen] - margin
    near[chosen] = False
    return np.flatnonzero(near).astype(np.int64)
