"""Loops over pixels that show the scene in less light: cast shadows.

Where something takes light away, a pixel shows `gain * light * mean` in all channels, and what is around it
has the same gain or, beyond the shadow's edge, the usual light. Dark places of an object look so by chance.
With the shares s, l, o of places around that have the same gain, the usual light, and anything else,

    log p(around | shade) / p(around | object) = INDEPENDENT log 3 (s + l / 2 - o)

which is multinomial: .51, .26, .23 in shade and .17, .15, .68 on objects; places that are the scene for
another reason say nothing. The agreement was measured on one road; how often it is shade where the plain
scene is not seen is learned by place and for the whole film, by expectation maximisation.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled, inlined, sigmoid
from ...models.pixels.background import ODDS_STEPS, SPAN, blocks_along, foreground_spans
from ...models.pixels.colour import planes_of
from .gaussians import MOST_RECALLED, SURE, light_beside, mean_of, noise_of, variance_of

_f4 = np.float32

DARKEST = 0.2  # gain, of a hard shadow in the sun
SAME_GAIN = 0.1  # relative difference within which gains are the same
CHROMA_SURPRISE = 9.2  # squared distance over the variance that one in a hundred exceeds by noise
INDEPENDENT = 8.0  # of the places around: they are near each other
DISTANCES = 0.006, 0.016, 0.028  # shares of the picture's longer side at which they lie, in eight directions

CAST = 0.5  # of what looks like shade: something else has to be near, or it is a smooth dark object
NO_SHADE = -20.0  # nats, where nothing is near that casts it
UNUSUAL = 0.01  # share of shade in what is not the plain scene, before any was seen
LITTLE = 0.001, 0.01  # share of the picture, and of a place, that has to be so for it to tell by itself
SHADE_TIME = 10.0  # s for which it is remembered
COUNT_STEPS = 1024  # of a pixel, in which pixels are counted: sums of whole numbers depend on no order


class Shade(NamedTuple):
    """How often there is shade, and where pixels are asked whether they agree."""

    log_odds: NDArray[np.float32]  # (block_rows, block_columns): of shade, where the plain scene is not seen
    around: NDArray[np.int64]  # (n, 2) px down and right


def shade_in(seen: NDArray[np.float32], size: tuple[int, int]) -> Shade:
    """Return what is expected of a picture of `size` `(height, width)` px.

    `seen` `(3, block_rows, block_columns)` are shares of blocks: of what is not the plain scene, of shade,
    and of what looks like shade. A place is as the film, and the film as others are, as far as they were not
    seen themselves. There is no shade where hardly anything is near that looks otherwise.
    """
    near = cv2.blur(seen.transpose(1, 2, 0), (3, 3)).transpose(2, 0, 1)
    foreground, shade, alike = np.maximum(near, 0)  # which running sums may miss by their rounding
    usual = (shade.mean() + UNUSUAL * LITTLE[0]) / (foreground.mean() + LITTLE[0])
    share = (shade + usual * LITTLE[1]) / (foreground + LITTLE[1])
    steps = [math.ceil(distance * max(size)) for distance in DISTANCES]
    eight = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
    around = np.array([(step * y, step * x) for step in steps for y, x in eight])
    others = foreground - alike
    usual_others = others.mean() / (alike.mean() + LITTLE[0])
    casts = (others + usual_others * LITTLE[1]) / (alike + LITTLE[1]) > CAST
    log_odds = np.where(casts, np.log(share) - np.log1p(-share), NO_SHADE)
    return Shade(log_odds.astype(np.float32), around)


def update_shade(
    seen: NDArray[np.float32], counts: NDArray[np.int64], size: tuple[int, int], age: float, elapsed: float
) -> NDArray[np.float32]:
    """Return the shares of blocks after a frame, `elapsed` s after the last; the first was `age` s ago.

    `counts` `(3, block_rows, block_columns)` are those of `recall_shaded`.
    """
    now = counts * (counts[0].size / (COUNT_STEPS * size[0] * size[1]))
    share = 1 - math.exp(-elapsed / (min(age, SHADE_TIME) + 1))
    return np.asarray(seen + share * (now - seen), np.float32)


@compiled
def _find_gains(first, end, pixels, before, light_field, model, log_odds, gains):
    """Gains of pixels of rows `first` to `end` that are not the plain scene; 0 where it is no shade."""
    mean, channels, width = before.mean, before.mean.shape[0], light_field.rows.shape[1]
    spans = np.empty(width // SPAN + 1, np.int64)
    for y in range(first, end):
        odds = log_odds[y * width : (y + 1) * width]
        out = gains[(y - first) * width : (y - first + 1) * width]
        upper, lower, below_share = light_beside(light_field, y)
        for span in range(foreground_spans(odds, spans)):
            for x in range(spans[span], min(spans[span] + SPAN, width)):
                if odds[x] >= 0:
                    continue
                out[x] = _f4(0)
                i = y * width + x
                light = upper[x] + below_share * (lower[x] - upper[x])
                expected = light * mean_of(mean[0, i])
                luma, red, blue = _f4(pixels[channels * i]), _f4(0), _f4(0)
                if channels == 3:
                    luma, red, blue = planes_of(pixels[3 * i], pixels[3 * i + 1], pixels[3 * i + 2])
                if luma >= expected or luma < _f4(DARKEST) * expected:
                    continue
                gain = luma / expected
                if channels == 3:
                    red -= gain * light * mean_of(mean[1, i])
                    blue -= gain * light * mean_of(mean[2, i])
                total = noise_of(before.noise[i])
                total += light * light * (variance_of(before.variance[i]) + model.drift)
                if red * red + blue * blue < _f4(CHROMA_SURPRISE) * total:
                    out[x] = gain


@inlined
def _vote(odds, gain, own_gain):
    """In halves: 2 for the same gain, 1 for the usual light, -2 for others, 0 for what is recalled."""
    # no branches, which cannot be predicted; a gain of background means nothing
    alike = 2 if abs(gain - own_gain) < _f4(SAME_GAIN) * own_gain else -2
    usual = 1 if odds == SURE else 0  # its own Gaussian, and nothing recalled
    return usual if odds >= 0 else alike


@compiled
def recall_shaded(first, end, halo, pixels, before, light_field, model, shade, log_odds, shaded, counts):
    """Turn foreground of rows `first` to `end` that shade explains into background.

    That is in `shaded`, their log odds and those of `halo` rows on either side; `log_odds` are those of the
    whole picture without shade. `counts` `(3, block_rows, block_columns)` get how many pixels of the rows are
    not the plain scene, the sum of their probabilities of shade, and how many look like it, in `COUNT_STEPS`.
    Returns the rows from the first to behind the last in which something was turned; none if nothing was.
    """
    height, width = light_field.positions.size, light_field.rows.shape[1]
    (block_rows, block_columns), around = shade.log_odds.shape, shade.around
    evidence, reach, blocks = _f4(INDEPENDENT * np.log(3)), around.max(), blocks_along(width, block_columns)
    steps = np.empty(around.shape[0], np.int64)
    for k in range(steps.size):
        steps[k] = around[k, 0] * width + around[k, 1]
    top, bottom = max(first - halo, 0), min(end + halo, height)
    start, stop = max(top - reach, 0), min(bottom + reach, height)
    gains, spans = np.empty((stop - start) * width, np.float32), np.empty(width // SPAN + 1, np.int64)
    _find_gains(start, stop, pixels, before, light_field, model, log_odds, gains)
    first_turned = end_turned = top
    for y in range(top, bottom):
        odds, out = log_odds[y * width : (y + 1) * width], shaded[(y - top) * width : (y - top + 1) * width]
        block_row, step = y * block_rows // height, COUNT_STEPS if first <= y < end else 0
        for span in range(foreground_spans(odds, spans)):
            for x in range(spans[span], min(spans[span] + SPAN, width)):
                if odds[x] >= 0:
                    continue
                block = blocks[x]
                counts[0, block_row, block] += step
                gain = gains[(y - start) * width + x]
                if gain == 0:
                    continue
                here, off, asked, agree = y * width + x, start * width, 0, 0
                if reach <= y < height - reach and reach <= x < width - reach:
                    asked = 2 * steps.size
                    for k in range(steps.size):
                        agree += _vote(log_odds[here + steps[k]], gains[here + steps[k] - off], gain)
                else:
                    for k in range(steps.size):
                        if 0 <= y + around[k, 0] < height and 0 <= x + around[k, 1] < width:
                            asked += 2
                            agree += _vote(log_odds[here + steps[k]], gains[here + steps[k] - off], gain)
                counts[2, block_row, block] += step if agree > 0 else 0
                ratio = shade.log_odds[block_row, block] + evidence * _f4(agree) / _f4(asked)
                counts[1, block_row, block] += int(_f4(step) * sigmoid(ratio))
                ratio = min(ratio + model.label_odds, _f4(MOST_RECALLED))
                if ratio > 0:
                    out[x] = max(out[x], np.int8(ratio * _f4(ODDS_STEPS)))
                    first_turned = y if end_turned == top else first_turned
                    end_turned = y + 1
    return first_turned, end_turned
