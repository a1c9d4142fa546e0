"""Likelihood of poses given an image: face, skin and occlusion edges along outlines (RSMCM paper §4.1)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.body.image_features import BodyImage
from ...models.body.parts import FALSE_HANDS, HAND_DETECTED
from ...models.body.skin import HIGHEST
from ...models.body.upper_body import PART_JOINTS, BodyPoses, UpperBody
from ...models.core.gaussian_mixtures import GaussianMixtures
from ...models.numerics.threads import over_bands
from .kernels.image import (
    HandModel,
    arm_terms,
    edge_features,
    forearm_terms,
    hand_terms,
    head_terms,
    over_density,
    unexplained_terms,
)
from .kernels.outlines import LANES, Solid, outline_terms

Array = NDArray[np.float64]
Map = NDArray[np.float32]

OUTLINE_PARTS = (
    "head", "torso", "left_upper_arm", "left_forearm", "left_hand",
    "right_upper_arm", "right_forearm", "right_hand",
)  # fmt: skip
"""Parts that have outlines of their own."""

_COUNTS = {"head": 18, "torso": 24, "upper_arm": 12, "forearm": 12, "hand": 9}
"""Outline points of each part, so that they are about a quarter of a head apart."""

N_POINTS = (
    _COUNTS["head"] + _COUNTS["torso"] + 2 * (_COUNTS["upper_arm"] + _COUNTS["forearm"] + _COUNTS["hand"])
)

_HEAD_DEPTH = 0.85  # depth of a head over its height
_RIM = np.float32(0.06)  # share of a part's squared radius that hides nothing: ends may touch


@lru_cache(maxsize=8)
def solid_of(body: UpperBody) -> Solid:
    """Return the solid of a body, for compiled loops."""
    lengths = np.array(
        [
            body.neck,
            body.head_width / 2, body.head_height / 2, _HEAD_DEPTH * body.head_height / 2,
            body.shoulder_width, body.upper_arm, body.forearm, body.hand,
            body.upper_arm_width / 2, body.forearm_width / 2, body.wrist_width / 2,
            # the plane of the torso is a little behind the shoulders: arms that hang are seen whole
            0.1 * body.head_height,
        ]
    )  # fmt: skip
    # half widths from the chin down: neck, its foot, top of the shoulder, armpit, lower end
    neck, shoulder, thick = 0.3 * body.head_width, body.shoulder_width / 2, body.upper_arm_width
    knots = np.array(
        [
            [-body.neck, neck],
            [-min(0.75 * thick, 0.9 * body.neck), neck],
            [-min(0.5 * thick, 0.6 * body.neck), shoulder],
            [min(0.5 * thick, 0.5 * body.torso_height), shoulder - min(0.2 * thick, 0.5 * shoulder)],
            [body.torso_height, body.torso_width / 2],
        ]
    )
    drops, growth = np.diff(knots, axis=0).T
    pieces = np.column_stack([knots[:-1, 0], drops, knots[:-1, 1], growth / drops])
    points, normals = [], []
    for (top, narrow), (bottom, wide), count in ((knots[1], knots[2], 3), (knots[3], knots[4], 9)):
        share = (np.arange(count) + 0.5)[:, None] / count
        right = [narrow, top] + share * [wide - narrow, bottom - top]
        across = np.tile([bottom - top, narrow - wide], (count, 1)) / np.hypot(bottom - top, wide - narrow)
        points += [right, right * [-1, 1]]
        normals += [across, across * [-1, 1]]
    counts = np.array([_count(name) for name in OUTLINE_PARTS])
    n_rows = -(-counts // LANES)
    firsts = np.cumsum([0, *n_rows])
    counted, circles = np.zeros((firsts[-1], LANES)), np.zeros((firsts[-1], 2, LANES))
    for part, count in enumerate(counts):
        place = np.arange(n_rows[part] * LANES).reshape(-1, LANES)
        turns = 2 * np.pi * (np.minimum(place, count - 1) + 0.5) / count
        rows = slice(firsts[part], firsts[part + 1])
        counted[rows], circles[rows, 0], circles[rows, 1] = place < count, np.cos(turns), np.sin(turns)
    half = _COUNTS["forearm"] // 2
    # one side from the limb's end to its beginning, and the other one back
    steps = np.minimum(np.arange(LANES), 2 * half - 1) - half + 0.5
    contour = np.concatenate([np.concatenate(points), np.concatenate(normals)], axis=1)
    contour = contour[np.minimum(np.arange(n_rows[1] * LANES), len(contour) - 1)]
    return Solid(
        lengths,
        pieces.astype(np.float32),
        contour.reshape(-1, LANES, 4).swapaxes(1, 2).astype(np.float32, order="C"),
        circles.astype(np.float32),
        np.array([np.abs(steps), np.sign(steps), np.full(LANES, half)], np.float32),
        firsts,
        counted.astype(np.float32),
        np.float32(0.02 * body.head_height),
        _RIM,
    )


def _count(name: str) -> int:
    """Points of a part's outline."""
    return _COUNTS[name.removeprefix("left_").removeprefix("right_")]


CELLS = 5.0  # entries of the skin maps in a hand's radius

WINDOWS = (0.4, 1.6)
"""Hand radii: standard deviations of the windows that weigh skin in a hand and skin around it. Beside other
widths these had the least error, 0.03 head heights on hands of a synthetic signer."""

SKIN_SCORES = (11.0, -1.0, 0.2)
"""Nats of a place with all the skin of a hand, and of one without any; probability of a hand without skin.
With these a hand's posterior has a standard deviation of about 0.07 head heights, as real hands differ from
the model. Skin is hidden in bursts of dependent frames, so the second must not drive a hand to the face."""

BARE_SCORES, BARE_HAND_SCORES = (14.0, -4.0, 0.2), (8.0, -1.0, 0.2)
"""The same of a bare forearm across the line of sight, which shows a little more skin than a hand, and of the
hand at its end. Skin counts less for that hand, since a longer forearm would show two thirds of it: otherwise
hidden hands would be drawn to their wrists."""

SEEN = 7.0
"""Factor of a hand's nats of skin in the odds that it is seen: by the scores above a hand without skin is
little evidence, since dependent frames have none. Measured by `rsmcm reproduce calibration`."""

WORTH_THREADS = 300  # poses from which several threads are faster than one
LEVELS = 256  # entries of tables over distances and directions
HEAD_WINDOWS = (0.5, 1.2)  # half widths and heights of the head: standard deviations of its skin's windows

HEAD_SCORES = (5.0, 0.2)
"""Nats of a place with all the skin of a head, where no face is detected; probability of a head without."""

NECK_RADIUS = 0.28  # head heights: of bare skin above the shoulders
OWN_HEAD = 0.5  # half axes of a head from its detection at most: 1.4 to 2.5 of `parts.HEAD_STD`
BLOB_COST = 4.0  # nats of a blob that looks like a hand and that no part explains
LEAST_COST = 0.1  # nats of a place below which its skin costs nothing
BLOB_REACH = (0.6, 0.35, 0.35, 0.25)  # head heights: within which parts and bare arms explain skin
EDGE_STD = 0.05  # head heights: standard deviation of an edge about the outline of a nearly right body
EDGE_WINDOW = 0.5  # head heights: standard deviation of the window of the density of edges
DENSITY_CELLS = 5.0  # entries of the map of that density per such length

LEAST_EDGES, LEAST_ALIKE = 0.2, 0.25
"""Density of edges at least; share of edges of one direction at least, over an even one."""

EDGE_SHARPNESS = 4.0  # von Mises concentration of twice the angle between an edge and the outline
EDGE_DIRECTIONS = np.array([EDGE_SHARPNESS, np.i0(EDGE_SHARPNESS)])  # that, and the density's divisor
NO_EDGE = 0.4  # probability that a point of the outline shows no edge of its own
EDGE_POINTS = 20.0  # independent points of a whole outline: errors of neighbours are correlated


ARM_POINTS = np.array([[0.25, 0.5, 0.75, 1.0], [0.2, 0.4, 0.6, 0.75]])
"""Points of upper arm and forearm whose colours are compared: shares of their lengths from the body."""

ARM_WEIGHTS = np.array([0.25, 0.5])
"""Weight of the colour of each: neighbours are correlated, and upper arms are mostly known anyway."""

BARE_POINTS = np.array([[0, 0, 1, 1], [1, 1, 1, 1]])
"""Those below a short sleeve, which ends halfway to the elbow: their skin is told by the terms of skin, and
would draw upper arms to hands if it counted here."""

TRUNK, TRUNK_BLUR = (0.45, 0.12), 0.05
"""Shoulder widths: half the width of the trunk, and its height above the shoulders; head heights over which
its border is blurred."""

NO_SLEEVE = 0.1  # probability that an arm has other colours than the trunk


PoseLikelihood = Callable[[BodyImage], Callable[[BodyPoses], Array]]
"""Returns for an image the function of poses log p(image | pose), `(n,)` nats, up to a constant."""


@dataclass(frozen=True)
class BodyLikelihood:
    """Log likelihood of an image given poses, up to a constant of the image.

    The cues are a face detector for the head, skin colour for the hands and edges for the outline, as in the
    paper, which gives no formulas. Each term is the log likelihood ratio of a cue under the pose against
    anywhere in the image, mixed with a probability that the cue fails: a hand without skin, one frame in
    five, costs a few nats at most.
    """

    body: UpperBody  # lengths and widths

    def __call__(self, image: BodyImage) -> "ImageLikelihood":
        """Return the likelihood of an image, whose maps are computed once."""
        return image.once(self, self._of)

    def _of(self, image: BodyImage) -> "ImageLikelihood":
        unit, skin, head = self.body.head_height, None, None
        if image.skin is not None and image.moving_skin is not None:
            skin = skin_maps(image.moving_skin, self.body.hand)
            if not image.mixtures.informative[0]:
                head = head_map(image.skin, self.body)
        edges = edge_ratios(image, EDGE_STD * unit, EDGE_WINDOW * unit)
        return ImageLikelihood(self.body, image, skin, head, edges)


@dataclass(frozen=True, eq=False)
class ImageLikelihood:
    """Log likelihood of one image, with its maps."""

    body: UpperBody
    image: BodyImage
    skin: tuple[Map, Map] | None  # of hands, see `skin_maps`; `None` without colour
    head: Map | None  # skin of the head if no face is detected, see `head_map`
    edges: Map  # see `edge_ratios`

    def __call__(self, poses: BodyPoses) -> Array:
        """log p(image | pose) `(n,)` nats, up to a constant."""
        return self.first(poses) + self.rest(poses)

    def first(self, poses: BodyPoses) -> Array:
        """`(n,)` nats of the cheap terms: all but the outline's."""
        total: Array = self.inner_terms(poses).sum(axis=0)
        return total

    def rest(self, poses: BodyPoses) -> Array:
        """`(n,)` nats of the outline's edges, up to a constant."""
        total, solid, scales = np.zeros(len(poses)), solid_of(self.body), _scales(self.edges, self.image)

        def work(first: int, end: int) -> None:
            outline_terms(
                *(each[first:end] for each in poses.arrays), solid, self.edges, scales,
                EDGE_POINTS / N_POINTS, EDGE_DIRECTIONS, NO_EDGE, total[first:end],
            )  # fmt: skip

        over_bands(work, len(poses), worth=len(poses) >= WORTH_THREADS)
        return total

    def inner_terms(self, poses: BodyPoses) -> Array:
        """`(4, n)` nats: of face, skin, keypoints and clothes, each up to a constant."""
        terms = np.zeros((4, len(poses)))

        def work(first: int, end: int) -> None:
            terms[:, first:end] = self._inner_terms(poses.take(slice(first, end)))

        over_bands(work, len(poses), worth=len(poses) >= WORTH_THREADS)
        return terms

    def _inner_terms(self, poses: BodyPoses) -> Array:
        """Terms of some poses in one thread; without a detected face, the head's skin replaces it."""
        body, image = self.body, self.image
        joints = body.joints(poses)[:, :, :2]
        parts = joints[:, PART_JOINTS]
        terms = np.zeros((4, len(poses)))
        terms[0] = self._face.log_values(parts[:, :1])[:, 0]
        if self.head is not None:
            head_terms(parts[:, 0], self.head, _scales(self.head, image), np.array(HEAD_SCORES), terms[0])
        if self.skin is not None:
            terms[1] = self._skin_terms(self.skin, joints, poses.roots)[0]
        if image.keypoints is not None:
            terms[2] = image.keypoints.log_ratios(body, joints)
        if image.arms is not None:
            torso = np.array([*TRUNK, TRUNK_BLUR * body.head_height])
            weights = ARM_WEIGHTS[:, None] * (1 - image.bare * BARE_POINTS)
            arm_terms(
                joints, image.arms, _scales(image.arms, image), ARM_POINTS, weights, torso, NO_SLEEVE,
                terms[3],
            )  # fmt: skip
        return terms

    @cached_property
    def _skin_by_area(self) -> tuple[Array, Array]:
        """Places `(m, 2)` px, a hand's radius apart, and nats `(m,)` of their skin if nothing explains it.

        Where arms may be bare, skin of a hand's area costs what a hand gains by it; detected faces explain
        theirs.
        """
        assert self.skin is not None
        share, scales = self.skin[0], _scales(self.skin[0], self.image)
        across, down = self.body.hand * scales
        rows, columns = (
            np.arange(0.5 * step, length, step).astype(np.int64)
            for step, length in zip((down, across), share.shape, strict=True)
        )
        places = (np.stack(np.meshgrid(columns, rows), axis=2).reshape(-1, 2) + 0.5) / scales - 0.5
        costs = BARE_HAND_SCORES[0] / np.pi * share[np.ix_(rows, columns)].ravel().astype(np.float64)
        shown = costs > LEAST_COST
        for x, y, half_width, half_height in self.image.heads_and_necks:
            shown &= np.square((places - [x, y]) / [half_width, half_height]).sum(axis=1) > 1
        return places[shown], costs[shown]

    @cached_property
    def _face(self) -> GaussianMixtures:
        return self.image.mixtures.take([0])

    def hand_log_odds(self, poses: BodyPoses) -> Array:
        """`(n, 2)` nats: log odds that left and right hand are seen where poses have them.

        Of skin that no detected head or neck explains, and of key points. Without them the odds are those of
        a detected hand as far as it is in the image, or, if no clothes of a trunk are in view, of a hand
        among the false ones of an image.
        """
        joints = self.body.joints(poses)[:, :, :2]
        parts = joints[:, PART_JOINTS]
        places, size = parts[:, 1:] + 0.5, np.array(self.image.size[::-1])
        inside = np.minimum(places, size - places).min(axis=2) / self.body.hand
        known = HAND_DETECTED * np.clip(0.5 + 0.5 * inside, 0, 1)
        with np.errstate(divide="ignore"):
            log_odds: Array = np.log(known / (FALSE_HANDS if self.image.arms is None else 1 - known))
        if self.skin is not None:
            log_odds += SEEN * self._skin_terms(self.skin, joints, poses.roots, own=0.0)[1]
        if self.image.keypoints is not None:
            none = np.zeros((0, 2))
            log_odds += self.image.keypoints.mixtures(none, none).log_values(parts)[:, 1:]
        return log_odds

    def _skin_terms(
        self, skin: tuple[Map, Map], joints: Array, roots: Array, own: float = OWN_HEAD
    ) -> tuple[Array, Array]:
        """Nats of hands and blobs `(n,)`, log of the mixture of bare and covered forearms; of each hand."""
        body, image = self.body, self.image
        parts, elbows = joints[:, PART_JOINTS], joints[:, [3, 6]]
        scales = _scales(skin[0], image)
        if image.bare:
            places, costs = self._skin_by_area
        else:  # weighted by the probability that a blob is a hand
            places, costs = image.blobs, BLOB_COST / (1 + np.exp(-image.blob_log_weights))
        reach = body.head_height * np.array(BLOB_REACH)
        found = []
        for bare, probability in ((False, 1 - image.bare), (True, image.bare)):
            if probability > 0:
                ratio, nats = np.full(len(parts), np.log(probability)), np.empty((len(parts), 2))
                hand = hand_model(body, bare, image.heads_and_necks, own)
                hand_terms(parts, roots, elbows, *skin, scales, hand, bare, ratio, nats)
                unexplained_terms(joints, places, costs, reach, bare, ratio)
                if bare:
                    forearm_terms(parts, roots, elbows, skin[0], scales, hand, ratio)
                found.append((ratio, nats))
        if len(found) == 1:
            return found[0]
        ratios, by_case = (np.array(each) for each in zip(*found, strict=True))
        total = np.asarray(np.logaddexp(*ratios))
        return total, np.einsum("bn,bnh->nh", np.exp(ratios - total), by_case)


def hand_model(
    body: UpperBody, bare: bool = False, heads_and_necks: Array | None = None, own: float = OWN_HEAD
) -> HandModel:
    """Return the model of this body's hands, in sleeves or not.

    `heads_and_necks` `(m, 4)` px: ellipses of detected ones, centre and half axes. They explain skin, but for
    that of the pose's own head, which is within `own` of its half axes.
    """
    return HandModel(
        body.hand,
        body.hand * np.array(WINDOWS),
        0.5 * np.array([body.head_width, body.head_height]),
        NECK_RADIUS * body.head_height,
        np.array(BARE_HAND_SCORES if bare else SKIN_SCORES),
        np.array([body.forearm, 0.25 * (body.forearm_width + body.wrist_width)]),
        np.array(BARE_SCORES),
        np.zeros((0, 4)) if heads_and_necks is None else heads_and_necks,
        own,
    )


def skin_maps(skin: Map, hand: float) -> tuple[Map, Map]:
    """Return the mean skin, from 0 to 1, in Gaussian windows of a hand's size and around it.

    Skin is the positive part of the log odds: colours that are hardly like skin count for little.

    `skin` `(height, width)` float32 nats: log odds. `hand` px: radius. The maps have an entry each fifth of
    it, or each px.
    """
    shrink = min(CELLS / hand, 1.0)
    share = _share(skin, shrink)
    centre, surround = (
        np.asarray(cv2.GaussianBlur(share, (0, 0), window * shrink * hand), np.float32) for window in WINDOWS
    )
    return centre, surround


def head_map(skin: Map, body: UpperBody) -> Map:
    """Return the contrast of skin in a head's ellipse with that around it, 1 for a full ellipse alone.

    `skin` `(height, width)` float32 nats: log odds; `body`: of the head.
    """
    shrink = min(CELLS / body.hand, 1.0)
    share = _share(skin, shrink)
    across, down = 0.5 * shrink * body.head_width, 0.5 * shrink * body.head_height
    inner, outer = (
        cv2.GaussianBlur(share, (0, 0), window * across, sigmaY=window * down) for window in HEAD_WINDOWS
    )
    ideal = np.exp(-0.5 / HEAD_WINDOWS[1] ** 2) - np.exp(-0.5 / HEAD_WINDOWS[0] ** 2)
    return np.asarray((inner - outer) / np.float32(ideal), np.float32)


def _share(skin: Map, shrink: float) -> Map:
    """Skin from 0 to 1, in an image that is `shrink` times as large."""
    height, width = (max(round(shrink * length), 2) for length in skin.shape)
    coarse = cv2.resize(skin, (width, height), interpolation=cv2.INTER_AREA)
    return np.maximum(coarse, np.float32(0)) * np.float32(1 / HIGHEST)


def _scales(coarse: Map, image: BodyImage) -> Array:
    """`(2,)`: entries of a coarse map a px of the image, along x and y."""
    return np.divide(coarse.shape[1::-1], image.size[::-1])


def edge_ratios(image: BodyImage, std: float, window: float) -> Map:
    """Return likelihood ratio (at an outline against nearby) and direction of the edge near each pixel.

    The density of edges nearby is the image's own: before a bookcase one more edge is little evidence, one
    across its boards much. The density of directions is taken to its first harmonic.

    `std` px: standard deviation of edges about an outline; `window` px: standard deviation of the window of
    the density. Returns `(rows, columns, 3)` float32 of the maps of edges: the ratio, cosine and sine of
    twice the angle of the edge's normal.
    """
    height, width = image.edges.shape
    window *= height / image.size[0]
    reach = max(float(image.edges.max()), 1.0)
    levels = np.linspace(0, 1, LEVELS)
    near = np.exp(-0.5 * (levels * reach / std) ** 2)
    near[-1] = 0  # distances are capped: the last one stands for any beyond
    turns = 2 * np.pi * levels
    block = max(round(window / DENSITY_CELLS), 1)
    ratios = np.empty((height, width, 3), np.float32)
    coarse = np.empty((max(-(-height // block), 2), max(-(-width // block), 2), 3), np.float32)
    edge_features(
        image.edges, image.edge_directions,
        near.astype(np.float32), np.cos(turns).astype(np.float32), np.sin(turns).astype(np.float32),
        (LEVELS - 1) / np.array([reach, np.pi]), block, ratios, coarse,
    )  # fmt: skip
    coarse = np.asarray(cv2.GaussianBlur(coarse, (0, 0), window / block), np.float32)
    over_density(ratios, coarse, block, LEAST_EDGES, LEAST_ALIKE)
    return ratios
