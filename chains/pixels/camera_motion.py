"""A camera that turns, walks and shakes, as a chain: by which map each frame shows the scene.

Of the map p_t = c_t + s_t (six numbers, px; see `AffineMap`) and the scene's picture:

    dc/dt = v, dv = -v / turn_time dt + noise of standard deviation speed in the long run
    p(s_t | s_t-1) = N(s_t; e^(-dt / shake_time) s_t-1, (1 - e^(-2 dt / shake_time)) shake^2)
    mu_{C -> F}(p) = N(p; predicted), together with the picture by which the frame is found

v and s are Ornstein-Uhlenbeck processes: where no frame is found, the camera goes on as it went for a while.

The pixels' evidence registers the frame with that picture and returns the likelihood of the map; with it
the image is the scene's, so that all other chains of the pixels see a camera that stands still. The
picture is updated where their messages expect background alone: objects that stand for long do not steer it.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from ...inference.engine.generic_chains import LinearGaussianChain, LinearGaussianState
from ...inference.engine.protocols import Incoming, Port
from ...inference.kalman import ornstein_uhlenbeck_velocity
from ...models.camera.moving_camera import UNKNOWNS, AffineMap, View
from ...models.core.checks import NotNegative, Positive, Shape, checked
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.pixels.pixel_labels import PixelMessage, ScenePixels

PICTURE_TIME = 10.0
"""s in which the scene's picture follows what is seen of the background: long, since each frame is put where
the picture is, so that what errors of many frames have in common would move it."""

FIRST_VARIANCE = 1e-6  # px^2: the first frame is the scene's picture, by definition

MAP = np.kron([[1.0, 0.0, 1.0]], np.eye(UNKNOWNS))  # from c, v and s to the map

STILL = GaussianMessage.from_moments(
    np.zeros(1, np.int64), np.zeros((1, UNKNOWNS)), FIRST_VARIANCE * np.eye(UNKNOWNS)[None]
)
"""The map of the frame with which a scene begins."""

ROOM = 0.1  # of half the diagonal: a frame that is farther away is another scene, of which half may be new

WORN, FIT_TIME = 0.8, 0.3
"""Share of its best correlation below which frames no longer resemble a scene, and s over which it is
averaged: blur comes and goes within that time."""

BLURRED = 0.5  # share of the usual correlation below which a frame is blurred or hidden

LOST_TIME = 1.0  # s, after which a scene in which no frame is found is given up: the camera may be anywhere


@short_repr
@dataclass(frozen=True, eq=False)
class CameraState:
    """Map from scene to frame, and the scene's picture."""

    where: LinearGaussianState  # of one thing: c, v and s of the map from scene to frame, (18,)
    # (height, width[, 3]): the scene under today's light, in the places of the frame with which it began
    picture: Annotated[NDArray[np.float32], Shape(...)]
    # where objects have hidden the scene since it began
    unknown: Annotated[NDArray[np.bool_], Shape("height", "width")]
    elapsed: NotNegative  # s since the last frame with an image
    fit: float  # usual correlation of frames with the scene, of late
    best_fit: float  # its highest value since the scene began
    first: Annotated[NDArray[np.float64], Shape(6)]  # px: map from the first frame to the scene
    first_covariance: Annotated[NDArray[np.float64], Shape(6, 6)]  # px^2, of these

    def require_fit(self) -> None:
        """Raise a `ValueError` if the picture or the map is of another shape."""
        shape, states = self.picture.shape, self.where.mean.shape
        if shape[:2] != self.unknown.shape or shape[2:] not in ((), (3,)):
            raise ValueError(
                f"picture: got shape {shape}, expected (height, width[, 3]) of {self.unknown.shape}"
            )
        if states != (1, MAP.shape[1]):
            raise ValueError(f"where: got shape {states}, expected {(1, MAP.shape[1])}")

    @property
    def mean(self) -> NDArray[np.float64]:
        """`(6,)` px: parameters of the map from scene to frame."""
        return np.asarray(MAP @ self.where.mean[0])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """`(6, 6)` px^2, of these."""
        return np.asarray(MAP @ self.where.covariance[0] @ MAP.T)

    @property
    def view(self) -> View:
        """The map from scene to frame."""
        return View.predicted(self.mean, self.covariance, self.picture)

    @property
    def map_of_first(self) -> AffineMap:
        """The map from the first frame to this one."""
        return self._composed(self.mean, self.first)

    @property
    def view_of_first(self) -> View:
        """The same with its covariance; errors of all scenes in between add."""
        # the composition is linear in either map, so differences are its derivatives
        whole, steps = self.map_of_first.parameters, np.eye(len(self.mean))
        by_map = np.stack([self._composed(self.mean + step, self.first).parameters for step in steps])
        by_first = np.stack([self._composed(self.mean, self.first + step).parameters for step in steps])
        by_map, by_first = by_map - whole, by_first - whole
        covariance = by_map.T @ self.covariance @ by_map + by_first.T @ self.first_covariance @ by_first
        return View.predicted(whole, covariance, self.picture)

    def _composed(self, mean: NDArray[np.float64], first: NDArray[np.float64]) -> AffineMap:
        size = self.picture.shape[:2]
        return AffineMap(mean, size).after(AffineMap(first, size))


@checked
@short_repr
@dataclass(frozen=True)
class CameraMotion:
    """Chain of a camera that shakes or turns around a view of the scene, and moves on to the next one.

    A scene is what a frame shows. When the camera leaves it, or frames no longer resemble it (near things
    move against far ones), or none is found in it for a second, the frame of that moment begins the next
    scene. All other chains map their states to its px, with what is unsure.

    Lengths are relative to half the diagonal of the image.

    Parameters
    ----------
    speed
        1/s, standard deviation of the velocity with which the image moves as the camera turns or walks.
    turn_time
        s, time constant with which this velocity changes.
    shake
        standard deviation of the shake of a hand.
    shake_time
        s, time constant of the shake.
    """

    speed: Positive = 0.3
    turn_time: Positive = 1.0
    shake: Positive = 0.01
    shake_time: Positive = 0.15
    name: str = "camera"

    ports = (Port(ScenePixels, sole="camera"),)

    def initial(self, frame: Frame) -> CameraState:
        """Return a camera at rest, with the first image as the image of the scene."""
        picture = frame.required_image().astype(np.float32)
        still, motion = np.zeros(UNKNOWNS), self._motion(picture)
        unknown = np.zeros(picture.shape[:2], np.bool_)
        where = motion.condition(motion.initial(frame), STILL)
        return CameraState(where, picture, unknown, 0.0, 0.0, 0.0, still, np.diag(still))

    def _motion(self, picture: NDArray[np.float32]) -> LinearGaussianChain:
        """The map's own chain."""
        radius = math.hypot(*picture.shape[:2]) / 2
        speed, shake = (self.speed * radius) ** 2, (self.shake * radius) ** 2

        def blocks(turn: NDArray[np.float64], shaken: float) -> NDArray[np.float64]:
            each = np.zeros((3, 3))
            each[:2, :2], each[2, 2] = turn, shaken
            return np.asarray(np.kron(each, np.eye(UNKNOWNS)), np.float64)

        def transition(dt: float) -> NDArray[np.float64]:
            turn = ornstein_uhlenbeck_velocity(dt, self.turn_time).transition
            return blocks(turn, math.exp(-dt / self.shake_time))

        def noise(dt: float) -> NDArray[np.float64]:
            turn = speed * ornstein_uhlenbeck_velocity(dt, self.turn_time).noise
            return blocks(turn, -shake * math.expm1(-2 * dt / self.shake_time))

        return LinearGaussianChain(
            transition,
            noise,
            MAP,
            None,
            features=ScenePixels,
            # where it looks is not known but by the first frame, which is the scene's picture
            initial_covariance=blocks(np.diag([radius**2, speed]), shake),
            identities=(0,),
        )

    def predict(self, state: CameraState, dt: float) -> CameraState:
        """Return the map `dt` seconds on."""
        where = self._motion(state.picture).predict(state.where, dt)
        return replace(state, where=where, elapsed=state.elapsed + dt)

    def message(self, state: CameraState, feature: ScenePixels, incoming: Incoming) -> PixelMessage:
        """Return the density of the map, with the image of the scene (mu_{C -> F})."""
        worn = state.fit < WORN * state.best_fit
        room = 0.0 if worn else ROOM * math.hypot(*state.picture.shape[:2]) / 2
        lost = bool(state.where.unseen[0] > LOST_TIME)
        return PixelMessage(
            view=View.predicted(
                state.mean,
                state.covariance,
                state.picture,
                state.unknown,
                room,
                BLURRED * state.fit,
                lost=lost,
            )
        )

    def update(self, state: CameraState, incoming: Incoming) -> CameraState:
        """Return the map given the registration, and the image of the scene updated by background pixels."""
        found = incoming.evidence(ScenePixels)
        if found.view is not None:
            state = self._registered(state, found.view)
            if found.view.begins is not None:
                return self._next_scene(state, found.view.begins, incoming[ScenePixels].foreground() > 0)
        if found.image is None:
            return state
        seen = incoming[ScenePixels].foreground() == 0
        if found.view is not None:
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
        return replace(state, where=where, fit=fit, best_fit=max(fit, state.best_fit))

    def _next_scene(
        self, state: CameraState, image: NDArray[np.uint8], hidden: NDArray[np.bool_]
    ) -> CameraState:
        """The state in the scene that an image begins; `hidden` `(height, width)` was foreground before."""
        mean = state.where.mean.copy()
        mean[0, :UNKNOWNS] -= state.mean  # its velocity and its shake go on
        where = self._motion(state.picture).condition(replace(state.where, mean=mean), STILL)
        of_first = state.view_of_first
        return replace(
            self.initial(Frame(image, 0.0, 1)),
            where=where,
            unknown=state.view.map.warp_to_frame(hidden.astype(np.uint8)) > 0,
            first=of_first.map.parameters,
            first_covariance=of_first.covariance,
        )
