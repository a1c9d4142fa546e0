"""Measures of tracks: boxes with identities against true ones."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import between, checked
from ..io.ground_truth import BoxTruth, Kind, MaskTruth
from .masks import ratio

Index = NDArray[np.int64]
Seen = tuple[Index, Index, NDArray[np.float64]]
"""Of a frame: which objects and which tracks are in it, and how much they overlap (IoU, `(n, m)`)."""

ALPHAS = np.arange(1, 20) / 20
"""Least overlaps over which HOTA is a mean."""


KEPT = 1000.0
"""What staying matched counts, in overlaps: more than all others together."""


@dataclass(frozen=True)
class TrackScores:
    """CLEAR-MOT, identity and HOTA measures; a ratio whose denominator is zero is NaN.

    `motp` is the mean overlap (IoU) of the matches; `deta` and `assa` are HOTA's parts, the accuracy of
    detection and of association, and means over least overlaps from 0.05 to 0.95 like `hota`, while all else
    is at one; `fragmentations` counts how often an object that is found again later is lost; an object is
    mostly tracked when found in 80 % of its frames or more, mostly lost when in less than 20 %; `n_truth`
    counts true boxes.
    """

    mota: float
    motp: float
    idf1: float
    idp: float
    idr: float
    hota: float
    deta: float
    assa: float
    switches: int
    fragmentations: int
    misses: int
    false_positives: int
    mostly_tracked: int
    mostly_lost: int
    n_truth: int
    n_frames: int

    def __repr__(self) -> str:
        return (
            f"TrackScores(MOTA {self.mota:.3f}, IDF1 {self.idf1:.3f}, HOTA {self.hota:.3f}: "
            f"{self.misses} misses, {self.false_positives} false positives, {self.switches} switches, "
            f"{self.n_truth} boxes in {self.n_frames} frames)"
        )


@checked
def evaluate_tracks(
    tracks: NDArray[np.void] | NDArray[np.float64],
    truth: BoxTruth | MaskTruth,
    frames: Collection[int] | None = None,
    iou: Annotated[float, between(0, 1)] = 0.5,
) -> TrackScores:
    """Compare tracks with true tracks.

    Parameters
    ----------
    tracks
        as `read_tracks` gives them, or `(n, 6)` float: frame number (1-based), identity, x, y (0-based px),
        width, height (px).
    truth
        the true boxes, as `read_ground_truth` gives them. A tracked box that is best explained by an ignored
        one does not count.
    frames
        the frame numbers to compare (`common_frames`); all that are annotated where it is left out.
    iou
        least overlap of a match.

    Notes
    -----
    K. Bernardin, R. Stiefelhagen, *Evaluating multiple object tracking performance: the CLEAR MOT metrics*
    (2008), as TrackEval has it: a pair that was matched in the frame before stays matched while its boxes
    overlap enough; the rest is matched by the largest sum of overlaps. E. Ristani et al., *Performance
    measures and a data set for multi-target, multi-camera tracking* (2016): the pairing of whole tracks with
    the most common frames (IDTP) gives IDF1. J. Luiten et al., *HOTA: a higher order metric for evaluating
    multi-object tracking* (2021), see `_hota`.

    MOTA, IDF1 and HOTA are TrackEval's where all true boxes are pedestrians or distractors. It knows no
    other objects: boxes of cars, for example, are false positives there.

    Raises
    ------
    ValueError
        if `tracks` has another form, or an identity twice in a frame, or `truth` has masks and no boxes.
    """
    if isinstance(truth, MaskTruth):
        raise ValueError("truth: got masks, expected boxes with identities")
    rows = _sorted_rows(tracks)
    frames = truth.frames if frames is None else frames
    true_index, n_objects = _positions(truth.identity)
    track_index, n_tracks = _positions(rows[:, 1])
    seen = [_seen(number, truth, true_index, rows, track_index, iou) for number in sorted(frames)]
    common = np.zeros((n_objects, n_tracks), np.int64)
    history: list[list[bool]] = [[] for _ in range(n_objects)]
    partner, just_before = np.full((2, n_objects), -1)
    switches = matches = 0
    overlap_sum = 0.0
    for objects, found, overlap in seen:
        allowed = overlap >= iou - np.finfo(float).eps
        first, second = np.nonzero(allowed)
        common[objects[first], found[second]] += 1
        still = just_before[objects][:, None] == found
        row, column = _assigned(-np.where(allowed, overlap + KEPT * still, 0.0))
        row, column = row[allowed[row, column]], column[allowed[row, column]]
        matched, names = objects[row], found[column]
        switches += int(np.count_nonzero((partner[matched] >= 0) & (partner[matched] != names)))
        partner[matched] = names
        if overlap.size:  # a frame without any boxes of one side is passed over
            just_before[:] = -1
            just_before[matched] = names
        for thing, was_found in zip(objects, np.isin(objects, matched), strict=True):
            history[thing].append(bool(was_found))
        matches += len(row)
        overlap_sum += float(overlap[row, column].sum())

    n_truth, n_found = (sum(len(one[side]) for one in seen) for side in (0, 1))
    paired = _assigned(-common)
    true_identities = int(common[paired].sum())
    misses, false_positives = n_truth - matches, n_found - matches
    share = np.array([np.mean(times) for times in history if times])
    hota, deta, assa = _hota(seen, n_objects, n_tracks)
    return TrackScores(
        mota=1 - ratio(misses + false_positives + switches, n_truth),
        motp=ratio(overlap_sum, matches),
        idf1=ratio(2 * true_identities, n_truth + n_found),
        idp=ratio(true_identities, n_found),
        idr=ratio(true_identities, n_truth),
        hota=hota,
        deta=deta,
        assa=assa,
        switches=switches,
        fragmentations=sum(_gaps(times) for times in history),
        misses=misses,
        false_positives=false_positives,
        mostly_tracked=int(np.count_nonzero(share >= 0.8)),
        mostly_lost=int(np.count_nonzero(share < 0.2)),
        n_truth=n_truth,
        n_frames=len(frames),
    )


def _seen(
    number: int,
    truth: BoxTruth,
    true_index: Index,
    rows: NDArray[np.float64],
    track_index: Index,
    iou: float,
) -> Seen:
    """What is in a frame; boxes to ignore, and the tracked ones that they explain best, are left out."""
    true = slice(*np.searchsorted(truth.frame, [number, number + 1]))
    columns = slice(*np.searchsorted(rows[:, 0], [number, number + 1]))
    objects, found = true_index[true], track_index[columns]
    overlap = box_overlap(truth.box[true], rows[columns, 2:])
    ignored = truth.kind[true] == Kind.IGNORED
    if not ignored.any():
        return objects, found, overlap
    keep = np.ones(len(found), bool)
    pairs = match_boxes(overlap, iou)
    keep[pairs[1][ignored[pairs[0]]]] = False
    return objects[~ignored], found[keep], overlap[~ignored][:, keep]


def _hota(seen: Sequence[Seen], n_objects: int, n_tracks: int) -> tuple[float, float, float]:
    """HOTA, DetA and AssA of Luiten et al. (2021), means over `ALPHAS`.

    Boxes are paired by their overlap times how well the whole tracks fit, which counts shared frames by the
    share of the overlap that is theirs alone; that pairing serves every least overlap. DetA is TP / (TP + FN
    + FP); AssA is the mean over TP of TPA / (TPA + FNA + FPA) of the pair of tracks that it belongs to, 0
    where there is none; HOTA at one least overlap is the geometric mean of both.
    """
    shared = np.zeros((n_objects, n_tracks))
    lengths = np.zeros(n_objects), np.zeros(n_tracks)
    for objects, found, overlap in seen:
        either = overlap.sum(axis=1)[:, None] + overlap.sum(axis=0) - overlap
        shared[np.ix_(objects, found)] += np.divide(overlap, either, np.zeros_like(overlap), where=either > 0)
        lengths[0][objects] += 1
        lengths[1][found] += 1
    pairs, overlaps = [np.zeros(0, np.int64)], [np.zeros(0)]
    for objects, found, overlap in seen:
        common = shared[np.ix_(objects, found)]
        union = lengths[0][objects][:, None] + lengths[1][found] - common
        row, column = _assigned(-common / union * overlap)
        pairs.append(objects[row] * n_tracks + found[column])
        overlaps.append(overlap[row, column])
    pair, paired_overlap = np.concatenate(pairs), np.concatenate(overlaps)
    scores = []
    for alpha in ALPHAS:
        both, count = np.unique(pair[paired_overlap >= alpha - np.finfo(float).eps], return_counts=True)
        n_matches = int(count.sum())
        total = lengths[0][both // max(n_tracks, 1)] + lengths[1][both % max(n_tracks, 1)] - count
        deta = ratio(n_matches, lengths[0].sum() + lengths[1].sum() - n_matches)
        assa = float((count * count / total).sum()) / max(n_matches, 1)
        scores.append((np.sqrt(deta * assa), deta, assa))
    hota, deta, assa = np.mean(scores, axis=0).tolist()
    return hota, deta, assa


def track_rows(boxes: NDArray[np.void]) -> NDArray[np.float64]:
    """Return boxes of `read_tracks` as rows frame, identity, x, y, width, height."""
    return np.column_stack([boxes["frame"], boxes["id"], boxes["box"].reshape(-1, 4)]).astype(np.float64)


def _sorted_rows(tracks: NDArray[Any]) -> NDArray[np.float64]:
    """By frame and identity, each of which occurs once."""
    rows = np.asarray(tracks if tracks.dtype.names is None else track_rows(tracks), np.float64)
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise ValueError(f"tracks: got {rows.shape}, expected (n, 6): frame, identity, x, y, width, height")
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    repeated = np.flatnonzero((np.diff(rows[:, :2], axis=0) == 0).all(axis=1))
    if repeated.size:
        frame, identity = rows[repeated[0], :2]
        raise ValueError(f"tracks: identity {identity:.0f} occurs twice in frame {frame:.0f}")
    return rows


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


def match_boxes(overlap: NDArray[np.float64], least: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair rows with columns that overlap by `least` or more: most pairs, then the greatest overlap."""
    # One forbidden pair costs more than all allowed ones together.
    forbidden = min(overlap.shape) + 1.0
    rows, columns = _assigned(np.where(overlap >= least, 1 - overlap, forbidden))
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


def _assigned(costs: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pairs with the least sum of costs."""
    from scipy.optimize import linear_sum_assignment  # slow to import, and only the truth needs it

    rows, columns = linear_sum_assignment(costs)
    return rows, columns
