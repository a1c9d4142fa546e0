"""How well poses of a body explain an image: face, flesh and occlusion edges (RSMCM paper §4.1)."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from .body_image import BodyImage
from .body_likelihood_kernels import blob_terms, edge_features, edge_terms, hand_terms, over_density
from .body_outline import silhouettes
from .body_poses import BodyPoses
from .memo import LastCall
from .upper_body import UpperBody

Array = NDArray[np.float64]
Map = NDArray[np.float32]

CELLS = 5.0
"""Entries of the flesh maps in a hand's radius."""

WINDOWS = (0.4, 1.6)
"""Hand radii: standard deviations of the windows that weigh flesh in a hand and flesh around it. Beside other
widths these had the least error, 0.03 head heights on hands of a synthetic signer."""

FLESH_SCORES = (11.0, -1.0, 0.2)
"""Nats of a place that looks all like a hand, and of one that does not; probability of a hand without flesh.
With these a hand's place is known to about 0.07 head heights, as real hands are off their model by. Flesh is
hidden in bursts, where frame after frame says the same: the second must not drive a hand to the face."""

LEVELS = 256
"""Entries of tables over distances and directions."""

MOST_FLESH = 4.0
"""Nats: greatest log odds of flesh."""

NECK_RADIUS = 0.2
"""Head heights: of bare flesh between head and shoulders."""

BLOB_COST = 1.0
"""Nats: of what looks like a hand and is neither hand nor head."""

BLOB_REACH = (0.6, 0.35, 0.35)
"""Head heights: within which head and hands explain a blob."""

EDGE_SPREAD = 0.05
"""Head heights: standard deviation of an edge about the outline of a body that is only nearly right."""

EDGE_WINDOW = 0.5
"""Head heights: standard deviation of the window in which an image's own edges are counted."""

COUNTED = 5.0
"""Entries of the map of these counts in that length."""

LEAST_EDGES, LEAST_ALIKE = 0.2, 0.25
"""Share of places near an edge that is assumed at least; share of edges of one direction, of an even one."""

EDGE_SHARPNESS = 4.0
"""Concentration (von Mises) of twice the angle between an edge and the outline."""

NO_EDGE = 0.4
"""Probability that a point of the outline shows no edge of its own."""

EDGE_POINTS = 50.0
"""Independent points of a whole outline: neighbours on it err together."""


@dataclass(frozen=True, eq=False)
class _Maps:
    """What is looked up for every pose: flesh in two windows, and edges."""

    flesh: tuple[Map, Map] | None
    ratios: Map


@dataclass(frozen=True, eq=False)
class BodyLikelihood:
    """Log likelihood of an image given poses, up to a constant of the image.

    The image speaks through a face detector for the head, through flesh colour for the hands and through
    edges for the outline, as in the paper, which gives no formulas. Here each term is the log ratio of how
    likely the cue is under the pose to how likely it is anywhere in the picture, with a chance that the cue
    fails: a hand without flesh, which happens in every fifth frame, loses a few nats and no more.

    Parameters
    ----------
    body
        lengths and widths.
    """

    body: UpperBody
    _last: LastCall = field(default_factory=LastCall, init=False, repr=False)

    def __call__(self, image: BodyImage, poses: BodyPoses) -> Array:
        """log p(image | pose) `(n,)` nats, up to a constant."""
        total: Array = self.terms(image, poses).sum(axis=0)
        return total

    def terms(self, image: BodyImage, poses: BodyPoses) -> Array:
        """`(3, n)` nats: what face, flesh and edges say, each up to a constant.

        The face's is the image's mixture at the pose's head. Hands count with `hand_terms`, flesh that looks
        like one more hand with `blob_terms`, the outline with `edge_terms`.
        """
        maps = self._last(self._maps, image)
        parts = self.body.parts(poses)
        terms = np.zeros((3, len(poses)))
        terms[0] = image.mixtures.take([0]).log_values(parts[:, :1])[:, 0]
        if maps.flesh is not None:
            self._add_flesh(terms[1], image, maps.flesh, parts, poses.roots)
        outlines = silhouettes(self.body, poses)
        edge_terms(
            outlines.points, outlines.normals, outlines.visible, maps.ratios, EDGE_POINTS,
            np.array([EDGE_SHARPNESS, np.i0(EDGE_SHARPNESS)]), NO_EDGE, terms[2],
        )  # fmt: skip
        return terms

    def _add_flesh(
        self, term: Array, image: BodyImage, flesh: tuple[Map, Map], parts: Array, roots: Array
    ) -> None:
        body = self.body
        height, width = image.size
        rows, columns = flesh[0].shape
        hand_terms(
            parts, roots, *flesh, np.array([columns / width, rows / height]),
            body.hand, body.hand * np.array(WINDOWS), 0.5 * np.array([body.head_width, body.head_height]),
            NECK_RADIUS * body.head_height, np.array(FLESH_SCORES), term,
        )  # fmt: skip
        # the odds that a blob is a hand; what is hardly one need not be explained
        costs = BLOB_COST / (1 + np.exp(-image.blob_log_weights))
        blob_terms(parts, image.blobs, costs, body.head_height * np.array(BLOB_REACH), term)

    def _maps(self, image: BodyImage) -> _Maps:
        flesh = None if image.flesh is None else flesh_maps(image.flesh, self.body.hand)
        unit = self.body.head_height
        return _Maps(flesh, edge_ratios(image, EDGE_SPREAD * unit, EDGE_WINDOW * unit))


def flesh_maps(flesh: Map, hand: float) -> tuple[Map, Map]:
    """Mean flesh, from 0 to 1, in Gaussian windows of a hand's size and around it.

    It grows with the log odds from where they are even: what is only rather like flesh, such as beige
    trousers, counts for little, and what is unlike it for nothing, however much.

    Parameters
    ----------
    flesh
        `(height, width)` float32 nats: log odds.
    hand
        px: radius. The maps have an entry each fifth of it, or each px.
    """
    shrink = min(CELLS / hand, 1.0)
    height, width = (max(round(shrink * length), 2) for length in flesh.shape)
    coarse = cv2.resize(flesh, (width, height), interpolation=cv2.INTER_AREA)
    share = np.maximum(coarse, np.float32(0)) * np.float32(1 / MOST_FLESH)
    centre, surround = (
        np.asarray(cv2.GaussianBlur(share, (0, 0), window * shrink * hand), np.float32) for window in WINDOWS
    )
    return centre, surround


def edge_ratios(image: BodyImage, spread: float, around: float) -> Map:
    """How much more likely the edge near a pixel is at an outline than thereabouts, and its direction.

    What is likely thereabouts is counted in the image itself: on a striped sleeve or before a bookcase one
    more edge says little, one across the stripes much. Of the density of directions there, its first
    harmonic is taken.

    Parameters
    ----------
    spread
        px: standard deviation of edges about an outline.
    around
        px: standard deviation of the window in which edges are counted.

    Returns
    -------
    NDArray
        `(height, width, 3)` float32: the ratio, cosine and sine of twice the angle of the edge's normal.
    """
    height, width = image.size
    reach = max(float(image.edges.max()), 1.0)
    levels = np.linspace(0, 1, LEVELS)
    near = np.exp(-0.5 * (levels * reach / spread) ** 2)
    near[-1] = 0  # distances are capped: the last one stands for any beyond
    turns = 2 * np.pi * levels
    block = max(round(around / COUNTED), 1)
    ratios = np.empty((height, width, 3), np.float32)
    coarse = np.empty((max(-(-height // block), 2), max(-(-width // block), 2), 3), np.float32)
    edge_features(
        image.edges, image.edge_directions,
        near.astype(np.float32), np.cos(turns).astype(np.float32), np.sin(turns).astype(np.float32),
        (LEVELS - 1) / np.array([reach, np.pi]), block, ratios, coarse,
    )  # fmt: skip
    coarse = np.asarray(cv2.GaussianBlur(coarse, (0, 0), around / block), np.float32)
    over_density(ratios, coarse, block, LEAST_EDGES, LEAST_ALIKE)
    return ratios
