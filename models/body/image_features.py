"""What one image says of a person's upper body: faces, skin, its blobs, edges."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.gaussian_mixtures import GaussianMixtures
from ..core.pictures import grey_of
from ..core.short_repr import short_repr
from .keypoints import SeenKeypoints

Made = TypeVar("Made")

BLUR = 1.2
"""px: of the picture in which edges are looked for."""

STEEPEST, OVER_MEDIAN, LEAST, WEAK = 0.9, 3.5, 12.0, 0.4
"""An edge begins where the gradient is among the image's steepest tenth, above 3.5 times its median and that
of a step of 3 levels, and goes on while it is above 0.4 of that: the steepest tenth of an image of noise
stays below twice its median, and soft shades go by steps of one level."""


@short_repr
@dataclass(frozen=True, eq=False)
class BodyImage:
    """Everything that is asked of an image when poses of a body are compared with it, worked out once.

    Parameters
    ----------
    skin
        `(height, width)` float32 nats: log odds of the pixel's colour on skin against anything else, between
        -4 and 4; `None` where there is no colour to tell from.
    moving_skin
        the same less what is skin all the time: for hands.
    edges
        `(height, width)` float32 px: distance to the nearest edge, capped at a sixth of the head's height.
    edge_directions
        `(height, width)` float32 rad, between 0 and pi: the normal of the nearest edge, as angle from x to y.
    blobs
        `(m, 2)` px: centres of places with as much skin as a hand shows, the strongest first.
    blob_log_weights
        `(m,)`: log of the probability ratio that the blob is some given hand against clutter, up to one
        constant.
    mixtures
        the evidence phi(I, F) of head and hands that faces, blobs and keypoints give.
    keypoints
        points of this body that a detector has found, if there are any.
    bare
        probability that forearms are bare.
    arms
        nats: log odds that a pixel's colour is that of an arm, half as large as the image; `None` where
        clothes' colours are not known.
    """

    skin: NDArray[np.float32] | None
    moving_skin: NDArray[np.float32] | None
    edges: NDArray[np.float32]
    edge_directions: NDArray[np.float32]
    blobs: NDArray[np.float64]
    blob_log_weights: NDArray[np.float64]
    mixtures: GaussianMixtures
    keypoints: SeenKeypoints | None = None
    bare: float = 0.0
    arms: NDArray[np.float32] | None = None
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def once(self, key: Hashable, make: Callable[["BodyImage"], Made]) -> Made:
        """`make(self)`, or what it was for an equal `key`: a filter and its hindsight ask for the same."""
        if key not in self._made:
            self._made[key] = make(self)
        made: Made = self._made[key]
        return made

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self.edges.shape
        return height, width


def edge_distances(image: NDArray[np.uint8], reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distance to the nearest edge, and which way that edge faces.

    What counts as an edge depends on the image's own gradients: dim and soft pictures have edges, too.

    Parameters
    ----------
    image
        `(height, width)` or `(height, width, 3)` BGR.
    reach
        px: distances are capped here.

    Returns
    -------
    distances, directions
        both `(height, width)` float32: px; rad from 0 to pi, the angle from x to y of the edge's normal (that
        of the gradient). Without any edge, the cap and 0.
    """
    smooth = cv2.GaussianBlur(grey_of(image), (0, 0), BLUR)
    right, down = (cv2.Sobel(smooth, cv2.CV_16S, *order, ksize=3) for order in ((1, 0), (0, 1)))
    some = np.hypot(right[::3, ::3].astype(np.float32), down[::3, ::3].astype(np.float32))
    steep = max(float(np.quantile(some, STEEPEST)), OVER_MEDIAN * float(np.median(some)), LEAST)
    edges = cv2.Canny(right, down, _off_ties(WEAK * steep), _off_ties(steep), L2gradient=True)
    if not edges.any():
        return np.full(edges.shape, reach, np.float32), np.zeros(edges.shape, np.float32)
    distances, nearest = cv2.distanceTransformWithLabels(
        cv2.bitwise_not(edges), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(edges)
    angles = np.zeros(len(rows) + 1, np.float32)
    # in float64: the angle of float32 is another one on other CPUs
    normals = np.arctan2(down[rows, columns], right[rows, columns], dtype=np.float64)
    angles[nearest[rows, columns]] = normals % np.pi
    return np.minimum(distances, np.float32(reach)), angles[nearest]


def _off_ties(threshold: float) -> float:
    """A threshold that no gradient equals: their squares are whole numbers.

    `threshold` comes from the image, so some pixels have just that gradient. OpenCV finds edges with its own
    code on several threads and with IPP's on one, and these two do not agree about such pixels.
    """
    return float(np.sqrt(np.floor(threshold**2) + 0.5))
