"""Background of several colours a pixel as a chain: leaves, water, a door that is open or shut.

Of pixel k with label B_k and colour L_k, and components j that the scene shows there in turns:

    p(w_t, m_t, v_t | w_t-1, m_t-1, v_t-1): they stay; what is learned wears off at `rate`
    p(L_k | B_k = 1) = sum_j w_j N(L_k; m_j, v_j) / sum_j w_j over the most probable j,  p(L_k | B_k = 0) = U
    mu_{R -> F_k} = P(B_k) p(L_k | B_k)

Stauffer and Grimson's mixture of Gaussians per pixel (CVPR 1999), with one difference: what other chains say
of a pixel slows its learning, so that objects that they track do not become background.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...models.camera.moving_camera import AffineMap
from ...models.core.checks import (
    Count,
    NotNegative,
    Positive,
    Probability,
    Shape,
    Share,
    SizesOf,
    checked,
)
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.numerics.compiled import compiled, exponential, logarithm
from ...models.numerics.threads import over_bands
from ...models.pixels import colour
from ...models.pixels.background import ODDS_STEPS, StoredPlanes, Subtraction
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from .background_prediction import log_prior_odds, smooth
from .gaussians import HIGHEST_NOISE, LOWEST_NOISE

_f4 = np.float32

LEAST_WEIGHT = 1e-9  # weight below which a component is forgotten: it is 0 from then on

_LEAST_DENSITY = _f4(1e-30)  # whose logarithm is one of a normal number


OfPixels = Annotated[NDArray[np.float32], Shape("components", "height * width")]


class Mixture(NamedTuple):
    """Components of every pixel, in the order of weight over standard deviation."""

    weights: OfPixels  # whose sum is 1; 0 of what is no component
    # in the planes of `colour`
    means: Annotated[NDArray[np.float32], Shape("components", "channels", "height * width")]
    variances: OfPixels  # of each channel, squared grey levels


@compiled
def _row_distance(planes, mean, here, out):
    """Squared distance of what is seen from one component's mean, along the row of pixels `here`."""
    out[:] = _f4(0)
    for channel in range(planes.shape[0]):
        seen, expected = planes[channel, here], mean[channel, here]
        for x in range(out.size):
            difference = seen[x] - expected[x]
            out[x] += difference * difference


@compiled
def _row_log_odds(planes, mixture, here, share, log_prior, out):
    """Log odds of background along one row: density of the components that together exceed `share`."""
    channels = _f4(planes.shape[0])
    distance = np.empty(out.size, np.float32)
    density, gathered = np.zeros(out.size, np.float32), np.zeros(out.size, np.float32)
    for k in range(len(mixture.weights)):
        _row_distance(planes, mixture.means[k], here, distance)
        weight, variance = mixture.weights[k, here], mixture.variances[k, here]
        for x in range(out.size):
            part = weight[x] if gathered[x] <= share else _f4(0)
            power = _f4(-0.5) * (channels * logarithm(variance[x]) + distance[x] / variance[x])
            density[x] += part * exponential(power)
            gathered[x] += part
    for x in range(out.size):
        out[x] = log_prior + logarithm(max(density[x], _LEAST_DENSITY)) - logarithm(gathered[x])


@compiled
def subtract_mixture(first, end, width, planes, mixture, share, log_prior, log_odds):
    """Return log odds of background in rows `first` to `end` as int8 in steps of `1 / ODDS_STEPS`."""
    odds = np.empty(width, np.float32)
    for y in range(first, end):
        here = slice(y * width, (y + 1) * width)
        _row_log_odds(planes, mixture, here, share, log_prior, odds)
        out = log_odds[here]
        for x in range(width):
            out[x] = np.int8(min(max(odds[x], _f4(-6)), _f4(6)) * _f4(ODDS_STEPS))


@compiled
def mixture_log_evidence(width, planes, mixture, share, log_prior, shift):
    """Return the sum over pixels of log(exp(log odds + shift) + 1), neither rounded nor saturated."""
    odds = np.empty(width, np.float32)
    total = 0.0
    for y in range(planes.shape[1] // width):
        here = slice(y * width, (y + 1) * width)
        _row_log_odds(planes, mixture, here, share, log_prior, odds)
        if shift.size > 1:
            for x in range(width):
                odds[x] += shift[y * width + x]
        else:
            for x in range(width):
                odds[x] += shift[0]
        in_row = _f4(0)
        for x in range(width):
            in_row += max(odds[x], _f4(0)) + logarithm(_f4(1) + exponential(-abs(odds[x])))
        total += in_row
    return total


@compiled
def learn_mixture(first, end, width, planes, rates, least_rate, first_variance, reach, before, mixture):
    """Learn rows `first` to `end` of `mixture` from `before`, by each pixel's own rate.

    The most probable component within `reach` variances learns. Where there is none, a new one takes the
    place of the last, if the rate exceeds `least_rate`: a component cannot be replaced in part.
    """
    weights, means, variances = before
    new_weights, new_means, new_variances = mixture
    components, channels = means.shape[:2]
    distances = np.empty((components, width), np.float32)
    shown, fresh = np.empty(width, np.float32), np.empty(width, np.float32)
    gain, total = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(first, end):
        here = slice(y * width, (y + 1) * width)
        rate = rates[here]
        shown[:] = _f4(components)
        for k in range(components - 1, -1, -1):
            distance, weight, variance = distances[k], weights[k, here], variances[k, here]
            _row_distance(planes, means[k], here, distance)
            for x in range(width):
                near = (weight[x] > _f4(0)) & (distance[x] < reach * variance[x])
                shown[x] = _f4(k) if near else shown[x]
        for x in range(width):
            replaced = (shown[x] == _f4(components)) & (rate[x] > least_rate)
            fresh[x] = _f4(1) if replaced else _f4(0)
            shown[x] = _f4(components - 1) if replaced else shown[x]
        total[:] = _f4(0)
        for k in range(components):
            distance, weight, variance = distances[k], weights[k, here], variances[k, here]
            weight_after, variance_after = new_weights[k, here], new_variances[k, here]
            for x in range(width):
                is_shown = shown[x] == _f4(k)
                new = is_shown & (fresh[x] > _f4(0))
                kept = _f4(0) if new else (_f4(1) - rate[x]) * weight[x]
                after = kept + rate[x] if is_shown else kept
                after = after if after > _f4(LEAST_WEIGHT) else _f4(0)
                step = rate[x] / max(after, _f4(LEAST_WEIGHT)) if is_shown else _f4(0)
                rest = _f4(1) - step
                variance_shown = rest * variance[x] + step * rest * rest * distance[x] / _f4(channels)
                variance_shown = min(max(variance_shown, _f4(LOWEST_NOISE)), _f4(HIGHEST_NOISE))
                weight_after[x] = after
                variance_after[x] = first_variance if new else (variance_shown if is_shown else variance[x])
                gain[x] = step
                total[x] += after
            for channel in range(channels):
                seen, mean = planes[channel, here], means[k, channel, here]
                mean_after = new_means[k, channel, here]
                for x in range(width):
                    mean_after[x] = mean[x] + gain[x] * (seen[x] - mean[x])
        for k in range(components):
            weight_after = new_weights[k, here]
            for x in range(width):
                weight_after[x] /= total[x]
        # only one component can be out of order: one pass lets it sink, the other lets it rise
        for k in range(components - 1):
            _order(k, here, mixture, shown)
        for k in range(components - 3, -1, -1):
            _order(k, here, mixture, shown)


@compiled
def _order(k, here, mixture, swapped):
    """Let components `k` and `k + 1` of a row change places where the second is the more probable."""
    weights, means, variances = mixture
    weight, next_weight = weights[k, here], weights[k + 1, here]
    variance, next_variance = variances[k, here], variances[k + 1, here]
    for x in range(swapped.size):
        ahead = weight[x] * weight[x] * next_variance[x]
        behind = next_weight[x] * next_weight[x] * variance[x]
        swapped[x] = _f4(1) if behind > ahead else _f4(0)
    _swap(weight, next_weight, swapped)
    _swap(variance, next_variance, swapped)
    for channel in range(means.shape[1]):
        _swap(means[k, channel, here], means[k + 1, channel, here], swapped)


@compiled
def _swap(one, other, swapped):
    for x in range(swapped.size):
        here, there = one[x], other[x]
        one[x] = there if swapped[x] > _f4(0) else here
        other[x] = here if swapped[x] > _f4(0) else there


Planes = NDArray[np.float32]

REACH = {1: 6.25, 3: 10.9}
"""By number of channels: squared distance over variance within which 98.8 % of what a component shows lies.

It is 2.5 standard deviations of one channel, as in the paper.
"""

REVEALED = 3.0
"""Nats from which on others are so sure of background that foreground is taken for it as it is seen."""


@short_repr
@dataclass(frozen=True, eq=False)
class MixturePrediction:
    """Prediction of every pixel's background value: the first components of its mixture, normalised."""

    size: tuple[int, int]
    mixture: Mixture
    prior: float  # P(B=1), that a pixel shows background
    share: float  # so much of the weight is background, as the first components have it (the paper's T)
    pooling: float  # weight of what the 5 x 5 pixels around show
    _compared: dict[int, tuple[NDArray[np.uint8], Planes, Subtraction]] = field(default_factory=dict)

    @property
    def colours(self) -> StoredPlanes:
        """Means of each pixel's most probable component."""
        return StoredPlanes(self.mixture.means[0].reshape(-1, *self.size), np.float32(1))

    def compare(self, image: NDArray[np.uint8]) -> Subtraction:
        """Compare an image with the prediction; the same image is compared only once."""
        return self._comparison(image)[2]

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None) -> float:
        """Return the log probability of the image (nats), pixels being independent.

        `pixel_shift` `(n_pixels,)` is the log ratio of what others say for B=1 and B=0.
        """
        planes = self._comparison(image)[1]
        total = mixture_log_evidence(
            self.size[1], planes, self.mixture, np.float32(self.share),
            np.float32(log_prior_odds(self.prior, len(planes))),
            np.zeros(1, np.float32) if pixel_shift is None else pixel_shift,
        )  # fmt: skip
        uniform = np.log1p(-self.prior) - len(planes) * np.log(256.0)
        return float(total + uniform * self.size[0] * self.size[1])

    def update(
        self, image: NDArray[np.uint8], rates: Planes, least_rate: float, first_variance: float
    ) -> Mixture:
        """Return the mixture after an image.

        With weight w, mean m and variance v of the component that is shown, and rate a: w moves to
        (1 - a) w + a, the other weights to (1 - a) times theirs; with g = a / w the mean moves to
        m + g (I - m) and the variance to (1 - g) v + g (I - m)^2, in which m is the new one. (The paper's g
        is a N(I; m, v), by which a mean hardly moves; a / w makes it an average of what was seen.)

        `rates` `(n_pixels,)` float32 are a of every pixel; where they do not exceed `least_rate`, no new
        component begins, of `first_variance` squared grey levels.
        """
        height, width = self.size
        planes = self._comparison(image)[1]
        after = Mixture(*(np.empty(before.shape, np.float32) for before in self.mixture))
        reach = np.float32(REACH[len(planes)])

        def learn(first: int, end: int) -> None:
            learn_mixture(
                first, end, width, planes, rates, np.float32(least_rate), np.float32(first_variance), reach,
                self.mixture, after,
            )  # fmt: skip

        over_bands(learn, height)
        return after

    def _comparison(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Planes, Subtraction]:
        """The image, its planes, and what they say."""
        if id(image) not in self._compared:
            planes = colour.to_planes(image)
            self._compared[id(image)] = image, planes, self._subtract(planes)
        return self._compared[id(image)]

    def _subtract(self, planes: Planes) -> Subtraction:
        height, width = self.size
        log_prior = np.float32(log_prior_odds(self.prior, len(planes)))
        log_odds = np.empty((height * width,), np.int8)

        def subtract(first: int, end: int) -> None:
            subtract_mixture(
                first, end, width, planes, self.mixture, np.float32(self.share), log_prior, log_odds
            )

        over_bands(subtract, height)
        smoothed = smooth(log_odds, self.size, self.prior, self.pooling)
        return Subtraction(log_odds, smoothed, smoothed)


@short_repr
@dataclass(frozen=True, eq=False)
class MixtureState:
    """State of every pixel of a picture `(height, width)`; `elapsed` s since the last image."""

    size: Annotated[tuple[int, int], SizesOf("height", "width")]
    mixture: Mixture
    elapsed: NotNegative

    def seen_by(self, view: AffineMap, known: NDArray[np.bool_], fresh: Self) -> Self:
        """Return the state in the px of a frame; `fresh` where nothing is `known` `(height, width)` of it."""
        where = view.warp_to_frame(known.astype(np.uint8)).reshape(-1) > 0

        def merged(old: Planes, new: Planes) -> Planes:
            planes = [view.warp_to_frame(plane) for plane in old.reshape(-1, *self.size)]
            return np.where(where, np.stack(planes).reshape(old.shape), new)

        pairs = zip(self.mixture, fresh.mixture, strict=True)
        return replace(fresh, mixture=Mixture(*(merged(*pair) for pair in pairs)))

    def picture(self) -> NDArray[np.uint8]:
        """Return the empty scene in its usual colours: grey `(height, width)` or BGR `(height, width, 3)`."""
        return colour.to_image(self.mixture.means[0], self.size)


@short_repr
@checked
@dataclass(frozen=True)
class MixtureBackground:
    """Per-pixel mixture of Gaussians, for scenes in which pixels alternate between several colours.

    It replaces `AdaptiveBackground` under constant light, which it does not follow.

    Parameters
    ----------
    prior
        P(B=1) of a pixel without other predictions.
    components
        of a pixel, at most.
    rate
        1/s, learning rate. A new constant colour becomes background after `-log(background_share) / rate` s,
        by default 4.5.
    background_share
        the most probable components with a total weight above this are background.
    first_variance
        squared grey levels, of a component seen once.
    pooling
        weight of the evidence of the surrounding 5 x 5 pixels in the log odds of a pixel.
    """

    prior: Probability = 0.95
    components: Count = 3
    rate: Positive = 0.05
    background_share: Share = 0.8
    first_variance: Positive = 30.0
    pooling: NotNegative = 0.3
    name: str = "background"

    ports = (Port(PixelLabels, sole="background"),)

    def initial(self, frame: Frame) -> MixtureState:
        """Return one component for every pixel, the first image."""
        image = frame.required_image()
        planes = colour.to_planes(image)
        channels, n_pixels = planes.shape
        mixture = Mixture(
            weights=np.zeros((self.components, n_pixels), np.float32),
            means=np.zeros((self.components, channels, n_pixels), np.float32),
            variances=np.full((self.components, n_pixels), self.first_variance, np.float32),
        )
        mixture.weights[0] = 1
        mixture.means[0] = planes
        return MixtureState((image.shape[0], image.shape[1]), mixture, 0.0)

    def predict(self, state: MixtureState, dt: float) -> MixtureState:
        """Predict the mixture `dt` seconds ahead: it is constant; the next learning rate grows."""
        return replace(state, elapsed=state.elapsed + dt)

    def message(self, state: MixtureState, feature: PixelLabels, incoming: Incoming) -> PixelMessage:
        """Return P(B) and the predicted values of every pixel (mu_{R -> F})."""
        return PixelMessage(background=incoming.once(self._prediction, state))

    def update(self, state: MixtureState, incoming: Incoming) -> MixtureState:
        """Update the mixture by the frame, at each pixel's own rate.

        It is `rate` times r / P(B=1), where r = P(B=1 | everything else). That factor is 1 without other
        chains. If others are certain of background with a different colour (an object of the first image has
        left), the colour is learned at once. Where a new scene begins, it is known as far as this frame shows
        it, or it is behind objects.
        """
        after, view = self._updated(state, incoming), incoming[PixelLabels].view
        if view is None or view.begins is None:
            return after
        message = incoming[PixelLabels] * PixelMessage(background=incoming.once(self._prediction, state))
        fresh = self.initial(Frame(view.begins, 0.0, 1))
        return after.seen_by(view.map, message.are_known(), fresh)

    def _updated(self, state: MixtureState, incoming: Incoming) -> MixtureState:
        image = incoming.evidence(PixelLabels).image
        if image is None:
            return state
        prediction = incoming.once(self._prediction, state)
        height, width = state.size
        rate = float(-np.expm1(-self.rate * state.elapsed))
        rates = np.full((height, width), rate, np.float32)
        log_odds = prediction.compare(image).smoothed.reshape(height, width)
        for part in incoming.others(PixelLabels).layers.composed(image, state.size):
            relative = 1 / (self.prior + (1 - self.prior) * np.exp(-part.shift))
            revealed = (part.shift > REVEALED) & (log_odds[part.window] < 0)
            rates[part.window] = np.where(revealed, 1, rate * np.minimum(relative, 1))
        mixture = prediction.update(image, rates.reshape(-1), 0.5 * rate, self.first_variance)
        return replace(state, mixture=mixture, elapsed=0.0)

    def _prediction(self, state: MixtureState) -> MixturePrediction:
        return MixturePrediction(state.size, state.mixture, self.prior, self.background_share, self.pooling)
