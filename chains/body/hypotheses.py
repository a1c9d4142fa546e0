"""Answers for one frame that differ in where the hands are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ...models.body.upper_body import JOINTS, UpperBody
from .samples import BodySamples

Array = NDArray[np.float64]

MOST = 4
"""Hypotheses of a frame that are told apart."""

WORTH_SAYING = 0.1
"""Probability from which a second answer is shown."""

ENOUGH = 200
"""Poses that tell them."""

HANDS = [JOINTS.index("left_hand"), JOINTS.index("right_hand")]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Answers for one frame, the most probable first.

    Parameters
    ----------
    weights
        `(4,)` probabilities, 0 where there are fewer; what is missing to 1 is of further ones.
    joints
        `(4, 8, 3)` px: the mean pose of each, NaN where there are fewer.
    apart
        px: hands that are farther than this from the first answer's are elsewhere.
    """

    weights: Array
    joints: Array
    apart: float

    @property
    def second(self) -> Array | None:
        """`(8, 3)` px: the second best answer, where it is worth saying."""
        return self.joints[1] if self.weights[1] >= WORTH_SAYING else None

    @property
    def unsure(self) -> Array:
        """`(2,)`: probability that left and right hand are elsewhere than in the first answer."""
        away = np.linalg.norm(self.joints[:, HANDS, :2] - self.joints[0, HANDS, :2], axis=2)
        return np.asarray(self.weights @ (away > self.apart))


def hypotheses(body: UpperBody, samples: BodySamples, random: np.random.Generator) -> Hypotheses:
    """Gather poses of which one leads to the next by steps that move no hand by more than its radius.

    So a hand that may be anywhere within a region is one answer, and two of a hand's places are two if no
    poses lie between them. Of many samples some are drawn, by `random`.
    """
    poses, weights = samples.poses, samples.weights
    if len(poses) > ENOUGH:
        poses, weights = samples.drawn(ENOUGH, random), np.full(ENOUGH, 1 / ENOUGH)
    joints = body.joints(poses)
    hands = joints[:, HANDS, :2]
    steps = np.linalg.norm(hands[:, None] - hands, axis=3).max(axis=2)
    count, group = connected_components(steps <= body.hand, directed=False)
    masses = np.bincount(group, weights, count)
    best = np.argsort(-masses, kind="stable")[:MOST]
    best = best[masses[best] > 0]
    found = np.zeros(MOST)
    found[: len(best)] = masses[best]
    means = np.full((MOST, *joints.shape[1:]), np.nan)
    for place, chosen in enumerate(best):
        share = np.where(group == chosen, weights, 0) / masses[chosen]
        means[place] = np.einsum("n,njx->jx", share, joints)
    return Hypotheses(found, means, body.hand)
