"""Cost of following points, and of finding a shape, over points and observations; one thread."""

import time
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ....chains.points.point_tracker import PointTracker
from ....chains.structure.track_association import associate_tracks
from ....inference import MultiChain, RecursiveBP, RunState
from ....inference.sfm.factor_analysis.em import Posterior, expectation_maximisation
from ....inference.sfm.factor_analysis.factorisation import around_start
from ....inference.sfm.factor_analysis.observations import Indices, Listed, Numbers, Observations
from ....models import Frame
from ....models.points.point_tracks import PointTracks
from ..bench.structure import turning_points
from ..bench.timing import in_turns
from ..measuring.machine import moving, multiplying
from ..measuring.stages import n_bytes
from .curve import Curve, Measured

Grey = NDArray[np.uint8]

POINTS = (100, 1000, 10_000, 100_000)
SIDE = 2560
"""px, of a picture that has corners for all of them."""

SPACING, PATCH = 4.0, 5  # px
ROUNDS, WARM_UP = 7, 3
SHIFT = (1.4, -0.7)
"""px from frame to frame."""

PLACES, WAYS = 9, 2
"""At which a patch is compared at the least, there and back."""

OBSERVATIONS = (10**3, 10**4, 10**5, 10**6, 10**7)
LENGTH = 30
"""Frames in which a point is seen."""

TRACKS = (250, 500, 1000, 2000)
PIECES, PIECE = 4, 15
"""Tracks of a point, and frames of each."""

PATIENCE = 3.0
"""s, after which a size has had enough rounds."""

FEW, MORE = 2, 7
"""Iterations: what is timed is the difference."""

BYTES_READ = 64
"""Of an observation, for cameras and for points: place, weight, and number of the other side."""


def over_points() -> list[Curve]:
    """The tracker of points, with its search there and back."""
    points = []
    texture = _texture(SIDE + 64)
    frames = [
        Frame(_moved(texture, number), number / 25, number) for number in range(1, WARM_UP + ROUNDS + 1)
    ]
    for count in POINTS:
        tracker = PointTracker(n_points=count, spacing=SPACING)
        engine, state, seconds = (
            RecursiveBP(MultiChain().connect(tracker, PointTracks(patch=PATCH))),
            RunState(),
            [],
        )
        for frame in frames:
            started = time.perf_counter()
            state = engine.step(state, frame).state
            seconds.append(time.perf_counter() - started)
        of_tracker = state.states[tracker.name]
        followed = int(of_tracker.known.alive.sum())
        held = n_bytes(of_tracker.known)
        products = 2.0 * WAYS * PLACES * PATCH**2 * followed
        limit = max(moving(2 * held + SIDE**2), multiplying(products))
        points.append(Measured.of(followed, seconds[WARM_UP:], limit, held))
    return [Curve(f"tracker of points, {SIDE}x{SIDE}", "points", points)]


def _texture(side: int) -> Grey:
    noise = np.random.default_rng(0).standard_normal((side, side), np.float32)
    picture = sum(scale * cv2.GaussianBlur(noise, (0, 0), scale) for scale in (1.0, 3.0))
    return np.asarray(np.clip(128 + 60 * np.asarray(picture), 0, 255), np.uint8)


def _moved(texture: Grey, number: int) -> Grey:
    shift = np.array([[1.0, 0.0, number * SHIFT[0]], [0.0, 1.0, number * SHIFT[1] + 32]])
    moved = cv2.warpAffine(texture, shift, (SIDE, SIDE), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(moved, np.uint8)


def over_observations() -> list[Curve]:
    """An iteration of EM, of tracks of 30 frames each."""
    points = []
    for count in OBSERVATIONS:
        observations, start = turning(count)
        steps = {str(n): partial(_iterations, observations, start, n) for n in (FEW, MORE)}
        spent = in_turns(steps, ROUNDS)
        each = (np.array(spent[str(MORE)]) - spent[str(FEW)]) / (MORE - FEW)
        held = n_bytes(observations)
        limit = moving(BYTES_READ * observations.count)
        points.append(Measured.of(observations.count, each.tolist(), limit, held))
    return [Curve("an iteration of EM", "observations", points)]


def _iterations(observations: Observations, start: Posterior, count: int) -> object:
    return expectation_maximisation(observations, start, iterations=count, tolerance=-np.inf)


def over_tracks() -> list[Curve]:
    """Which tracks show one point: robust factor analysis, association, and what is read of both."""
    points = []
    associate_tracks(broken_tracks(TRACKS[0]))  # loads what is compiled
    for count in TRACKS:
        positions, seconds = broken_tracks(count), list[float]()
        while len(seconds) < ROUNDS and sum(seconds) < PATIENCE:
            started = time.perf_counter()
            associate_tracks(positions)
            seconds.append(time.perf_counter() - started)
        seen = int(np.count_nonzero(~np.isnan(positions[..., 0])))
        points.append(Measured.of(count, seconds, moving(BYTES_READ * seen)))
    return [Curve("association", "tracks", points)]


def broken_tracks(count: int) -> Numbers:
    """Positions `(n_frames, count, 2)` px of points that are each followed in four pieces, NaN between."""
    n_frames, n_points = PIECES * PIECE, count // PIECES
    positions = turning_points(n_frames, n_points, n_frames)
    begun = np.random.default_rng(0).integers(0, PIECE, n_points)
    piece, since = np.divmod(np.arange(n_frames)[:, None] + begun, PIECE)
    frame, point = np.nonzero((piece < PIECES) & (since > 0))  # lost for a frame
    broken = np.full((n_frames, PIECES * n_points, 2), np.nan)
    broken[frame, point + n_points * piece[frame, point]] = positions[frame, point]
    return broken


def turning(count: int) -> tuple[Observations, Posterior]:
    """So many observations of points before a turning camera, and where EM begins, near the truth.

    Positions are in units of their spread already; they are made as lists, without a table of all frames and
    points.
    """
    generator = np.random.default_rng(0)
    n_frames, n_points = max(40, round(np.sqrt(count) / 2)), count // LENGTH
    shape = generator.standard_normal((n_points, 3))
    angle = np.linspace(0, n_frames / 50, n_frames)
    cameras = np.zeros((n_frames, 2, 4))
    cameras[:, 0, 0], cameras[:, 0, 2], cameras[:, 1, 1] = np.cos(angle), np.sin(angle), 1.0
    first = generator.integers(0, n_frames - LENGTH, n_points, endpoint=True)
    point = np.repeat(np.arange(n_points), LENGTH)
    frame = np.repeat(first, LENGTH) + np.tile(np.arange(LENGTH), n_points)
    listed = Listed.sorted_by(
        point, n_points, frame, *_seen(cameras, shape, frame, point), np.ones(len(point))
    )
    by_frame = listed.transposed(n_frames)
    observations = Observations(by_frame, listed, np.zeros(2), 1.0, 1.0)
    near = shape + 0.1 * generator.standard_normal(shape.shape)
    all_frames, all_points = np.ones(n_frames, np.bool_), np.ones(n_points, np.bool_)
    return observations, around_start(observations, cameras, near, all_frames, all_points, coherent=False)


def _seen(cameras: Numbers, shape: Numbers, frame: Indices, point: Indices) -> tuple[Numbers, Numbers]:
    """Coordinates of points in frames, with noise."""
    generator = np.random.default_rng(1)
    x, y = (
        np.einsum("nj,nj->n", cameras[frame, row, :3], shape[point])
        + 0.01 * generator.standard_normal(len(frame))
        for row in range(2)
    )
    return x, y
