"""Pixel labels and values as a feature node: F_k = (B_k, L_k), "is background" and the latent colour.

Messages are cheap: they refer to what chains predict (a background picture, layers of objects) and to the
image; products gather factors, and loops over pixels run when a number is read. Where a chain has
nothing to say, its message has no factor, and nothing is computed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..camera.moving_camera import View
from ..core.checks import checked, made, shown
from ..core.frame import Frame
from ..core.short_repr import short_repr
from .background import NEVER, ODDS_STEPS, BackgroundFactor, Subtraction
from .layers import NO_LAYERS, ComposedLayers, LayerStack, Region

Map = NDArray[np.float32]

EVEN = 0.5  # probability of being covered above which a pixel shows no scene

Window = tuple[slice, slice]


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class PixelMessage:
    """Product of factors over all pixels: a background prediction, layers of objects, an image.

    For every pixel it is a function of b in {0, 1} and the latent colour L. The background has the factors
    P(B=1) N(L; mean, variance) for b = 1 and P(B=0) U for b = 0, with any colour; the layers of a chain are
    composed front to back: w1 = prod(1 - M_j), w0 = 1 + sum_j strength M_j f_j(L) prod_{i<j} (1 - M_i); a
    ghost reduces w0; the image fixes L to the observed colour.

    Parameters
    ----------
    background
        at most one.
    layers
        of objects.
    image
        uint8 `(height, width[, 3])`, or `None`.
    view
        map from the scene to the frame; `None` for a fixed camera.

    Raises
    ------
    TypeError
        if `layers` is no `LayerStack`.
    ValueError
        if the image is of another kind, or empty.
    """

    background: BackgroundFactor | None = None
    layers: LayerStack = NO_LAYERS
    image: NDArray[np.uint8] | None = None
    view: View | None = None

    def __post_init__(self) -> None:
        image = self.image
        if image is not None and not (image.ndim in (2, 3) and image.size):
            raise ValueError(f"image: got {shown(image)}, expected uint8 (height, width[, 3]) with pixels")

    def __mul__(self, other: Self) -> Self:
        if self.background is not None and other.background is not None:
            raise ValueError("pixel message: got two background predictions, expected at most one")
        if self.image is not None and other.image is not None:
            raise ValueError("pixel message: got two images, expected at most one")
        return made(
            type(self),
            background=self.background or other.background,
            layers=self.layers * other.layers,
            image=self.image if other.image is None else other.image,
            view=self.view * other.view if self.view and other.view else self.view or other.view,
        )

    def distance(self, other: Self) -> float:
        """Return the greatest difference of the probability that a pixel is not covered."""
        tables = [sheet.table for message in (self, other) for sheet in message.layers.factors]
        rows = max((int((table["top"] + table["rows"]).max()) for table in tables), default=0)
        columns = max((int((table["left"] + table["columns"]).max()) for table in tables), default=0)
        size = max(rows, 1), max(columns, 1)
        return float(np.abs(self.layers.cover(size) - other.layers.cover(size)).max())

    @property
    def size(self) -> tuple[int, int]:
        """`(height, width)` px.

        Raises
        ------
        ValueError
            if there is no image, background or view.
        """
        if self.image is not None:
            return self.image.shape[0], self.image.shape[1]
        if self.background is not None:
            return self.background.size
        if self.view is not None:
            return self.view.map.size
        raise ValueError("pixel message: got no image, background or view, so its size is not known")

    @cached_property
    def subtraction(self) -> Subtraction | None:
        """Comparison of the image with the background, if both are there."""
        if self.image is None or self.background is None:
            return None
        return self.background.compare(self.image)

    @property
    def composed_layers(self) -> tuple[ComposedLayers, ...]:
        """The composed layers; uniform elsewhere."""
        return self.layers.composed(self.image, self.size)

    def foreground(self) -> NDArray[np.uint8]:
        """Return `(height, width)` uint8: 255 where P(B=0) is over one half, else 0."""
        out = self._log_odds()
        mask: NDArray[np.uint8] = np.empty(out.shape, np.uint8)
        np.right_shift(out, 7, out=mask.view(np.int8))  # all bits are the sign's
        for part in self.composed_layers:
            window = part.window
            odds = out[window] * np.float32(1 / ODDS_STEPS) + part.shift
            mask[window] = np.where(odds < 0, 255, 0)
        return mask

    def are_known(self) -> NDArray[np.bool_]:
        """Return `(height, width)` bool: pixels that show background, or that the layers cover.

        Nothing is known without an image.
        """
        if self.image is None:
            return np.zeros(self.size, np.bool_)
        return np.asarray((self.foreground() == 0) | (self.layers.cover(self.size) > EVEN), np.bool_)

    def background_probability(self) -> Map:
        """Return `(height, width)` float32: P(B=1) of every pixel."""
        return np.asarray(np.float32(1) / (np.float32(1) + np.exp(-self.log_odds())))

    @checked
    def log_odds(self, region: Region | None = None) -> Map:
        """Return the log of P(B=1) over P(B=0), by all factors of the message.

        Parameters
        ----------
        region
            top, left, height and width px; it may extend beyond the image, where odds are even. Default: the
            whole image.

        Returns
        -------
        log_odds
            `(height, width)` float32 nats, pooled over neighbours; without layers they are within +-6.
        """
        odds = self._log_odds() * np.float32(1 / ODDS_STEPS)
        for part in self.composed_layers:
            odds[part.window] += part.shift
        if region is None:
            return odds
        window, place = _inside(region, self.size)
        out = np.zeros(region[2:], np.float32)
        out[place] = odds[window]
        return out

    @checked
    def log_likelihood_ratio(self, region: Region | None = None) -> Map:
        """Return the log of p(image | background visible) over p(image | any colour) for each pixel.

        The evidence of the image about labels, without priors and layers: `(height, width)` float32 nats; 0
        without an image or a background. `region` as for `log_odds`.
        """
        out = np.zeros(self.size if region is None else region[2:], np.float32)
        if self.subtraction is not None and self.background is not None:
            window, place = _inside(region or (0, 0, *self.size), self.size)
            prior = np.log(self.background.prior) - np.log1p(-self.background.prior)
            out[place] = self._log_odds()[window] * np.float32(1 / ODDS_STEPS) - np.float32(prior)
        return out

    @property
    def log_mass(self) -> float:
        """Log of the integral over labels and colours, summed over pixels (nats); 0 without a background.

        With an image, it is the log density of its colours. Without one, colours are integrated out, and it
        is 0 if only the background has predicted. Colours of several chains' layers at one pixel count as
        independent. Pixels of a moving camera outside the scene have the uniform density.
        """
        return (0.0 if self.view is None else self.view.where.log_mass) + self._log_mass_of_pixels()

    def _log_mass_of_pixels(self) -> float:
        background, image = self.background, self.image
        if background is None:
            return 0.0
        if image is None:
            clear, covered = background.prior, 1 - background.prior
            masses = (clear * part.clear + covered * part.explained for part in self.composed_layers)
            return sum(float(np.log(mass, dtype=np.float64).sum()) for mass in masses)
        hidden = None if self.view is None else self.view.hidden
        if not self.layers and hidden is None:
            return background.log_likelihood(image)
        return self._log_mass_of_seen(background, image, hidden)

    def _log_mass_of_seen(
        self, background: BackgroundFactor, image: NDArray[np.uint8], hidden: NDArray[np.bool_] | None
    ) -> float:
        """Of the image; what is `hidden` `(height, width)` counts as pixels of any colour."""
        shift = np.zeros(self.size, np.float32)
        explained = 0.0
        for part in self.composed_layers:
            shift[part.window] = part.shift
            seen = part.explained if hidden is None else part.explained[~hidden[part.window]]
            explained += float(np.log(seen, dtype=np.float64).sum())
        if hidden is not None:
            np.copyto(shift, np.float32(NEVER), where=hidden)
            explained -= np.count_nonzero(hidden) * float(np.log1p(-background.prior))
        return background.log_likelihood(image, shift.reshape(-1)) + explained

    @checked
    def log_density(self, among: NDArray[np.bool_]) -> float:
        """Return the log probability (nats) of the image at some pixels, given all other factors.

        These probabilities sum to 1 over all images. Labels without a prior have even odds.

        Parameters
        ----------
        among
            `(height, width)`: of which pixels.

        Raises
        ------
        ValueError
            if there is no image.
        """
        if self.image is None:
            raise ValueError("pixel message: got no image, expected one whose density is asked for")
        if among.shape != self.size:
            raise ValueError(f"among: got shape {among.shape}, expected that of the image, {self.size}")
        channels = 1 if self.image.ndim == 2 else self.image.shape[2]
        uniform = -channels * float(np.log(256.0))
        clear = 0.5 if self.background is None else self.background.prior
        total = 0.0
        for part in self.layers.composed(None, self.size):
            mass = clear * part.clear + (1 - clear) * part.explained
            total -= float(np.log(mass[among[part.window]], dtype=np.float64).sum())
        if self.background is not None:
            total += self._log_mass_of_seen(self.background, self.image, ~among)
            return total - uniform * np.count_nonzero(~among)
        for part in self.composed_layers:
            mass = 0.5 * part.clear + 0.5 * part.explained
            total += float(np.log(mass[among[part.window]], dtype=np.float64).sum())
        return total + uniform * np.count_nonzero(among)

    def _log_odds(self) -> NDArray[np.int8]:
        """`(height, width)` int8 log odds of background without the layers."""
        height, width = self.size
        if self.subtraction is not None:
            return self.subtraction.smoothed.reshape(height, width)
        prior = 0.5 if self.background is None else self.background.prior
        odds = float(np.clip(np.log(prior) - np.log1p(-prior), -6, 6))
        return np.full((height, width), round(odds * ODDS_STEPS), np.int8)


@short_repr
@checked
@dataclass(frozen=True)
class PixelLabels:
    """Feature node of per-pixel labels and colours, shared by background, blobs and other objects.

    RSMCM paper §4.2. Differences: colours as well as grey values; the observation noise is part of the noise
    of each prediction, since only their sum is used.
    """

    name: str = "pixels"

    searches = False

    def uniform(self) -> PixelMessage:
        """Return the constant 1."""
        return PixelMessage()

    def evidence(self, frame: Frame, prior: PixelMessage) -> PixelMessage:
        """Return the evidence: L is the observed colour."""
        return PixelMessage(image=frame.image)


def _inside(region: Region, size: tuple[int, int]) -> tuple[Window, Window]:
    """Rows and columns of the part of a region that is inside: in the picture, and in the region."""
    spans = [
        (start, min(start + length, end))
        for start, length, end in zip(region[:2], region[2:], size, strict=True)
    ]
    rows, columns = (slice(max(start, 0), max(stop, 0)) for start, stop in spans)
    top, left = (slice(max(-start, 0), max(stop - start, max(-start, 0))) for start, stop in spans)
    return (rows, columns), (top, left)


@short_repr
@checked
@dataclass(frozen=True)
class ScenePixels(PixelLabels):
    """Feature node of labels and colours in scene coordinates, and of the map to the frame.

    Chains of `PixelLabels` can be connected to it. If a chain predicts the map (`View`), the evidence is the
    frame resampled to scene coordinates, and the likelihood of the map. Without such a chain it is the frame
    itself.
    """

    searches = True

    def evidence(self, frame: Frame, prior: PixelMessage) -> PixelMessage:
        """Return the image registered to the scene, and the likelihood of the map.

        What other chains expect to be covered, or a detector finds, is not compared with the scene. Pixels of
        a frame that is not found in the scene say nothing.
        """
        if frame.image is None or prior.view is None:
            return PixelMessage(image=frame.image)
        covered = prior.layers.cover(prior.view.size) > EVEN
        if frame.boxes is not None:
            shown = np.zeros(covered.shape, np.bool_)
            for left, top, right, bottom in np.rint(np.maximum(frame.boxes.xyxy, 0)).astype(int).tolist():
                shown[top:bottom, left:right] = True
            covered |= prior.view.map.mask_to_scene(shown)
        view, image = prior.view.register(frame.image, covered)
        return PixelMessage(image=image if view.is_found else None, view=view)
