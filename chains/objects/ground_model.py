"""A ground plane and who walks on it: perspective from a linear regression of heights on the foot's row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import BOX
from ...models.objects.box_message import Newcomers
from .kernels.ground_plane import Objects, box_densities

Numbers = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class GroundState:
    """Perspective of the scene and the objects in it.

    With its foot in row y, object k is scene[0] + scene[1] (y - middle) + scene[2 + k] heights[k] high: what
    the plane makes of everybody, and how much taller or shorter this one is.

    Parameters
    ----------
    size
        `(height, width)` px of the picture; `middle` is its middle row.
    variation
        standard deviation of heights over what the plane predicts, as a share of that.
    scene
        `(2 + n_objects,)`: px height with the foot in the middle row, px it grows with each row, and each
        object's share.
    scene_covariance
        `(2 + n_objects, 2 + n_objects)`.
    everybody
        `(3,)`: weight, mean and variance of the width over height of all who were seen.
    identities
        `(n_objects,)` int64, increasing.
    feet
        `(n_objects, 2, 2)`: along x and y, position px and velocity px/s.
    feet_covariance
        `(n_objects, 2, 2, 2)`: along x and y, of position and velocity.
    heights
        `(n_objects,)` px, the scale on which an object moves and varies.
    aspects, aspect_variances
        `(n_objects,)` width over height.
    trust
        `(n_objects,)` log odds that the object stands on the plane.
    unseen
        `(n_objects,)` s since it was last heard of.
    """

    size: tuple[int, int]
    variation: float
    scene: Numbers
    scene_covariance: Numbers
    everybody: Numbers
    identities: NDArray[np.int64]
    feet: Numbers
    feet_covariance: Numbers
    heights: Numbers
    aspects: Numbers
    aspect_variances: Numbers
    trust: Numbers
    unseen: Numbers

    @property
    def middle(self) -> float:
        """px, middle row of the picture."""
        return 0.5 * self.size[0]

    def newcomers(self) -> Newcomers:
        """Box of somebody new; as long as nobody was seen, heights deviate by about the picture's."""
        _, aspect, variance = self.everybody.tolist()
        return Newcomers(
            self.size, self.scene[:2], self.scene_covariance[:2, :2], self.variation, aspect, variance
        )

    def expected_height(self, foot_y: ArrayLike) -> tuple[Numbers, Numbers]:
        """Mean and standard deviation px of the height of somebody new, with feet in these rows."""
        return self.newcomers().height(foot_y)

    @property
    def objects(self) -> Objects:
        """What loops know of the objects."""
        return Objects(
            self.feet,
            self.feet_covariance,
            self.heights,
            self.aspects,
            self.aspect_variances,
            self.trust,
            self.unseen,
        )

    def boxes(self, spread: float, foot_spread: float) -> GaussianMessage:
        """Density N(x) N(y) N(height; plane's at y) N(width; aspect * height) of every object's box.

        Of the perspective, which all objects share, each gets its own marginal, with the slope at its mean.

        Parameters
        ----------
        spread
            standard deviation of one person's height about their own mean, as a share.
        foot_spread
            heights: standard deviation of the bottom edge's middle about the point on the ground.
        """
        count = len(self.identities)
        message = GaussianMessage(
            self.identities, np.empty((count, BOX, BOX)), np.empty((count, BOX)), np.empty(count)
        )
        box_densities(
            self.middle, spread, foot_spread, self.scene, self.scene_covariance, self.objects,
            message.information, message.vector, message.log_scale,
        )  # fmt: skip
        return message
