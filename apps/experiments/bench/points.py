"""Points beside filterpy and OpenCV, structure beside bundle adjustment, all on one thread."""

import statistics
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.optimize import least_squares as minimise
from scipy.sparse import csr_array

from ....inference.kalman import PointStates, filter_tracks, kinematic, predict, smooth, update
from ....inference.sfm.factor_analysis.factorisation import factorise
from ....models.points.patches import sample_patches
from ....models.points.point_tracks import PointTracks
from ....models.points.search import GRID, NEAR, REACH, WHOLE, PreviousView, find_points
from ..experiment import Findings
from ..record import Expectation
from .timing import in_turns, over_rounds

Numbers = NDArray[np.float64]
Grey = NDArray[np.uint8]

FOLLOWED = 500
STEPS = 30
FRAME = 1 / 25  # s
ACCELERATION = 100.0  # px^2/s^3
NOISE = 0.5  # px
FIRST, SPEED = 10.0, 100.0  # px and px/s: standard deviations of a new point

N_PATCHES = 300
SIDE = 5  # px
SHIFT = np.array([3.4, -2.7])  # px
REACHES = {3: 0.9, 10: 0.0}
"""px around the place where a point should be, and the share of its way that is known beforehand."""

LEVELS = {3: 1, 10: 2}
"""Levels of OpenCV's pyramid that reach as far with the same window, each twice as far as the one below."""


def points() -> Findings:
    """Measure all of them, on one thread."""
    cv2.setNumThreads(1)
    return Findings("Points", [], [*kalman_expectations(), *search_expectations()])


# --- Kalman filter and smoother -----------------------------------------------------------------------------


def kalman_expectations() -> list[Expectation]:
    """Measure filter and smoother, per point and step, for points that are seen in all frames."""
    random = np.random.default_rng(0)
    places = random.normal(0, 2, (STEPS, FOLLOWED, 2)).cumsum(axis=0)
    times = FRAME * np.arange(STEPS)
    information = np.broadcast_to(np.eye(2) / NOISE**2, (STEPS, FOLLOWED, 2, 2)).copy()
    vector = places / NOISE**2
    prior = PointStates.at_rest(places[0], FIRST**2, SPEED)

    def frame_by_frame() -> PointStates:
        states = prior
        for t in range(STEPS):
            states = update(predict(states, FRAME, ACCELERATION), information[t], vector[t])
        return states

    filtered = filter_tracks(prior, times, information, vector, ACCELERATION)
    arrays = [each.swapaxes(0, 1) for each in filtered.arrays]
    theirs = [(_filterpy_filter(places[:, k]), (arrays[0][k], arrays[1][k])) for k in range(FOLLOWED)]
    spent = in_turns(
        {
            "frame by frame": frame_by_frame,
            "filter": lambda: filter_tracks(prior, times, information, vector, ACCELERATION),
            "smoother": lambda: smooth(filtered, times, ACCELERATION),
            "filterpy": lambda: [_filterpy_filter(places[:, k]) for k in range(FOLLOWED)],
            "filterpy's smoother": lambda: [one.rts_smoother(*states) for one, states in theirs],
        },
        rounds=7,
    )
    return over_rounds(_of_filters, spent)


def _of_filters(seconds: Mapping[str, float]) -> list[Expectation]:
    of = {name: 1e6 * value / (FOLLOWED * STEPS) for name, value in seconds.items()}
    one, whole, smoother = of["frame by frame"], of["filter"], of["smoother"]
    return [
        Expectation("Kalman filter frame by frame, us a point and step", one),
        Expectation("Kalman filter of whole tracks, us a point and step", whole),
        Expectation("RTS smoother, us a point and step", smoother),
        Expectation("filterpy over filter frame by frame", of["filterpy"] / one, ">=", 150),
        Expectation("filterpy over filter of whole tracks", of["filterpy"] / whole, ">=", 150),
        Expectation("filterpy's smoother over RTS smoother", of["filterpy's smoother"] / smoother, ">=", 100),
    ]


def _filterpy_filter(places: Numbers) -> KalmanFilter:
    """Filter one point seen at `(n_frames, 2)`."""
    one = KalmanFilter(dim_x=4, dim_z=2)
    one.x = np.array([*places[0], 0.0, 0.0])
    one.P = np.diag([FIRST**2, FIRST**2, SPEED**2, SPEED**2])
    one.H, one.R = np.eye(2, 4), NOISE**2 * np.eye(2)
    one.F, noise = kinematic(2, FRAME).along(2)  # positions before velocities
    one.Q = ACCELERATION * noise
    for place in places:
        one.predict()
        one.update(place)
    return one


# --- search for patches -------------------------------------------------------------------------------------


def search_expectations() -> list[Expectation]:
    """Measure the search of corners' patches in a picture that has moved a little, and back.

    The search is the tracker's, there and back: once for points that it has followed for a while, and once
    for new ones, which may be anywhere in a wide window. OpenCV has the same window, and a pyramid that
    reaches as far.
    """
    first, second = _pictures()
    found = cv2.goodFeaturesToTrack(first, 2 * N_PATCHES, 1e-3, 6)[:, 0]
    rim = max(REACHES) + SIDE
    kept = ((found > rim) & (found < np.array(first.shape[::-1]) - rim - 1)).all(axis=1)
    corners = found[kept][:N_PATCHES].astype(np.float32)
    expectations: list[Expectation] = []
    for reach, known in REACHES.items():
        searches = _searches(first, second, corners, reach, known)
        what = f"search for {len(corners)} patches there and back, +-{reach} px"
        expectations += over_rounds(partial(_of_searches, what), in_turns(searches, rounds=10, turn=8))
        for name, search in searches.items():
            off = np.linalg.norm(search() - corners - SHIFT, axis=1)
            share = float((off < 0.5).mean())
            expectations.append(Expectation(f"{name}, +-{reach} px: found within 0.5 px, share", share))
    return expectations


def _of_searches(what: str, seconds: Mapping[str, float]) -> list[Expectation]:
    return [
        Expectation(f"{what}, ms", 1e3 * seconds["search"]),
        Expectation(f"{what}, over PyrLK", seconds["search"] / seconds["PyrLK"], "<=", 0.7),
    ]


def _searches(
    first: Grey, second: Grey, corners: NDArray[np.float32], reach: int, predicted_share: float
) -> dict[str, Callable[[], Numbers]]:
    """Ways there and back: from `first` to `second`, and from what is found back to `first`.

    Where points should be is known to `reach` px (three standard deviations), and wrong by `1 - known` of the
    way. Each gives places `(n, 2)` px, NaN where a point was not found.
    """
    origin = corners.astype(np.float64)
    expected = origin + predicted_share * SHIFT
    deviation = np.sqrt(((reach - 0.5) / REACH) ** 2 - GRID**2)
    covariances = np.tile(deviation**2 * np.eye(2), (len(corners), 1, 1))
    patches = sample_patches(first, origin, SIDE)
    before = PreviousView(first, np.ones(len(corners), np.bool_), origin)
    node = PointTracks(patch_size=SIDE)

    def search() -> Numbers:
        found = find_points(
            second, patches, expected, covariances, node.false_alarm_rate, node.search_radius, before
        )
        places = np.full(expected.shape, np.nan)
        places[found.seen] = found.position
        return places

    def optical_flow() -> Numbers:
        window: Any = {"winSize": (SIDE, SIDE), "maxLevel": LEVELS[reach]}
        found, there, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, np.empty_like(corners), **window)
        again, back, _ = cv2.calcOpticalFlowPyrLK(second, first, found, np.empty_like(corners), **window)
        right = (there.astype(np.bool_) & back.astype(np.bool_))[:, 0] & (
            np.abs(again - corners).max(axis=1) <= NEAR + WHOLE
        )
        return np.where(right[:, None], found.astype(np.float64), np.nan)

    return {"search": search, "PyrLK": optical_flow}


def _pictures() -> tuple[Grey, Grey]:
    """Texture of 640x480 px, and the same moved by `SHIFT`, with noise."""
    random = np.random.default_rng(1)
    noise = random.normal(size=(480, 640))
    blurred = [scale * cv2.GaussianBlur(noise, (0, 0), scale) for scale in (1.5, 4.0, 10.0)]
    texture = 60 * np.sum(blurred, axis=0)
    shift = np.column_stack([np.eye(2), SHIFT])
    moved = cv2.warpAffine(texture, shift, (640, 480), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    first, second = (
        np.clip(128 + picture + random.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
        for picture in (texture, moved)
    )
    return first, second


# --- structure ----------------------------------------------------------------------------------------------

N_FRAMES, N_POINTS = 300, 2000
SAME = 5e-6  # relative difference of errors that agree to five digits


def structure() -> Findings:
    """Compare start and polish with bundle adjustment, which is given a start."""
    expectations = []
    for length, bound in ((N_FRAMES, 10.0), (60, None)):
        positions = turning_points(N_FRAMES, N_POINTS, length)
        found = factorise(positions)
        ours = statistics.median(in_turns({"ours": partial(factorise, positions)}, 3)["ours"])
        generator = np.random.default_rng(1)
        near = found.cameras + 50 * generator.normal(size=found.cameras.shape)
        shape = found.shape + 0.5 * generator.normal(size=found.shape.shape)
        started = time.perf_counter()
        error = bundle_adjustment(positions, near, shape)
        theirs = time.perf_counter() - started
        seen = f"{N_FRAMES} x {N_POINTS}, {'all' if length == N_FRAMES else f'{length} frames a point'}"
        expectations += [
            Expectation(f"{seen}: a solve from nothing, s", ours),
            Expectation(f"{seen}: bundle adjustment, given a start, over that", theirs / ours, ">=", bound),
            Expectation(f"{seen}: error over that of bundle adjustment", found.rmse / error, "<=", 1 + SAME),
        ]
    return Findings("Structure", [], expectations)


def turning_points(n_frames: int, n_points: int, length: int, seed: int = 0) -> Numbers:
    """Return positions `(n_frames, n_points, 2)` px of points before a turning camera; NaN where not seen.

    Noise is 1 px. Each point is seen through `length` frames in a row, fewer at both ends.
    """
    generator = np.random.default_rng(seed)
    shape = 100 * generator.normal(size=(n_points, 3))
    angle = np.linspace(0, n_frames / 50, n_frames)
    cameras = np.zeros((n_frames, 2, 3))
    cameras[:, 0, 0], cameras[:, 0, 2] = np.cos(angle), np.sin(angle)
    cameras[:, 1, 1], cameras[:, 1, 0] = 1.0, 0.3 * np.sin(angle)
    positions: Numbers = (
        300 + np.einsum("tcj,ij->tic", cameras, shape) + generator.normal(size=(n_frames, n_points, 2))
    )
    if length < n_frames:
        first = generator.integers(-length // 2, n_frames - length // 2, n_points)
        times = np.arange(n_frames)[:, None]
        positions[(times < first) | (times >= first + length)] = np.nan
    return positions


def bundle_adjustment(positions: Numbers, cameras: Numbers, shape: Numbers) -> float:
    """Return the root mean square error (px) of joint least squares over all cameras and points.

    Sparse analytic Jacobian, trust region with LSMR (`scipy.optimize.least_squares`).
    """
    n_frames, n_points = positions.shape[:2]
    frame, point = np.nonzero(~np.isnan(positions[..., 0]))
    seen, count = positions[frame, point], len(frame)
    split = 8 * n_frames
    of_camera = 8 * frame[:, None, None] + 4 * np.arange(2)[:, None] + np.arange(4)
    of_point = np.repeat(split + 3 * point[:, None, None] + np.arange(3), 2, axis=1)
    columns = np.concatenate([of_camera, of_point], axis=2).reshape(-1)
    edges = 7 * np.arange(2 * count + 1)

    def parts(numbers: Numbers) -> tuple[Numbers, Numbers]:
        return numbers[:split].reshape(n_frames, 2, 4)[frame], numbers[split:].reshape(n_points, 3)[point]

    def residuals(numbers: Numbers) -> Numbers:
        matrices, places = parts(numbers)
        errors: Numbers = np.einsum("ncj,nj->nc", matrices[..., :3], places) + matrices[..., 3] - seen
        return errors.reshape(-1)

    def jacobian(numbers: Numbers) -> csr_array:
        matrices, places = parts(numbers)
        rows = np.empty((count, 2, 7))
        rows[..., :3], rows[..., 3], rows[..., 4:] = places[:, None], 1.0, matrices[..., :3]
        return csr_array((rows.reshape(-1), columns, edges), shape=(2 * count, split + 3 * n_points))

    found = minimise(
        residuals,
        np.concatenate([cameras.reshape(-1), shape.reshape(-1)]),
        jac=jacobian,
        method="trf",
        tr_solver="lsmr",
        x_scale="jac",
        ftol=1e-8,
        max_nfev=60,
    )
    return float(np.sqrt(np.mean(found.fun**2)))
