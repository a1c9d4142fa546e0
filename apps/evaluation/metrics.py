"""How good a result is: masks against labels, components against objects, tracks against tracks."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..io.ground_truth import FOREGROUND, SHADOW, BoxTruth, Kind

MIN_AREA = 50
"""px; smaller connected components are noise and no extracted objects."""

_GROWTH = 0.2
_GHOST_OVERLAP = 0.1
_COVERED = 0.5


@dataclass(frozen=True)
class PixelScores:
    """Pixels counted, and CDnet's measures of them; a measure whose denominator is zero is NaN."""

    true_positives: int
    false_positives: int
    false_negatives: int
    true_negatives: int

    @property
    def precision(self) -> float:
        """TP / (TP + FP)."""
        return _ratio(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float:
        """TP / (TP + FN)."""
        return _ratio(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def f_measure(self) -> float:
        """2 TP / (2 TP + FP + FN), the harmonic mean of precision and recall."""
        twice = 2 * self.true_positives
        return _ratio(twice, twice + self.false_positives + self.false_negatives)

    @property
    def specificity(self) -> float:
        """TN / (TN + FP)."""
        return _ratio(self.true_negatives, self.true_negatives + self.false_positives)

    @property
    def wrong_percent(self) -> float:
        """CDnet's PWC, 100 (FN + FP) / all."""
        wrong = self.false_negatives + self.false_positives
        return 100 * _ratio(wrong, wrong + self.true_positives + self.true_negatives)


@dataclass
class PixelScore:
    """Counts right and wrong pixels frame by frame.

    Shadow counts as background; pixels that are unknown or outside the region of interest do not count.
    """

    numbers: list[int] = field(default_factory=list)
    counts: list[tuple[int, int, int, int]] = field(default_factory=list)

    def add(self, number: int, foreground: NDArray[np.uint8], labels: NDArray[np.uint8]) -> None:
        """Count one frame.

        Parameters
        ----------
        number
            its 1-based number.
        foreground
            `(height, width)` uint8, not 0 where foreground was found.
        labels
            `(height, width)` uint8, CDnet's labels.

        Raises
        ------
        ValueError
            if the two differ in size.
        """
        _check_same_size(foreground, labels)
        found = foreground != 0
        positive = labels == FOREGROUND
        negative = labels <= SHADOW
        true_positives = int(np.count_nonzero(found & positive))
        false_positives = int(np.count_nonzero(found & negative))
        self.numbers.append(number)
        self.counts.append(
            (
                true_positives,
                false_positives,
                int(np.count_nonzero(positive)) - true_positives,
                int(np.count_nonzero(negative)) - false_positives,
            )
        )

    def total(self) -> PixelScores:
        """Return the measures over all frames."""
        return _sum_counts(self.counts)

    def blocks(self, length: int = 250) -> list[tuple[int, PixelScores]]:
        """Return the number of the first frame and the measures of each block of `length` counted frames."""
        return [
            (self.numbers[start], _sum_counts(self.counts[start : start + length]))
            for start in range(0, len(self.counts), length)
        ]


def joined(scores: Iterable[PixelScore]) -> PixelScore:
    """The frames of all scores in one."""
    whole = PixelScore()
    for score in scores:
        whole.numbers += score.numbers
        whole.counts += score.counts
    return whole


def total(scores: Iterable[PixelScore]) -> PixelScores:
    """Return the measures over all frames of all scores."""
    return joined(scores).total()


@dataclass(frozen=True)
class ErrorClasses:
    """The three error classes of the paper (§4.2, Fig. 8), counted over frames; instances add up.

    `missed_objects` is the first two for truth that does not tell pedestrians from vehicles.
    `missed_by_pixels`, of all kinds, is the stricter count that takes the components' pixels and not their
    boxes as cover, which most walking people fail: they fill about half of their box.
    """

    missed_pedestrians: int = 0
    missed_vehicles: int = 0
    missed_objects: int = 0
    ghosts: int = 0
    missed_by_pixels: int = 0
    objects: int = 0
    """How many there were to be found."""

    @property
    def errors(self) -> int:
        """Objects missed plus ghosts."""
        return self.missed_pedestrians + self.missed_vehicles + self.missed_objects + self.ghosts

    def __add__(self, other: "ErrorClasses") -> "ErrorClasses":
        return ErrorClasses(
            self.missed_pedestrians + other.missed_pedestrians,
            self.missed_vehicles + other.missed_vehicles,
            self.missed_objects + other.missed_objects,
            self.ghosts + other.ghosts,
            self.missed_by_pixels + other.missed_by_pixels,
            self.objects + other.objects,
        )


def error_classes(foreground: NDArray[np.uint8], truth: BoxTruth, min_area: int = MIN_AREA) -> ErrorClasses:
    """Count missed objects and ghosts in one frame.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, not 0 where foreground was found.
    truth
        the boxes of this frame.
    min_area
        px; smaller components (8-connected) are dropped first.

    Notes
    -----
    *Ghost*: less than 10 % of the component's pixels lie in true boxes (ignored ones included) grown by
    20 % about their centres. *Missed*: less than 50 % of the true box, clipped to the picture, is covered
    by the union of the bounding boxes of the components that are no ghosts. Boxes are compared with boxes,
    since a silhouette fills only about half of its box; ghosts cover nothing, since otherwise one component
    over the whole picture would find everybody. Objects wholly outside the picture do not count.
    """
    height, width = foreground.shape
    labels, corners, areas = _components(foreground, min_area)
    far = np.ones((height, width), np.bool_)
    inside = np.zeros(len(areas), np.int64)
    for x0, y0, x1, y1 in _pixel_corners(truth.box, foreground.shape, _GROWTH):
        region = slice(y0, y1), slice(x0, x1)
        inside += np.bincount(labels[region][far[region]], minlength=len(areas))
        far[region] = False
    kept = areas > 0
    ghost = kept & (inside < _GHOST_OVERLAP * areas)
    cover = np.zeros((height, width), np.bool_)
    for x0, y0, x1, y1 in corners[kept & ~ghost]:
        cover[y0:y1, x0:x1] = True

    missed = {Kind.PEDESTRIAN: 0, Kind.VEHICLE: 0}
    by_pixels = objects = 0
    for kind, (x0, y0, x1, y1) in zip(truth.kind, _pixel_corners(truth.box, foreground.shape), strict=True):
        area = (x1 - x0) * (y1 - y0)
        if kind == Kind.IGNORED or area <= 0:
            continue
        objects += 1
        region = slice(y0, y1), slice(x0, x1)
        missed[Kind(kind)] += int(np.count_nonzero(cover[region]) < _COVERED * area)
        by_pixels += int(np.count_nonzero(kept[labels[region]]) < _COVERED * area)
    return ErrorClasses(
        missed_pedestrians=missed[Kind.PEDESTRIAN],
        missed_vehicles=missed[Kind.VEHICLE],
        ghosts=int(np.count_nonzero(ghost)),
        missed_by_pixels=by_pixels,
        objects=objects,
    )


def mask_error_classes(
    foreground: NDArray[np.uint8], labels: NDArray[np.uint8], min_area: int = MIN_AREA
) -> ErrorClasses:
    """Count missed objects and ghosts in one frame of labelled masks.

    The true objects are the connected components of the labels' foreground with at least `min_area` pixels;
    one is missed if less than 50 % of its pixels belong to extracted components. A ghost has less than 10 %
    of its pixels on anything but background: where the truth is unknown, nothing is a ghost.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, not 0 where foreground was found.
    labels
        `(height, width)` uint8, CDnet's labels.
    min_area
        px, of extracted and of true components.

    Raises
    ------
    ValueError
        if the two differ in size.
    """
    _check_same_size(foreground, labels)
    found, _, areas = _components(foreground, min_area)
    inside = np.bincount(found[labels > 0], minlength=len(areas))
    kept = areas > 0
    objects, _, sizes = _components((labels == FOREGROUND).astype(np.uint8), min_area)
    covered = np.bincount(objects[kept[found]], minlength=len(sizes))
    missed = int(np.count_nonzero((sizes > 0) & (covered < _COVERED * sizes)))
    return ErrorClasses(
        missed_objects=missed,
        ghosts=int(np.count_nonzero(kept & (inside < _GHOST_OVERLAP * areas))),
        missed_by_pixels=missed,
        objects=int(np.count_nonzero(sizes)),
    )


@dataclass(frozen=True)
class TrackScores:
    """CLEAR-MOT and identity measures; a ratio whose denominator is zero is NaN.

    `motp` is the mean overlap (IoU) of the matches; `fragmentations` counts how often an object that is
    found again later is lost; an object is mostly tracked when found in 80 % of its frames or more, mostly
    lost when in less than 20 %; `n_truth` counts true boxes.
    """

    mota: float
    motp: float
    idf1: float
    idp: float
    idr: float
    switches: int
    fragmentations: int
    misses: int
    false_positives: int
    mostly_tracked: int
    mostly_lost: int
    n_truth: int
    n_frames: int


def evaluate_tracks(
    truth: BoxTruth, tracks: NDArray[np.float64], frames: Collection[int], iou: float = 0.5
) -> TrackScores:
    """Compare tracks with true tracks.

    Parameters
    ----------
    truth
        the true boxes. A tracked box that is best explained by an ignored one does not count.
    tracks
        `(n, 6)` float: frame number (1-based), identity, x, y (0-based px), width, height (px).
    frames
        the frame numbers to compare (`common_frames`).
    iou
        least overlap of a match.

    Notes
    -----
    K. Bernardin, R. Stiefelhagen, *Evaluating multiple object tracking performance: the CLEAR MOT metrics*
    (2008): a pair matched before stays matched while its boxes overlap enough, also after a gap; the rest is
    matched with the most pairs, then the least total distance. E. Ristani et al., *Performance measures and
    a data set for multi-target, multi-camera tracking* (2016): the pairing of whole tracks with the most
    common frames (IDTP) gives IDF1.

    Raises
    ------
    ValueError
        if `tracks` has another form, or an identity twice in a frame.
    """
    tracks = np.asarray(tracks, dtype=np.float64)
    if tracks.ndim != 2 or tracks.shape[1] != 6:
        raise ValueError(f"tracks: got {tracks.shape}, expected (n, 6): frame, identity, x, y, width, height")
    tracks = tracks[np.lexsort((tracks[:, 1], tracks[:, 0]))]
    repeated = np.flatnonzero((np.diff(tracks[:, :2], axis=0) == 0).all(axis=1))
    if repeated.size:
        frame, identity = tracks[repeated[0], :2]
        raise ValueError(f"tracks: identity {identity:.0f} occurs twice in frame {frame:.0f}")

    true_index, n_objects = _positions(truth.identity)
    track_index, n_tracks = _positions(tracks[:, 1])
    common = np.zeros((n_objects, n_tracks), np.int64)
    history: list[list[bool]] = [[] for _ in range(n_objects)]
    partner = np.full(n_objects, -1)
    switches = false_positives = matches = n_truth = n_found = 0
    overlap_sum = 0.0
    for number in sorted(frames):
        rows = slice(*np.searchsorted(truth.frame, [number, number + 1]))
        columns = slice(*np.searchsorted(tracks[:, 0], [number, number + 1]))
        objects, found = true_index[rows], track_index[columns]
        overlap = box_overlap(truth.box[rows], tracks[columns, 2:])
        ignored = truth.kind[rows] == Kind.IGNORED
        if ignored.any():
            keep = np.ones(len(found), bool)
            pairs = _match(overlap, iou)
            keep[pairs[1][ignored[pairs[0]]]] = False
            objects, found, overlap = objects[~ignored], found[keep], overlap[~ignored][:, keep]
        n_truth += len(objects)
        n_found += len(found)

        allowed = overlap >= iou
        first, second = np.nonzero(allowed)
        common[objects[first], found[second]] += 1
        still = allowed & (partner[objects][:, None] == found)
        # Two objects may remember the same track; the first one keeps it.
        still &= np.cumsum(still, axis=0) == 1
        open_rows, open_columns = ~still.any(axis=1), ~still.any(axis=0)
        new = _match(np.where(open_rows[:, None] & open_columns, overlap, 0.0), iou)
        switches += int(np.count_nonzero(partner[objects[new[0]]] >= 0))
        partner[objects[new[0]]] = found[new[1]]
        still[new] = True
        for thing, was_found in zip(objects, still.any(axis=1), strict=True):
            history[thing].append(bool(was_found))
        matched = int(np.count_nonzero(still))
        matches += matched
        false_positives += len(found) - matched
        overlap_sum += float(overlap[still].sum())

    paired = linear_sum_assignment(common, maximize=True)
    true_identities = int(common[paired].sum())
    misses = n_truth - matches
    share = np.array([np.mean(seen) for seen in history if seen])
    return TrackScores(
        mota=1 - _ratio(misses + false_positives + switches, n_truth),
        motp=_ratio(overlap_sum, matches),
        idf1=_ratio(2 * true_identities, n_truth + n_found),
        idp=_ratio(true_identities, n_found),
        idr=_ratio(true_identities, n_truth),
        switches=switches,
        fragmentations=sum(_gaps(seen) for seen in history),
        misses=misses,
        false_positives=false_positives,
        mostly_tracked=int(np.count_nonzero(share >= 0.8)),
        mostly_lost=int(np.count_nonzero(share < 0.2)),
        n_truth=n_truth,
        n_frames=len(frames),
    )


def box_overlap(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the IoU `(n, m)` of boxes `(n, 4)` and `(m, 4)`: x, y, width, height (px)."""
    top_left = np.maximum(first[:, None, :2], second[None, :, :2])
    bottom_right = np.minimum(
        first[:, None, :2] + first[:, None, 2:], second[None, :, :2] + second[None, :, 2:]
    )
    shared: NDArray[np.float64] = np.clip(bottom_right - top_left, 0, None).prod(axis=2)
    union = first[:, 2:].prod(axis=1)[:, None] + second[:, 2:].prod(axis=1) - shared
    overlap: NDArray[np.float64] = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
    return overlap


def _match(overlap: NDArray[np.float64], least: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair rows with columns that overlap by `least` or more: most pairs, then the greatest overlap."""
    # One forbidden pair costs more than all allowed ones together.
    forbidden = min(overlap.shape) + 1.0
    rows, columns = linear_sum_assignment(np.where(overlap >= least, 1 - overlap, forbidden))
    good = overlap[rows, columns] >= least
    return rows[good], columns[good]


def _positions(identity: NDArray[np.int64] | NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """Return each identity's position among the distinct ones, and how many there are."""
    distinct, position = np.unique(identity, return_inverse=True)
    return position.astype(np.int64), len(distinct)


def _gaps(seen: list[bool]) -> int:
    """Count the losses between the first and the last time that something was found."""
    places = np.flatnonzero(seen)
    return int(np.count_nonzero(np.diff(places) > 1))


def _components(
    mask: NDArray[np.uint8], min_area: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return labels, corners (x0, y0, x1, y1) and areas of components; area 0: background or too small."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = statistics[:, cv2.CC_STAT_AREA].astype(np.int32)
    areas[areas < min_area] = 0
    areas[0] = 0
    corners = statistics[:, : cv2.CC_STAT_HEIGHT + 1].astype(np.int32)
    corners[:, 2:] += corners[:, :2]
    return labels.astype(np.int32, copy=False), corners, areas


def _pixel_corners(
    box: NDArray[np.float64], shape: tuple[int, ...], growth: float = 0.0
) -> NDArray[np.int64]:
    """Return x0, y0, x1, y1 of boxes grown about their centres, in whole pixels of the picture."""
    margin = box[:, 2:] * (growth / 2)
    corners = np.hstack([box[:, :2] - margin, box[:, :2] + box[:, 2:] + margin])
    height, width = shape
    return np.clip(np.rint(corners), 0, [width, height, width, height]).astype(np.int64)


def _check_same_size(foreground: NDArray[np.uint8], labels: NDArray[np.uint8]) -> None:
    if foreground.shape != labels.shape:
        raise ValueError(f"foreground: got {foreground.shape} pixels, but the labels have {labels.shape}")


def _sum_counts(counts: list[tuple[int, int, int, int]]) -> PixelScores:
    return (
        PixelScores(*(sum(column) for column in zip(*counts, strict=True)))
        if counts
        else PixelScores(0, 0, 0, 0)
    )


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator else float("nan")
