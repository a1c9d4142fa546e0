"""Filter and smoother of many points against filterpy, and against one dense Gaussian over all frames."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.inference.kalman import PointStates, cavity, filter_tracks, predict, smooth, update

Numbers = NDArray[np.float64]

SEES = np.eye(2, 4)


def moving(dt: float) -> Numbers:
    return np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])


def motion_noise(dt: float, acceleration: float) -> Numbers:
    """Covariance of what white acceleration adds in `dt` s."""
    return acceleration * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))


class Tracks:
    """Points that wander, seen with covariances of any direction; many are not seen in many frames."""

    def __init__(self, seed: int, n_frames: int = 12, n_points: int = 37, seen: float = 0.7) -> None:
        random = np.random.default_rng(seed)
        self.times = np.cumsum(random.uniform(0.01, 0.3, n_frames))
        self.acceleration = random.uniform(1, 500, n_points)
        roots = random.normal(size=(n_frames, n_points, 2, 2))
        self.noise = roots @ roots.transpose(0, 1, 3, 2) + 0.05 * np.eye(2)
        self.seen = random.random((n_frames, n_points)) < seen
        self.places = random.uniform(0, 300, (n_points, 2)) + random.normal(0, 5, (n_frames, n_points, 2))
        self.information = np.where(self.seen[:, :, None, None], np.linalg.inv(self.noise), 0.0)
        self.vector = (self.information @ self.places[..., None])[..., 0]
        roots = random.normal(size=(n_points, 4, 4)) * [[3.0], [3.0], [20.0], [20.0]]
        self.prior = PointStates(random.normal(100, 50, (n_points, 4)), roots @ roots.transpose(0, 2, 1))

    def filtered(self) -> PointStates:
        return filter_tracks(self.prior, self.times, self.information, self.vector, self.acceleration)


def by_filterpy(tracks: Tracks, point: int) -> tuple[KalmanFilter, Numbers, Numbers, list[Numbers]]:
    """One point's filter, with filtered means and covariances and the noise of each step into a frame."""
    one = KalmanFilter(dim_x=4, dim_z=2)
    one.x, one.P, one.H = tracks.prior.mean[point].copy(), tracks.prior.covariance[point].copy(), SEES
    means, covariances, steps = [], [], []
    for t, time in enumerate(tracks.times):
        dt = time - tracks.times[t - 1] if t else 0.0
        one.F, one.Q = moving(dt), motion_noise(dt, tracks.acceleration[point])
        steps.append(one.Q)
        one.predict()
        one.update(tracks.places[t, point] if tracks.seen[t, point] else None, R=tracks.noise[t, point])
        means.append(one.x.copy())
        covariances.append(one.P.copy())
    return one, np.array(means), np.array(covariances), steps


def test_filter_and_smoother_equal_filterpy() -> None:
    tracks = Tracks(0)
    filtered = tracks.filtered()
    smoothed = smooth(filtered, tracks.times, tracks.acceleration)
    for point in range(0, 37, 4):
        one, means, covariances, steps = by_filterpy(tracks, point)
        np.testing.assert_allclose(filtered.mean[:, point], means, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(filtered.covariance[:, point], covariances, rtol=1e-9, atol=1e-9)
        ways = [moving(dt) for dt in np.diff(tracks.times, prepend=tracks.times[0])]
        means, covariances, _, _ = one.rts_smoother(means, covariances, Fs=ways, Qs=steps)
        np.testing.assert_allclose(smoothed.mean[:, point], means, rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(smoothed.covariance[:, point], covariances, rtol=1e-9, atol=1e-8)


def joint(tracks: Tracks, point: int, without: int | None = None) -> tuple[Numbers, Numbers]:
    """Means `(n_frames, 4)` and covariances of one point's states, by one Gaussian over all of them."""
    n_frames = len(tracks.times)
    mean, covariance = tracks.prior.mean[point], tracks.prior.covariance[point]
    information, vector = np.zeros((4 * n_frames, 4 * n_frames)), np.zeros(4 * n_frames)
    for t in range(n_frames):
        if t:
            dt = tracks.times[t] - tracks.times[t - 1]
            step = np.zeros((4, 4 * t))
            step[:, -4:] = moving(dt)
            new = step @ covariance @ step.T + motion_noise(dt, tracks.acceleration[point])
            mean = np.concatenate([mean, step @ mean])
            covariance = np.block([[covariance, covariance @ step.T], [step @ covariance, new]])
        if t != without:
            information[4 * t : 4 * t + 2, 4 * t : 4 * t + 2] = tracks.information[t, point]
            vector[4 * t : 4 * t + 2] = tracks.vector[t, point]
    # (covariance^-1 + information)^-1 without either inverse, which may not be there
    after = np.linalg.solve(np.eye(4 * n_frames) + covariance @ information, covariance)
    mean = mean + after @ (vector - information @ mean)
    blocks = after.reshape(n_frames, 4, n_frames, 4)[range(n_frames), :, range(n_frames)]
    return mean.reshape(n_frames, 4), blocks


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.3, 1.0]))
def test_smoother_and_cavity_equal_a_dense_gaussian(seed: int, seen: float) -> None:
    tracks = Tracks(seed, n_frames=6, n_points=2, seen=seen)
    smoothed = smooth(tracks.filtered(), tracks.times, tracks.acceleration)
    means, covariances = joint(tracks, 1)
    np.testing.assert_allclose(smoothed.mean[:, 1], means, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(smoothed.covariance[:, 1], covariances, rtol=1e-7, atol=1e-7)
    information, vector = cavity(smoothed, tracks.information, tracks.vector)
    for t in range(6):
        means, covariances = joint(tracks, 1, without=t)
        covariance = np.linalg.inv(information[t, 1])
        np.testing.assert_allclose(covariance, covariances[t, :2, :2], rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(covariance @ vector[t, 1], means[t, :2], rtol=1e-6, atol=1e-6)


def test_frame_by_frame_is_the_same_as_all_at_once() -> None:
    tracks = Tracks(1)
    filtered, states = tracks.filtered(), tracks.prior
    for t, dt in enumerate(np.diff(tracks.times, prepend=tracks.times[0])):
        if t:
            states = predict(states, dt, tracks.acceleration)
        states = update(states, tracks.information[t], tracks.vector[t])
        # equal but for the order of multiplications and additions
        np.testing.assert_allclose(states.mean, filtered.mean[t], rtol=1e-11)
        np.testing.assert_allclose(states.covariance, filtered.covariance[t], rtol=1e-10, atol=1e-10)


def test_points_with_times_of_their_own_are_as_one_by_one() -> None:
    tracks = Tracks(2)
    times = np.cumsum(np.random.default_rng(2).uniform(0.01, 0.3, (12, 37)), axis=0)
    noise = tracks.acceleration
    filtered = filter_tracks(tracks.prior, times, tracks.information, tracks.vector, noise)
    smoothed = smooth(filtered, times, noise)
    for point in range(0, 37, 6):
        one = slice(point, point + 1)
        prior = PointStates(tracks.prior.mean[one], tracks.prior.covariance[one])
        measured = tracks.information[:, one], tracks.vector[:, one]
        alone = filter_tracks(prior, times[:, point], *measured, noise[one])
        alone = smooth(alone, times[:, point], noise[one])
        np.testing.assert_allclose(smoothed.mean[:, one], alone.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(smoothed.covariance[:, one], alone.covariance, rtol=1e-9, atol=1e-9)


def test_measurements_of_one_direction_only() -> None:
    states = PointStates.at_rest([[10.0, 20.0]], 4.0, 3.0)
    along = np.array([0.6, 0.8])
    after = update(states, 100 * np.outer(along, along)[None], 100 * 25.0 * along[None])
    gain = 4 / (4 + 0.01)
    np.testing.assert_allclose(after.position[0], [10, 20] + gain * (25 - 22) * along, rtol=1e-12)
    spread = 4 * np.eye(2) - 4 * gain * np.outer(along, along)
    np.testing.assert_allclose(after.position_covariance[0], spread, rtol=1e-9)


EXTREMES = [1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12]


def smallest_eigenvalue(covariance: Numbers) -> float:
    """Smallest one of all, diagonals scaled to 1; it is negative where a covariance is none."""
    size = np.sqrt(covariance.diagonal(axis1=-2, axis2=-1))
    return float(np.linalg.eigvalsh(covariance / (size[..., :, None] * size[..., None, :])).min())


def measured(strong: float, weak: float, angle: float) -> tuple[Numbers, Numbers]:
    """A point that stands at (300, 200), in eight frames, not in all of them."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    information = turn @ np.diag([strong, weak]) @ turn.T
    information = np.tile(0.5 * (information + information.T), (8, 1, 1, 1))
    information[2] = information[5] = 0
    information[3] *= 1e-6
    return information, information @ [300.0, 200.0]


@given(
    st.sampled_from(EXTREMES),
    st.sampled_from(EXTREMES),
    st.sampled_from(EXTREMES),
    st.sampled_from(EXTREMES),
    st.floats(0, np.pi),
    st.sampled_from([0.0, 1e-9, 1.0, 1e9]),
    st.sampled_from([1e-6, 0.04, 1e3]),
)
def test_filtered_covariances_stay_positive_definite(
    variance: float, speed: float, strong: float, weak: float, angle: float, acceleration: float, dt: float
) -> None:
    prior = PointStates.at_rest([[0.0, 0.0]], variance, speed)
    filtered = filter_tracks(prior, dt * np.arange(8), *measured(strong, weak, angle), acceleration)
    assert np.isfinite(filtered.mean).all()
    np.testing.assert_array_equal(filtered.covariance, filtered.covariance.mT)
    assert smallest_eigenvalue(filtered.covariance) > 0


@given(
    st.sampled_from([1e-4, 1.0, 1e3, 1e8]),
    st.sampled_from([0.1, 10.0, 1e3]),
    st.sampled_from([1e-4, 1e-2, 1.0, 1e2, 1e4]),
    st.sampled_from([1e-4, 1e-2, 1.0, 1e2, 1e4]),
    st.floats(0, np.pi),
    st.sampled_from([1e-2, 1.0, 1e3, 1e6]),
    st.sampled_from([1e-3, 0.04, 1.0]),
)
def test_smoothed_covariances_are_positive_definite_and_smaller(
    variance: float, speed: float, strong: float, weak: float, angle: float, acceleration: float, dt: float
) -> None:
    information, vector = measured(strong, weak, angle)
    times, prior = dt * np.arange(8), PointStates.at_rest([[0.0, 0.0]], variance, speed)
    filtered = filter_tracks(prior, times, information, vector, acceleration)
    smoothed = smooth(filtered, times, acceleration)
    assert np.isfinite(smoothed.mean).all()
    np.testing.assert_array_equal(smoothed.covariance, smoothed.covariance.mT)
    assert smallest_eigenvalue(smoothed.covariance) > 0
    # a point that moves by 1e5 of its measurements' deviations in a step costs all but two digits
    variances = (states.covariance.diagonal(axis1=-2, axis2=-1) for states in (smoothed, filtered))
    assert (next(variances) <= 1.05 * next(variances)).all()
    others, _ = cavity(smoothed, information, vector)
    assert (np.linalg.eigvalsh(others) >= 0).all()


def test_no_points() -> None:
    none = PointStates.at_rest(np.zeros((0, 2)), 1.0, 1.0)
    assert predict(none, 0.1, 1.0).mean.shape == (0, 4)
    filtered = filter_tracks(none, [0.0, 0.1], np.zeros((2, 0, 2, 2)), np.zeros((2, 0, 2)), 1.0)
    assert smooth(filtered, [0.0, 0.1], 1.0).covariance.shape == (2, 0, 4, 4)


def test_bad_arguments_are_named() -> None:
    states = PointStates.at_rest(np.zeros((3, 2)), 1.0, 1.0)
    told, weighted = np.zeros((3, 2, 2)), np.zeros((3, 2))
    with pytest.raises(ValueError, match=r"dt: got -0\.1 s"):
        predict(states, -0.1, 1.0)
    with pytest.raises(ValueError, match=r"acceleration: got \(2,\)"):
        predict(states, 0.1, np.ones(2))
    with pytest.raises(ValueError, match=r"information \(2, 2, 2\)"):
        update(states, told[:2], weighted)
    with pytest.raises(ValueError, match="times: got"):
        filter_tracks(states, [0.1, 0.0], np.stack([told] * 2), np.stack([weighted] * 2), 1.0)
    with pytest.raises(ValueError, match="states: got mean"):
        smooth(states, [0.0], 1.0)
    filtered = filter_tracks(states, [0.0], told[None], weighted[None], 1.0)
    with pytest.raises(ValueError, match="times: got 2 for states in 1"):
        smooth(filtered, [0.0, 1.0], 1.0)
