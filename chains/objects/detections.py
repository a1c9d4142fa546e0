"""What detections do to objects: they correct, start, confirm and doubt them.

Of an object j with its blob at x_j and its box d_j within that, which exists (e_j) and is noticed (n_j):

    p(z | j) = N(z; d_j about x_j, detector's noise), d_j a random walk, whose sides also grow at a rate g_j
    p(g_t | g_t-1): it is forgotten within GROWTH_TIME s, for others of GROWTH_STD
    p(e_t | e_t-1): it leaves after LIFE s on average; p(n_t | n_t-1): a Markov chain of two states, PHASE s
    p(j found | e_j, n_j) = its visible share, times NOTICED or UNNOTICED

Existence and association are those of joint integrated probabilistic data association (D. Musicki, R. Evans,
2004), with marginals by belief propagation (see `models.objects.association`). We depart in what a box of
uncertain origin does: the mean of the log likelihood over assignments updates place and size, which does not
widen them, and keeps objects that are close to each other apart better than the mixture's mean does.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference.kalman import kinematic
from ...models.core.gaussian_message import GaussianMessage
from ...models.objects.box_message import (
    BOX,
    FOOT_X,
    FOOT_Y,
    HEIGHT,
    WIDTH,
    BoxMessage,
    Errors,
    LogOdds,
    error_probabilities,
)
from .blob_records import FRESH, MARGIN, RECORD, move
from .blobs import Blob, Blobs, Map, Numbers, box_densities, paste

ACCELERATION = 0.4
"""Heights/s^2, standard deviation of what moves a person out of the straight way; it lasts half a second."""

INITIAL_VELOCITY_STD = 0.8  # heights/s, standard deviation of a new object's velocity, along either axis
LIFE = 20.0  # s, for which an object stays in the picture on average
PHASE = 0.15  # s, time constant with which the detector begins to notice an object, or ceases to
USUALLY = 0.85  # share of the time for which the detector notices an object
BOX_WALK_STD = 0.03  # heights/s^0.5: how far a box moves against the blob that it is of, by gait
SIDE_WALK_STD = 0.1  # shares/s^0.5: how fast sides of a box change as an object comes nearer
GROWTH_STD, GROWTH_TIME = 0.1, 5.0
"""1/s and s: deviation of the rate at which sides grow, and time constant with which it changes.

Who walks towards a camera 14 m away grows by a tenth a second.
"""

MASK_ERROR = 0.2  # of a mask's box, in its sides: how far a detector's box may be off
LEAST = np.array([-np.inf, -np.inf, 1.0, 1.0])  # px: of a box's numbers

WHOLE = 0.25
"""s after which a box of the same object is worth a whole new one: a detector errs alike for a while."""

SURE_COVER = np.float32(0.9)
"""Probability that a pixel well inside of what a detector shows of an object is the object's."""

GIVEN_UP = math.log(0.02 / 0.98)  # log odds of existence below which an object is forgotten
UNLIKELY = 0.02  # probability of existence from which on a box is remembered as a candidate
REPORTED = 0.5  # probability of existence from which on a candidate is an object, with pixels of its own
MOVING = 0.2  # share of errors that move along with something, of those that are no second boxes
MOVING_LIFE = 1.0  # s, for which an error moves along on average
FADED = 0.1  # probability of an error below which an unlikely candidate is forgotten
SURE = 30.0  # nats, greatest log odds of an error

OF_CANDIDATE = (
    "velocity", "covariance", "existence", "noticed", "detected", "box_variance", "growth",
    "growth_covariance", "unfound", "origin",
)  # fmt: skip
"""Fields of a candidate that the object keeps which it becomes."""

NO_COVER: Map = np.zeros((1, 1), np.float32)


def predict(blobs: Blobs, dt: float, acceleration: float, detecting: bool) -> Blobs:
    """Predict blobs `dt` seconds ahead: constant velocity but for a random force."""
    if not len(blobs):
        return blobs
    table = blobs.table.copy()
    move(table, dt, kinematic(2, dt).noise, acceleration, ACCELERATION)
    if detecting:
        _predict_detections(table, dt)
    return blobs.with_table(table)


def _predict_detections(table: NDArray[np.void], dt: float) -> None:
    """Predict detected boxes, existence and phase `dt` seconds ahead."""
    found = np.flatnonzero(table["detected"])
    sides = table["box_mean"][found][:, [HEIGHT, HEIGHT, WIDTH, HEIGHT]]
    table["box_variance"][found] += (
        dt * (sides * [BOX_WALK_STD, BOX_WALK_STD, SIDE_WALK_STD, SIDE_WALK_STD]) ** 2
    )
    _grow(table, found, dt)
    table["unfound"][found] += dt
    stays, lasts = math.exp(-dt / PHASE), math.exp(-dt / LIFE)
    exists = _probability(table["existence"][found])
    table["existence"][found] = _log_odds(lasts * exists)
    # given that it does not exist, which includes that it has left
    never = ((1 - exists) / (1 - lasts * exists))[:, None]
    errors = never * error_probabilities(table["errors"][found])
    errors *= np.exp(-dt / np.array([LIFE, MOVING_LIFE]))
    ended = 1 - errors.sum(axis=1, keepdims=True)
    table["errors"][found] = np.log(np.maximum(errors, math.exp(-SURE)) / ended)
    noticed = stays * _probability(table["noticed"][found]) + (1 - stays) * USUALLY
    table["noticed"][found] = _log_odds(noticed)


def _grow(table: NDArray[np.void], found: NDArray[np.intp], dt: float) -> None:
    """Predict the sides of boxes and their growth, an Ornstein-Uhlenbeck process, `dt` seconds ahead."""
    kept, force = math.exp(-dt / GROWTH_TIME), GROWTH_STD**2
    reach = GROWTH_TIME * (1 - kept)  # s
    growth, spread = table["growth"][found], table["growth_covariance"][found]
    sides, own, both = table["box_mean"][found, WIDTH:], spread[:, :1], spread[:, 1:]
    added = force * GROWTH_TIME * (2 * dt - 2 * reach - reach**2 / GROWTH_TIME)
    unsure = table["box_variance"][found, WIDTH:] + sides**2 * (2 * reach * both + reach**2 * own + added)
    larger = np.exp(reach * growth)[:, None]
    table["box_variance"][found, WIDTH:] = larger**2 * unsure
    table["box_mean"][found, WIDTH:] = larger * sides
    table["growth"][found] = kept * growth
    both = kept * (both + reach * own) + force * reach**2 / GROWTH_TIME
    table["growth_covariance"][found] = np.hstack([kept**2 * own + force * (1 - kept**2), both])


def box_message(blobs: Blobs, candidates: Blobs, detecting: bool, image: bool) -> BoxMessage:
    """Return the message of blobs to `ObjectBoxes`: boxes the image shows, and what a detector may find."""
    table = blobs.table
    # of those whom the pixels alone show
    shown = (table["confidence"] > 0.5) & (table["seen"] >= FRESH) & (table["detected"] == 0)
    message = BoxMessage()
    if image and shown.any():
        message = BoxMessage(box_densities(table["identity"][shown], blobs.boxes[shown]))
    return message * _expectations(table, candidates.table) if detecting else message


def _expectations(blobs: NDArray[np.void], candidates: NDArray[np.void]) -> BoxMessage:
    """Existence and phases of all objects, and boxes of those that the detector has found before."""
    table = np.concatenate([blobs, candidates])
    table = table[np.argsort(table["identity"])]
    identities = table["identity"].copy()
    candidates = candidates[np.argsort(candidates["identity"])]
    x, y, width, height = candidates["origin"].T
    first = np.stack([x + 0.5 * width, y + height, width, height], axis=1)
    message = BoxMessage(
        existence=LogOdds(identities, table["existence"].copy()),
        noticed=LogOdds(identities, table["noticed"].copy()),
        errors=Errors(candidates["identity"].copy(), candidates["errors"].copy(), first),
    )
    hidden = table[table["detected"] != 0]
    if not len(hidden):
        return message
    means, variances = hidden["box_mean"].copy(), hidden["box_variance"].copy()
    means[:, :WIDTH] += hidden["position"][:, ::-1]
    variances[:, :WIDTH] += hidden["covariance"][:, 0, :1]
    gaussian = GaussianMessage.from_moments(hidden["identity"], means, variances[:, :, None] * np.eye(BOX))
    return replace(message, hidden=gaussian)


def correct(blobs: Blobs, boxes: BoxMessage) -> Blobs:
    """Correct place, velocity, box and existence of objects by the boxes associated with them."""
    association = boxes.association
    assert association is not None
    precision, vector = association.information
    existence, noticed = (odds.of(association.identities) for odds in (boxes.existence, boxes.noticed))
    places = {int(identity): k for k, identity in enumerate(association.identities)}
    table = blobs.table.copy()
    for record, box in zip(table, blobs.boxes.tolist(), strict=True):
        k = places.get(int(record["identity"]))
        if k is None:
            continue
        record["existence"] += existence[k]
        record["errors"] = np.minimum(record["errors"] + association.errors[k], SURE)
        record["noticed"] += noticed[k]
        share = float(association.followed[k].sum())
        if not record["detected"] and share > 0.5:
            _detect_from_mask(record, box)
        if record["detected"] and share > 1e-3:
            _correct_box(record, vector[k] / precision[k], 1 / precision[k])
    return blobs.with_table(table)


def _detect_from_mask(record: np.void, box: list[float]) -> None:
    """Initialise the detected box of a blob from its mask, with its `box`."""
    x, y, width, height = box
    top, left = record["position"].tolist()
    record["box_mean"] = x + 0.5 * width - left, y + height - top, width, height
    record["box_variance"] = (MASK_ERROR * np.array([width, height, width, height])) ** 2 + 1
    record["detected"], record["unfound"], record["growth"] = 1, 0.0, 0.0
    record["growth_covariance"] = GROWTH_STD**2, 0.0, 0.0


def new_candidates(born: int, boxes: BoxMessage, size: tuple[int, int], channels: int) -> Blobs:
    """Return what boxes in the picture may show of new objects, after `born` others: it covers no pixels."""
    association = boxes.association
    assert association is not None
    found = np.flatnonzero((association.new > UNLIKELY) & _inside(boxes.in_frame(association.boxes), size))
    x, y, width, height = association.boxes[found].T
    blank = Blob(np.zeros(1, RECORD)[0], NO_COVER, NO_COVER[None][:0]).changed(mask=NO_COVER)
    blobs = Blobs.of([blank] * len(found), channels)
    table, new = blobs.table, association.new[found]
    table["identity"] = table["whole"] = born + 1 + np.arange(len(found))
    table["position"] = np.stack([y - height, x - 0.5 * width], axis=1)
    table["covariance"][:, 0, 0], table["covariance"][:, 1, 1] = 1e-6, (INITIAL_VELOCITY_STD * height) ** 2
    table["existence"], table["noticed"] = _log_odds(new), _log_odds(0.98)
    doubles = np.minimum(association.double[found] / np.maximum(1 - new, 1e-12), 1)
    moving = doubles + (1 - doubles) * MOVING
    # as likely as not the detector does not err again
    table["errors"] = np.log(np.maximum(np.stack([1 - moving, moving], axis=1), 1e-12))
    table["detected"] = 1
    table["growth_covariance"][:, 0] = GROWTH_STD**2
    table["box_mean"] = np.stack([0.5 * width, height, width, height], axis=1)
    table["box_variance"] = association.noise[found]
    table["origin"] = np.stack([x - 0.5 * width, y - height, width, height], axis=1)
    return blobs


def sort_candidates(candidates: Blobs, boxes: BoxMessage, size: tuple[int, int]) -> tuple[Blobs, Blobs]:
    """Return candidates that are as likely as not, and those that may still become so, or are errors."""
    table = candidates.table
    exists, errors = _probability(table["existence"]), error_probabilities(table["errors"]).sum(axis=1)
    there = _are_there(candidates, boxes, size)
    likely = there & (exists > REPORTED)
    lasts = (exists > UNLIKELY) | ((1 - exists) * errors > FADED)
    return candidates.select(likely), candidates.select(there & lasts & ~likely)


def newborn(candidate: Blob, boxes: BoxMessage, channels: int, colour_variance: float) -> Blob:
    """Return a candidate as an object with pixels: those of the detector's outline, or of an ellipse."""
    association = boxes.association
    assert association is not None
    y, x = candidate.position + candidate.box_mean[[FOOT_Y, FOOT_X]]
    width, height = candidate.box_mean[WIDTH:].tolist()
    corner = np.array([y - height - MARGIN, x - 0.5 * width - MARGIN])
    mask = _ellipse(width, height)
    if association.outlines is not None:
        off = np.abs(association.boxes - [x, y, width, height]).sum(axis=1)
        nearest = int(np.argmin(off))
        outline = np.zeros(mask.shape, np.float32)
        top, left = (math.floor(start + 0.5) for start in corner.tolist())
        if off[nearest] < width:  # else the detector has not found it now
            paste(outline, top, left, association.outlines[nearest], 0, 0)
        if outline.any():  # in a detector's outline nearly everything is the object's
            mask = SURE_COVER * outline
    planes = np.zeros((channels, *mask.shape), np.float32)
    known = {name: candidate.record[name] for name in OF_CANDIDATE}
    return Blob.newborn(
        int(candidate.identity), corner, mask, planes, INITIAL_VELOCITY_STD, colour_variance
    ).changed(confidence=0.0, box_mean=(x - corner[1], y - corner[0], width, height), **known)


def are_parts(blobs: Blobs, detected: Blobs) -> NDArray[np.bool_]:
    """Return `(n,)` whether undetected blobs lie in the boxes of detected ones, as parts of them."""
    x, y, width, height = blobs.boxes.T[:, :, None]
    left, top, across, down = detected.reported_boxes.T
    shared_x = np.minimum(x + width, left + across) - np.maximum(x, left)
    shared_y = np.minimum(y + height, top + down) - np.maximum(y, top)
    shared = (shared_x > 0) & (shared_y > 0) & (shared_x * shared_y > 0.5 * width * height)
    return np.asarray(shared.any(axis=1) & (blobs.table["detected"] == 0))


def are_kept(blobs: Blobs, boxes: BoxMessage, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return `(n,)` whether objects are kept: undetected ones, and detected ones that may still be there."""
    table = blobs.table
    there = _are_there(blobs, boxes, size) & (table["existence"] > GIVEN_UP)
    return np.asarray((table["detected"] == 0) | there)


def _are_there(blobs: Blobs, message: BoxMessage, size: tuple[int, int]) -> NDArray[np.bool_]:
    """`(n,)`: whether the box of a detected object is in the picture, and known to its own height."""
    table = blobs.table
    boxes = table["box_mean"].copy()
    boxes[:, :WIDTH] += table["position"][:, ::-1]
    known = table["covariance"][:, 0, 0] < boxes[:, HEIGHT] ** 2
    return np.asarray(_inside(message.in_frame(boxes), size) & known)


def _inside(boxes: Numbers, size: tuple[int, int]) -> NDArray[np.bool_]:
    """`(n,)`: whether a fifth of a box, along either axis, is in the picture."""
    x, y, width, height = boxes.T
    across = np.minimum(x + 0.5 * width, size[1]) - np.maximum(x - 0.5 * width, 0.0)
    down = np.minimum(y, size[0]) - np.maximum(y - height, 0.0)
    return np.asarray((across > 0.2 * width) & (down > 0.2 * height))


def _correct_box(record: np.void, place: Numbers, noise: Numbers) -> None:
    """Kalman update of patch, velocity and box by a box observed at `place`."""
    (along, both), (_, speed) = record["covariance"].tolist()
    top, left = record["position"].tolist()
    mean, variance = record["box_mean"], record["box_variance"]
    off = place - (mean + np.array([left, top, 0.0, 0.0]))
    noise = noise / min(max(float(record["unfound"]), 1e-3) / WHOLE, 1.0)
    total = variance + noise
    total[:WIDTH] += along
    gain = variance / total
    middle = float(total[:WIDTH].mean())
    down_right = off[[FOOT_Y, FOOT_X]]
    kept = 1 - along / middle
    record["position"] += along / middle * down_right
    record["velocity"] += both / middle * down_right
    record["covariance"] = [[kept * along, kept * both], [kept * both, speed - both**2 / middle]]
    # both sides of a detector's box err alike, so growth is corrected by the mean of what they say
    spread, shares = record["growth_covariance"], mean[WIDTH:] * record["growth_covariance"][1:]
    record["growth"] += float((shares * off[WIDTH:] / total[WIDTH:]).mean())
    spread[0] -= float((shares**2 / total[WIDTH:]).mean())
    spread[1:] *= 1 - gain[WIDTH:]
    record["box_mean"] = np.maximum(mean + gain * off, LEAST)
    record["box_variance"] = (1 - gain) * variance
    record["unfound"] = 0.0


def _ellipse(width: float, height: float) -> Map:
    """Mask of a person in a box, as an ellipse, in a patch with a border of `MARGIN`."""
    rows, columns = (max(round(side), 1) + 2 * MARGIN for side in (height, width))
    y = (np.arange(rows) - 0.5 * (rows - 1)) / (0.5 * height)
    x = (np.arange(columns) - 0.5 * (columns - 1)) / (0.5 * width)
    square = y[:, None] ** 2 + x**2
    return np.asarray(SURE_COVER / (1 + np.exp(np.minimum(8 * (square - 1), 700))), np.float32)


def _probability(log_odds: Numbers) -> Numbers:
    return 0.5 * (1 + np.tanh(0.5 * log_odds))


def _log_odds(probability: ArrayLike) -> Numbers:
    likely = np.clip(probability, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(likely) - np.log1p(-likely))
