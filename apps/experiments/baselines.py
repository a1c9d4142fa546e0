"""The usual pipeline to compare with: OpenCV's background subtractors, a clean-up, Kalman and Hungarian."""

from dataclasses import dataclass
from typing import Protocol, cast

import cv2
import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..evaluation.tracks import box_overlap

Boxes = NDArray[np.float64]  # `(n, 4)`: x, y, width, height (px)
Image = NDArray[np.uint8]
TrackerParameters = tuple[float, int, int]
"""Of `KalmanHungarian`: least overlap, least hits, and frames without a find."""


class Subtractor(Protocol):
    """Background subtractor, picture by picture."""

    def apply(self, image: Image, /) -> Image:
        """Take the next `(height, width[, 3])` picture.

        Returns
        -------
        `(height, width)`: 0 background, 255 foreground; 127 for what it takes for a shadow, if it does.
        """
        ...


def opencv_subtractor(method: str, history: int, threshold: float) -> Subtractor:
    """Return OpenCV's "MOG2" or "KNN" with shadows, with a memory of `history` frames.

    `threshold` is the squared distance between pixel and model from which a pixel is foreground:
    `varThreshold` (in variances) for MOG2, `dist2Threshold` (in squared grey values) for KNN.
    """
    cv2.setRNGSeed(0)  # KNN draws from OpenCV's generator: the same run must give the same masks
    make = {"MOG2": cv2.createBackgroundSubtractorMOG2, "KNN": cv2.createBackgroundSubtractorKNN}[method]
    return cast(Subtractor, make(history, threshold, True))


@dataclass(frozen=True)
class CleanUp:
    """Clean-up of a mask: shadows, median, opening, closing, least area, in this order."""

    keep_shadows: bool = False  # whether a shadow is foreground: dark clothes are often taken for one
    # median, opening, closing: width of the window or elliptic structuring element in px; 0 for none
    median: int = 0
    opening: int = 0
    closing: int = 0
    min_area: int = 0  # px; smaller connected components (8-connected) are removed

    def apply(self, mask: Image) -> Image:
        """Return the cleaned `(height, width)` mask, 0 or 255."""
        smooth: cv2.typing.MatLike = np.where(mask >= (127 if self.keep_shadows else 255), np.uint8(255), 0)
        if self.median:
            smooth = cv2.medianBlur(smooth, self.median)
        for operation, size in ((cv2.MORPH_OPEN, self.opening), (cv2.MORPH_CLOSE, self.closing)):
            if size:
                element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
                smooth = cv2.morphologyEx(smooth, operation, element)
        if self.min_area:
            labels, statistics = _labelled(smooth)
            large = statistics[:, cv2.CC_STAT_AREA] >= self.min_area
            large[0] = False
            smooth = np.where(large, np.uint8(255), np.uint8(0))[labels]
        return np.asarray(smooth, np.uint8)

    def __str__(self) -> str:
        parts = ["shadows kept"] if self.keep_shadows else []
        for name in ("median", "opening", "closing"):
            parts += [f"{name} {getattr(self, name)}"] if getattr(self, name) else []
        return ", ".join([*parts, *([f"area {self.min_area}"] if self.min_area else [])])


@dataclass(frozen=True)
class Setting:
    """OpenCV's "MOG2" or "KNN" with a memory of `history` frames, and how its masks are cleaned."""

    method: str
    history: int
    threshold: float  # as of `opencv_subtractor`
    clean_up: CleanUp = CleanUp()

    def make(self) -> Subtractor:
        """Return a new subtractor."""
        return opencv_subtractor(self.method, self.history, self.threshold)

    def __str__(self) -> str:
        parts = (f"history {self.history}", f"threshold {self.threshold:g}", str(self.clean_up))
        return ", ".join(filter(None, parts))


def components(mask: Image) -> NDArray[np.float64]:
    """Return box and area `(n, 5)`, x, y, width, height (px), px, of the mask's 8-connected components."""
    return _labelled(mask)[1][1:].astype(np.float64)


class KalmanHungarian:
    """Tracker of boxes by a Kalman filter each and the assignment of greatest overlap (SORT).

    The state is centre, size (px) and the centre's velocity (px a frame).
    A. Bewley et al., *Simple online and realtime tracking* (2016).

    Parameters
    ----------
    least_overlap
        IoU of predicted and found box from which they may belong together.
    min_hits
        finds after which a track counts.
    max_age
        frames without a find after which a track ends.
    """

    def __init__(self, least_overlap: float = 0.1, min_hits: int = 5, max_age: int = 20):
        self._least_overlap, self._min_hits, self._max_age = least_overlap, min_hits, max_age
        self._tracks: list[_BoxTrack] = []
        self._next_identity = 1

    def update(self, boxes: Boxes | None) -> NDArray[np.float64]:
        """Update the tracks with the next frame's boxes.

        Parameters
        ----------
        boxes
            `None` in a frame without detection.

        Returns
        -------
        `(m, 5)`: identity, x, y, width, height of the tracks with a box in this frame, or, without detection,
        the predicted ones of the tracks with a box in the last frame with it.
        """
        for track in self._tracks:
            track.predict()
        if boxes is not None:
            self._correct(boxes)
        self._tracks = [track for track in self._tracks if track.age <= self._max_age]
        found = [track for track in self._tracks if not track.lost and track.hits >= self._min_hits]
        return np.array([[track.identity, *track.box()] for track in found]).reshape(-1, 5)

    def _correct(self, boxes: Boxes) -> None:
        predicted = np.array([track.box() for track in self._tracks]).reshape(-1, 4)
        overlap = box_overlap(predicted, boxes)
        rows, columns = linear_sum_assignment(overlap, maximize=True)
        good = overlap[rows, columns] >= self._least_overlap
        for track in self._tracks:
            track.lost = True
        for row, column in zip(rows[good], columns[good], strict=True):
            self._tracks[row].correct(boxes[column])
        for column in np.setdiff1d(np.arange(len(boxes)), columns[good]):
            self._tracks.append(_BoxTrack(self._next_identity, boxes[column]))
            self._next_identity += 1


class _BoxTrack:
    """One box's filter, how often it was found, how long ago, and whether it was missed the last time."""

    def __init__(self, identity: int, box: Boxes):
        self.identity, self.hits, self.age, self.lost = identity, 1, 0, False
        self._filter = KalmanFilter(dim_x=6, dim_z=4)
        self._filter.x[:4, 0] = _centre_and_size(box)
        self._filter.F[[0, 1], [4, 5]] = 1
        self._filter.H[:, :4] = np.eye(4)
        self._filter.P = np.diag([10.0, 10, 10, 10, 100, 100])
        # Fragments and shadows make sizes jump, so they are believed less than places.
        self._filter.R = np.diag([4.0, 4, 16, 16])
        self._filter.Q = np.diag([1.0, 1, 1, 1, 0.05, 0.05])

    def predict(self) -> None:
        self._filter.predict()
        self.age += 1

    def correct(self, box: Boxes) -> None:
        self._filter.update(_centre_and_size(box))
        self.hits, self.age, self.lost = self.hits + 1, 0, False

    def box(self) -> Boxes:
        state = self._filter.x[:, 0]
        size = np.maximum(state[2:4], 1)
        return np.concatenate([state[:2] - size / 2, size])


def _centre_and_size(box: Boxes) -> Boxes:
    return np.concatenate([box[:2] + box[2:] / 2, box[2:]])


def _labelled(mask: cv2.typing.MatLike) -> tuple[cv2.typing.MatLike, cv2.typing.MatLike]:
    """Return labels and statistics of 8-connected components; the default way takes three times as long."""
    return cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)[1:3]
