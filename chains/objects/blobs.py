"""Objects that move in front of a background, as soft masks with colours: what is known of them."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...models.camera.moving_camera import AffineMap
from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import FOOT_X, FOOT_Y, HEIGHT
from .kernels.masks import MaskShape, shape_of
from .kernels.patches import UNKNOWN_COLOUR
from .kernels.records import MARGIN

Map = NDArray[np.float32]
Pair = NDArray[np.float64]
Box = tuple[float, float, float, float]
Covariance = tuple[tuple[float, float], tuple[float, float]]


def around(box: Box, other: Box) -> Box:
    """The box that holds two boxes x, y, width, height."""
    left, top = min(box[0], other[0]), min(box[1], other[1])
    right, bottom = max(box[0] + box[2], other[0] + other[2]), max(box[1] + box[3], other[1] + other[3])
    return left, top, right - left, bottom - top


@short_repr
@dataclass(frozen=True)
class Track:
    """What is reported of an object in a frame.

    Parameters
    ----------
    identity
        from 1, never used twice.
    box
        x, y, width, height px; x, y is the top left corner, 0 at the picture's.
    confidence
        share of the object's visible part that was seen, 0 to 1; 0 while it is hidden or not found. A missing
        frame leaves it as it was. Of who was detected it is the probability that there is such an object.
    velocity
        px/s to the right and down.
    seen
        whether this frame shows it, to its pixels or to a detector; else it is only predicted.
    position_covariance
        px^2, of the middle of the box, along x and y.
    """

    identity: int
    box: Box
    confidence: float
    velocity: tuple[float, float]
    seen: bool
    position_covariance: Covariance

    def seen_by(self, view: AffineMap) -> Self:
        """The same as a frame shows it whose camera has moved by `view`; its velocity stays the scene's."""
        linear = view.matrix[:, :2]
        vx, vy = (linear @ self.velocity).tolist()
        (xx, xy), (yx, yy) = (linear @ self.position_covariance @ linear.T).tolist()
        return replace(
            self, box=view.box(self.box), velocity=(vx, vy), position_covariance=((xx, xy), (yx, yy))
        )


def middle_covariance(variance: Pair) -> Covariance:
    """Of a box's middle: its foot's, and half its height's, of `(4,)` px^2 as of `ObjectBoxes`."""
    return (
        (float(variance[FOOT_X]), 0.0),
        (0.0, float(variance[FOOT_Y] + 0.25 * variance[HEIGHT])),
    )


@short_repr
@dataclass(frozen=True, eq=False)
class DetectedBox:
    """Box of an object as a detector finds it.

    Parameters
    ----------
    mean
        `(4,)` px: foot x and y from the top left corner of the blob's patch, width, height.
    variance
        `(4,)` px^2.
    unfound
        s since a box was last found that may be its.
    """

    mean: Pair
    variance: Pair
    unfound: float = 0.0


@short_repr
@dataclass(frozen=True, eq=False)
class Blob:
    """State of one object.

    Parameters
    ----------
    identity
        from 1.
    position, velocity
        `(2,)` px and px/s, (down, right), of the patch's top left corner.
    covariance
        `(2, 2)` of position and velocity along either axis.
    mask
        `(height, width)` float32 probability of covering a pixel.
    appearance
        `(channels, height, width)` float32 planes; none where no image has shown it yet.
    spread
        squared grey levels: variance of its colours about `appearance`.
    seen
        s for which it was seen.
    unseen, still
        s since it was last seen, and for which it has not moved.
    confidence
        share of its visible part that was seen in the last frame.
    view, past_views
        nats, log ratio of being a ghost and being real by its outline as it is now, and by how it was before
        (see `ghosts`).
    fragment_time
        s for which it has been much smaller than anybody where it stands.
    whole
        identity of the object that it is a part of; its own if it is one itself.
    origin
        x, y, width, height px of where it appeared.
    parting
        s for which it has seemed to be two beside each other.
    size
        `(2,)` px, its usual height and width.
    existence
        log odds that it is one of those that the detector is made to find, if there is one.
    noticed
        log odds that the detector finds it at present, if it is in sight.
    detected
        its box for the detector; `None` as long as it has not found it.
    """

    identity: int
    position: Pair
    velocity: Pair
    covariance: Pair
    mask: Map
    appearance: Map
    spread: float
    seen: float
    unseen: float
    still: float
    confidence: float
    view: float
    past_views: float
    fragment_time: float
    whole: int
    origin: Box
    parting: float
    size: Pair
    existence: float = 0.0
    noticed: float = 0.0
    detected: DetectedBox | None = None

    @classmethod
    def newborn(
        cls,
        identity: int,
        corner: Pair,
        mask: Map,
        planes: Map,
        first_speed: float,
        spread: float,
    ) -> Self:
        """An object that was never seen before.

        Parameters
        ----------
        identity
            from 1.
        corner
            `(2,)` px, top and left of its patch.
        mask
            `(height, width)`, with a border of `MARGIN`.
        planes
            `(channels, height, width)` of the image.
        first_speed
            of its own lengths in a second, standard deviation of its velocity.
        spread
            squared grey levels, of its colours.
        """
        size = np.array(mask.shape) - 2.0 * MARGIN
        return cls(
            identity=identity,
            position=corner,
            velocity=np.zeros(2),
            covariance=np.diag([1.0, (first_speed * size.max()) ** 2]),
            mask=mask,
            appearance=np.where(mask > 0.2, planes, np.float32(UNKNOWN_COLOUR)),
            spread=spread,
            seen=0.0,
            unseen=0.0,
            still=0.0,
            confidence=1.0,
            view=0.0,
            past_views=0.0,
            fragment_time=0.0,
            whole=identity,
            origin=(float(corner[1]) + MARGIN, float(corner[0]) + MARGIN, float(size[1]), float(size[0])),
            parting=0.0,
            size=size,
        )

    @cached_property
    def corner(self) -> tuple[int, int]:
        """Top and left px of the patch, as it is rendered."""
        return math.floor(self.position[0] + 0.5), math.floor(self.position[1] + 0.5)

    @cached_property
    def shape(self) -> MaskShape:
        """Measures of the mask."""
        return shape_of(self.mask)

    @cached_property
    def box(self) -> Box:
        """x, y, width, height px of what the mask likely covers, or else of its patch."""
        top, left, bottom, right = self.shape[1:5]
        if bottom == 0 or right == 0:
            (top, left), (bottom, right) = (0, 0), self.mask.shape
        y, x = self.position.tolist()
        return x + left, y + top, float(right - left), float(bottom - top)

    @property
    def reported_box(self) -> tuple[float, float, float, float]:
        """x, y, width, height px: as detections have it, or else as the mask."""
        if self.detected is None:
            return self.box
        x, y, width, height = self.detected.mean.tolist()
        top, left = self.position.tolist()
        return left + x - 0.5 * width, top + y - height, width, height

    @property
    def length(self) -> float:
        """px, the longer side of the box."""
        return max(self.reported_box[2:])

    def moved_patch(self, shift: NDArray[Any]) -> Self:
        """The same with another top left corner, px down and right of the old; the mask must follow."""
        box = self.detected
        if box is not None:
            box = replace(box, mean=box.mean - (shift[1], shift[0], 0, 0))
        return self.changed(position=self.position + shift, detected=box)

    def changed(self, **values: Any) -> Self:
        """Like `dataclasses.replace`, but what was measured of a mask that stays is kept."""
        kept = {
            name: value for name, value in self.__dict__.items() if name not in ("corner", "shape", "box")
        }
        blob = object.__new__(type(self))
        blob.__dict__.update(kept | values)
        if "mask" not in values and "shape" in self.__dict__:
            blob.__dict__["shape"] = self.shape
        return blob
