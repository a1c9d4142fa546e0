"""The background of pixels: what a message says where it is seen, and the empty scene of a whole film."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.compiled import compiled, inlined

Planes = NDArray[np.float32]

ODDS_STEPS = 20.0  # steps of the stored log odds per nat; they saturate at +-6 nats
NEVER = -80.0  # log odds of background that leave nothing of it
SPAN = 64  # pixels that are looked at together for whether any of them needs more than most pixels do

_SIGNS = np.uint64(0x8080808080808080)


class StoredPlanes(NamedTuple):
    """Colours of a whole picture as they are stored: `values` of so many grey levels (`step`) each."""

    values: NDArray[np.int16] | Planes
    step: np.float32

    def grey_levels(self) -> Planes:
        """Return `(channels, height, width)` float32."""
        return np.asarray(self.values * self.step)


@inlined
def _any_negative(words, first):
    """Whether any of the 64 numbers in eight words is negative."""
    signs = np.uint64(0)
    for k in range(8):
        signs |= words[first + k]
    return signs & _SIGNS != np.uint64(0)


@compiled
def foreground_spans(log_odds, spans):
    """Write the starts of runs of `SPAN` pixels in which there is foreground; return how many there are."""
    words = log_odds[: log_odds.size // 8 * 8].view(np.uint64)
    count = 0
    for start in range(0, log_odds.size, SPAN):
        if start + SPAN > log_odds.size or _any_negative(words, start // 8):
            spans[count] = start
            count += 1
    return count


@compiled
def blocks_along(n_pixels, n_blocks):
    """Return `x * n_blocks // n_pixels` for all pixels x, without the divisions, which are slow."""
    blocks, block, end = np.empty(n_pixels, np.int64), 0, n_pixels
    for x in range(n_pixels):
        while x * n_blocks >= end:
            block, end = block + 1, end + n_pixels
        blocks[x] = block
    return blocks


@short_repr
@dataclass(frozen=True, eq=False)
class EmptyScene:
    """Picture of the empty scene, with its variances."""

    shape: tuple[int, ...]  # of an image: (height, width) px, or (height, width, 3)
    mean: Planes  # (channels, n_pixels) in the planes of `models.pixels.colour`
    variance: Planes  # (n_pixels,), squared grey levels: of the mean
    noise: Planes  # (n_pixels,), squared grey levels: of a single observation
    light: Planes  # (block_rows, block_columns): that of the first image relative to that of the mean


@short_repr
@dataclass(frozen=True, eq=False)
class Subtraction:
    """Log odds of an image against a predicted background, `(n_pixels,)` int8 in steps of 1/20 nat.

    `log_odds`, of P(B=1) N(I; ...) over P(B=0) U, within +-6 nats; `smoothed`, with the neighbours' share,
    where the scene in something's shade is background too; `unshaded`, where it is not.
    """

    log_odds: NDArray[np.int8]
    smoothed: NDArray[np.int8]
    unshaded: NDArray[np.int8]


class BackgroundFactor(Protocol):
    """Prediction of pixels that show background, whatever model it comes from."""

    @property
    def size(self) -> tuple[int, int]:
        """`(height, width)` px."""
        ...

    @property
    def colours(self) -> StoredPlanes:
        """Expected colours of the scene."""
        ...

    @property
    def prior(self) -> float:
        """P(B=1), that a pixel shows background."""
        ...

    def compare(self, image: NDArray[np.uint8], /) -> Subtraction:
        """Compare an image with the prediction; the same image is compared only once."""
        ...

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None, /) -> float:
        """Return the log probability of the image (nats).

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0.
        """
        ...
