"""Speed of following points beside filterpy, simdkalman and OpenCV, all on one thread."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np
import simdkalman
from filterpy.kalman import KalmanFilter, rts_smoother
from numpy.typing import NDArray

from ....inference.kalman import PointStates, filter_tracks, kinematic, predict, smooth, update
from ....models.points.kernels.search import GRID, NEAR, REACH, WHOLE
from ....models.points.patches import sample_patches
from ....models.points.point_tracks import PointTracks
from ....models.points.search import Before, find_points
from ..expectations import Expectation
from ..experiment import Findings
from .timing import in_turns, over_rounds

Numbers = NDArray[np.float64]
Grey = NDArray[np.uint8]

N_POINTS = 500
N_FRAMES = 30
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
    """All of them, on one thread."""
    cv2.setNumThreads(1)
    return Findings("Points", [], [*kalman_expectations(), *search_expectations()])


# --- Kalman filter and smoother -----------------------------------------------------------------------------


def kalman_expectations() -> list[Expectation]:
    """Filter and smoother, per point and step, for points that are seen in all frames."""
    random = np.random.default_rng(0)
    places = random.normal(0, 2, (N_FRAMES, N_POINTS, 2)).cumsum(axis=0)
    times = FRAME * np.arange(N_FRAMES)
    information = np.broadcast_to(np.eye(2) / NOISE**2, (N_FRAMES, N_POINTS, 2, 2)).copy()
    vector = places / NOISE**2
    prior = PointStates.at_rest(places[0], FIRST**2, SPEED)

    def frame_by_frame() -> PointStates:
        states = prior
        for t in range(N_FRAMES):
            states = update(predict(states, FRAME, ACCELERATION), information[t], vector[t])
        return states

    filtered = filter_tracks(prior, times, information, vector, ACCELERATION)
    passed = [_filterpy_filter(places[:, k]) for k in range(N_POINTS)]
    spent = in_turns(
        {
            "frame by frame": frame_by_frame,
            "filter": lambda: filter_tracks(prior, times, information, vector, ACCELERATION),
            "smoother": lambda: smooth(filtered, times, ACCELERATION),
            "filterpy": lambda: [_filterpy_filter(places[:, k]) for k in range(N_POINTS)],
            "filterpy smoother": lambda: [_filterpy_smoother(*states) for states in passed],
            "simdkalman": lambda: _simdkalman(places),
        },
        rounds=7,
    )
    return over_rounds(_of_filters, spent)


def _of_filters(seconds: Mapping[str, float]) -> list[Expectation]:
    of = {name: 1e6 * value / (N_POINTS * N_FRAMES) for name, value in seconds.items()}
    one, whole, smoother = of["frame by frame"], of["filter"], of["smoother"]
    return [
        Expectation("Kalman filter frame by frame, us a point and step", one),
        Expectation("Kalman filter of whole tracks, us a point and step", whole),
        Expectation("RTS smoother, us a point and step", smoother),
        Expectation("filterpy over filter frame by frame", of["filterpy"] / one, ">=", 150),
        Expectation("filterpy over filter of whole tracks", of["filterpy"] / whole, ">=", 150),
        Expectation("simdkalman over filter frame by frame", of["simdkalman"] / one, ">=", 8),
        Expectation("simdkalman over filter of whole tracks", of["simdkalman"] / whole, ">=", 8),
        Expectation("filterpy's smoother over RTS smoother", of["filterpy smoother"] / smoother, ">=", 45),
    ]


def _moving(axes: int) -> tuple[Numbers, Numbers]:
    """Transition and its noise over a frame, positions before velocities."""
    transition, noise = kinematic(2, FRAME).along(axes)
    return transition, ACCELERATION * noise


def _filterpy_filter(places: Numbers) -> tuple[Numbers, Numbers]:
    """Means and covariances of one point seen at `(n_frames, 2)`."""
    one = KalmanFilter(dim_x=4, dim_z=2)
    one.x = np.array([*places[0], 0.0, 0.0])
    one.P = np.diag([FIRST**2, FIRST**2, SPEED**2, SPEED**2])
    one.H, one.R = np.eye(2, 4), NOISE**2 * np.eye(2)
    one.F, one.Q = _moving(2)
    means, covariances = np.empty((len(places), 4)), np.empty((len(places), 4, 4))
    for t, place in enumerate(places):
        one.predict()
        one.update(place)
        means[t], covariances[t] = one.x, one.P
    return means, covariances


def _filterpy_smoother(means: Numbers, covariances: Numbers) -> object:
    transition, noise = _moving(2)
    smoothed: object = rts_smoother(means, covariances, [transition] * len(means), [noise] * len(means))
    return smoothed


def _simdkalman(places: Numbers) -> object:
    """All points' x and y as series of their own, which is the faster way for it."""
    transition, noise = _moving(1)
    series = places.reshape(N_FRAMES, -1).T
    model = simdkalman.KalmanFilter(transition, noise, np.array([[1.0, 0.0]]), NOISE**2)
    result: object = model.compute(
        series,
        0,
        initial_value=np.stack([series[:, 0], np.zeros(len(series))], axis=1)[:, :, None],
        initial_covariance=np.diag([FIRST**2, SPEED**2]),
        filtered=True,
        smoothed=False,
    )
    return result


# --- search for patches -------------------------------------------------------------------------------------


def search_expectations() -> list[Expectation]:
    """Patches of corners, found in a picture that has moved a little, and found again in the one before.

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
    first: Grey, second: Grey, corners: NDArray[np.float32], reach: int, known: float
) -> dict[str, Callable[[], Numbers]]:
    """Ways there and back: from `first` to `second`, and from what is found back to `first`.

    Where points should be is known to `reach` px (three standard deviations), and wrong by `1 - known` of the
    way. Each gives places `(n, 2)` px, NaN where a point was not found.
    """
    origin = corners.astype(np.float64)
    expected = origin + known * SHIFT
    deviation = np.sqrt(((reach - 0.5) / REACH) ** 2 - GRID**2)
    covariances = np.tile(deviation**2 * np.eye(2), (len(corners), 1, 1))
    patches = sample_patches(first, origin, SIDE)
    before = Before(first, np.ones(len(corners), np.bool_), origin)
    node = PointTracks(patch=SIDE)

    def search() -> Numbers:
        found = find_points(second, patches, expected, covariances, node.false_alarms, node.farthest, before)
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
