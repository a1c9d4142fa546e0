"""A camera that shakes about where it looks, as a chain: by which map each frame shows the scene.

Of the map p_t (six numbers, px; see `AffineMap`) and the scene's picture:

    p(p_t | p_t-1) = N(p_t; e^(-dt / time) p_t-1, (1 - e^(-2 dt / time)) reach^2)   (Ornstein-Uhlenbeck)
    mu_{C -> F}(p) = N(p; predicted), together with the picture by which the frame is found

The pixels' evidence registers the frame with that picture and returns the likelihood of the map; with it
the image is the scene's, so that all other chains of the pixels see a camera that stands still. The
picture is updated where their messages expect background alone: objects that stand for long do not steer it.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...inference.engine.generic_chains import LinearGaussianChain, LinearGaussianState
from ...inference.engine.protocols import Incoming, Port
from ...models.camera.moving_camera import UNKNOWNS, AffineMap, View
from ...models.core.checks import Positive, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.pixels.pixel_labels import PixelMessage, ScenePixels

PICTURE_TIME = 10.0
"""s in which the scene's picture follows what is seen of the background: long, since each frame is put where
the picture is, so that what errors of many frames have in common would move it."""

FIRST_VARIANCE = 1e-6  # px^2: the first frame is the scene's picture, by definition

BEYOND = 2.0  # standard deviations of the camera's motion, which it exceeds only by leaving the scene

WORN, FIT_TIME = 0.8, 0.3
"""Share of its best correlation below which frames no longer resemble a scene, and s over which it is
averaged: blur comes and goes within that time."""

LOST_TIME = 3.0  # s, after which a scene in which no frame is found is given up, as hidden objects are


@short_repr
@dataclass(frozen=True, eq=False)
class CameraState:
    """Map from scene to frame, and the scene's picture."""

    where: LinearGaussianState  # of one thing, the map from scene to frame
    # (height, width[, 3]): the scene under today's light, in the places of the frame with which it began
    picture: NDArray[np.float32]
    unknown: NDArray[np.bool_]  # (height, width): where objects have hidden the scene since it began
    elapsed: float  # s since the last frame with an image
    unseen: float  # s since a frame was found in the scene
    fit: float  # usual correlation of frames with the scene, of late
    best_fit: float  # its highest value since the scene began
    first: NDArray[np.float64]  # (6,) px: map from the first frame to the scene
    first_covariance: NDArray[np.float64]  # (6, 6) px^2, of these

    @property
    def mean(self) -> NDArray[np.float64]:
        """`(6,)` px: parameters of the map from scene to frame."""
        return np.asarray(self.where.mean[0])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """`(6, 6)` px^2, of these."""
        return np.asarray(self.where.covariance[0])

    @property
    def view(self) -> View:
        """The map from scene to frame."""
        return View.predicted(self.mean, self.covariance, self.picture)

    @property
    def view_of_first(self) -> View:
        """The map from the first frame to this one; errors of all scenes in between add."""
        size = self.picture.shape[:2]
        whole = AffineMap(self.mean, size).after(AffineMap(self.first, size))
        return View.predicted(whole.parameters, self.covariance + self.first_covariance, self.picture)


@checked
@short_repr
@dataclass(frozen=True)
class CameraMotion:
    """Chain of a camera that shakes or turns around a view of the scene, and moves on to the next one.

    A scene is what a frame shows. When the camera leaves it (by more than twice `reach`), or frames no
    longer resemble it (near things move against far ones), or none is found in it for some seconds, the frame
    of that moment begins the next scene. All other chains map their states to its px, with what is unsure.

    Parameters
    ----------
    reach
        standard deviation of the motion of image positions, as a share of half the diagonal of the image.
    time
        s, time constant with which the camera returns to its mean view.
    """

    reach: Positive = 0.05
    time: Positive = 1.0
    name: str = "camera"

    ports = (Port(ScenePixels, sole="camera"),)

    def initial(self, frame: Frame) -> CameraState:
        """Return a camera at rest, with the first image as the image of the scene."""
        picture = frame.required_image().astype(np.float32)
        still = np.zeros(UNKNOWNS)
        where = self._motion(picture).initial(frame)
        unknown = np.zeros(picture.shape[:2], np.bool_)
        return CameraState(where, picture, unknown, 0.0, 0.0, 0.0, 0.0, still, np.diag(still))

    def _motion(self, picture: NDArray[np.float32]) -> LinearGaussianChain:
        """The map's own chain, an Ornstein-Uhlenbeck process."""
        variance = (self.reach * math.hypot(*picture.shape[:2]) / 2) ** 2
        return LinearGaussianChain(
            lambda dt: math.exp(-dt / self.time) * np.eye(UNKNOWNS),
            lambda dt: -math.expm1(-2 * dt / self.time) * variance * np.eye(UNKNOWNS),
            None,
            None,
            features=ScenePixels,
            initial_covariance=FIRST_VARIANCE * np.eye(UNKNOWNS),
            identities=(0,),
        )

    def predict(self, state: CameraState, dt: float) -> CameraState:
        """Return the map `dt` seconds on."""
        where = self._motion(state.picture).predict(state.where, dt)
        return replace(state, where=where, elapsed=state.elapsed + dt, unseen=state.unseen + dt)

    def message(self, state: CameraState, feature: ScenePixels, incoming: Incoming) -> PixelMessage:
        """Return the density of the map, with the image of the scene (mu_{C -> F})."""
        worn = state.fit < WORN * state.best_fit
        room = 0.0 if worn else BEYOND * self.reach * math.hypot(*state.picture.shape[:2]) / 2
        lost = state.unseen > LOST_TIME
        return PixelMessage(
            view=View.predicted(state.mean, state.covariance, state.picture, state.unknown, room, lost=lost)
        )

    def update(self, state: CameraState, incoming: Incoming) -> CameraState:
        """Return the map given the registration, and the image of the scene updated by background pixels."""
        found = incoming.evidence(ScenePixels)
        if found.image is None:
            return state
        seen = incoming[ScenePixels].foreground() == 0
        if found.view is not None:
            state = self._registered(state, found.view)
            if found.view.begins is not None:
                return self._next_scene(state, found.view.begins, ~seen)
            seen &= state.view.map.shown
        picture, revealed = state.picture.copy(), seen & state.unknown
        share = -math.expm1(-state.elapsed / PICTURE_TIME)
        cv2.accumulateWeighted(found.image, picture, share, mask=seen.astype(np.uint8))
        picture[revealed] = found.image[revealed]
        return replace(state, picture=picture, unknown=state.unknown & ~seen, elapsed=0.0)

    def _registered(self, state: CameraState, found: View) -> CameraState:
        if not len(found.where):
            return state
        where = self._motion(state.picture).condition(state.where, found.where)
        share = -math.expm1(-state.elapsed / FIT_TIME) if state.best_fit else 1.0
        fit = state.fit + share * (found.correlation - state.fit)
        return replace(state, where=where, unseen=0.0, fit=fit, best_fit=max(fit, state.best_fit))

    def _next_scene(
        self, state: CameraState, image: NDArray[np.uint8], hidden: NDArray[np.bool_]
    ) -> CameraState:
        """The state in the scene that an image begins; `hidden` `(height, width)` was foreground before."""
        return replace(
            self.initial(Frame(image, 0.0, 1)),
            unknown=state.view.map.warp_to_frame(hidden.astype(np.uint8)) > 0,
            first=state.view_of_first.map.parameters,
            first_covariance=state.first_covariance + state.covariance,
        )
