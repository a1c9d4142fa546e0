"""Scores of one method on one source, frame by frame, by any kind of ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..io.ground_truth import OUTSIDE, BoxTruth, Kind, MaskTruth, common_frames, read_ground_truth
from ..io.sources.open_source import Source
from ..runs.region import stands_inside
from .masks import ErrorClasses, PixelScore, error_classes, mask_error_classes
from .tracks import evaluate_tracks

Mask = NDArray[np.uint8]


SAVED = {
    "frames": list[int],
    "pixels": tuple[list[int], list[tuple[int, int, int, int]]],
    "errors": ErrorClasses,
}
"""Kinds of what `Scoring.saved` returns."""


class Scoring:
    """Comparison of masks with the ground truth, frame by frame.

    Parameters
    ----------
    truth
        true boxes (the paper's error classes and track measures) or true masks (error classes and CDnet's
        measures).
    region
        `(height, width)` uint8, 0 outside the region of interest, where nothing counts; `None`: it all does.
    """

    def __init__(self, truth: BoxTruth | MaskTruth, region: Mask | None = None) -> None:
        self._region = region
        if isinstance(truth, BoxTruth) and region is not None:
            away = [not stands_inside(region, (x, y, w, h)) for x, y, w, h in truth.box]
            truth = replace(truth, kind=np.where(away, np.int64(Kind.IGNORED), truth.kind))
        self.truth = truth
        self.frames: list[int] = []
        self.pixels = PixelScore()
        self.errors = ErrorClasses()

    def add(self, number: int, foreground: Mask) -> None:
        """Count the mask `(height, width)`, 0 or 255, of a frame, if there is truth for it.

        Raises
        ------
        ValueError
            if the true mask has another size or cannot be read.
        """
        if number not in self.truth:
            return
        self.frames.append(number)
        if isinstance(self.truth, BoxTruth):
            self.errors += error_classes(foreground, self.truth.at(number))
            return
        labels = self.truth.labels(number)
        if self._region is not None and labels.shape == self._region.shape:
            labels[self._region == 0] = OUTSIDE
        self.pixels.add(number, foreground, labels)
        self.errors += mask_error_classes(foreground, labels)

    def measures(self, tracks: NDArray[np.float64] | None) -> dict[str, Any]:
        """Return all measures as nested plain values; empty if no frame had a truth.

        Parameters
        ----------
        tracks
            `(n, 6)`: frame, identity, x, y, width, height; `None` if the method does not track.
        """
        if not self.frames:
            return {}
        measures: dict[str, Any] = {
            "frames compared": len(self.frames),
            "errors": {
                **asdict(self.errors),
                "missed and ghosts": self.errors.errors,
                "counted": f"anew in each of the {len(self.frames)} frames compared",
            },
        }
        has_kinds = isinstance(self.truth, BoxTruth)  # pedestrians from vehicles
        for name in ("missed_objects",) if has_kinds else ("missed_pedestrians", "missed_vehicles"):
            del measures["errors"][name]
        if isinstance(self.truth, BoxTruth):
            if tracks is not None:
                measures["tracks"] = asdict(evaluate_tracks(tracks, self.truth, self.frames))
        else:
            total = self.pixels.total()
            measures["pixels"] = {
                "F": total.f_measure,
                "precision": total.precision,
                "recall": total.recall,
                "specificity": total.specificity,
                "wrong, %": total.wrong_percent,
            }
        return measures

    def saved(self) -> dict[str, Any]:
        """Return all counts, of the kinds of `SAVED`."""
        return {
            "frames": self.frames,
            "pixels": [self.pixels.numbers, self.pixels.counts],
            "errors": self.errors,
        }

    def restore(self, data: Mapping[str, Any]) -> None:
        """Set the counts that `saved` returned."""
        self.frames = list(data["frames"])
        numbers, counts = data["pixels"]
        self.pixels = PixelScore(list(numbers), list(counts))
        self.errors = data["errors"]


def scoring_of(
    path: Path | None, source: Source, start: int, step: int, region: Mask | None
) -> Scoring | None:
    """Read ground truth, if it is given, and check that it belongs to a source.

    Parameters
    ----------
    path
        as of `read_ground_truth`; without one there is nothing.
    source
        opened.
    start, step
        which of its frames are taken.
    region
        as of `Scoring`.

    Raises
    ------
    ValueError
        if it has no frame in common with the source, or masks of another size.
    """
    if path is None:
        return None
    truth = read_ground_truth(path)
    numbers: Sequence[int] = truth.frames
    if source.n_frames is not None:
        numbers = common_frames(truth, range(start, start + (source.n_frames - 1) * step + 1, step))
    if isinstance(truth, MaskTruth):
        height, width = truth.labels(numbers[0]).shape
        if (width, height) != source.size:
            raise ValueError(
                f"--ground-truth: {truth.files[numbers[0]]} has {width}x{height} px, "
                f"expected {source.size[0]}x{source.size[1]} like {source.name}"
            )
    return Scoring(truth, region)
