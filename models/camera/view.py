"""What is said of where a camera looks, and how a frame is seen by it as the scene's picture."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.gaussian_message import GaussianMessage
from ..core.grey import grey_of
from ..core.short_repr import short_repr
from .affine_map import UNKNOWNS, AffineMap, Image, Numbers
from .registration import ScenePicture

LEAST_CORRELATION = 0.25
"""Below which a frame is not like the scene wherever the camera looks: chance makes 0.1."""

_CAMERA = np.zeros(1, np.int64)
"""The one thing that the Gaussians are about."""


@short_repr
@dataclass(frozen=True, eq=False)
class View:
    """A factor about the map from the scene to the frame: a Gaussian over its parameters.

    Parameters
    ----------
    size
        `(height, width)` px of scene and frame.
    where
        of the six parameters of `AffineMap` (px); uniform where nothing is known.
    scene
        `(height, width[, 3])` float32, what the scene looks like; of the chain that knows the camera.
    """

    size: tuple[int, int]
    where: GaussianMessage
    scene: NDArray[np.float32] | None = None

    @classmethod
    def predicted(cls, mean: Numbers, covariance: Numbers, scene: NDArray[np.float32]) -> Self:
        """A density of the map, and the scene by which it is found."""
        where = GaussianMessage.from_moments(_CAMERA, mean[None], covariance[None])
        return cls((scene.shape[0], scene.shape[1]), where, scene)

    def __mul__(self, other: Self) -> Self:
        scene = self.scene if other.scene is None else other.scene
        return replace(self, where=self.where * other.where, scene=scene)

    @cached_property
    def map(self) -> AffineMap:
        """The most likely one."""
        return AffineMap(self.where.marginal(0)[0], self.size)

    @property
    def covariance(self) -> Numbers:
        """`(6, 6)` px^2, of the map's parameters."""
        return self.where.marginal(0)[1]

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """`(height, width)`: places of the scene that the frame does not show."""
        return ~self.map.shown

    def register(self, image: Image) -> tuple[Self, Image]:
        """The likelihood of the map, and the image as the scene's picture.

        The likelihood is Laplace's approximation, 1 at its peak: what the image's pixels say there is said by
        the pixels. Where the frame is not like the scene at all, it is uniform. The picture is seen by the
        most likely map, prediction included; where the frame does not show the scene, it is what is known of
        it.

        Parameters
        ----------
        image
            `(height, width[, 3])` uint8.

        Raises
        ------
        ValueError
            if this factor has no scene.
        """
        if self.scene is None:
            raise ValueError("view: got no scene, expected one by which frames are found")
        grey = self.scene if self.scene.ndim == 2 else cv2.cvtColor(self.scene, cv2.COLOR_BGR2GRAY)
        found = ScenePicture(np.asarray(grey, np.float32)).register(grey_of(image), self.map)
        where = GaussianMessage.uniform(UNKNOWNS)
        if found.correlation >= LEAST_CORRELATION:
            information = np.linalg.inv(found.covariance).astype(np.float64)
            vector = information @ found.map.parameters
            log_scale = np.array([-0.5 * vector @ found.map.parameters])
            where = GaussianMessage(_CAMERA, information[None], vector[None], log_scale)
        likelihood = replace(self, where=where, scene=None)
        beyond = np.clip(np.rint(self.scene), 0, 255).astype(np.uint8)
        return likelihood, (self * likelihood).map.in_scene(image, beyond)
