"""Background of several colours a pixel as a chain: leaves, water, a door that is open or shut.

Of pixel k with label B_k and colour L_k, and components j that the scene shows there in turns:

    p(w_t, m_t, v_t | w_t-1, m_t-1, v_t-1): they stay; what is learned wears off at `rate`
    p(L_k | B_k = 1) = sum_j w_j N(L_k; m_j, v_j) / sum_j w_j over the most probable j,  p(L_k | B_k = 0) = U
    mu_{R -> F_k} = P(B_k) p(L_k | B_k)

Stauffer and Grimson's mixture of Gaussians per pixel (CVPR 1999), with one difference: what other chains say
of a pixel slows its learning, so that objects that they track do not become background.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Incoming, Port
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.pixels import colour
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from .kernels.mixture import Mixture
from .mixture import MixturePrediction

REVEALED = 3.0
"""Nats from which on others are so sure of background that foreground is taken for it as it is seen."""


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
        for name in ("prior", "background_share"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0 and less than 1")
        for name in ("rate", "first_variance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")
        if not self.components >= 1:
            raise ValueError(f"components: got {self.components}, expected 1 or more")
        if not self.pooling >= 0:
            raise ValueError(f"pooling: got {self.pooling}, expected 0 or more")

    def initial(self, frame: Frame) -> MixtureState:
        """One component for every pixel, the first image."""
        image = frame.image
        if image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
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
