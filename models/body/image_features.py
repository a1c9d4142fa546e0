"""Features of an image for an upper body: skin, blobs of a hand's or head's size, edges."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.checks import Shape, SizesOf
from ..core.gaussian_mixtures import GaussianMixtures
from ..core.pictures import grey_of
from ..core.short_repr import short_repr
from .keypoints import SeenKeypoints

Array = NDArray[np.float64]
OfPixels = Annotated[NDArray[np.float32], Shape("height", "width")]
Map = NDArray[np.float32]
Made = TypeVar("Made")

COARSE_RADIUS = 7.0  # px: radius of a hand in the reduced image that is searched

CENTRE, AROUND = 0.5, 1.0
"""Standard deviations of the two Gaussian windows whose difference is the contrast, in radii: the inner one
lies within a hand, the outer one reaches about as far beyond."""

APART, TOGETHER = 0.5, 0.55
"""Radii: peaks are the highest within the first; of two places within the second, one is left."""

LEAST_CONTRAST = 0.03  # of the share of skin in the two windows; 0.4 for a lone disc

LEVEL, PENALTY = 1.5, 2.0
"""A blob's log weight: 1.5 times the mean log odds in the inner window, less those in the outer one, less 2.
Cloth in skin's colour has a level without contrast, its corners contrast without level. On 16 frames of a
real signer, hands had 0.6 and clutter -0.6 on average, with standard deviations of 0.8."""

OF_HEAD = 0.3  # weight of the head's skin in a hand's centre
HIDDEN_BY_HEAD = 6.0  # nats: penalty of blobs in the face, where a hand adds no skin
ONE_HAND = 0.9  # pi radii^2 in a Gaussian window of one radius: more skin than a hand's 0.55 to 0.8
HALF_APART = 0.55  # radii: half the distance of the two hands that such a blob may be

BLOB_STD, ELONGATION = 0.2, 0.15
"""A blob's covariance: the first squared, in radii, plus this share of the skin's second moments."""

MOST_BLOBS = 12


@dataclass(frozen=True, eq=False)
class SkinBlobs:
    """m blobs of skin that may be a hand, or a head."""

    means: Array  # `(m, 2)` px, the strongest first
    covariances: Array  # `(m, 2, 2)` px^2: of the hand's centre
    log_weights: Array  # `(m,)` nats: log likelihood ratio of a hand against clutter

    @classmethod
    def none(cls) -> "SkinBlobs":
        """Return no blobs."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))


def skin_blobs(skin: Map, radius: float, heads: Array | None = None) -> SkinBlobs:
    """Detect blobs of a hand's size with more skin than around them.

    Hands beside and below the face are searched for in the image without it. A blob with more skin than one
    hand shows is also split into two that touch.

    `skin` `(height, width)` float32 nats: log odds of skin; `radius` px: of a hand; `heads` `(k, 4)` px:
    ellipses of known heads, centre x, y and half axes; blobs in them have less weight.
    """
    scale = min(1.0, COARSE_RADIUS / radius)
    reach = radius * scale
    odds = np.asarray(cv2.resize(skin, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32)
    # in float64: the exponential of float32 differs between CPUs
    share = np.asarray(1 / (1 + np.exp(-odds, dtype=np.float64)), np.float32)
    inside = _inside(share.shape, np.zeros((0, 4)) if heads is None else heads, scale)
    beside = np.where(inside, np.float32(0), share)
    places = _thinned(np.concatenate([_peaks(beside, reach), _peaks(share, reach)]), reach)
    if not len(places):
        return SkinBlobs.none()
    means, moments, masses = _local(np.where(inside, np.float32(OF_HEAD) * share, share), places, reach)
    log_weights = _log_weights(odds, places, reach)
    log_weights -= np.where(inside[places[:, 1], places[:, 0]], HIDDEN_BY_HEAD, 0.0)
    two = masses > ONE_HAND * np.pi * reach**2
    along = np.linalg.eigh(moments[two])[1][:, :, 1] * (HALF_APART * reach)
    means = np.concatenate([means, means[two] + along, means[two] - along])
    moments = np.concatenate([moments, moments[two] / 2, moments[two] / 2])
    log_weights = np.concatenate([log_weights, *2 * [log_weights[two] - np.log(2)]])
    order = np.argsort(-log_weights, kind="stable")[:MOST_BLOBS]
    covariances = (BLOB_STD * reach) ** 2 * np.eye(2) + ELONGATION * moments[order]
    return SkinBlobs((means[order] + 0.5) / scale - 0.5, covariances / scale**2, log_weights[order])


def _inside(shape: tuple[int, ...], heads: Array, scale: float) -> NDArray[np.bool_]:
    """Pixels in any head."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    inside = np.zeros(shape, np.bool_)
    for x, y, across, down in heads:
        right, below = (columns + 0.5) / scale - 0.5 - x, (rows + 0.5) / scale - 0.5 - y
        inside |= (right / across) ** 2 + (below / down) ** 2 < 1
    return inside


def _peaks(share: Map, reach: float) -> NDArray[np.int64]:
    """`(n, 2)` columns and rows of the local maxima of contrast, the highest first."""
    within, around = (cv2.GaussianBlur(share, (0, 0), width * reach) for width in (CENTRE, AROUND))
    contrast = within - around
    size = 2 * round(APART * reach) + 1
    highest = cv2.dilate(contrast, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    rows, columns = np.nonzero((contrast == highest) & (contrast > LEAST_CONTRAST))
    order = np.argsort(-contrast[rows, columns], kind="stable")[: 2 * MOST_BLOBS]
    return np.stack([columns[order], rows[order]], axis=1)


def _thinned(places: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Drop places that are close to an earlier one."""
    apart = ((places[:, None] - places[None]) ** 2).sum(axis=2) > (TOGETHER * reach) ** 2
    kept: list[int] = []
    for place in range(len(places)):
        if apart[place, kept].all():
            kept.append(place)
    return places[kept]


def _log_weights(odds: Map, places: NDArray[np.int64], reach: float) -> Array:
    columns, rows = places.T
    level = cv2.GaussianBlur(odds, (0, 0), CENTRE * reach)[rows, columns]
    around = cv2.GaussianBlur(odds, (0, 0), AROUND * reach)[rows, columns]
    return np.asarray(LEVEL * level - around - PENALTY, np.float64)


def _local(share: Map, places: NDArray[np.int64], reach: float) -> tuple[Array, Array, Array]:
    """Return centre `(n, 2)`, second moments `(n, 2, 2)` and mass `(n,)` of the skin near places, in px."""
    half = int(np.ceil(2.5 * reach))
    steps = np.arange(-half, half + 1)
    padded = np.pad(share, half)
    patches = padded[
        places[:, 1, None, None] + half + steps[:, None], places[:, 0, None, None] + half + steps
    ].astype(np.float64)
    squares = np.square(steps[:, None]) + np.square(steps)
    near = patches * np.exp(-0.5 * squares / (0.5 * reach) ** 2)
    shift = _centres(near, steps)
    wide = patches * np.exp(-0.5 * squares / reach**2)
    masses = wide.sum(axis=(1, 2))
    centres = _centres(wide, steps)
    right, down = steps - centres[:, :1], steps - centres[:, 1:]
    xx = np.einsum("nij,nj->n", wide, right**2) / masses
    yy = np.einsum("nij,ni->n", wide, down**2) / masses
    xy = np.einsum("nij,ni,nj->n", wide, down, right) / masses
    moments = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    return places + shift, moments, masses


def _centres(weights: Array, steps: NDArray[np.int64]) -> Array:
    total = weights.sum(axis=(1, 2))
    sums = np.stack([weights.sum(axis=1) @ steps, weights.sum(axis=2) @ steps], axis=1)
    return np.asarray(sums / total[:, None], np.float64)


REACH = 8.0  # entries of the maps of edges: bound of distances to them, at least
BLUR = 1.2  # px: of the image before edge detection

STEEPEST, OVER_MEDIAN, LEAST, WEAK = 0.9, 3.5, 12.0, 0.4
"""An edge begins where the gradient is among the image's steepest tenth, above 3.5 times its median and that
of a step of 3 levels, and goes on while it is above 0.4 of that: the steepest tenth of an image of noise
stays below twice its median, and soft shades go by steps of one level."""


@short_repr
@dataclass(frozen=True, eq=False)
class BodyImage:
    """Features of an image that poses of a body are compared with."""

    size: Annotated[tuple[int, int], SizesOf("height", "width")]  # px
    # nats, from -4 to 4: log odds of skin; `None` without colour
    skin: OfPixels | None
    moving_skin: OfPixels | None  # the same less the static skin: for hands
    # px: distance to the nearest edge, capped at a sixth of the head's height
    edges: Annotated[NDArray[np.float32], Shape("rows", "columns")]
    # rad, between 0 and pi: the normal of the nearest edge, as angle from x to y
    edge_directions: Annotated[NDArray[np.float32], Shape("rows", "columns")]
    blobs: Annotated[NDArray[np.float64], Shape("m", 2)]  # px: centres of `SkinBlobs`
    # log odds of a hand against clutter, up to a constant
    blob_log_weights: Annotated[NDArray[np.float64], Shape("m")]
    mixtures: GaussianMixtures  # evidence phi(I, F) of head and hands by faces, blobs and key points
    keypoints: SeenKeypoints | None = None  # detected points of this body, if any
    bare: float = 0.0  # probability that forearms are bare
    # nats: log odds of a sleeve's colour, half as large as the image; `None` without known clothes
    arms: Annotated[NDArray[np.float32], Shape(None, None)] | None = None
    # px: ellipses of heads whose faces are detected and of their necks, centre x, y and half axes
    heads_and_necks: Annotated[NDArray[np.float64], Shape(None, 4)] = field(
        default_factory=lambda: np.zeros((0, 4))
    )
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def once(self, key: Hashable, make: Callable[["BodyImage"], Made]) -> Made:
        """Return `make(self)`, cached by `key`: a filter and its smoother need the same."""
        if key not in self._made:
            self._made[key] = make(self)
        made: Made = self._made[key]
        return made


def edge_distances(image: NDArray[np.uint8], reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return distance and direction of the nearest edge.

    The threshold depends on the image's own gradients: dim and soft images have edges, too.

    `image` `(height, width)` or `(height, width, 3)` BGR; `reach` px: cap of the distances. Returns
    `distances`, `directions`, both `(rows, columns)` float32: px; rad from 0 to pi, the angle from x to y of
    the edge's normal (the gradient's). Without any edge, the cap and 0. These maps have an entry a px, or so
    few that the reach is `REACH` entries at least.
    """
    smooth = cv2.GaussianBlur(grey_of(image), (0, 0), BLUR)
    right, down = (cv2.Sobel(smooth, cv2.CV_16S, *order, ksize=3) for order in ((1, 0), (0, 1)))
    some = np.hypot(right[::3, ::3].astype(np.float32), down[::3, ::3].astype(np.float32))
    steep = max(float(np.quantile(some, STEEPEST)), OVER_MEDIAN * float(np.median(some)), LEAST)
    edges = cv2.Canny(right, down, _off_ties(WEAK * steep), _off_ties(steep), L2gradient=True)
    places, step = np.nonzero(edges), max(int(reach / REACH), 1)
    free = np.full([max(length // step, 1) for length in edges.shape], 255, np.uint8)
    if not len(places[0]):
        return np.full(free.shape, reach, np.float32), np.zeros(free.shape, np.float32)
    rows, columns = (
        place * some // every for place, some, every in zip(places, free.shape, edges.shape, strict=True)
    )
    free[rows, columns] = 0
    distances, nearest = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    angles = np.zeros(len(rows) + 1, np.float32)
    # in float64: the angle of float32 differs between CPUs
    angles[nearest[rows, columns]] = np.arctan2(down[places], right[places], dtype=np.float64) % np.pi
    return np.minimum(np.float32(step) * distances, np.float32(reach)), angles[nearest]


def _off_ties(threshold: float) -> float:
    """Return a threshold that no gradient equals (squares are whole): OpenCV's codes differ in ties."""
    return float(np.sqrt(np.floor(threshold**2) + 0.5))
