"""Verdicts on which chains of a finished run help each other, and why (§3.3 of the RSMCM paper)."""

import errno
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...inference.validity import (
    FEWEST_GROUPS,
    Comparison,
    Interval,
    ScoreComparison,
    compare_predictions,
    compare_scores,
)
from ...models.core.checks import checked
from ...models.core.gaussian_message import squared_distances
from .predictions import FILE, PairRecord, ScoreRecord, read_predictions
from .text_tables import in_columns

WRITTEN_BY = "rsmcm structure, or background"
STRETCHES = 40
"""Into how many stretches of frames a run is cut, whose errors are taken for independent."""

HONEST = (0.8, 1.25)
"""Squared errors over stated variances between which a chain's covariances pass for honest."""

SCORE_HEADER = ("chains", "feature", "frames", "score 1", "score 2", "product", "gain, nats", "verdict")

HEADER = (
    "chains", "feature", "predictions", "error 1", "error 2", "correlation", "critical", "gain, nats",
    "verdict",
)  # fmt: skip


class TooFewError(ValueError):
    """Raised when a pair has too few recorded predictions."""


@checked
def report_validity(folder: str | Path) -> str:
    """Return a table of all pairs of chains of a run, with an explanation.

    Raises
    ------
    ValueError
        if the folder has no recorded predictions, they cannot be read, or there are too few of every pair.
    OSError
        if there is no such folder.
    """
    folder = Path(folder)
    if not folder.exists():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(folder))
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected the folder of a finished run", str(folder))
    if not (folder / FILE).exists():
        raise ValueError(f"{folder}: holds no {FILE}; it is written by: {WRITTEN_BY}")
    records = read_predictions(folder)
    if not records:
        return "No two chains of this run predict the same feature."
    pairs: list[tuple[PairRecord, Comparison]] = []
    scores: list[tuple[ScoreRecord, ScoreComparison]] = []
    too_few: list[TooFewError] = []
    for record in records:
        try:
            if isinstance(record, PairRecord):
                pairs.append((record, judge(record)))
            else:
                scores.append((record, judge_scores(record)))
        except TooFewError as error:
            too_few.append(error)
    if not pairs and not scores:
        raise too_few[0]
    parts = []
    if pairs:
        parts.append(in_columns(HEADER, [_row(*each) for each in pairs]))
    if scores:
        parts.append(in_columns(SCORE_HEADER, [_score_row(*each) for each in scores]))
    parts += [_in_words(*each) for each in pairs]
    parts += [_scores_in_words(*each) for each in scores]
    return "\n\n".join([*parts, *(f"{error}." for error in too_few)])


def judge(record: PairRecord) -> Comparison:
    """Compare a pair of chains by the wider one of two intervals.

    Errors of one track are related over time, and errors of one frame over all tracks (they share a camera),
    so that neither tracks nor frames are independent of each other: once tracks are resampled, once stretches
    of frames, and the wider interval counts.
    """
    groupings = [record.tracks, _stretches(record.frames)]
    enough = [labels for labels in groupings if len(np.unique(labels)) >= FEWEST_GROUPS]
    several = enough or [labels for labels in groupings if len(np.unique(labels)) > 1]
    if not several:
        raise TooFewError(
            f"{record.first} + {record.second}: got {len(record.predictions)} predictions of one track "
            "in one frame, expected more"
        )
    comparisons = [compare_predictions(record.predictions, labels) for labels in several]
    return max(comparisons, key=lambda comparison: comparison.gain.high - comparison.gain.low)


def judge_scores(record: ScoreRecord) -> ScoreComparison:
    """Compare a pair by its log densities, with stretches of frames as independent groups."""
    if len(np.unique(record.frames)) < 2:
        raise TooFewError(f"{record.first} + {record.second}: got scores of one frame, expected more")
    return compare_scores(record.scores, _stretches(record.frames))


def _stretches(frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """In which stretch of the run each row is, by its frame; of a short run, the frame itself."""
    _, order = np.unique(frames, return_inverse=True)
    stretches: NDArray[np.int64] = order * STRETCHES // max(int(order.max()) + 1, STRETCHES)
    return stretches


def noise_ratio(record: PairRecord) -> float:
    """Return the squared distance of observations from the nearer prediction over their stated noise.

    Of right noises it is 1 and more: predictions err too. Below, the noise is overstated, and what is left of
    the errors without it means nothing.
    """
    found = record.predictions
    ratios: list[float] = [
        float(squared_distances(found.observed - means, found.noise).mean()) / found.observed.shape[1]
        for means in (found.first, found.second)
    ]
    return min(ratios)


def _row(record: PairRecord, comparison: Comparison) -> tuple[object, ...]:
    return (
        f"{record.first} + {record.second}",
        record.feature,
        str(comparison.count),
        f"{comparison.rms_first.estimate:.3g} {record.unit}",
        f"{comparison.rms_second.estimate:.3g} {record.unit}",
        f"{comparison.correlation:.2f}",
        f"{comparison.critical_correlation:.2f}" if np.isfinite(comparison.critical_correlation) else "any",
        f"{comparison.gain:.2g}",
        comparison.verdict if noise_ratio(record) >= 1 else "not sure",
    )


def _score_row(record: ScoreRecord, comparison: ScoreComparison) -> tuple[object, ...]:
    return (
        f"{record.first} + {record.second}",
        record.feature,
        str(comparison.count),
        *(f"{score.estimate:.3f}" for score in (comparison.first, comparison.second, comparison.product)),
        f"{comparison.gain:.2g}",
        comparison.verdict,
    )


def _scores_in_words(record: ScoreRecord, comparison: ScoreComparison) -> str:
    return (
        f"{record.first} + {record.second} on {record.feature}: {comparison.verdict}. {comparison.reason}.\n"
        f"Scores are log densities of the observations, nats {record.unit}."
    )


def _in_words(record: PairRecord, comparison: Comparison) -> str:
    pair, ratio = f"{record.first} + {record.second} on {record.feature}", noise_ratio(record)
    if ratio < 1:
        lines = [
            f"{pair}: not sure. Observations are nearer to a prediction than their stated noise allows "
            f"(squared distances are {ratio:.2f} times the noise): the noise is overstated, so errors, "
            "correlation and gain are unknown. Scores with the stated covariances are valid."
        ]
    else:
        lines = [f"{pair}: {comparison.verdict}. {comparison.reason}."]
    if comparison.theorem_holds and ratio >= 1:
        lines.append("The sufficient condition of Theorem 2 is met.")
    stated = comparison.stated
    if stated is not None:
        lines += [
            _honesty(record.first, stated.nis_first),
            _honesty(record.second, stated.nis_second),
            f"With the stated covariances, the product predicts the observations "
            f"{_better(stated.score_gain)} than the better chain; its posterior is {_better(stated.gain)}.",
        ]
    return "\n".join(lines)


def _honesty(name: str, excess: Interval[float]) -> str:
    least, most = HONEST
    if excess.low > most:
        word = "is overconfident"
    elif excess.high < least:
        word = "is underconfident"
    else:
        word = "has calibrated covariances"
    return f"{name} {word}: its squared errors are {excess:.2f} times its stated variances."


def _better(gain: Interval[float]) -> str:
    if gain.low > 0:
        word = "better"
    elif gain.high < 0:
        word = "worse"
    else:
        word = "neither clearly better nor worse"
    return f"{word} ({gain:.2g} nats)"
