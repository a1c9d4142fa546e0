"""How a detector of objects behaves: what it finds, where it errs, and what its scores mean."""

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Numbers = NDArray[np.float64]

FOOT_X, FOOT_Y, WIDTH, HEIGHT = range(4)
"""Order of a box's numbers (px): middle of its bottom edge, as column and row, then its size."""

BOX = 4

SIZES = log(20) * log(40)
"""Of log height and log aspect, the range over which false boxes are spread evenly."""


def feet(xyxy: Numbers) -> Numbers:
    """Boxes `(n, 4)` of left, top, right, bottom edge as foot x, foot y, width, height."""
    left, top, right, bottom = xyxy.T
    return np.stack([0.5 * (left + right), bottom, right - left, bottom - top], axis=1)


@short_repr
@dataclass(frozen=True)
class Scores:
    """Scores of true and of false boxes: Gaussians with one deviation, so that log odds are linear.

    Parameters
    ----------
    true, false
        mean score of boxes that show an object, and of those that do not.
    deviation
        of either about its mean.
    """

    true: float
    false: float
    deviation: float

    def log_ratio(self, scores: Numbers) -> Numbers:
        """`(n,)` nats: log of p(score | true box) over p(score | false box)."""
        off: Numbers = scores - 0.5 * (self.true + self.false)
        return (self.true - self.false) / self.deviation**2 * off


@short_repr
@dataclass(frozen=True)
class BoxDetector:
    """A detector of boxes, and how it errs.

    Parameters
    ----------
    found
        probability that it finds an object of which everything can be seen.
    clutter
        1/px^2: false boxes in a frame, for each pixel of the picture.
    position, size
        standard deviations of a box's foot and of its sides, as shares of the box's own size: of the root of
        its area, and of each side.
    doubles
        share of found objects of which there is a second box, less exact than the first.
    newcomers
        objects that are found in a frame for the first time, on average.
    scores
        what they mean; `None` as long as they mean nothing.

    Raises
    ------
    ValueError
        if a number is out of its range.
    """

    found: float = 0.9
    clutter: float = 1e-6
    position: float = 0.08
    size: float = 0.15
    doubles: float = 0.1
    newcomers: float = 0.1
    scores: Scores | None = None

    def __post_init__(self) -> None:
        if not 0 < self.found < 1:
            raise ValueError(f"found: got {self.found}, expected a probability between 0 and 1")
        for name in ("clutter", "position", "size", "doubles", "newcomers"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")

    def noise(self, boxes: Numbers) -> Numbers:
        """`(n, 4)` px^2: variances of what is found of such boxes `(n, 4)`."""
        width, height = np.maximum(boxes[:, WIDTH], 1.0), np.maximum(boxes[:, HEIGHT], 1.0)
        place = self.position**2 * width * height
        return np.stack([place, place, (self.size * width) ** 2, (self.size * height) ** 2], axis=1)

    def log_score_ratio(self, scores: Numbers | None, n_boxes: int) -> Numbers:
        """`(n_boxes,)` nats: what the scores say for a true box and against a false one."""
        return np.zeros(n_boxes) if self.scores is None or scores is None else self.scores.log_ratio(scores)


def log_anywhere(boxes: Numbers, area: float) -> Numbers:
    """`(n,)` nats, of 1/px^4: a box anywhere in a picture of `area` px, of any size and shape."""
    spread: Numbers = -np.log(area * SIZES * boxes[:, WIDTH] * boxes[:, HEIGHT])
    return spread
