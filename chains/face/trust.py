"""How far a tracker believes that it follows its object: the fit of its texture beside that of a second."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ...models.core.short_repr import short_repr

LEAST_SHARE = 0.5
"""Of the usual fit, below which the object is doubted."""

RETURN_SHARE = 0.75
"""The same for an object that was lost and is found elsewhere: chance has had many places to try."""

CHANCE, CHANCE_ANYWHERE = 0.2, 0.4
"""Fits below which they are doubted whatever is usual. In films of other things, the texture of a face
explained less than 0.12 of the variance, also in the best of all places."""

MEMORY = 1.0
"""s over which the usual fit is averaged."""

PATIENCE = 0.1
"""s of doubt after which the object is lost; one picture, however late, counts for half of it."""

SHORTEST_TRIAL, TRIAL = 0.06, 0.2
"""s for which an object that a detector shows has to be seen there, with a texture taken there, before it is
believed: where the texture that is remembered fits better than by chance, and where it does not. Of 1200
pictures without a face four showed one, and one of these for more than three pictures."""

ROUNDING = 1e-6
"""s by which sums of frame times may be off."""


@short_repr
@dataclass(frozen=True)
class Trust:
    """Belief of a tracker in itself.

    Parameters
    ----------
    usual
        running mean of the fit over the last second in which there was no doubt; 1 before anything was seen.
    doubt
        s for which the fit has been too low; 0 without a doubt.
    trial
        s for which an object that a detector has shown must still be seen; 0 where none is on trial.
    relocations
        how often the object was lost and found again.
    searches
        pictures in which it was looked for since it was lost.
    """

    usual: float = 1.0
    doubt: float = 0.0
    trial: float = 0.0
    relocations: int = 0
    searches: int = 0

    @property
    def lost(self) -> bool:
        """Whether the tracker knows that it does not follow the object."""
        return self.doubt > PATIENCE - ROUNDING

    @property
    def least_fit(self) -> float:
        """Below which the object is doubted where it is followed."""
        return max(LEAST_SHARE * self.usual, CHANCE)

    @property
    def return_fit(self) -> float:
        """From which on it is believed where it is found by its texture."""
        return max(RETURN_SHARE * self.usual, CHANCE_ANYWHERE)

    def confirmed(self, fit: float, elapsed: float) -> Self:
        """After a picture in which the object was where it was followed."""
        share = -float(np.expm1(-elapsed / MEMORY))
        return replace(self, doubt=0.0, searches=0, usual=self.usual + share * (fit - self.usual))

    def doubted(self, elapsed: float) -> Self:
        """After a picture in which it may not have been there."""
        return replace(self, doubt=self.doubt + pictures_worth(elapsed), trial=0.0)

    def seen_again(self, elapsed: float) -> Self:
        """After a picture in which its texture was found: it takes one more until it is believed."""
        return replace(
            self, doubt=pictures_worth(elapsed), trial=0.0, searches=0, relocations=self.relocations + 1
        )

    def on_trial(self, *, known: bool) -> Self:
        """After a picture in which a detector has shown it; `known` where its texture says so, too."""
        return replace(self, trial=SHORTEST_TRIAL if known else TRIAL)

    def tried(self, fit: float, elapsed: float) -> Self:
        """After a picture in which an object on trial was there once more."""
        left = self.trial - elapsed
        if left > ROUNDING:
            return replace(self, trial=left)
        return replace(self, usual=fit, doubt=0.0, trial=0.0, searches=0, relocations=self.relocations + 1)


def pictures_worth(elapsed: float) -> float:
    """S of doubt for a picture that comes so long after the one before."""
    return min(max(elapsed, ROUNDING), PATIENCE / 2)
