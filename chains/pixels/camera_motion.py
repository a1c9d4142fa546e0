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


@short_repr
@dataclass(frozen=True, eq=False)
class CameraState:
    """Map from scene to frame, and the scene's picture."""

    where: LinearGaussianState  # of one thing, the map from scene to frame
    # (height, width[, 3]): the scene under today's light, in the first frame's places
    picture: NDArray[np.float32]
    elapsed: float  # s since the last frame with an image

    @property
    def mean(self) -> NDArray[np.float64]:
        """`(6,)` px: parameters of the map from scene to frame."""
        return np.asarray(self.where.mean[0])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """`(6, 6)` px^2, of these."""
        return np.asarray(self.where.covariance[0])


@checked
@short_repr
@dataclass(frozen=True)
class CameraMotion:
    """Chain of a camera that shakes, turns or slowly drifts around its view in the first frame.

    The scene is limited to the view of the first frame: a camera that pans away from it loses it.

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
        return CameraState(self._motion(picture).initial(frame), picture, 0.0)

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
        return replace(state, where=where, elapsed=state.elapsed + dt)

    def message(self, state: CameraState, feature: ScenePixels, incoming: Incoming) -> PixelMessage:
        """Return the density of the map, with the image of the scene (mu_{C -> F})."""
        return PixelMessage(view=View.predicted(state.mean, state.covariance, state.picture))

    def update(self, state: CameraState, incoming: Incoming) -> CameraState:
        """Return the map given the registration, and the image of the scene updated by background pixels."""
        found = incoming.evidence(ScenePixels)
        if found.image is None:
            return state
        where, picture = state.where, state.picture.copy()
        seen = np.asarray(incoming[ScenePixels].foreground() == 0, np.uint8)
        if found.view is not None:
            where = self._motion(picture).condition(where, found.view.where)
            seen[~AffineMap(where.mean[0], found.view.size).shown] = 0
        share = -math.expm1(-state.elapsed / PICTURE_TIME)
        cv2.accumulateWeighted(found.image, picture, share, mask=seen)
        return CameraState(where, picture, 0.0)
