"""What summary and page need of a body-tracking run."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...chains.body.hand_labelling import HandLabels, hand_labels
from ...chains.body.hypotheses import WORTH_SAYING
from ...chains.body.relabelling import EXCHANGED_PARTS
from ...models.body.upper_body import JOINTS, PARTS
from ..runs.row_log import RowLog
from ..view.page import FrameRecord, listed_periods, notes_on_missing, periods

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PART_JOINTS = [JOINTS.index(name) for name in PARTS]

SAME_DOUBT = 0.5
"""s: doubt that comes again so soon is the same."""

MOST_SAID = 5
"""Stretches of doubt that a sentence names."""

RARELY_SEEN = 0.5
"""Share of the frames below which a part's position is mostly a guess, and said to be one."""


class Doubt(NamedTuple):
    """First and last frame of a stretch with another answer, and its greatest probability there."""

    first: int
    last: int
    probability: float

    @property
    def frames(self) -> str:
        """In words."""
        return f"{self.first} to {self.last}"


def doubts(numbers: Sequence[int], times: Sequence[float], probabilities: Array) -> list[Doubt]:
    """Stretches of frames in which something is probable enough to be said, but for gaps of a moment."""
    found: list[Doubt] = []
    ended = -np.inf  # s
    for index in np.flatnonzero(probabilities >= WORTH_SAYING).tolist():
        one = Doubt(numbers[index], numbers[index], round(float(probabilities[index]), 3))
        if times[index] - ended <= SAME_DOUBT:
            before = found.pop()
            one = Doubt(before.first, one.last, max(before.probability, one.probability))
        found.append(one)
        ended = times[index]
    return found


def in_words(found: Mapping[str, Sequence[Doubt]]) -> list[str]:
    """A sentence for each kind of doubt that there is, the longest stretches first where they are many."""
    sentences = []
    for name, stretches in found.items():
        if not stretches:
            continue
        part = name.replace("_", " ")
        what = "hands may be exchanged" if name == "exchanged" else f"{part} may be elsewhere"
        longest = sorted(stretches, key=lambda each: each.first - each.last)[:MOST_SAID]
        where = ", ".join(f"{each.frames} ({100 * each.probability:.0f} %)" for each in sorted(longest))
        more = len(stretches) - len(longest)
        shorter = f" and {more} shorter stretches" if more else ""
        sentences.append(f"The {what} in frames {where}{shorter}.")
    return sentences


class BodyRecord(FrameRecord):
    """What summary and page need of a run, a few numbers a frame.

    Parameters
    ----------
    log
        the rows of the run.

    Attributes
    ----------
    stationary
        numbers of the frames whose image has shown nothing of the body.
    log_evidence
        nats, up to a constant; NaN where nothing was to be seen.
    effective
        effective number of samples, 1 / sum of squared weights.
    places, spreads
        a frame each: means `(3, 3)` px of head and hands, and their standard deviations.
    seen
        a frame each: `(3,)`, whether the image has shown them.
    second
        probability of the second answer.
    unsure
        a frame each: `(3,)`, probability that a part is elsewhere than in the best answer, 0 for the head.
    exchange_log_odds, confusable
        what each frame says of the names of the hands: log odds, nats, that they are exchanged, and the
        probability that they could be confused.
    """

    def __init__(self, log: RowLog) -> None:
        super().__init__(log)
        self.log_evidence, self.effective = log["log_evidence"], log["effective"]
        self.stationary: list[int] = log["number"][log["stationary"] & ~log["missing"]].tolist()
        self.places = log["joints_3d"][:, PART_JOINTS]
        covariances = log["joints_3d_covariances"][:, PART_JOINTS]
        self.spreads = np.sqrt(np.maximum(np.diagonal(covariances, axis1=2, axis2=3), 0))
        self.seen, self.unsure, self.second = log["seen"], log["unsure"], log["hypotheses"][:, 1]
        self.exchange_log_odds, self.confusable = log["exchange_log_odds"], log["confusable"]

    @property
    def shares_seen(self) -> dict[str, float]:
        """Of the frames that are not missing, the share in which the image has shown a part."""
        there = ~np.isin(np.array(self.numbers), self.missing)
        shares = self.of_parts(self.seen)[there].mean(axis=0) if there.any() else np.zeros(len(PARTS))
        return dict(zip(PARTS, map(float, shares), strict=True))

    @property
    def stationary_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which nothing of the body was seen."""
        return periods(self.numbers, self.stationary)

    @cached_property
    def labels(self) -> HandLabels:
        """Which hand is left, by the whole film; to be asked for when all frames are there."""
        numbers, times = np.array(self.numbers, np.int64), np.array(self.times)
        return hand_labels(numbers, times, self.exchange_log_odds, self.confusable)

    @property
    def exchanged(self) -> Array:
        """Probability of each frame that hands have each other's name, after what was relabelled."""
        found = self.labels
        return np.where(found.exchanged, 1 - found.probabilities, found.probabilities)

    @property
    def relabelled(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which hands have changed their names at the end."""
        return periods(self.numbers, self.labels.numbers[self.labels.exchanged].tolist())

    def of_parts(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Values `(n, 3, ...)` of head and hands by their final names, from those of every frame."""
        values = np.array(columns)
        chosen = self.labels.exchanged
        values[chosen] = values[chosen][:, EXCHANGED_PARTS]
        return values

    @property
    def doubts(self) -> dict[str, list[Doubt]]:
        """When hands may be exchanged, or one of them elsewhere."""
        probabilities = {"exchanged": self.exchanged}
        unsure = self.of_parts(self.unsure)
        probabilities |= {PARTS[hand]: unsure[:, hand] for hand in (1, 2)}
        return {name: doubts(self.numbers, self.times, each) for name, each in probabilities.items()}

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = [*notes_on_missing(self.missing), *in_words(self.doubts)]
        if self.relabelled:
            notes.append(
                "By the whole film, left and right hand have changed their names in "
                f"{listed_periods(self.relabelled)}."
            )
        if self.stationary:
            notes.append(
                f"Nothing of the body was seen, and it was only predicted, in "
                f"{listed_periods(self.stationary_periods)}."
            )
        for name, share in self.shares_seen.items():
            if share < RARELY_SEEN:
                hidden = "seen" if name == "head" else "seen, or not told from the face,"
                notes.append(
                    f"The {name.replace('_', ' ')} was not {hidden} in {100 * (1 - share):.0f} % of the "
                    "frames: its position there is a guess from its motion and the rest of the body."
                )
        return notes
