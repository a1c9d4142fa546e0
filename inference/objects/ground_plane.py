"""A ground plane and who walks on it: perspective from a linear regression of heights on the foot's row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import FOOT_X, FOOT_Y, HEIGHT, WIDTH
from ...models.objects.box_message import Newcomers

Numbers = NDArray[np.float64]

LEAST_SPREAD = 0.05
"""Of a width, in heights: what remains uncertain about it, however alike the observations were."""

HALF_HIDDEN = 0.5
"""Heights: standard deviation of what an observation is off by that does not show an object wholly."""


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

    def plane(self, foot_y: Numbers) -> tuple[Numbers, Numbers]:
        """Mean px and variance px^2 of the height of somebody of average stature, any shape."""
        below, covariance = foot_y - self.middle, self.scene_covariance
        mean = self.scene[0] + self.scene[1] * below
        return mean, covariance[0, 0] + 2 * below * covariance[0, 1] + below**2 * covariance[1, 1]

    def whole(self, boxes: Numbers) -> NDArray[np.bool_]:
        """Which of `(n, 4)` boxes the picture's edge does not cut off."""
        x, y, width, height = boxes.T
        rows, columns = self.size
        inside: NDArray[np.bool_] = (
            (y - height > 1) & (y < rows - 1) & (x - 0.5 * width > 1) & (x + 0.5 * width < columns - 1)
        )
        return inside

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
        x, y = self.feet[:, 0, 0], self.feet[:, 1, 0]
        design = design_matrix(y - self.middle, self.heights)
        slope = self.scene[1]
        upright = design @ self.scene - slope * y
        uncertain = ((design @ self.scene_covariance) * design).sum(axis=1)
        squares = self.heights**2
        sway = foot_spread**2 * squares
        precision = np.empty((len(x), 4))
        precision[:, FOOT_X] = 1 / (self.feet_covariance[:, 0, 0, 0] + sway)
        precision[:, FOOT_Y] = 1 / (self.feet_covariance[:, 1, 0, 0] + sway)
        precision[:, WIDTH] = 1 / ((self.aspect_variances + LEAST_SPREAD**2) * squares)
        precision[:, HEIGHT] = probability(self.trust) / (uncertain + spread**2 * squares)
        of_x, of_y, of_width, of_height = precision.T
        information = np.zeros((len(x), 4, 4))
        information[:, FOOT_X, FOOT_X] = of_x
        information[:, FOOT_Y, FOOT_Y] = of_y + slope**2 * of_height
        information[:, FOOT_Y, HEIGHT] = information[:, HEIGHT, FOOT_Y] = -slope * of_height
        information[:, WIDTH, WIDTH] = of_width
        information[:, WIDTH, HEIGHT] = information[:, HEIGHT, WIDTH] = -self.aspects * of_width
        information[:, HEIGHT, HEIGHT] = of_height + self.aspects**2 * of_width
        vector = np.zeros((len(x), 4))
        vector[:, FOOT_X] = of_x * x
        vector[:, FOOT_Y] = of_y * y - slope * of_height * upright
        vector[:, HEIGHT] = of_height * upright
        quadratic = of_x * x**2 + of_y * y**2 + of_height * upright**2
        log_scale = 0.5 * (np.log(precision / (2 * np.pi)).sum(axis=1) - quadratic)
        return GaussianMessage(self.identities, information, vector, log_scale)


def design_matrix(below: Numbers, heights: Numbers, seen: NDArray[np.intp] | None = None) -> Numbers:
    """`(n_seen, 2 + n_objects)`: what every observed height is made of, in the order of `scene`."""
    rows = np.arange(len(below))
    place = rows if seen is None else seen
    design = np.zeros((len(below), 2 + len(heights)))
    design[:, 0] = 1.0
    design[:, 1] = below
    design[rows, 2 + place] = heights[place]
    return design


def usual_heights(state: GroundState, foot_y: Numbers, height: Numbers) -> Numbers:
    """px: what the plane says of the height of anybody there; before it is known, the measured one.

    An object's own share and all noise are scaled with it. The measured height comes in as little as can be:
    shares of hidden people's heights would let the plane sink while the shares grow.
    """
    mean, variance = state.plane(foot_y)
    height = np.maximum(height, 1.0)
    share = 1 / (1 + variance / (HALF_HIDDEN * height) ** 2)
    usual: Numbers = np.maximum(height + share * (mean - height), 0.25 * height)
    return usual


def good_over_bad(squares: Numbers, variance: Numbers, more: Numbers) -> Numbers:
    """Likelihood ratio of two Gaussians about the same mean, the second one with `more` variance."""
    bad = variance + more
    ratio: Numbers = np.sqrt(bad / variance) * np.exp(-0.5 * squares * (1 / variance - 1 / bad))
    return np.maximum(ratio, 1e-30)


def probability(log_odds: Numbers) -> Numbers:
    """Give what log odds stand for."""
    probability: Numbers = 1 / (1 + np.exp(-log_odds))
    return probability
