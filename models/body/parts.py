"""Where head and hands are in a picture: the feature node on which body trackers meet, and its message."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.frame import BoundingBox, Frame
from ..core.gaussian_mixtures import GaussianMixtures, log_sums
from ..core.pictures import draw_region
from ..core.short_repr import short_repr
from ..face.detectors import HaarFaces, PartDetector
from ..numerics.threads import side_by_side
from .image_features import BodyImage, SkinBlobs, edge_distances, skin_blobs
from .keypoints import SeenKeypoints
from .person import (
    ClothesColour,
    OtherFaces,
    bare_probability,
    find_face_at,
    find_largest_face,
    hand_area,
    track_face,
)
from .skin import HIGHEST, SkinColour, smoothed, static_skin
from .upper_body import PARTS

Array = NDArray[np.float64]

MOST_HYPOTHESES = 16  # of a product; of more, those of the least mass are left out

N_PARTS = len(PARTS)


@short_repr
@dataclass(frozen=True, eq=False)
class PartMessage:
    """What is said of the parts' positions, by chains and by the image.

    Chains say joint hypotheses, in which each part has a mixture of its own:

        p(F) = sum_h exp(log_hypotheses[h]) prod_part m_h,part(F_part)

    What the image says is kept apart, since who compares whole bodies with the image reads it better than its
    mixtures can say.

    Raises `ValueError` if there are not three mixtures for each hypothesis.
    """

    # product of the chains' messages: the mixtures of all hypotheses, one after the other, H times 3
    stacked: GaussianMixtures
    image: BodyImage | None = None  # what the image says; `None` where it says nothing
    # `(H,)` log weights; of one hypothesis, unless given
    log_hypotheses: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        if self.stacked.n_parts != N_PARTS * len(self.log_hypotheses):
            raise ValueError(
                f"part message: got {self.stacked.n_parts} mixtures, expected {N_PARTS} for each of "
                f"{len(self.log_hypotheses)} hypotheses"
            )

    @property
    def predicted(self) -> GaussianMixtures:
        """What chains say of each part, whatever holds for the others.

        A hypothesis counts by its mass; flat components count as 1.
        """
        return self._marginals(self.stacked, self.log_hypotheses)

    @cached_property
    def mixtures(self) -> GaussianMixtures:
        """The same of the product of all, the image among them."""
        return self._marginals(self._all_said, self.log_hypotheses)

    @property
    def log_mass(self) -> float:
        """Log of the integral over all parts' positions."""
        masses = self._all_said.log_masses.reshape(-1, N_PARTS).sum(axis=1)
        return float(log_sums(self.log_hypotheses + masses))

    def log_values(self, places: Array) -> Array:
        """`(n,)` nats: what chains say of parts at `places`, `(n, 3, 2)` px."""
        return self.stacked.log_joint_values(places, self.log_hypotheses)

    def __mul__(self, other: Self) -> Self:
        """Every hypothesis of one with every one of the other; the `MOST_HYPOTHESES` of the greatest mass."""
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
    def _all_said(self) -> GaussianMixtures:
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
    """Where the parts of some hypotheses are."""
    return np.asarray((N_PARTS * hypotheses[:, None] + np.arange(N_PARTS)).ravel())


HEAD_OF_BOX = 1.33  # head from chin to skull over the height of a detector's box
CENTRE_OF_BOX = 0.4  # of the box's height, from above: the head's centre

HEAD_SPREAD = (0.13, 0.1)
"""Of the head's height: standard deviation of its centre about that place. A head that is turned away reaches
further to one side than its face."""

HAND_RADIUS = 0.3  # of the head's height
EDGE_REACH = 1 / 6  # of the head's height: as far as an edge is felt

HEAD_ELLIPSE, NECK_ELLIPSE = (0.0, 0.0, 0.38, 0.49), (0.0, 0.62, 0.26, 0.32)
"""In head heights: centres, from the head's, and half axes of what the skin of face and throat fills."""

HEAD_BLOB = 0.42  # of the head's height: radius of the disc of skin that a head is without a face detector
KNOWN = 0.35  # of the head's height: where chains know its place better than this, they show where it is
SOUGHT = 1.25  # head heights to each side of a head whose place is known: there its face is sought first

ANYWHERE = 5
"""Of so many frames, faces are sought in the whole picture in one, wherever the head is taken to be: chains
that follow something else see the person again."""

FACE_FOUND, FALSE_FACES = 0.8, 0.05  # chance that a face is detected, and number of false ones in an image
HEAD_SKIN, FALSE_HEADS = 0.6, 3.0  # the same of a head's blob of skin
HAND_FOUND, FALSE_HANDS = 0.8, 4.0  # the same of a hand's blob
COLOURS = ((60, 220, 60), (60, 60, 255), (255, 190, 40))  # BGR, of parts that are drawn
CALIBRATION_FRAMES = 24  # frames of a clip that are looked at for faces, evenly spread


@short_repr
@dataclass(frozen=True, eq=False)
class BodyParts:
    """Feature node of the places of head and hands in a picture.

    Parameters
    ----------
    head_height
        px, from chin to skull: all sizes are in its units.
    skin
        the person's skin colour; without it (grey video), the image says nothing of the hands but edges.
    detector
        of faces; without it, the head is where a head's size of skin is.
    static_skin
        `(height, width)` nats: `static_skin` of the clip, from which hands are distinguished.
    bare
        probability that forearms are bare: of skin, as hands are.
    others
        where other people's faces are seen.
    """

    head_height: float
    skin: SkinColour | None = None
    detector: PartDetector | None = None
    static_skin: NDArray[np.float32] | None = None
    bare: float = 0.0
    others: OtherFaces | None = None
    clothes: ClothesColour | None = None
    name: str = "parts"

    searches = True

    def __post_init__(self) -> None:
        if not 0 < self.head_height < np.inf:
            raise ValueError(f"head_height: got {self.head_height} px, expected more than 0")

    @classmethod
    def learned(
        cls, images: Sequence[NDArray[np.uint8]], detector: PartDetector, face: BoundingBox | None = None
    ) -> Self:
        """Learn the head's size and the skin's colour from the faces found in some frames of a clip.

        Of several people it is the one whose face is largest, unless `face` tells; faces of others are
        expected where they are seen.

        Parameters
        ----------
        images
            frames of the clip.
        detector
            of faces.
        face
            x, y, width, height px: about where the person's is in the first image in which there are any.

        Raises
        ------
        ValueError
            if there is a face in none of them.
        """
        chosen = np.unique(
            np.linspace(0, len(images) - 1, min(len(images), CALIBRATION_FRAMES)).round().astype(int)
        )
        found = [detector(Frame(images[number], 0.0, int(number) + 1)) for number in chosen]
        if not any(map(len, found)):
            raise ValueError(f"images: got no face in {len(chosen)} of {len(images)}, expected one at least")
        own = track_face(
            found, find_largest_face(found) if face is None else find_face_at(found, np.array(face))
        )
        seen = [images[number] for number, one in zip(chosen, own, strict=True) if one is not None]
        boxes = np.array([faces[one] for faces, one in zip(found, own, strict=True) if one is not None])
        height = float(np.median(boxes[:, 3]))
        if isinstance(detector, HaarFaces):
            detector = replace(detector, height=height)
        skin = SkinColour.learned(seen, boxes)
        still = None if skin is None else static_skin(skin, [images[number] for number in chosen])
        known = cls(HEAD_OF_BOX * height, skin, detector, still, others=OtherFaces.learned(found, own))
        return known.dressed(seen, boxes)

    def dressed(self, images: Sequence[NDArray[np.uint8]], boxes: Array) -> Self:
        """The same with what images say of the person's clothes, given the face in each, `(n, 4)` px."""
        if self.skin is None:
            return self
        heads = boxes[:, :2] + boxes[:, 2:] * (0.5, CENTRE_OF_BOX)
        clothes = ClothesColour.learned(images, heads, self.head_height, self.skin)
        return replace(self, bare=self.bare_forearms(images, boxes), clothes=clothes)

    def bare_forearms(self, images: Sequence[NDArray[np.uint8]], boxes: Array) -> float:
        """Probability that forearms are bare, from images and the person's face in each, `(n, 4)` px."""
        if self.skin is None:
            return 0.0
        height, areas = self.head_height, []
        for image, box in zip(images, boxes, strict=True):
            centre = box[None, :2] + box[None, 2:] * (0.5, CENTRE_OF_BOX)
            ellipses = [_ellipses(centre, shape, height) for shape in (HEAD_ELLIPSE, NECK_ELLIPSE)]
            skin = self._moving(self.skin.log_odds(image), ellipses[0])
            areas.append(hand_area(skin, np.concatenate(ellipses), HAND_RADIUS * height, height))
        return bare_probability(areas)

    def uniform(self) -> PartMessage:
        """The message that says nothing."""
        return PartMessage(GaussianMixtures.uniform(len(PARTS)))

    def evidence(self, frame: Frame, prior: PartMessage) -> PartMessage:
        """What the image says of the three parts, and all that a likelihood of whole bodies asks of it.

        Each part's mixture is the ratio of two probabilities, of what is detected with the part at F and of
        the same as clutter: (1 - P) + sum_k P / (clutter's density per px^2) w_k N(F; m_k, S_k), P being the
        chance of a detection. What is not detected at all is thus flat, and a frame without detections says
        nothing of where the parts are. Both hands have the same blobs, by their numbers as labels.

        Parameters
        ----------
        frame
            of a missing one, nothing is said.
        prior
            shows where the head is when no face is detected, so that hands are distinguished from its skin;
            and whose of several persons' keypoints count.
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
            partial(self._arms, colours, skin),
        ]
        faces, (edges, directions), arms = side_by_side(works)
        centres = faces[:, :2] + faces[:, 2:] * (0.5, CENTRE_OF_BOX)
        if skin is not None:
            centres = _recentred(centres, skin, height)
        spread = np.diag(np.square(np.array(HEAD_SPREAD) * height))
        covariances = np.broadcast_to(spread, (len(faces), 2, 2)).copy()
        heads = SkinBlobs(centres, covariances, np.zeros(len(faces)))
        hands, moving = SkinBlobs.none(), None
        area = image.shape[0] * image.shape[1]
        found, false = FACE_FOUND, np.full(len(faces), FALSE_FACES / area)
        if self.others is not None:
            false += self.others.density(faces[:, :2] + 0.5 * faces[:, 2:])
        if skin is not None:
            near = np.linalg.norm(centres[:, None] - known_head, axis=2) < height
            known = centres if near.any() else np.concatenate([centres, known_head])
            faces_there = _ellipses(known, HEAD_ELLIPSE, height)
            moving = self._moving(skin, faces_there)
            bare = (
                [faces_there] if moving is not skin else [faces_there, _ellipses(known, NECK_ELLIPSE, height)]
            )
            hands = skin_blobs(moving, HAND_RADIUS * height, np.concatenate(bare))
            if not len(faces):
                heads, found = skin_blobs(skin, HEAD_BLOB * height), HEAD_SKIN
                false = np.full(len(heads.means), FALSE_HEADS / area)
        hand_weights = np.log(HAND_FOUND * area / FALSE_HANDS) + hands.log_weights
        lost_head = np.log(1 - found) if len(heads.means) else 0.0
        lost_hand = np.log(1 - HAND_FOUND) if len(hands.means) else 0.0
        numbers = np.arange(len(hands.means))
        mixtures = GaussianMixtures.of_parts(
            [np.log(found / false) + heads.log_weights, hand_weights, hand_weights],
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
        seen = BodyImage(
            skin, moving, edges, directions, hands.means, hands.log_weights, mixtures, points, self.bare, arms
        )
        return PartMessage(self.uniform().stacked, seen)

    def draw(self, picture: NDArray[np.uint8], belief: PartMessage) -> None:
        """Draw into a BGR picture where head and hands are to 90 %, as far as that is known."""
        height, width = picture.shape[:2]
        moments = belief.mixtures.moments(float(height * width), (width / 2, height / 2))
        for mean, covariance, colour in zip(*moments, COLOURS, strict=True):
            draw_region(picture, mean, covariance, colour)

    def _faces(self, frame: Frame, known_head: Array) -> Array:
        """`(k, 4)` px: boxes of faces, largest first. Cascades look about a known head first."""
        image = frame.image
        if self.detector is None or image is None:
            return np.zeros((0, 4))
        if isinstance(self.detector, HaarFaces) and frame.number % ANYWHERE:
            for x, y in known_head:
                reach = SOUGHT * self.head_height
                left, top, right, bottom = (
                    int(max(end, 0)) for end in (x - reach, y - reach, x + reach, y + reach)
                )
                about = np.ascontiguousarray(image[top:bottom, left:right])
                if min(about.shape[:2]) > self.head_height:
                    found = self.detector(
                        replace(frame, image=about, boxes=None, points=None, keypoints=None)
                    )
                    if len(found):
                        return np.asarray(np.add(found, (left, top, 0, 0)))
        return self.detector(frame)

    def _moving(self, skin: NDArray[np.float32], faces: Array) -> NDArray[np.float32]:
        """Skin less what is there all the time; but of faces none is lost, since heads move."""
        if self.static_skin is None or self.static_skin.shape != skin.shape:
            return skin
        still = self.static_skin.copy()
        for x, y, across, down in faces:
            cv2.ellipse(still, ((x, y), (2 * across, 2 * down), 0.0), 0.0, cv2.FILLED)
        return np.asarray(np.maximum(skin - still, np.float32(-HIGHEST)))

    def _arms(
        self, colours: NDArray[np.uint8] | None, skin: NDArray[np.float32] | None
    ) -> NDArray[np.float32] | None:
        if self.clothes is None or colours is None or skin is None:
            return None
        return self.clothes.arm_map(colours, self.head_height, skin, self.bare)

    def _known_head(self, prior: PartMessage, shape: tuple[int, ...]) -> Array:
        """`(k, 2)` px: the head's centre, k = 1, if the chains know it."""
        means, covariances = prior.predicted.moments(float(shape[0] * shape[1]), (shape[1] / 2, shape[0] / 2))
        known = np.linalg.eigvalsh(covariances[0])[-1] < (KNOWN * self.head_height) ** 2
        return means[:1] if known else np.zeros((0, 2))


def _ellipses(heads: Array, shape: tuple[float, ...], height: float) -> Array:
    """`(k, 4)` px: an ellipse each of heads `(k, 2)`."""
    return np.hstack([heads, np.zeros_like(heads)]) + height * np.array(shape)


def _recentred(centres: Array, skin: NDArray[np.float32], height: float) -> Array:
    """Heads `(k, 2)` px moved sideways to the middle of their skin, which a face that looks away is not."""
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
