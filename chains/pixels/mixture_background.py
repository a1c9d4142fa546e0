"""Background of several colours a pixel as a chain: leaves, water, a door that is open or shut.

Of pixel k with label B_k and colour L_k, and components j that the scene shows there in turns:

    p(w_t, m_t, v_t | w_t-1, m_t-1, v_t-1): they stay; what is learned wears off at `rate`
    p(L_k | B_k = 1) = sum_j w_j N(L_k; m_j, v_j) / sum_j w_j over the most probable j,  p(L_k | B_k = 0) = U
    mu_{R -> F_k} = P(B_k) p(L_k | B_k)

Stauffer and Grimson's mixture of Gaussians per pixel (CVPR 1999), with one difference: what other chains say
of a pixel slows its learning, so that objects that they track do not become background.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...models.core.bounds import NOT_NEGATIVE, POSITIVE, Bound, check_bounds
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.numerics.threads import over_bands
from ...models.pixels import colour
from ...models.pixels.background import Subtraction
from ...models.pixels.kernels import StoredPlanes
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from .background_prediction import log_prior_odds, smooth
from .kernels.mixture import Mixture, learn_mixture, mixture_log_evidence, subtract_mixture

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
    """Prediction of every pixel's background value: the first components of its mixture, normalised.

    Stauffer and Grimson, "Adaptive background mixture models for real-time tracking", CVPR 1999.

    Parameters
    ----------
    size
        `(height, width)` px.
    mixture
        of all that was seen.
    prior
        P(B=1), that a pixel shows background.
    share
        as many of the first components are background as it takes for their weight to exceed this (their T).
    pooling
        weight of what the 5 x 5 pixels around a pixel show in its own log odds.
    """

    size: tuple[int, int]
    mixture: Mixture
    prior: float
    share: float
    pooling: float
    _compared: dict[int, tuple[NDArray[np.uint8], Planes, Subtraction]] = field(default_factory=dict)

    @property
    def colours(self) -> StoredPlanes:
        """Means of each pixel's most probable component."""
        return StoredPlanes(self.mixture.means[0].reshape(-1, *self.size), np.float32(1))

    def compare(self, image: NDArray[np.uint8]) -> Subtraction:
        """Compare an image with the prediction; the same image only once."""
        return self._comparison(image)[2]

    def log_likelihood(self, image: NDArray[np.uint8], pixel_shift: Planes | None = None) -> float:
        """Log probability of the image, summed over its pixels as if they were independent (nats).

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
        """The mixture after an image.

        With weight w, mean m and variance v of the component that is shown, and rate a: w moves to
        (1 - a) w + a, the other weights to (1 - a) times theirs; with g = a / w the mean moves to
        m + g (I - m) and the variance to (1 - g) v + g (I - m)^2, in which m is the new one. (The paper's g
        is a N(I; m, v), by which a mean hardly moves; a / w makes it an average of what was seen.)

        Parameters
        ----------
        image
            uint8 `(height, width[, 3])`.
        rates
            `(n_pixels,)` float32, a of every pixel.
        least_rate
            at a pixel whose rate does not exceed it, no new component begins.
        first_variance
            squared grey levels, of a new component.
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
        return Subtraction(log_odds, smooth(log_odds, self.size, self.prior, self.pooling))


@short_repr
@dataclass(frozen=True, eq=False)
class MixtureState:
    """What was seen at every pixel.

    Parameters
    ----------
    size
        `(height, width)` px.
    mixture
        of colours.
    elapsed
        s since the last frame with an image.
    """

    size: tuple[int, int]
    mixture: Mixture
    elapsed: float

    def picture(self) -> NDArray[np.uint8]:
        """The empty scene in its usual colours: grey `(height, width)` or BGR `(height, width, 3)`."""
        return colour.to_image(self.mixture.means[0], self.size)


@short_repr
@dataclass(frozen=True)
class MixtureBackground:
    """Per-pixel mixture of Gaussians, for scenes in which pixels show several colours in turns.

    It takes the place of `AdaptiveBackground`, but does not follow the light: use it where that is steady.

    Parameters
    ----------
    prior
        P(B=1) of a pixel of which nobody else knows anything.
    components
        of a pixel, at most.
    rate
        share per second by which weights follow what is seen. A new colour that stays becomes background
        after `-log(background_share) / rate` s, here 4.5.
    background_share
        the most probable components that together weigh more than this are background.
    first_variance
        squared grey levels, of a component seen once.
    pooling
        weight of what the 5 x 5 pixels about a pixel show in its own log odds.
    """

    prior: float = 0.95
    components: int = 3
    rate: float = 0.05
    background_share: float = 0.8
    first_variance: float = 30.0
    pooling: float = 0.3
    name: str = "background"

    ports = (Port(PixelLabels, sole="background"),)

    def __post_init__(self) -> None:
        inside: Bound = (lambda value: 0 < value < 1, "more than 0 and less than 1")
        check_bounds(
            self,
            {
                "prior": inside,
                "background_share": inside,
                "rate": POSITIVE,
                "first_variance": POSITIVE,
                "components": (lambda count: count >= 1, "1 or more"),
                "pooling": NOT_NEGATIVE,
            },
        )

    def initial(self, frame: Frame) -> MixtureState:
        """One component for every pixel, the first image."""
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
        """The mixture stays; more is learned from the next frame."""
        return replace(state, elapsed=state.elapsed + dt)

    def message(self, state: MixtureState, feature: PixelLabels, incoming: Incoming) -> PixelMessage:
        """P(B) and the predicted values of every pixel (mu_{R -> F})."""
        return PixelMessage(background=incoming.once(self._prediction, state))

    def update(self, state: MixtureState, incoming: Incoming) -> MixtureState:
        """The mixture after the frame, learned at each pixel's own rate.

        It is `rate` times r / P(B=1), where r = P(B=1 | everything else). That factor is one where no other
        chain speaks. Where others are sure of background that shows itself as something else (an object of
        the first image that has left), that colour is taken for it at once.
        """
        others = incoming[PixelLabels]
        image = others.image
        if image is None:
            return state
        prediction = incoming.once(self._prediction, state)
        height, width = state.size
        rate = float(-np.expm1(-self.rate * state.elapsed))
        rates = np.full((height, width), rate, np.float32)
        log_odds = prediction.compare(image).smoothed.reshape(height, width)
        for region in others.regions:
            relative = 1 / (self.prior + (1 - self.prior) * np.exp(-region.shift))
            revealed = (region.shift > REVEALED) & (log_odds[region.window] < 0)
            rates[region.window] = np.where(revealed, 1, rate * np.minimum(relative, 1))
        mixture = prediction.update(image, rates.reshape(-1), 0.5 * rate, self.first_variance)
        return replace(state, mixture=mixture, elapsed=0.0)

    def _prediction(self, state: MixtureState) -> MixturePrediction:
        return MixturePrediction(state.size, state.mixture, self.prior, self.background_share, self.pooling)
