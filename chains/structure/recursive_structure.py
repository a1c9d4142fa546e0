"""Structure from motion as a filtering chain: points of a rigid shape before a moving affine camera (§4.3).

The conclusion of the RSMCM paper claims this filter without giving it; what is here is ours, in constant time
per frame. `chains.structure.recursive` has its mathematics.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...inference.sfm.factor_analysis.em import homogeneous
from ...inference.sfm.factor_analysis.factorisation import Factorisation, factorise, projected
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import NOWHERE, PointMessage, PointTracks
from . import camera_motion
from .camera_motion import CameraMotion
from .recursive import (
    GATE,
    LEAST_SCALE,
    MEDIAN,
    PRIOR_DEVIATION,
    CameraEvidence,
    Identities,
    Numbers,
    ObservedPoints,
    Registration,
    Structure,
    add_points,
    camera_information,
    correlation_time,
    register,
    updated,
    wandering,
)

LEAST_SEEN = 6
"""Points that a frame has to show to be kept."""

LEAST_FRAMES = 3
"""Frames that have to show a point for it to be part of the first shape."""

FIRST_FRAMES, MOST_FRAMES, STEP = 8, 32, 4
"""Frames that are kept at the first attempt, at most, and from one attempt to the next."""

CLEAR = 4.0
"""How far the shape's third direction must stand out of what noise alone would give for one."""

UNEVEN = 3.0
"""Mean over usual squared error from which on there are outliers."""

TRIMMINGS = 4
"""Rounds in which outliers are dropped, at most."""

ROUNDS = 100
"""Of learning the noise of the camera's motion."""


@short_repr
@dataclass(frozen=True, eq=False)
class Window:
    """Frames and what they show; when there are too many, every other one is dropped.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing, of the points seen in them.
    positions
        `(n_frames, n, 2)` px, 0 where not seen.
    variances
        `(n_frames, n)` px^2, 0 where not seen.
    times
        `(n_frames,)` s.
    stride, skipped
        one of how many frames is kept, and how many were left out since the last.
    """

    identities: Identities
    positions: Numbers
    variances: Numbers
    times: Numbers
    stride: int = 1
    skipped: int = 0

    @classmethod
    def empty(cls) -> "Window":
        """No frames yet."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 0, 2)), np.zeros((0, 0)), np.zeros(0))

    def lengthened(self, seen: ObservedPoints, time: float, most_points: int) -> "Window":
        """With one more frame, if it is this one's turn; of too many points those seen most are kept."""
        if len(seen) < LEAST_SEEN:
            return self
        if self.skipped + 1 < self.stride:
            return replace(self, skipped=self.skipped + 1)
        every, stride = (2, 2 * self.stride) if len(self.times) == MOST_FRAMES else (1, self.stride)
        times = np.append(self.times[::every], time)
        identities = np.union1d(self.identities, seen.identities)
        positions = np.zeros((len(times), len(identities), 2))
        variances = np.zeros((len(times), len(identities)))
        old, new = (np.searchsorted(identities, part) for part in (self.identities, seen.identities))
        positions[:-1, old], variances[:-1, old] = self.positions[::every], self.variances[::every]
        positions[-1, new], variances[-1, new] = seen.positions, seen.variances
        counts = (variances > 0).sum(axis=0)
        kept = np.sort(np.argsort(-counts, kind="stable")[: min(most_points, np.count_nonzero(counts))])
        return Window(identities[kept], positions[:, kept], variances[:, kept], times, stride)

    @property
    def due(self) -> bool:
        """Whether it is time to try for a shape."""
        n_frames = len(self.times)
        return not self.skipped and n_frames >= FIRST_FRAMES and n_frames % STEP == 0


def first_structure(window: Window) -> Structure | None:
    """Shape and camera after the last frame, or `None` if the points' motion does not determine them.

    It does not if the camera stands still or the scene is flat: then one of the shape's three directions
    comes from noise alone, whose largest singular value is known.
    """
    seen = window.variances > 0
    points = seen.sum(axis=0) >= LEAST_FRAMES
    frames = seen[:, points].sum(axis=1) >= LEAST_SEEN
    if frames.sum() < FIRST_FRAMES:
        return None
    chosen = np.ix_(frames, points)
    positions, stated, seen = window.positions[chosen], window.variances[chosen], seen[chosen]
    times = window.times[frames]
    found, seen, is_clean = _factorised(positions, stated, seen)
    if not is_clean and len(window.times) < MOST_FRAMES:
        return None
    weights = np.divide(1, stated, out=np.zeros_like(stated), where=seen)
    scale = max(found.noise_variance, LEAST_SCALE)
    linear = found.cameras[:, :, :3]
    per_frame, per_point = seen.sum() / seen.shape[0], seen.sum() / seen.shape[1]
    third = np.sqrt(per_frame) * np.linalg.svd(linear.reshape(-1, 3), compute_uv=False)[2]
    by_chance = np.sqrt(scale * stated[seen].mean()) * (np.sqrt(2 * per_point) + np.sqrt(per_frame))
    if not third > CLEAR * by_chance:
        return None

    extent = float(np.sqrt(0.5 * (linear**2).sum() / len(linear)))
    precisions = weights / scale
    autocorrelation = _autocorrelation(found.cameras, found.shape, positions, seen)
    shape, covariance = _intersected(
        found.cameras, found.shape, positions, precisions, correlation_time(autocorrelation)
    )
    of_shape = np.einsum("tcj,ijk,tck->ti", linear, covariance, linear, optimize=True)
    points_and_one = homogeneous(shape)
    of_camera = [
        camera_information(points_and_one, where, precision / (1 + precision * noise))
        for where, precision, noise in zip(positions, precisions, of_shape, strict=True)
    ]
    information, vector = (np.array(parts) for parts in zip(*of_camera, strict=True))
    motion_noise = camera_motion.learned_noise(None, information, vector, times, extent, ROUNDS)
    motion = camera_motion.vague(extent, motion_noise)
    for k in range(len(times)):
        if k:
            motion = camera_motion.predict(motion, float(times[k] - times[k - 1]))
        motion = camera_motion.update(motion, information[k], vector[k])
    now = float(window.times[-1])
    if now > times[-1]:
        motion = camera_motion.predict(motion, now - float(times[-1]))
    last_seen = times[len(times) - 1 - np.argmax(seen[::-1], axis=0)]
    return Structure(
        identities=window.identities[points],
        shape=shape,
        shape_covariance=covariance,
        unseen=now - last_seen,
        motion=motion,
        evidence=CameraEvidence(information, vector, times),
        extent=extent,
        noise_scale=scale,
        innovations=np.zeros_like(shape[:, :2]),
        autocorrelation=autocorrelation ** (1 / window.stride),
        wander=wandering(autocorrelation, scale * stated[seen], float(np.median(np.diff(times)))),
    )


def _factorised(
    positions: Numbers, stated: Numbers, seen: NDArray[np.bool_]
) -> tuple[Factorisation, NDArray[np.bool_], bool]:
    """Shape and cameras, which observations are inliers, and whether these have errors of one size.

    Few frames can bend a shape to outliers, which then show in errors of very different size only.
    """
    for last in (*[False] * (TRIMMINGS - 1), True):
        weights = np.divide(1, stated, out=np.zeros_like(stated), where=seen)
        found = factorise(positions, weights)
        squares = weights * ((positions - projected(found.cameras, found.shape)) ** 2).sum(axis=2)
        usual = float(np.median(squares[seen])) / MEDIAN
        fits = seen & (squares <= GATE * usual)
        enough = (fits.sum(axis=1) >= LEAST_SEEN).all() and (fits.sum(axis=0) >= LEAST_FRAMES).all()
        if last or not enough or np.array_equal(fits, seen):
            break
        seen = fits
    return found, seen, found.noise_variance <= max(UNEVEN * usual, LEAST_SCALE)


def _autocorrelation(cameras: Numbers, shape: Numbers, positions: Numbers, seen: NDArray[np.bool_]) -> float:
    """Correlation of what points are off by, from one frame of the window to the next."""
    off = np.where(seen[:, :, None], positions - projected(cameras, shape), 0.0)
    both = (seen[1:] & seen[:-1])[:, :, None]
    squares = 0.5 * float(((off[1:] ** 2 + off[:-1] ** 2) * both).sum())
    return max(0.0, float((off[1:] * off[:-1]).sum()) / squares) if squares > 0 else 0.0


def _intersected(
    cameras: Numbers, shape: Numbers, positions: Numbers, precisions: Numbers, repeated: float
) -> tuple[Numbers, Numbers]:
    """Points `(n, 3)` and their covariances from all frames, each through the camera that the others show."""
    points = homogeneous(shape)
    of_frames = np.einsum("ti,ij,ik->tjk", precisions, points, points, optimize=True)
    leverage = np.einsum("ij,tjk,ik->ti", points, np.linalg.inv(of_frames), points, optimize=True)
    others = np.maximum(1 - precisions * leverage, 1e-6)  # without the point's share of its own camera
    weights = precisions / (repeated + precisions * leverage / others)
    linear = cameras[:, :, :3]
    information = np.einsum("ti,tcj,tck->ijk", weights, linear, linear, optimize=True)
    vector = np.einsum("ti,tcj,tic->ij", weights, linear, positions - cameras[:, None, :, 3], optimize=True)
    covariance = np.linalg.inv(information + np.eye(3) / PRIOR_DEVIATION**2)
    return (covariance @ vector[:, :, None])[:, :, 0], covariance


LOST = 0.5
"""Standard deviation of the camera, in extents of the shape's picture, from which on it is lost."""


@short_repr
@dataclass(frozen=True, eq=False)
class StructureState:
    """A shape and its camera, or what was seen until there is one.

    Parameters
    ----------
    time, elapsed
        s, of the state, and since the last frame that it was updated with.
    window
        frames that do not determine a shape yet.
    structure
        what is known; `None` as long as nothing is.
    """

    time: float
    elapsed: float
    window: Window
    structure: Structure | None


@short_repr
@dataclass(frozen=True)
class RecursiveStructure:
    """Rigid shape and camera motion, from the points that others track.

    The model, with rows m of the camera M_t, points S_i and features F_ti of RSMCM eq. (18) to (20):

        p(m_t, m_t', m_t'' | t - dt) = N(Taylor's polynomial over dt, Q(dt)),  p(S_i) = N(0, 3^2 I),
        p(F_ti | M_t, S_i) = N(M_t (S_i, 1), sigma_i^2 I).

    The message to a point is `N(M_-i (S_i, 1), P_i)` with `M_-i` the camera that the frame's other points
    show and P_i the covariance that this camera and S_i leave.

    Until the points' motion determines a shape the chain says nothing, so before a static camera, a flat
    scene, or fewer than six points it never does. Then it predicts every point that it knows, seen or not:
    from the camera that the other points of the frame show (its cavity), and where none is seen from the
    camera's motion. A camera that gets lost (other scene, nothing known in sight) is the end of the shape,
    and a new one begins.

    Parameters
    ----------
    patience
        s after which a point that is not seen is forgotten.
    most_points
        that are kept; those that were seen longest ago are forgotten first.
    """

    patience: float = 20.0
    most_points: int = 2000
    name: str = "structure"

    ports = (Port(PointTracks, Cavity.OTHERS),)

    def __post_init__(self) -> None:
        if not self.patience > 0:
            raise ValueError(f"patience: got {self.patience}, expected more than 0")
        if not self.most_points >= LEAST_SEEN:
            raise ValueError(f"most_points: got {self.most_points}, expected {LEAST_SEEN} or more")

    def initial(self, frame: Frame) -> StructureState:
        """Nothing known."""
        return StructureState(frame.time, 0.0, Window.empty(), None)

    def predict(self, state: StructureState, dt: float) -> StructureState:
        """The camera moves on, the shape stays."""
        structure = state.structure
        if structure is not None:
            motion = camera_motion.predict(structure.motion, dt)
            structure = replace(structure, motion=motion, unseen=structure.unseen + dt)
        return replace(state, time=state.time + dt, elapsed=state.elapsed + dt, structure=structure)

    def message(self, state: StructureState, feature: PointTracks, incoming: Incoming) -> PointMessage:
        """Where every known point should be (mu_{S -> F}); uniform as long as there is no shape.

        All points depend on one camera, which a message of independent points cannot hold: each gets its own
        marginal, given what its cavity says of the other points. What it says of the point itself is left
        out.
        """
        structure = state.structure
        if structure is None or not len(structure):
            return feature.uniform()
        found = incoming.once(_registered, structure, state, incoming[feature])
        return PointMessage(
            GaussianMessage.from_moments(structure.identities, found.means, found.covariances)
        )

    def update(self, state: StructureState, incoming: Incoming) -> StructureState:
        """Camera and points updated with the points that the frame shows."""
        others = incoming[PointTracks]
        seen, structure = _seen(state, others), state.structure
        if structure is not None:
            found = incoming.once(_registered, structure, state, others)
            if len(seen) < LEAST_SEEN or not _lost(found.motion, structure.extent):
                structure = updated(structure, found, state.elapsed, state.time)
                structure = self._remembered(add_points(structure, seen))
                return replace(state, elapsed=0.0, structure=structure)
        window = state.window.lengthened(seen, state.time, self.most_points)
        structure = first_structure(window) if window is not state.window and window.due else None
        window = window if structure is None else Window.empty()
        return StructureState(state.time, 0.0, window, structure)

    def _remembered(self, structure: Structure) -> Structure:
        """Without the points that were not seen for too long."""
        latest = np.argsort(structure.unseen, kind="stable")[: self.most_points]
        latest = latest[structure.unseen[latest] <= self.patience]
        return structure if len(latest) == len(structure) else structure.only(np.sort(latest))


def _seen(state: StructureState, others: PointMessage) -> ObservedPoints:
    """The points that the frame shows: where they were found, as sure as the message is of them.

    What the tracker expects of a point comes from frames that the shape has been fitted to as well, and from
    this chain's own messages. Counted as one more observation it would be such errors' own confirmation, so
    where the frame has a view, positions are those found in it; of both coordinates.
    """
    identities, positions, covariances = others.positions.moments
    variances = 0.5 * np.trace(covariances, axis1=1, axis2=2)
    if others.view is None:
        return ObservedPoints(identities, positions, variances)
    found = others.view.found
    if state.time - others.view.time > 0.5 * state.elapsed:  # a tracker's view of an earlier frame
        found = NOWHERE
    common, here, there = np.intersect1d(
        identities, found.identities, assume_unique=True, return_indices=True
    )
    whole = ~np.isnan(found.positions[there]).any(axis=1)
    common, here, there = common[whole], here[whole], there[whole]
    return ObservedPoints(common, found.positions[there], variances[here])


def _registered(structure: Structure, state: StructureState, others: PointMessage) -> Registration:
    return register(structure, _seen(state, others))


def _lost(motion: CameraMotion, extent: float) -> bool:
    return bool(motion.camera_covariance.diagonal()[:3].mean() > (LOST * extent) ** 2)
