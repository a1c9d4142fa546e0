"""Small square pieces of a grey picture: what points look like."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Numbers = NDArray[np.float64]
Pixels = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class Patches:
    """What points look like.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    pixels
        `(n, side, side)` float32: grey values about each point, rows first.
    """

    identities: NDArray[np.int64]
    pixels: Pixels

    def __len__(self) -> int:
        return len(self.identities)


def ncc(one: Pixels, other: Pixels) -> Numbers:
    """Normalised correlation, `(n,)` from -1 to 1, of patches `(n, side, side)`; 0 where one is of one
    colour."""
    a, b = _centred(one), _centred(other)
    lengths = np.sqrt(np.square(a).sum(axis=(1, 2)) * np.square(b).sum(axis=(1, 2)))
    correlation: Numbers = (a * b).sum(axis=(1, 2)) / np.where(lengths > 0, lengths, 1.0)
    return correlation


def with_light_of(patches: Pixels, others: Pixels) -> Pixels:
    """Patches `(n, side, side)` with the brightness and contrast that `others` of the same things have."""
    a, b = _centred(patches), _centred(others)
    squares = np.square(a).sum(axis=(1, 2), keepdims=True)
    gain = (a * b).sum(axis=(1, 2), keepdims=True) / np.where(squares > 0, squares, 1.0)
    level = others.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    lit: Pixels = (level + np.maximum(gain, 0.0) * a).astype(np.float32)
    return lit


def _centred(patches: Pixels) -> Numbers:
    centred: Numbers = np.subtract(patches, patches.mean(axis=(1, 2), keepdims=True, dtype=np.float64))
    return centred
