"""Points of a person that a detector has found, as evidence of a body's pose."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..core.frame import KEYPOINTS, GivenKeypoints
from ..core.gaussian_mixtures import GaussianMixtures
from ..core.short_repr import short_repr
from .kernels import keypoint_terms
from .upper_body import JOINTS, PARTS, PROPORTIONS, UpperBody

Array = NDArray[np.float64]

DEVIATIONS = {"head": 0.12, "neck": 0.15, "shoulder": 0.15, "elbow": 0.12, "hand": 0.12, "wrist": 0.15}
"""Head heights: standard deviation of a point that was found about that of the model. Networks err by about
0.05 to 0.1 of these; the rest is what people mean by a shoulder, a turned head, and wrists that are bent."""

BEYOND = PROPORTIONS["hand"] / (PROPORTIONS["forearm"] - PROPORTIONS["hand"])
"""A hand's centre is beyond the wrist by half a hand: this share of the way from the elbow to the wrist. In
the picture, too, as long as the wrist is straight."""

FROM_ELBOW, WITHOUT_ELBOW = 0.22, 0.28
"""Head heights: standard deviations of a hand's centre of which the wrist is known, with the elbow and
without: a wrist that is bent by half a rad takes the hand 0.15 off, one that points anywhere by 0.2."""

SURE = 0.9  # probability that a wholly sure point is right: a network's errors last for many frames

EXCHANGED = (0.95, 0.03, 0.02)
"""Probability that sides are told rightly, that arms are exchanged below the shoulders, and that all are."""

SOMEBODY_ELSE = 0.05  # probability that all points are another person's
AROUND = 4.0  # head heights: side of the square of false points, which are mostly the same person's

KEPT = (("shoulder", "elbow", "hand", "wrist"), ("shoulder",), ())
"""Kinds of points whose sides are told rightly, in the order of `EXCHANGED`."""

SAME_THING = 0.3  # head heights: so near to each other a point and a blob of skin, or a face, are one

OTHER = {"left": "right", "right": "left"}

SAME_HEAD = 0.6  # head heights: so far from where the head is known to be is that of another person


@short_repr
@dataclass(frozen=True, eq=False)
class SeenKeypoints:
    """Points that are taken for this body's.

    Each is where the pose has it, with a normal error, or false; sides may be exchanged, of the arms or of
    all; and all may be another person's. A score says how probable a point is: 1 is `SURE`, 0.5 half of that.
    """

    positions: Array  # `(10, 2)` px in the order of `KEYPOINTS`, NaN where a point was not found
    probabilities: Array  # `(10,)`: that a point is what it says; 0 where it was not found
    head_height: float  # px

    @classmethod
    def of(cls, given: GivenKeypoints, heads: Array, head_height: float) -> Self | None:
        """The points of the person whose head is nearest to one of `heads` `(k, 2)` px.

        Where no head is known, those of the largest person; `None` if nobody is near enough.
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
        """What they say of head, left and right hand: ratios of probabilities, as of blobs of skin.

        Sides may be exchanged.

        `hands`, `heads` `(k, 2)`, `(m, 2)` px: other things in the picture that hands and heads may be, whose
        labels are 0 to k + m - 1. A point that is as near to one of them as `SAME_THING` has its label,
        others have labels of their own.
        """
        head = KEYPOINTS.index("head")
        own_hands = [self._hand(side) for side in ("left", "right")]
        unit = self.head_height
        head_spread = DEVIATIONS["head"]
        places = [self.positions[head], *(place for place, _, _ in own_hands)]
        spreads = np.square(np.array([head_spread, *(spread for _, spread, _ in own_hands)]) * unit)
        chances = np.array([self.probabilities[head], *(chance for _, _, chance in own_hands)])
        chances *= 1 - SOMEBODY_ELSE
        exchanged = self._exchanged
        numbers = len(hands) + len(heads) + np.arange(len(PARTS))
        for thing, (others, first) in enumerate(((heads, len(hands)), (hands, 0), (hands, 0))):
            apart = np.linalg.norm(others - places[thing], axis=1)
            if (apart < SAME_THING * unit).any():
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
            covariances.append(spreads[things, None, None] * np.eye(2))
            labels.append(numbers[things])
            flat.append(np.log(1 - own.sum()))
        return GaussianMixtures.of_parts(log_weights, means, covariances, flat, labels)

    def log_ratios(self, body: UpperBody, joints: Array) -> Array:
        """`(n,)` nats: how much more probable points are if neck, shoulders and arms are there than anywhere.

        The head is left to `mixtures`. `joints` are those of n poses, `(n, 8, 2)` or `(n, 8, 3)` px.
        """
        ratios = np.zeros(len(joints))
        found = [name for name in self._counted if self.probabilities[KEYPOINTS.index(name)] > 0]
        if not found:
            return ratios
        rows = [KEYPOINTS.index(name) for name in found]
        deviations = self.head_height * np.array([DEVIATIONS[name.rpartition("_")[2]] for name in found])
        probable = self.probabilities[rows]
        wrist = 1 - body.hand / body.forearm
        chances = np.append((1 - SOMEBODY_ELSE) * np.array(EXCHANGED), SOMEBODY_ELSE)
        keypoint_terms(
            joints, self.positions[rows],
            np.array([[_ends(_mirrored(name, kept)) for name in found] for kept in KEPT]),
            np.array([wrist if name.endswith("wrist") else 0.0 for name in found]),
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
        """Names of the points of neck and arms; where a hand is found, its wrist says nothing new."""
        hands = {name for name in JOINTS if name.endswith("hand") and self._found(name)}
        return [
            name for name in KEYPOINTS[1:]
            if not (name.endswith("wrist") and name.replace("wrist", "hand") in hands)
        ]  # fmt: skip

    def _found(self, name: str) -> bool:
        return bool(self.probabilities[KEYPOINTS.index(name)] > 0)

    def _hand(self, side: str) -> tuple[Array, float, float]:
        """A hand's centre px, its standard deviation in head heights, and the probability of it all."""
        hand, wrist, elbow = (KEYPOINTS.index(f"{side}_{name}") for name in ("hand", "wrist", "elbow"))
        places, probable = self.positions, self.probabilities
        if probable[hand] > 0:
            return places[hand], DEVIATIONS["hand"], float(probable[hand])
        if probable[elbow] > 0:
            return beyond(places[elbow], places[wrist]), FROM_ELBOW, float(probable[wrist])
        return places[wrist], WITHOUT_ELBOW, float(probable[wrist])


def head_places(given: GivenKeypoints, head_height: float) -> Array:
    """`(n, 2)` px: heads of persons, as found, or above neck or shoulders; NaN where nothing says."""
    rows = {name: given.positions[:, place] for place, name in enumerate(KEYPOINTS)}
    between = 0.5 * (rows["left_shoulder"] + rows["right_shoulder"])
    places = rows["head"].copy()
    for neck in (rows["neck"], between):
        above = neck - (0.0, PROPORTIONS["neck"] * head_height)
        places = np.where(np.isnan(places), above, places)
    return places


def joints_of(given: GivenKeypoints) -> Array:
    """`(n, 8, 2)` px: `JOINTS` of persons; hands that were not found are beyond their wrists."""
    joints = given.positions[:, : len(JOINTS)].copy()
    for side in ("left", "right"):
        hand, wrist, elbow = (KEYPOINTS.index(f"{side}_{name}") for name in ("hand", "wrist", "elbow"))
        further = beyond(given.positions[:, elbow], given.positions[:, wrist])
        joints[:, hand] = np.where(np.isnan(joints[:, hand]), further, joints[:, hand])
    return joints


def beyond(elbow: Array, wrist: Array) -> Array:
    """`(..., 2)` px: where the centre of a hand is whose wrist is straight."""
    place: Array = wrist + BEYOND * (wrist - elbow)
    return place


def largest(given: GivenKeypoints) -> int:
    """Number of the person whose points reach over most of the picture."""
    low, high = (np.where(np.isnan(given.positions), bad, given.positions) for bad in (np.inf, -np.inf))
    reach = np.linalg.norm(np.maximum(high.max(axis=1) - low.min(axis=1), 0.0), axis=1)
    return int(reach.argmax())


def _mirrored(name: str, kept: Collection[str]) -> str:
    """The same point of the other side, unless it is of a kind that is kept."""
    side, _, kind = name.partition("_")
    return name if not kind or kind in kept else f"{OTHER[side]}_{kind}"


def _ends(name: str) -> tuple[int, int]:
    """Between which joints a point is."""
    if name.endswith("wrist"):
        side = name.partition("_")[0]
        return JOINTS.index(f"{side}_elbow"), JOINTS.index(f"{side}_hand")
    return JOINTS.index(name), JOINTS.index(name)
