"""Key points of persons from a detector, as evidence of a body's pose."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Positive, Shape
from ..core.frame import KEYPOINTS, GivenKeypoints
from ..core.gaussian_mixtures import GaussianMixtures
from ..core.short_repr import short_repr
from .kernels import keypoint_terms
from .upper_body import JOINTS, PARTS, PROPORTIONS, UpperBody

Array = NDArray[np.float64]

DEVIATIONS = {"head": 0.12, "neck": 0.15, "shoulder": 0.15, "elbow": 0.12, "hand": 0.12, "wrist": 0.15}
"""Head heights: standard deviation of a detected point about that of the model. Networks err by about 0.05 to
0.1 of these; the rest is the definition of a shoulder, a turned head, and bent wrists."""

BEYOND = PROPORTIONS["hand"] / (PROPORTIONS["forearm"] - PROPORTIONS["hand"])
"""A hand's centre is beyond the wrist by half a hand: this share of the way from the elbow to the wrist. In
the picture, too, as long as the wrist is straight."""

FROM_ELBOW, WITHOUT_ELBOW = 0.22, 0.28
"""Head heights: standard deviations of a hand's centre of which the wrist is known, with the elbow and
without: a wrist that is bent by half a rad takes the hand 0.15 off, one that points anywhere by 0.2."""

SURE = 0.9  # probability that a point of score 1 is right: a network's errors last for many frames

EXCHANGED = (0.95, 0.03, 0.02)
"""Probability that sides are right, that arms are exchanged below the shoulders, and that all points are."""

OTHER_PERSON = 0.05  # probability that all points are another person's
AROUND = 4.0  # head heights: side of the square of false points, which are mostly the same person's

KEPT = (("shoulder", "elbow", "hand", "wrist"), ("shoulder",), ())
"""Kinds of points whose sides are right, in the order of `EXCHANGED`."""

SAME_BLOB = 0.3  # head heights: a point within this distance of a blob of skin, or a face, has its label

OTHER = {"left": "right", "right": "left"}

SAME_HEAD = 0.6  # head heights: distance between heads from which they are different persons'


@short_repr
@dataclass(frozen=True, eq=False)
class SeenKeypoints:
    """Detected key points of this body.

    Each has a normal error, or is false; sides may be exchanged, of the arms or of all; and all points may be
    another person's. A point of score s is right with probability s `SURE`.
    """

    # px in the order of `KEYPOINTS`, NaN where a point was not detected
    positions: Annotated[Array, Shape(len(KEYPOINTS), 2, finite=False)]
    # that a point is right; 0 where it was not detected
    probabilities: Annotated[Array, Shape(len(KEYPOINTS))]
    head_height: Positive  # px

    @classmethod
    def of(cls, given: GivenKeypoints, heads: Array, head_height: float) -> Self | None:
        """Select the person whose head is nearest to one of `heads` `(k, 2)` px.

        The largest person without `heads`; `None` if no person is near enough.
        """
        if not len(given):
            return None
        own = head_places(given, head_height)
        if len(heads):
            apart = np.linalg.norm(own[:, None] - heads, axis=2).min(axis=1)
            apart[np.isnan(apart)] = np.inf
            person = int(apart.argmin())
            if apart[person] > SAME_HEAD * head_height:
                return None
        else:
            person = largest(given)
        scores = np.clip(given.scores[person], 0.0, 1.0)
        return cls(given.positions[person], SURE * scores, head_height)

    def mixtures(self, hands: Array, heads: Array) -> GaussianMixtures:
        """Return likelihood ratios of head, left and right hand, as of blobs; sides may be exchanged.

        `hands`, `heads` `(k, 2)`, `(m, 2)` px: other detections of hands and heads, whose labels are 0 to
        k + m - 1. A point within `SAME_BLOB` of one has its label, others have labels of their own.
        """
        head = KEYPOINTS.index("head")
        own_hands = [self._hand(side) for side in ("left", "right")]
        unit = self.head_height
        places = [self.positions[head], *(place for place, _, _ in own_hands)]
        variances = np.square(np.array([DEVIATIONS["head"], *(std for _, std, _ in own_hands)]) * unit)
        chances = np.array([self.probabilities[head], *(chance for _, _, chance in own_hands)])
        chances *= 1 - OTHER_PERSON
        exchanged = self._exchanged
        numbers = len(hands) + len(heads) + np.arange(len(PARTS))
        for thing, (others, first) in enumerate(((heads, len(hands)), (hands, 0), (hands, 0))):
            apart = np.linalg.norm(others - places[thing], axis=1)
            if (apart < SAME_BLOB * unit).any():
                numbers[thing] = first + apart.argmin()
        log_weights, means, covariances, labels, flat = [], [], [], [], []
        for part in range(len(PARTS)):
            shares = np.zeros(len(PARTS))
            shares[part] = 1.0 if part == 0 else 1 - exchanged
            if part > 0:
                shares[3 - part] = exchanged
            things = np.flatnonzero(shares * chances)
            own = (shares * chances)[things]
            log_weights.append(np.log(own * (AROUND * unit) ** 2))
            means.append(np.array([places[thing] for thing in things]).reshape(-1, 2))
            covariances.append(variances[things, None, None] * np.eye(2))
            labels.append(numbers[things])
            flat.append(np.log(1 - own.sum()))
        return GaussianMixtures.of_parts(log_weights, means, covariances, flat, labels)

    def log_ratios(self, body: UpperBody, joints: Array) -> Array:
        """`(n,)` nats: log likelihood ratios of the points of neck, shoulders and arms against false points.

        The head is left to `mixtures`. `joints` are those of n poses, `(n, 8, 2)` or `(n, 8, 3)` px.
        """
        ratios = np.zeros(len(joints))
        names = [name for name in self._counted if self._is_detected(name)]
        if not names:
            return ratios
        rows = [KEYPOINTS.index(name) for name in names]
        deviations = self.head_height * np.array([DEVIATIONS[name.rpartition("_")[2]] for name in names])
        probable = self.probabilities[rows]
        wrist = 1 - body.hand / body.forearm
        chances = np.append((1 - OTHER_PERSON) * np.array(EXCHANGED), OTHER_PERSON)
        keypoint_terms(
            joints, self.positions[rows],
            np.array([[_ends(_mirrored(name, kept)) for name in names] for kept in KEPT]),
            np.array([wrist if name.endswith("wrist") else 0.0 for name in names]),
            probable * (AROUND * self.head_height) ** 2 / (2 * np.pi * deviations**2), 0.5 / deviations**2,
            1 - probable, chances, ratios,
        )  # fmt: skip
        return ratios

    @property
    def _exchanged(self) -> float:
        """Probability that hands are exchanged, by the order of the shoulders in the picture."""
        _, arms, all_of_it = EXCHANGED
        left, right = (KEYPOINTS.index(f"{side}_shoulder") for side in ("left", "right"))
        if self.probabilities[left] > 0 and self.probabilities[right] > 0:
            across = (self.positions[left, 0] - self.positions[right, 0]) / self.head_height
            wide, true = PROPORTIONS["shoulder_width"], self.probabilities[left] * self.probabilities[right]
            variance = 2 * DEVIATIONS["shoulder"] ** 2
            own, other = (
                true * np.exp(-0.5 * (across - side * wide) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
                + (1 - true) / AROUND
                for side in (1, -1)
            )
            all_of_it = float(all_of_it * other / (all_of_it * other + (1 - all_of_it) * own))
        return all_of_it + arms - 2 * all_of_it * arms

    @property
    def _counted(self) -> list[str]:
        """Names of the points of neck and arms; the wrist of a detected hand is left out."""
        hands = {name for name in JOINTS if name.endswith("hand") and self._is_detected(name)}
        return [
            name for name in KEYPOINTS[1:]
            if not (name.endswith("wrist") and name.replace("wrist", "hand") in hands)
        ]  # fmt: skip

    def _is_detected(self, name: str) -> bool:
        return bool(self.probabilities[KEYPOINTS.index(name)] > 0)

    def _hand(self, side: str) -> tuple[Array, float, float]:
        """Return a hand's centre px, its standard deviation in head heights, and its probability."""
        hand, wrist, elbow = (KEYPOINTS.index(f"{side}_{name}") for name in ("hand", "wrist", "elbow"))
        places, probable = self.positions, self.probabilities
        if probable[hand] > 0:
            return places[hand], DEVIATIONS["hand"], float(probable[hand])
        if probable[elbow] > 0:
            return beyond(places[elbow], places[wrist]), FROM_ELBOW, float(probable[wrist])
        return places[wrist], WITHOUT_ELBOW, float(probable[wrist])


def head_places(given: GivenKeypoints, head_height: float) -> Array:
    """`(n, 2)` px: heads of persons, detected, or above neck or shoulders; NaN without any of these."""
    rows = {name: given.positions[:, place] for place, name in enumerate(KEYPOINTS)}
    between = 0.5 * (rows["left_shoulder"] + rows["right_shoulder"])
    places = rows["head"].copy()
    for neck in (rows["neck"], between):
        above = neck - (0.0, PROPORTIONS["neck"] * head_height)
        places = np.where(np.isnan(places), above, places)
    return places


def joints_of(given: GivenKeypoints) -> Array:
    """`(n, 8, 2)` px: `JOINTS` of persons; hands that were not detected are beyond their wrists."""
    joints = given.positions[:, : len(JOINTS)].copy()
    for side in ("left", "right"):
        hand, wrist, elbow = (KEYPOINTS.index(f"{side}_{name}") for name in ("hand", "wrist", "elbow"))
        further = beyond(given.positions[:, elbow], given.positions[:, wrist])
        joints[:, hand] = np.where(np.isnan(joints[:, hand]), further, joints[:, hand])
    return joints


def beyond(elbow: Array, wrist: Array) -> Array:
    """`(..., 2)` px: centre of a hand with a straight wrist."""
    place: Array = wrist + BEYOND * (wrist - elbow)
    return place


def largest(given: GivenKeypoints) -> int:
    """Index of the person whose points have the largest extent."""
    low, high = (np.where(np.isnan(given.positions), bad, given.positions) for bad in (np.inf, -np.inf))
    reach = np.linalg.norm(np.maximum(high.max(axis=1) - low.min(axis=1), 0.0), axis=1)
    return int(reach.argmax())


def _mirrored(name: str, kept: Collection[str]) -> str:
    """Name of the same point of the other side, unless it is of a kind that is kept."""
    side, _, kind = name.partition("_")
    return name if not kind or kind in kept else f"{OTHER[side]}_{kind}"


def _ends(name: str) -> tuple[int, int]:
    """Indices of the joints that a point lies between."""
    if name.endswith("wrist"):
        side = name.partition("_")[0]
        return JOINTS.index(f"{side}_elbow"), JOINTS.index(f"{side}_hand")
    return JOINTS.index(name), JOINTS.index(name)
