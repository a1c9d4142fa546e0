"""Structure from motion as a filtering chain: points of a rigid shape before a moving affine camera (§4.3).

The conclusion of the RSMCM paper claims this filter without giving it; what is here is ours, in constant time
per frame. `chains.structure.recursive` has its mathematics.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.points.point_tracks import NOWHERE, PointMessage, PointTracks
from . import camera_motion, recursive
from .camera_motion import CameraMotion
from .recursive import ObservedPoints, Registration, Structure
from .recursive_start import LEAST_SEEN, Window, first_structure

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
                structure = recursive.update(structure, found, state.elapsed, state.time)
                structure = self._remembered(recursive.add_points(structure, seen))
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
    return recursive.register(structure, _seen(state, others))


def _lost(motion: CameraMotion, extent: float) -> bool:
    return bool(motion.camera_covariance.diagonal()[:3].mean() > (LOST * extent) ** 2)
