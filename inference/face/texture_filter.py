"""Kalman filter of each texel of each expert, G-flow paper eq. (10)-(12), with gains fixed or learned."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.face.image_pyramid import MIDDLE_GREY
from ...models.face.texel_noise import USUAL_RATE, TexelNoise
from .pose_dynamics import SHORTEST

Map = NDArray[np.float32]

UNKNOWN_VARIANCE = 60.0**2
"""Squared grey levels: of a texel that has never been seen."""

MEMORY = 1.0
"""s over which the square of innovations is averaged, where gains are learned."""

PACE = 15.0
"""Change of a gain's log odds in that time, at full correlation of large innovations."""

SMALL = 36.0
"""Squared grey levels: innovations whose square is well below it say little of the gain."""

MISPLACED = 3.0
"""Squared grey levels: persistent innovations of this product come from texels that are seen a little off."""

GAIN_LIMITS = (-6.0, 6.0)
"""Log odds between which a learned gain stays."""

FIRST_GAIN = 0.05

RETURN = 0.3
"""s in which what sets a texel apart from its lasting texture decays to 1/e."""

LEAST_INSIDE = 0.4
"""Share of the visible texels that has to lie in the picture, if a texture is to explain it."""


@short_repr
@dataclass(frozen=True, eq=False)
class LearnedGain:
    """What is remembered of each texel's innovations, to learn its gain (§7.2.1).

    Under the right gain innovations are white. A texel that changes faster than its gain follows has
    innovations of the same sign one after the other, one that follows noise has alternating ones. So the log
    odds of a gain climb or fall with the correlation of successive innovations: fast where innovations are
    large beside what noise makes of a prediction, slowly where they are small. A texel of a shape that is
    only nearly right is seen next to its place for many frames; what this leaves in the correlation is taken
    off, or else every texel would end at flow, whose drift no texel can see.

    Parameters
    ----------
    log_odds
        `(n_experts, n_texels)` float32 of the gain.
    last
        `(n_experts, n_texels)` float32 grey levels: the last innovation, 0 if the texel was hidden.
    power
        `(n_experts, n_texels)` float32: running mean of innovations' square.
    """

    log_odds: Map
    last: Map
    power: Map

    @classmethod
    def first(cls, n_experts: int, n_texels: int) -> Self:
        """Before anything was seen."""
        start = np.full((n_experts, n_texels), np.log(FIRST_GAIN / (1 - FIRST_GAIN)), np.float32)
        return cls(start, np.zeros_like(start), np.zeros_like(start))

    @property
    def gain(self) -> Map:
        """`(n_experts, n_texels)` from 0 to 1."""
        gain = 1 / (1 + np.exp(-self.log_odds))
        return gain.astype(np.float32)

    def of(self, parents: NDArray[np.int64]) -> Self:
        """What the children of `parents` remember."""
        return replace(
            self,
            log_odds=self.log_odds[parents],
            last=self.last[parents],
            power=self.power[parents],
        )

    def updated(self, innovation: Map, seen: NDArray[np.bool_], elapsed: float) -> Self:
        """With a picture `elapsed` s after the last one; `innovation` counts where `seen`."""
        share = -np.expm1(-elapsed / MEMORY)
        both = seen & (self.last != 0)
        square = innovation**2
        power = np.where(seen, self.power + np.float32(share) * (square - self.power), self.power)
        scale = np.maximum(power, square) + np.float32(SMALL)
        step = np.float32(PACE * share) * (innovation * self.last - np.float32(MISPLACED)) / scale
        return replace(
            self,
            log_odds=np.clip(self.log_odds + np.where(both, step, 0), *GAIN_LIMITS).astype(np.float32),
            last=np.where(seen, innovation, np.float32(0)),
            power=power.astype(np.float32),
        )


@short_repr
@dataclass(frozen=True, eq=False)
class LastingTexture:
    """What texels look like in the long run, to which they return.

    A departure from the paper, whose texels walk at random. There, errors of the pose add up: the texture is
    seen a little off, is learned so, and holds the next poses there. Here it is a mean over all that was
    seen, which forgets with the square of the gain, so that flow (gain 1) remains flow. The first picture
    counts for as many as the filter remembers, 1 / gain: where texels lie on the object was given there, and
    in each later one the texture so far has said so, errors included.

    Parameters
    ----------
    mean
        `(n_experts, n_texels)` float32 grey levels.
    looks
        `(n_experts, n_texels)` float32: pictures of the usual rate that it rests on; 0 if never seen.
    """

    mean: Map
    looks: Map

    def of(self, parents: NDArray[np.int64]) -> Self:
        """Those of the children of `parents`."""
        return replace(self, mean=self.mean[parents], looks=self.looks[parents])

    def updated(self, observed: Map, seen: NDArray[np.bool_], gain: Map | np.float32, elapsed: float) -> Self:
        """With a picture `elapsed` s after the last one, under a filter of steady `gain` above 0."""
        weight = np.float32(max(elapsed, SHORTEST) * USUAL_RATE)
        first = self.looks == 0
        looks = self.looks + np.where(seen, np.where(first, 1 / gain, weight), np.float32(0))
        share = np.maximum(weight / np.maximum(looks, weight), 1 - (1 - gain**2) ** weight)
        share = np.where(first, np.float32(1), share)
        mean = self.mean + np.where(seen, share * (observed - self.mean), np.float32(0))
        return replace(self, mean=mean.astype(np.float32), looks=looks.astype(np.float32))


@short_repr
@dataclass(frozen=True, eq=False)
class Texture:
    """Texture of every expert: independent Gaussians of its texels.

    Parameters
    ----------
    mean
        `(n_experts, n_levels, n_texels)` float32 grey levels, on each level of the picture.
    variance
        `(n_experts, n_texels)` float32, squared grey levels, common to the levels.
    learned
        where gains are learned.
    lasting
        what the finest level returns to; `None` for a walk at random.
    """

    mean: Map
    variance: Map
    learned: LearnedGain | None = None
    lasting: LastingTexture | None = None

    @classmethod
    def unknown(cls, n_experts: int, n_levels: int, n_texels: int, *, learn: bool) -> Self:
        """Texture of which nothing has been seen."""
        return cls(
            np.full((n_experts, n_levels, n_texels), MIDDLE_GREY, np.float32),
            np.full((n_experts, n_texels), UNKNOWN_VARIANCE, np.float32),
            LearnedGain.first(n_experts, n_texels) if learn else None,
            LastingTexture(*np.zeros((2, n_experts, n_texels), np.float32)),
        )

    def forgotten(self) -> Self:
        """As before anything was seen."""
        n_experts, n_levels, n_texels = self.mean.shape
        return self.unknown(n_experts, n_levels, n_texels, learn=self.learned is not None)

    def of(self, parents: NDArray[np.int64]) -> Self:
        """Textures of the children of `parents`."""
        return replace(
            self,
            mean=self.mean[parents],
            variance=self.variance[parents],
            learned=None if self.learned is None else self.learned.of(parents),
            lasting=None if self.lasting is None else self.lasting.of(parents),
        )

    def temperature(self, noise: TexelNoise) -> Map:
        """tau = V + sigma_w^2 `(n_experts, n_texels)` of a predicted texture, squared grey levels (§4.1)."""
        return self.variance + self._noises(noise)[0]

    def predicted(self, noise: TexelNoise, elapsed: float) -> Self:
        """The texture `elapsed` s later, eq. (12), on its way to the lasting one if anything changes."""
        variance = self.variance + self._noises(noise)[1] * np.float32(max(elapsed, SHORTEST))
        mean = self.mean
        if self.lasting is not None:
            returned = np.float32(-np.expm1(-max(elapsed, SHORTEST) / RETURN))
            there = self.lasting.looks > 0
            mean = mean.copy()
            mean[:, 0] += np.where(there, returned * (self.lasting.mean - mean[:, 0]), np.float32(0))
        return replace(self, mean=mean, variance=np.minimum(variance, np.float32(UNKNOWN_VARIANCE)))

    def updated(self, observed: Map, seen: NDArray[np.bool_], noise: TexelNoise, elapsed: float) -> Self:
        """This prediction, made `elapsed` s after the last picture, with a picture: eq. (10), (11).

        `observed` `(n_experts, n_levels, n_texels)` are the texels as this frame shows them; where they are
        not `seen` `(n_experts, n_texels)` both stay. Departures: only the finest
        level is filtered. The coarse ones, which say where the search begins and nothing of the belief, hold
        the texel as last seen: blurred texture is blurred light as well, which changes. And where nothing is
        said to change (gain 0) the first picture is the template.
        """
        rendering, process = self._noises(noise)
        unknown = self.variance >= np.float32(0.5 * UNKNOWN_VARIANCE)
        gain = np.where(unknown, np.float32(1), self.variance / (self.variance + rendering))
        gain = np.where(seen, gain, np.float32(0)).astype(np.float32)
        first = np.where(process > 0, rendering, np.float32(0))
        variance = np.where(seen & unknown, first, (1 - gain) * self.variance).astype(np.float32)
        mean = np.where(seen[:, None], observed, self.mean)
        innovation = observed[:, 0] - self.mean[:, 0]
        mean[:, 0] = self.mean[:, 0] + gain * innovation
        learned = None if self.learned is None else self.learned.updated(innovation, seen & ~unknown, elapsed)
        lasting = self.lasting
        if lasting is not None and (self.learned is not None or noise.process > 0):
            steady = np.float32(noise.steady_gain) if self.learned is None else self.learned.gain
            lasting = lasting.updated(observed[:, 0], seen, steady, elapsed)
        return replace(self, mean=mean, variance=variance, learned=learned, lasting=lasting)

    def _noises(self, noise: TexelNoise) -> tuple[Map | np.float32, Map | np.float32]:
        """Rendering noise, and process noise per second; with a learned gain those of its steady state."""
        if self.learned is None:
            return np.float32(noise.rendering), np.float32(noise.process)
        gain, temperature = self.learned.gain, np.float32(noise.temperature)
        return (1 - gain) * temperature, gain**2 * temperature * np.float32(USUAL_RATE)


def explained(observed: Map, mean: Map, visible: NDArray[np.bool_], seen: NDArray[np.bool_]) -> Map:
    """Share of the picture's variance that a predicted texture explains, `(n,)` from -1 to 1.

    Parameters
    ----------
    observed, mean
        `(n, n_texels)` grey levels: as the picture shows the texels, and as they were predicted.
    visible, seen
        `(n, n_texels)`: texels that face the viewer, and those of them in the picture; 0 where these are few.
    """
    count = np.maximum(seen.sum(axis=1), 1)
    middle = (observed * seen).sum(axis=1) / count
    error = ((observed - mean) ** 2 * seen).sum(axis=1)
    power = ((observed - middle[:, None]) ** 2 * seen).sum(axis=1)
    inside = count > LEAST_INSIDE * np.maximum(visible.sum(axis=1), 1)
    return np.where(inside, np.maximum(1 - error / np.maximum(power, 1), -1), 0).astype(np.float32)
