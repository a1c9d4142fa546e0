"""Positions of head and hands in the image: the feature node of body trackers, and its message."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..core.checks import Positive, Shape, between, checked
from ..core.frame import BoundingBox, Frame
from ..core.gaussian_mixtures import GaussianMixtures, log_sums
from ..core.short_repr import short_repr
from ..face.detectors import HaarFaces, PartDetector, confirmed_faces
from ..numerics.threads import side_by_side
from .image_features import BodyImage, SkinBlobs, edge_distances, skin_blobs
from .keypoints import SeenKeypoints
from .person import (
    REACH,
    ClothesColour,
    OtherFaces,
    bare_probability,
    find_face_at,
    find_largest_face,
    hand_area,
    track_face,
)
from .skin import HIGHEST, SkinColour, face_ellipses, smoothed, static_skin
from .upper_body import PARTS

Array = NDArray[np.float64]

MOST_HYPOTHESES = 16  # of a product: those of the greatest mass

N_PARTS = len(PARTS)


@short_repr
@dataclass(frozen=True, eq=False)
class PartMessage:
    """Message about the parts' positions, from chains and from the image.

    Chains send joint hypotheses, with a mixture for each part:

        p(F) = sum_h exp(log_hypotheses[h]) prod_part m_h,part(F_part)

    The evidence of the image is stored separately: likelihoods of whole bodies use more of it than its
    mixtures.

    Raises `ValueError` if there are not three mixtures for each hypothesis, or for NaN or infinity in one.
    """

    # product of the chains' messages: the mixtures of all hypotheses, one after the other, H times 3
    stacked: GaussianMixtures
    image: BodyImage | None = None  # evidence of the image; `None` without any
    # `(H,)` log weights; one hypothesis by default
    log_hypotheses: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        if self.stacked.n_parts != N_PARTS * len(self.log_hypotheses):
            raise ValueError(
                f"part message: got {self.stacked.n_parts} mixtures, expected {N_PARTS} for each of "
                f"{len(self.log_hypotheses)} hypotheses"
            )
        mixtures = self.stacked
        used = ~mixtures.flat & (mixtures.log_weights > -np.inf)
        places = mixtures.means[used], mixtures.covariances[used]
        weights = mixtures.log_weights, self.log_hypotheses
        if not (
            all(np.isfinite(each).all() for each in places) and all((each < np.inf).all() for each in weights)
        ):
            raise ValueError("part message: got NaN or infinity, expected finite numbers")

    @property
    def predicted(self) -> GaussianMixtures:
        """Marginals of the chains' product; hypotheses count by their mass, flat components as 1."""
        return self._marginals(self.stacked, self.log_hypotheses)

    @cached_property
    def mixtures(self) -> GaussianMixtures:
        """Marginals of the product of chains and image."""
        return self._marginals(self._with_image, self.log_hypotheses)

    @property
    def log_mass(self) -> float:
        """Log of the integral over all parts' positions."""
        masses = self._with_image.log_masses.reshape(-1, N_PARTS).sum(axis=1)
        return float(log_sums(self.log_hypotheses + masses))

    def log_values(self, places: Array) -> Array:
        """`(n,)` nats: log density of the chains' product at `places`, `(n, 3, 2)` px."""
        return self.stacked.log_joint_values(places, self.log_hypotheses)

    def __mul__(self, other: Self) -> Self:
        """Multiply all pairs of hypotheses, and keep the `MOST_HYPOTHESES` of the greatest mass."""
        if self.image is not None and other.image is not None:
            raise ValueError("part message: got two images, expected at most one")
        ours, theirs = np.indices((len(self.log_hypotheses), len(other.log_hypotheses))).reshape(2, -1)
        product = self._of(ours) * other._of(theirs)
        weights = self.log_hypotheses[ours] + other.log_hypotheses[theirs]
        if len(weights) > MOST_HYPOTHESES:
            masses = weights + product.log_masses.reshape(-1, N_PARTS).sum(axis=1)
            kept = np.sort(np.argsort(-masses, kind="stable")[:MOST_HYPOTHESES])
            product, weights = product.take(_rows(kept)), weights[kept]
        return type(self)(product, self.image or other.image, weights)

    def _of(self, hypotheses: NDArray[np.intp]) -> GaussianMixtures:
        return self.stacked.take(_rows(hypotheses))

    @property
    def _with_image(self) -> GaussianMixtures:
        if self.image is None:
            return self.stacked
        rows = np.tile(np.arange(N_PARTS), len(self.log_hypotheses))
        return self.stacked * self.image.mixtures.take(rows)

    @staticmethod
    def _marginals(stacked: GaussianMixtures, log_hypotheses: Array) -> GaussianMixtures:
        if len(log_hypotheses) == 1:
            return stacked
        masses = log_sums(stacked.log_weights).reshape(-1, N_PARTS)
        others = masses.sum(axis=1, keepdims=True) - masses + log_hypotheses[:, None]
        return stacked.pooled(N_PARTS, others.ravel())


def _rows(hypotheses: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows of the parts of some hypotheses."""
    return np.asarray((N_PARTS * hypotheses[:, None] + np.arange(N_PARTS)).ravel())


HEAD_OF_BOX = 1.33  # head from chin to skull over the height of a detector's box
CENTRE_OF_BOX = 0.4  # of the box's height, from above: the head's centre

HEAD_STD = (0.13, 0.1)
"""Head heights, across and down: standard deviation of the head's centre about that point of the box. A head
that is turned away reaches further to one side than its face."""

HAND_RADIUS = 0.3  # head heights
EDGE_REACH = 1 / 6  # head heights: bound of distances to edges

HEAD_ELLIPSE, NECK_ELLIPSE = (0.0, 0.0, 0.38, 0.49), (0.0, 0.62, 0.26, 0.32)
"""Head heights: centres, from the head's, and half axes of the skin of face and throat."""

HEAD_BLOB = 0.42  # head heights: radius of the disc of skin that stands for a head without a detected face
KNOWN = 0.35  # head heights: standard deviation below which the chains' prediction of the head is used
SEARCHED = 1.25  # head heights to each side of a predicted head in which its face is searched for

ANYWHERE = 5
"""In one of so many frames, cascades search the whole image for faces, wherever the head is predicted: so a
chain that tracks something else recovers."""

FACE_DETECTED, FALSE_FACES = 0.8, 0.05  # detection probability of a face, and false ones in an image
HEAD_DETECTED, FALSE_HEADS = 0.6, 3.0  # the same of a head's blob of skin
HAND_DETECTED, FALSE_HANDS = 0.8, 4.0  # the same of a hand's blob
RING = (
    1.2,
    2.2,
)  # hand radii: about a hand at rest, in which an arm leads to it; the outer one holds its skin
CALIBRATION_FRAMES = 24  # frames of a clip in which faces are detected at first, evenly spread


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class BodyParts:
    """Feature node of the positions of head and hands in an image.

    Parameters
    ----------
    head_height
        px, from chin to skull: the unit of all sizes.
    skin
        the person's skin colour; without it (grey video), edges are the only evidence of the hands.
    detector
        of faces; without it, the head is a disc of skin.
    static_skin
        `(height, width)` nats: log odds of static skin-coloured clutter, from `static_skin`.
    bare
        probability that forearms are bare.
    others
        faces of other people.
    clothes
        colours of the person's clothes.
    """

    head_height: Positive
    skin: SkinColour | None = None
    detector: PartDetector | None = None
    static_skin: Annotated[NDArray[np.float32], Shape("height", "width")] | None = None
    bare: Annotated[float, between(0, 1)] = 0.0
    others: OtherFaces | None = None
    clothes: ClothesColour | None = None
    name: str = "parts"

    searches = True

    @classmethod
    def learned(
        cls, images: Sequence[NDArray[np.uint8]], detector: PartDetector, face: BoundingBox | None = None
    ) -> Self:
        """Learn head size, skin colour and clothes from the faces detected in some frames of a clip.

        Unless `face` is given, the person is selected below whose face most hands move; of equal ones, that
        with the largest face. Faces of others are kept in `OtherFaces`.

        Parameters
        ----------
        images
            frames of the clip.
        detector
            of faces.
        face
            x, y, width, height px: approximate face of the person in the first image with a face.

        Raises
        ------
        ValueError
            if no face is detected, or none is confirmed by a second look and `face` is not given.
        """
        chosen = np.unique(
            np.linspace(0, len(images) - 1, min(len(images), CALIBRATION_FRAMES)).round().astype(int)
        )
        faces = [detector(Frame(images[number], 0.0, int(number) + 1)) for number in chosen]
        if not any(map(len, faces)):
            raise ValueError(f"images: got no face in {len(chosen)} of {len(images)}, expected one at least")
        if face is None:
            sure = [confirmed_faces(images[k], each, detector) for k, each in zip(chosen, faces, strict=True)]
            own = _with_most_hands([images[number] for number in chosen], faces, sure)
        else:
            own = track_face(faces, find_face_at(faces, np.array(face)))
        seen = [images[number] for number, one in zip(chosen, own, strict=True) if one is not None]
        boxes = np.array([each[one] for each, one in zip(faces, own, strict=True) if one is not None])
        height = float(np.median(boxes[:, 3]))
        if isinstance(detector, HaarFaces):
            detector = replace(detector, height=height)
        skin = SkinColour.learned(seen, boxes)
        still = None if skin is None else static_skin(skin, [images[number] for number in chosen])
        node = cls(HEAD_OF_BOX * height, skin, detector, still, others=OtherFaces.learned(faces, own))
        return node.dressed(seen, boxes)

    def dressed(self, images: Sequence[NDArray[np.uint8]], boxes: Array) -> Self:
        """Learn the person's clothes from images, given the face in each, `(n, 4)` px."""
        if self.skin is None:
            return self
        heads = _centres(boxes)
        clothes = ClothesColour.learned(images, heads, self.head_height, self.skin)
        dressed = replace(self, bare=self.bare_forearms(images, boxes), clothes=clothes)
        return replace(dressed, static_skin=dressed._without_resting_hands(images, heads))

    def _without_resting_hands(
        self, images: Sequence[NDArray[np.uint8]], heads: Array
    ) -> NDArray[np.float32] | None:
        """Remove what is rather a hand at rest than a thing from the static skin; `heads` are `(n, 2)` px.

        The odds are those of a blob that is a hand against clutter, times those of an arm around it against
        background, times those that a hand is missing, that moving skin shows fewer than two.
        """
        if self.static_skin is None or self.skin is None or self.clothes is None:
            return self.static_skin
        height, radius = self.head_height, HAND_RADIUS * self.head_height
        rate, arms = 0.0, []
        for image, head in zip(images, heads, strict=True):
            ellipses = _face_and_neck(head[None], height)
            colours = smoothed(image)
            skin = self.skin.log_odds_of(colours)
            blobs = skin_blobs(self._moving(skin, ellipses[0]), radius, np.concatenate(ellipses))
            rate += min(float(expit(blobs.log_weights).sum()), 2.0) / 2
            arms.append(self.clothes.arm_map(colours, height))
        missing = 1 - (rate + 0.5) / (len(images) + 1)  # Jeffreys' prior
        prior = np.log(HAND_DETECTED / FALSE_HANDS * missing / (1 - missing))
        arm = cv2.resize(np.mean(arms, axis=0), self.static_skin.shape[::-1])
        still = np.where(self.static_skin > 0, self.static_skin, np.float32(-HIGHEST))
        centre = np.median(heads, axis=0)[None]
        ellipses = _face_and_neck(centre, height)
        things, kept = skin_blobs(still, radius, np.concatenate(ellipses)), self.static_skin.copy()
        rows, columns = np.ogrid[: still.shape[0], : still.shape[1]]
        for (x, y), log_weight in zip(things.means, things.log_weights, strict=True):
            away = np.hypot(columns - x, rows - y) / radius
            leads = np.median(arm[(away > RING[0]) & (away < RING[1])])
            if log_weight + leads + prior > 0:
                kept[away < RING[1]] = 0
        return kept

    def bare_forearms(self, images: Sequence[NDArray[np.uint8]], boxes: Array) -> float:
        """Return the probability of bare forearms, from images and the face in each, `(n, 4)` px."""
        if self.skin is None:
            return 0.0
        height, areas = self.head_height, []
        for image, box in zip(images, boxes, strict=True):
            ellipses = _face_and_neck(_centres(box[None]), height)
            skin = self._moving(self.skin.log_odds(image), ellipses[0])
            areas.append(hand_area(skin, np.concatenate(ellipses), HAND_RADIUS * height, height))
        return bare_probability(areas)

    def uniform(self) -> PartMessage:
        """Return the constant message 1."""
        return PartMessage(GaussianMixtures.uniform(len(PARTS)))

    def evidence(self, frame: Frame, prior: PartMessage) -> PartMessage:
        """Detect the three parts, and compute the features for likelihoods of whole bodies.

        Each part's mixture is a likelihood ratio of the detections, with the part at F against clutter:
        (1 - P) + sum_k P / (density of clutter per px^2) w_k N(F; m_k, S_k), with detection probability P.
        Without detections it is flat. Both hands have the same blobs, which labels identify.

        Parameters
        ----------
        frame
            a missing one has the uniform message.
        prior
            gives the head if no face is detected, and selects the person among several keypoints.
        """
        image = frame.image
        if image is None:
            return self.uniform()
        height = self.head_height
        colours = None if self.skin is None else smoothed(image)
        skin = None if self.skin is None or colours is None else self.skin.log_odds_of(colours)
        known_head = self._known_head(prior, image.shape)
        works: list[Callable[[], Any]] = [
            partial(self._faces, frame, known_head),
            partial(edge_distances, image, EDGE_REACH * height),
            partial(self._arms, colours),
        ]
        faces, (edges, directions), arms = side_by_side(works)
        centres = _centres(faces)
        if skin is not None:
            centres = _recentred(centres, skin, height)
        of_head = np.diag(np.square(np.array(HEAD_STD) * height))
        covariances = np.broadcast_to(of_head, (len(faces), 2, 2)).copy()
        heads = SkinBlobs(centres, covariances, np.zeros(len(faces)))
        near = (np.linalg.norm(centres[:, None] - known_head, axis=2) < height).any(axis=1)
        hands, moving = SkinBlobs.none(), None
        area = image.shape[0] * image.shape[1]
        detected, false = FACE_DETECTED, np.full(len(faces), FALSE_FACES / area)
        if self.others is not None:
            false += self.others.density(faces[:, :2] + 0.5 * faces[:, 2:])
        if skin is not None:
            known = centres if near.any() else np.concatenate([centres, known_head])
            bare = _face_and_neck(known, height)
            moving = self._moving(skin, bare[0])
            hands = skin_blobs(moving, HAND_RADIUS * height, np.concatenate(bare))
            if not len(faces):
                heads, detected = skin_blobs(skin, HEAD_BLOB * height), HEAD_DETECTED
                false = np.full(len(heads.means), FALSE_HEADS / area)
        hand_weights = np.log(HAND_DETECTED * area / FALSE_HANDS) + hands.log_weights
        lost_head = np.log(1 - detected) if len(heads.means) else 0.0
        lost_hand = np.log(1 - HAND_DETECTED) if len(hands.means) else 0.0
        numbers = np.arange(len(hands.means))
        mixtures = GaussianMixtures.of_parts(
            [np.log(detected / false) + heads.log_weights, hand_weights, hand_weights],
            [heads.means, hands.means, hands.means],
            [heads.covariances, hands.covariances, hands.covariances],
            [lost_head, lost_hand, lost_hand],
            [len(numbers) + np.arange(len(heads.means)), numbers, numbers],
        )
        points = None
        if frame.keypoints is not None:
            heads_known = known_head if len(known_head) else centres
            points = SeenKeypoints.of(frame.keypoints, heads_known, height)
        if points is not None:
            mixtures = mixtures * points.mixtures(hands.means, heads.means)
        shown = faces[near] if len(known_head) else faces
        seen = BodyImage(
            image.shape[:2], skin, moving, edges, directions,
            hands.means, hands.log_weights, mixtures, points, self.bare, arms,
            np.concatenate(_face_and_neck(_centres(shown), height)),
        )  # fmt: skip
        return PartMessage(self.uniform().stacked, seen)

    def _faces(self, frame: Frame, known_head: Array) -> Array:
        """Detect faces: boxes `(k, 4)` px, largest first. Cascades search about a predicted head."""
        image = frame.image
        if self.detector is None or image is None:
            return np.zeros((0, 4))
        if isinstance(self.detector, HaarFaces) and frame.number % ANYWHERE:
            for x, y in known_head:
                reach = SEARCHED * self.head_height
                left, top, right, bottom = (
                    int(max(end, 0)) for end in (x - reach, y - reach, x + reach, y + reach)
                )
                about = np.ascontiguousarray(image[top:bottom, left:right])
                if min(about.shape[:2]) > self.head_height:
                    boxes = self.detector(
                        replace(frame, image=about, boxes=None, points=None, keypoints=None)
                    )
                    return np.asarray(np.add(boxes, (left, top, 0, 0)))
        return self.detector(frame)

    def _moving(self, skin: NDArray[np.float32], faces: Array) -> NDArray[np.float32]:
        """Subtract the static skin, but not in faces, since heads move."""
        if self.static_skin is None or self.static_skin.shape != skin.shape:
            return skin
        still = self.static_skin.copy()
        for x, y, across, down in faces:
            cv2.ellipse(still, ((x, y), (2 * across, 2 * down), 0.0), 0.0, cv2.FILLED)
        return np.asarray(np.maximum(skin - still, np.float32(-HIGHEST)))

    def _arms(self, colours: NDArray[np.uint8] | None) -> NDArray[np.float32] | None:
        if self.clothes is None or colours is None:
            return None
        return self.clothes.arm_map(colours, self.head_height)

    def _known_head(self, prior: PartMessage, shape: tuple[int, ...]) -> Array:
        """`(k, 2)` px: the head's centre predicted by the chains; k is 0 where they are uncertain."""
        means, covariances = prior.predicted.moments(float(shape[0] * shape[1]), (shape[1] / 2, shape[0] / 2))
        known = np.linalg.eigvalsh(covariances[0])[-1] < (KNOWN * self.head_height) ** 2
        return means[:1] if known else np.zeros((0, 2))


def _with_most_hands(
    images: Sequence[NDArray[np.uint8]], faces: Sequence[Array], sure: Sequence[Array]
) -> list[int | None]:
    """Return the face of one person in every image, as `track_face`: that with most hands, or the largest.

    `faces`, `sure`: by image, `(k, 4)` px: all faces, and those of them with which a person may begin. Who is
    found less than half as often as somebody else is nobody.
    """
    people: list[list[int | None]] = []
    left = list(sure)
    while not people or any(map(len, left)):
        picture, which = find_largest_face(left)
        face = int((faces[picture] == left[picture][which]).all(axis=1).argmax())
        people.append(track_face(faces, (picture, face)))
        for k, one in enumerate(people[-1]):
            if one is not None:
                left[k] = left[k][(left[k] != faces[k][one]).any(axis=1)]
    found = [{k: faces[k][one] for k, one in enumerate(own) if one is not None} for own in people]
    often = [k for k, boxes in enumerate(found) if 2 * len(boxes) >= max(map(len, found))]
    if len(often) == 1:
        return people[often[0]]
    ranks = {}
    for person in often:
        boxes, where = np.array([*found[person].values()]), list(found[person])
        hands = _hands_below([images[k] for k in where], boxes, [faces[k] for k in where])
        ranks[person] = round(hands), float(np.median(boxes[:, 3]))
    return people[max(ranks, key=lambda person: ranks[person])]


def _hands_below(images: Sequence[NDArray[np.uint8]], boxes: Array, faces: Sequence[Array]) -> float:
    """Return how many hands move within reach below a person's face, in boxes `(n, 4)` px, on average.

    `faces`: by image, `(k, 4)` px, of all people. A hand is that of the nearest face, in units of its height.
    """
    skin = SkinColour.learned(images, boxes)
    if skin is None:
        return 0.0
    still, total = static_skin(skin, images), 0.0
    for image, box, others in zip(images, boxes, faces, strict=True):
        height = HEAD_OF_BOX * box[3]
        odds = skin.log_odds(image) - (0 if still is None else still)
        blobs = skin_blobs(
            np.maximum(odds, np.float32(-HIGHEST)), HAND_RADIUS * height, face_ellipses(others)
        )
        steps = (blobs.means[:, None] - others[:, :2] - 0.5 * others[:, 2:]) / others[:, 3:]
        away = np.linalg.norm(steps, axis=2)
        own = (others == box).all(axis=1).argmax()
        theirs = (
            (away.argmin(axis=1) == own) & (away[:, own] < REACH * HEAD_OF_BOX) & (steps[:, own, 1] > 0.5)
        )
        total += min(float(expit(blobs.log_weights[theirs]).sum()), 2.0)
    return total / len(images)


def _centres(faces: Array) -> Array:
    """Centres of heads `(k, 2)` px whose faces have boxes `(k, 4)`."""
    return np.asarray(faces[:, :2] + faces[:, 2:] * (0.5, CENTRE_OF_BOX))


def _face_and_neck(heads: Array, height: float) -> tuple[Array, Array]:
    """Ellipses of the skin of heads `(k, 2)` px and of their necks: `(k, 4)` px, centre and half axes."""
    still = np.hstack([heads, np.zeros_like(heads)])
    return still + height * np.array(HEAD_ELLIPSE), still + height * np.array(NECK_ELLIPSE)


def _recentred(centres: Array, skin: NDArray[np.float32], height: float) -> Array:
    """Move heads `(k, 2)` px sideways to the middle of their skin: faces that look away are off it."""
    moved = centres.copy()
    columns = np.arange(skin.shape[1])
    for centre in moved:
        x, y = centre
        top, bottom = (int(np.clip(y + step * height, 0, skin.shape[0])) for step in (-0.35, 0.25))
        odds = skin[top:bottom]
        share = (odds > 0).sum(axis=0) * (np.abs(columns - x) < 0.55 * height)
        if share.any():
            centre[0] = x + np.clip(share @ columns / share.sum() - x, -0.2 * height, 0.2 * height)
    return moved
