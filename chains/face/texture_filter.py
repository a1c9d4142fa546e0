"""Kalman filter of each texel of each expert, G-flow paper eq. (10)-(12), with fixed or learned gains.

The noises of a texel determine the steady-state gain and temperature of its filter, and vice versa.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape
from ...models.core.short_repr import Rows, short_repr
from ...models.numerics.threads import over_bands
from . import kernels
from .pose_terms import SHORTEST
from .texture_likelihood import MIDDLE_GREY, UNKNOWN_VARIANCE, WORTH

Map = NDArray[np.float32]
OfTexels = Annotated[Map, Shape("n_experts", "n_texels")]

USUAL_RATE = 25.0  # frames a second to which steady-state gains and temperatures refer


@dataclass(frozen=True)
class TexelNoise:
    """Noises of the texture (G-flow paper eq. 1, 4)."""

    rendering: float  # sigma_w^2, squared grey levels: observation noise of a texel
    process: float  # psi_v, squared grey levels per second: process noise of a texel

    def __post_init__(self) -> None:
        if not (self.rendering >= 0 and self.process >= 0 and self.rendering + self.process > 0):
            raise ValueError(
                f"texel noise: got rendering {self.rendering}, process {self.process}, expected 0 or more "
                "and one of them above"
            )

    @classmethod
    def of_steady_state(cls, gain: float, temperature: float) -> Self:
        """Return the noises of which gain and temperature are the steady state: eq. (33) solved for them.

        sigma_w^2 = (1 - K) tau, and Psi = K^2 tau from one frame to the next of `USUAL_RATE`.

        Raises `ValueError` if the gain is not from 0 to 1 or the temperature not above 0.
        """
        if not (0 <= gain <= 1 and temperature > 0):
            raise ValueError(
                f"texel noise: got gain {gain}, temperature {temperature}, expected a gain from 0 to 1 and a "
                "temperature above 0"
            )
        return cls((1 - gain) * temperature, gain**2 * temperature * USUAL_RATE)

    @property
    def steady_variance(self) -> float:
        """V_inf, squared grey levels, eq. (34), at `USUAL_RATE`."""
        change = self.process / USUAL_RATE
        return 0.5 * (change + float(np.sqrt(change**2 + 4 * self.rendering * change)))

    @property
    def steady_gain(self) -> float:
        """K_inf, from 0 to 1, at `USUAL_RATE`."""
        return self.steady_variance / self.temperature

    @property
    def temperature(self) -> float:
        """tau_inf = V_inf + sigma_w^2, squared grey levels (§4.1)."""
        return self.steady_variance + self.rendering


AnyTuple = TypeVar("AnyTuple", kernels.Noises, kernels.Memory)

# Learned gains, chosen on generated textures of all ratios of process and observation noise:
MEMORY = 1.0  # s: time constant of the mean squared innovation
PACE = 15.0  # change of a gain's log odds in that time, at full correlation of large innovations
SMALL = 36.0  # squared grey levels: innovations well below it change the gain slowly
MISPLACED = 3.0  # squared grey levels: product of successive innovations from errors of the shape
GAIN_LIMITS = (-6.0, 6.0)  # range of a learned gain's log odds
FIRST_GAIN = 0.05
RETURN = 0.3  # s: time constant of the return to the lasting texture
LEAST_INSIDE = 0.4  # share of the visible texels that must lie in the picture for a fit


@short_repr
@dataclass(frozen=True, eq=False)
class LearnedGain(Rows):
    """Gain of each texel, learned from its innovations (§7.2.1).

    Under the right gain innovations are white. If the gain is too low, successive innovations have the same
    sign; if it is too high, they alternate. So the log odds of a gain rise or fall with the correlation of
    successive innovations: fast if innovations are large against the noise of a prediction, slowly if they
    are small. Errors of the shape add a positive correlation, which is subtracted; else every gain would
    become 1, optic flow, whose drift does not show in innovations.
    """

    log_odds: OfTexels  # of the gain
    last: OfTexels  # grey levels: last innovation, 0 if the texel was hidden
    power: OfTexels  # running mean of squared innovations

    @classmethod
    def first(cls, n_experts: int, n_texels: int) -> Self:
        """Return the first gains."""
        start = np.full((n_experts, n_texels), np.log(FIRST_GAIN / (1 - FIRST_GAIN)), np.float32)
        return cls(start, np.zeros_like(start), np.zeros_like(start))

    @property
    def gain(self) -> Map:
        """Gains `(n_experts, n_texels)` from 0 to 1."""
        gain = 1 / (1 + np.exp(-self.log_odds))
        return gain.astype(np.float32)

    def updated(self, innovation: Map, seen: NDArray[np.bool_], elapsed: float) -> Self:
        """Update gains with the innovations of a picture where `seen`, `elapsed` s after the last one."""
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
class LastingTexture(Rows):
    """Long-term mean of the texels, to which they return.

    A departure from the paper, whose texels walk at random. There, errors of the pose accumulate: the texture
    is learned at a wrong pose, and holds the next poses there. Here it returns to a mean over all pictures,
    which forgets with the square of the gain, so that gain 1 remains optic flow. The first picture counts as
    1 / gain pictures, the filter's memory, since its pose is given and those of later ones are estimated.
    """

    mean: OfTexels  # grey levels
    looks: OfTexels  # number of pictures, at the usual rate, in the mean

    def updated(self, observed: Map, seen: NDArray[np.bool_], gain: Map, elapsed: float) -> Self:
        """Update the mean with a picture, `elapsed` s after the last one, for a steady `gain` above 0.

        `observed` `(n_experts, n_levels, n_texels)`, and `gain` of every texel, or `(1, n_texels)`.
        """
        weight = np.float32(max(elapsed, SHORTEST) * USUAL_RATE)
        share = 1 - (1 - gain**2) ** weight
        memory = kernels.Memory((1 / gain).astype(np.float32), share.astype(np.float32))
        after = kernels.Lasting(np.empty_like(self.mean), np.empty_like(self.looks))

        def work(a: int, b: int) -> None:
            kernels.learn_lasting(
                observed[a:b], seen[a:b], kernels.Lasting(self.mean[a:b], self.looks[a:b]),
                _rows(memory, a, b), weight, kernels.Lasting(after.mean[a:b], after.looks[a:b]),
            )  # fmt: skip

        over_bands(work, len(seen), worth=seen.size > WORTH)
        return replace(self, mean=after.mean, looks=after.looks)


@short_repr
@dataclass(frozen=True, eq=False)
class Texture:
    """Texture of every expert: independent Gaussians of its texels."""

    # grey levels, on each level of the picture
    mean: Annotated[Map, Shape("n_experts", "n_levels", "n_texels")]
    variance: OfTexels  # squared grey levels, common to the levels
    learned: LearnedGain | None = None  # if gains are learned
    lasting: LastingTexture | None = None  # to which the finest level returns; `None` for a random walk

    @classmethod
    def unknown(cls, n_experts: int, n_levels: int, n_texels: int, *, learn: bool) -> Self:
        """Return unseen textures."""
        return cls(
            np.full((n_experts, n_levels, n_texels), MIDDLE_GREY, np.float32),
            np.full((n_experts, n_texels), UNKNOWN_VARIANCE, np.float32),
            LearnedGain.first(n_experts, n_texels) if learn else None,
            LastingTexture(*np.zeros((2, n_experts, n_texels), np.float32)),
        )

    def fits(self, n_experts: int, n_texels: int) -> bool:
        """Whether all parts are of so many experts and texels."""
        learned = [] if self.learned is None else [self.learned.power]
        lasting = [] if self.lasting is None else [self.lasting.mean]
        own = (n_experts, n_texels)
        return self.mean.shape[::2] == own and all(
            each.shape == own for each in [self.variance, *learned, *lasting]
        )

    def reset(self) -> Self:
        """Return unseen textures of the same shape."""
        n_experts, n_levels, n_texels = self.mean.shape
        return self.unknown(n_experts, n_levels, n_texels, learn=self.learned is not None)

    def of(self, parents: NDArray[np.int64]) -> Self:
        """Return the textures of the children of `parents`."""
        if np.array_equal(parents, np.arange(len(self.mean))):
            return self
        return replace(
            self,
            mean=self.mean[parents],
            variance=self.variance[parents],
            learned=None if self.learned is None else self.learned.only(parents),
            lasting=None if self.lasting is None else self.lasting.only(parents),
        )

    def temperature(self, noise: TexelNoise) -> Map:
        """Return tau = V + sigma_w^2 `(n_experts, n_texels)` of a prediction, squared grey levels (§4.1)."""
        temperature: Map = self.variance + self._noises(noise, 0.0).rendering
        return temperature

    def predicted(self, noise: TexelNoise, elapsed: float) -> Self:
        """Predict the texture `elapsed` s ahead, eq. (12), with its return to the lasting texture."""
        elapsed = max(elapsed, SHORTEST)
        noises, returned = self._noises(noise, elapsed), np.float32(-np.expm1(-elapsed / RETURN))
        lasting = kernels.Lasting(*np.zeros((2, 0, 0), np.float32))
        if self.lasting is not None:
            lasting = kernels.Lasting(self.lasting.mean, self.lasting.looks)
        mean, variance = np.empty_like(self.mean), np.empty_like(self.variance)

        kernels.predict(
            self.mean, self.variance, lasting, returned, noises, np.float32(UNKNOWN_VARIANCE), mean, variance
        )
        return replace(self, mean=mean, variance=variance)

    def updated(self, observed: Map, seen: NDArray[np.bool_], noise: TexelNoise, elapsed: float) -> Self:
        """Update this prediction with a picture, `elapsed` s after the last one: eq. (10), (11).

        `observed` `(n_experts, n_levels, n_texels)` are the texels in this picture; those not `seen`
        `(n_experts, n_texels)` keep mean and variance. Departures: only the finest level is filtered. Coarse
        levels, where the search begins, hold the last observation, since blurred texture contains blurred
        light, which changes. With a gain of 0 the first picture is the template.
        """
        noises, unknown = self._noises(noise, elapsed), np.float32(0.5 * UNKNOWN_VARIANCE)
        mean, variance = np.empty_like(self.mean), np.empty_like(self.variance)

        def work(a: int, b: int) -> None:
            kernels.learn(
                observed[a:b], seen[a:b], self.mean[a:b], self.variance[a:b], _rows(noises, a, b), unknown,
                mean[a:b], variance[a:b],
            )  # fmt: skip

        over_bands(work, len(seen), worth=seen.size > WORTH)
        learned, lasting = self.learned, self.lasting
        if learned is not None:
            innovation = observed[:, 0] - self.mean[:, 0]
            learned = learned.updated(innovation, seen & (self.variance < unknown), elapsed)
        if lasting is not None and (self.learned is not None or noise.process > 0):
            steady = self._everywhere(noise.steady_gain) if self.learned is None else self.learned.gain
            lasting = lasting.updated(observed, seen, steady, elapsed)
        return replace(self, mean=mean, variance=variance, learned=learned, lasting=lasting)

    def _noises(self, noise: TexelNoise, elapsed: float) -> kernels.Noises:
        """Return the noises of texels `elapsed` s after the last picture, by their learned gains if any."""
        if self.learned is None:
            rendering = self._everywhere(noise.rendering)
            process = self._everywhere(noise.process * elapsed)
            return kernels.Noises(rendering, process, rendering if noise.process > 0 else 0 * rendering)
        gain, temperature = self.learned.gain, np.float32(noise.temperature)
        rendering = (1 - gain) * temperature
        process = gain**2 * temperature * np.float32(USUAL_RATE * elapsed)
        return kernels.Noises(rendering, process, np.where(gain > 0, rendering, np.float32(0)))

    def _everywhere(self, number: float) -> Map:
        return np.full((1, self.variance.shape[1]), number, np.float32)


def explained_variance(observed: Map, mean: Map, visible: NDArray[np.bool_], seen: NDArray[np.bool_]) -> Map:
    """Return the share of the picture's variance that a predicted texture explains, `(n,)` from -1 to 1.

    `observed`, `mean` `(n, n_levels, n_texels)` grey levels: texels in the picture and their predictions, of
    which the finest level counts; `visible`, `seen` `(n, n_texels)`: texels that face the viewer, and those
    of them in the picture. It is 0 if these are few.
    """
    share = np.empty(len(seen), np.float32)
    kernels.write_explained_variance(observed, mean, visible, seen, np.float32(LEAST_INSIDE), share)
    return share


def _rows(arrays: AnyTuple, a: int, b: int) -> AnyTuple:
    """Return the arrays of experts a to b; those common to all unchanged."""
    return type(arrays)(*(part[a:b] if len(part) > 1 else part for part in arrays))
