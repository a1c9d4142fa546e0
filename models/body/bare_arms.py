"""Whether a person's forearms are bare, from how much skin hangs together where a hand is."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float64]
Map = NDArray[np.float32]

IN_SLEEVE, WITH_FOREARM = 0.65, 1.9
"""Discs of a hand's radius: skin that a hand alone shows (0.55 to 0.8), and with a forearm, whose own 1.4
discs are mostly seen from aslant."""

BETWEEN_PEOPLE, BETWEEN_FRAMES = 0.2, 0.4
"""Standard deviations of the logs of both: proportions and colour; how an arm is held."""

SURE = 0.02
"""Probabilities that are less than that, or that far from 1, are taken for 0 and 1."""

SKIN_FROM = 1.0
"""Nats: log odds from which a pixel counts."""

HEAD_MARGIN = 1.15
"""Over the ellipses of head and neck: what is left of their rims is no hand."""

REACH = 3.2
"""Head heights from the head's centre: as far as hands are."""


def bare_probability(areas: Sequence[float]) -> float:
    """Probability that forearms are bare, from `hand_area` of some frames.

    Logs of areas are normal about one of two means, with what is common to all frames and what is not; of
    that the frames' median is taken. Both are as probable before; with no area, they stay so.
    """
    seen = [area for area in areas if area > 0]
    if not seen:
        return 0.5
    low, high = np.log(IN_SLEEVE), np.log(WITH_FOREARM)
    variance = BETWEEN_PEOPLE**2 + BETWEEN_FRAMES**2 / len(seen)
    log_odds = (np.log(np.median(seen)) - 0.5 * (low + high)) * (high - low) / variance
    probability = float(expit(log_odds))
    return 0.0 if probability < SURE else 1.0 if probability > 1 - SURE else probability


def hand_area(skin: Map, heads: Array, radius: float, head_height: float) -> float:
    """Area of the largest patch of skin beside heads, in discs of a hand's radius; 0 without any.

    Parameters
    ----------
    skin
        `(height, width)` float32 nats: log odds of skin.
    heads
        `(k, 4)` px, of one person: ellipses, centre x, y and half axes, of head and neck; the head first.
    radius, head_height
        px.
    """
    beside = np.asarray(skin > SKIN_FROM, np.uint8)
    near = np.zeros_like(beside)
    x, y = heads[0, :2]
    cv2.circle(near, (round(x), round(y)), round(REACH * head_height), 1, cv2.FILLED)
    for x, y, across, down in heads:
        cv2.ellipse(near, ((x, y), (2 * HEAD_MARGIN * across, 2 * HEAD_MARGIN * down), 0.0), 0, cv2.FILLED)
    # single pixels do not tie patches together
    patches = cv2.morphologyEx(beside & near, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, _, statistics, _ = cv2.connectedComponentsWithStats(patches)
    largest = statistics[1:, cv2.CC_STAT_AREA].max(initial=0)
    return float(largest / (np.pi * radius**2))
