"""The one pass over the pixels of a frame, band by band: all that an image says of a predicted background."""

from typing import NamedTuple

import numpy as np

from ...numerics.compiled import compiled, put
from .gaussian import HIGHEST_VARIANCE, ODDS_STEPS, VARIANCE_STEPS, Gaussians, smooth_log_odds
from .rows import other_rows, usual_rows_of_colour, usual_rows_of_grey
from .second_colours import recall
from .sway import LEAST_RATE, recall_moved

HALO = 2
"""Rows beyond a band that its own log odds depend on."""


BLOCK = 32
"""Rows that are worked on at a time: small enough to stay in the cache."""


class Pooling(NamedTuple):
    """`prior` log odds of background in steps, int16, and the `share` of neighbours, float32."""

    prior: np.int16
    share: np.float32


@compiled
def subtract(first, end, pixels, before, light_field, models, hypotheses, pooling, after, results):
    """Rows `first` to `end` of a picture: log odds of background, and the update that they imply.

    `models` are the pixels' model, what of it pixels need that show background for sure, and what is added
    to numbers before they are cut off. `hypotheses` are what else a pixel may show and be background: its
    second colour, within a tolerance, and what sways. `results` get the log odds of each pixel by itself, and
    smoothed. What rows of other bands add to the neighbours' share is worked out again here, so that no band
    waits for another one.
    """
    model, (log_odds, smoothed) = models[0], results
    second, tolerance, sway = hypotheses
    channels, (height, width) = before.mean.shape[0], (light_field.positions.size, light_field.rows.shape[1])
    top, bottom = max(first - HALO, 0), min(end + HALO, height)
    own = np.empty((bottom - top) * width, np.int8)
    beyond = Gaussians(
        np.empty((channels, HALO * width), np.int16),
        np.empty(HALO * width, np.uint16),
        np.empty(HALO * width, np.uint16),
    )
    most, start = 0, top
    while start < bottom:
        # one call for all rows: a copy of the loops inside is compiled for each
        is_own = first <= start < end
        if is_own:
            stop, to, updated = min(start + BLOCK, end), start * width, after
        else:
            stop, to, updated = first if start < first else bottom, 0, beyond
        odds = own[(start - top) * width : (stop - top) * width]
        highest = _rows(start, stop, pixels, before, light_field, models, to, updated, odds)
        most = max(most, highest) if is_own else most
        start = stop
    recall(top * width, pixels, second, tolerance, model, own)
    if sway.rates.max() >= LEAST_RATE:
        recall_moved(top, pixels, before, light_field, model, sway, own)
    put(own[(first - top) * width : (end - top) * width], log_odds[first * width : end * width])
    smooth_log_odds(
        first - top, end - top, bottom - top, width, own, pooling.prior, pooling.share,
        smoothed[top * width : bottom * width],
    )  # fmt: skip
    if most > HIGHEST_VARIANCE * VARIANCE_STEPS:  # neighbours tell nothing of a value that nobody knows
        for i in range(first * width, end * width):
            if before.variance[i] > HIGHEST_VARIANCE * VARIANCE_STEPS:
                smoothed[i] = np.int8(model.label_odds * np.float32(ODDS_STEPS))


@compiled
def _rows(first, end, pixels, before, light_field, models, to, after, log_odds):
    """Rows `first` to `end`: their `log_odds`, and the Gaussians `after` them from pixel `to` on."""
    model, certain, rounding = models
    if before.mean.shape[0] == 3:
        usual_rows_of_colour(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds)
    else:
        usual_rows_of_grey(first, end, pixels, before, light_field, certain, rounding, to, after, log_odds)
    return other_rows(first, end, pixels, before, light_field, model, rounding, to, after, log_odds)
