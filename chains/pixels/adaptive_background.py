"""Adaptive background as a chain: the empty scene, pixel by pixel, under changing light.

Of pixel k with label B_k and colour L_k, under the light g of the frame:

    p(R_t | R_t-1) = N(R_t; R_t-1, drift dt)
    p(L_k | B_k = 1, R) = N(L_k; g_k R_k, noise_k),  p(L_k | B_k = 0) = U
    mu_{R -> F_k} = P(B_k) N(L_k; g_k m_k, g_k^2 (s_k + drift dt) + noise_k) where B_k = 1, U where B_k = 0

The RSMCM paper's low-level chain (§4.2): a Gaussian per pixel, whose posterior after a frame is a mixture of
"the pixel was seen" and "it was covered", collapsed by its moments. Since P(B) is multiplied with what other
chains predict, the background stays as it is behind an object that they track; where that stood from the
first frame on, m_k is unknown. Where things are seen to sway, p(L_k | B_k = 1) has a share of what is beside.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...models.camera.moving_camera import AffineMap
from ...models.core.checks import (
    CountFrom0,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Probability,
    Shape,
    SizesOf,
    checked,
)
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.pixels import colour
from ...models.pixels.background import EmptyScene
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from .background_prediction import BackgroundPrediction, fixed_point, stored_planes
from .empty_scene import empty_scene
from .gaussians import MEAN_STEPS, Gaussians
from .light import LightField, light_grid, share_of_blocks, track_light
from .mirror import EVERY, mirroring, update_mirror
from .second_colours import SETTLED, SecondColours, Settling, learn_second_colours, update_behind
from .shade import shade_in, update_shade
from .sleeping_blocks import Flags, blocks_in_turn
from .sway import Sway, sway_reach, update_rates

Planes = NDArray[np.float32]
OfBlocks = Annotated[Planes, Shape("block_rows", "block_columns")]
OfPixels = Annotated[NDArray[np.uint16], Shape("height * width")]

UNSURE_VARIANCE = 4.0
"""Variance of a value that was seen a few times only, and gives way easily in the beginning."""

WIDEST_VARIANCE = 255.0**2 / 12
"""Squared grey levels: of a value that may be anything; so far it wanders at most, however long it hides."""

FIRST_TIME = 0.5
"""s in which objects of the first frame are found; the scene behind them is unknown until then."""

BOOTSTRAP_TIME = 3.0
"""s after which nothing that was there from the first is taken for the scene by mistake any more."""

LEAST_TIME = 0.2  # s for which a second colour must have been seen in any case

LIGHT_ROUNDS = 2
"""How often empty scene and light are found in turn; from then on the scene's noise changes by 1 %."""

LONG = 60.0  # s, in which any light can come about
MOST_NOISE_SHARE = 0.1  # of a single observation in a pixel's noise, however long ago the one before was


@short_repr
@dataclass(frozen=True, eq=False)
class BackgroundState:
    """State of the empty scene, pixel by pixel in fixed-point numbers of 16 bits."""

    size: Annotated[tuple[int, int], SizesOf("height", "width")]  # px
    # steps of 1/32 grey level under the first frame's light; see `planes`
    mean: Annotated[NDArray[np.int16], Shape("channels", "height * width")]
    variance: OfPixels  # of the mean; see `Gaussians` for its steps
    noise: OfPixels  # of a single observation
    light: OfBlocks  # today's light relative to that of `mean`
    covered: OfBlocks  # share of each block behind known objects, or that mirrors them
    sway: OfBlocks  # how often its pixels show what is beside them, as leaves do
    shade: Annotated[Planes, Shape(3, "block_rows", "block_columns")]  # shares of blocks; see `shade_in`
    mirror: Annotated[
        Planes, Shape(2, "block_columns")
    ]  # shares of time with foreground, and an axis; see `mirroring`
    # colours that are neither background nor an object
    candidate: Annotated[NDArray[np.uint8], Shape("height * width * channels")]
    seen: OfPixels  # how much of the settling time they have lasted; see `SecondColours`
    elapsed: NotNegative  # s since the last frame with an image
    age: NotNegative  # s for which the scene has been seen
    frames: CountFrom0  # with an image, since the first

    def require_fit(self) -> None:
        """Raise a `ValueError` if there are other blocks than loops expect, or darkness."""
        grid = light_grid(*self.size)
        if self.light.shape != grid or not (self.light > 0).all():
            raise ValueError(f"light: got {self.light.shape} blocks, expected {grid} above 0")

    @property
    def pixels(self) -> Gaussians:
        """Gaussians of all pixels."""
        return Gaussians(self.mean, self.variance, self.noise)

    def planes(self) -> Planes:
        """Return the scene's colours, `(channels, height, width)` float32 grey levels."""
        return stored_planes(self.mean, self.size).grey_levels()

    def lit_planes(self) -> Planes:
        """Return the scene's colours under today's light, `(channels, height, width)` float32 grey levels."""
        rows, position = LightField(self.light, self.size).along_rows
        above = position.astype(np.intp)
        share = (position - above)[:, None]
        return np.asarray(self.planes() * (rows[above] * (1 - share) + rows[above + 1] * share))

    def picture(self) -> NDArray[np.uint8]:
        """Return the empty scene under today's light: grey `(height, width)` or BGR `(height, width, 3)`."""
        return colour.to_image(self.lit_planes().reshape(-1, self.size[0] * self.size[1]), self.size)

    def seen_by(self, view: AffineMap, known: NDArray[np.bool_], fresh: Self) -> Self:
        """Return the state in the px of a frame; `fresh` where nothing is `known` `(height, width)` of it."""
        # where the means are not mixed with what lies beyond the edge
        where = view.warp_to_frame(known.astype(np.float32), cv2.INTER_LINEAR).reshape(-1) > 0.99
        means = np.stack([view.warp_to_frame(plane, cv2.INTER_LINEAR) for plane in self.lit_planes()])
        mean = np.rint(MEAN_STEPS * means).reshape(fresh.mean.shape).clip(-32768, 32767).astype(np.int16)
        variance, noise = (
            view.warp_to_frame(plane.reshape(self.size)).reshape(-1) for plane in (self.variance, self.noise)
        )
        return replace(
            fresh,
            mean=np.where(where, mean, fresh.mean),
            variance=np.where(where, variance, fresh.variance),
            noise=np.where(where, noise, fresh.noise),
            shade=np.zeros_like(fresh.shade) + self.shade.mean(axis=(1, 2), keepdims=True),  # of the film
            mirror=np.zeros_like(fresh.mirror) + self.mirror.mean(axis=1, keepdims=True),
            age=self.age,
            frames=self.frames,
        )


@short_repr
@checked
@dataclass(frozen=True)
class AdaptiveBackground:
    """Per-pixel adaptive background: a Gaussian per pixel under changing light.

    Parameters
    ----------
    prior
        P(B=1) of a pixel without other predictions.
    noise
        squared grey levels: initial noise variance of sensor and scene.
    noise_rate
        1/s, rate at which the noise variance of a pixel is learned (0: fixed variance as in the paper).
    drift
        squared grey levels per second, random walk of a background value.
    first_variance
        squared grey levels: variance of a value seen once.
    settle_time
        s after which a new colour that no chain explains becomes background; infinite switches this off.
    pooling
        weight of the evidence of the surrounding 5 x 5 pixels in the log odds of a pixel.
    follow_light
        estimate a smooth field of light in every frame, so that clouds and lamps do not become foreground.
    sleep
        do not compare blocks of pixels that show what is expected, once the scene is known: see
        `sleeping_blocks`.
    """

    prior: Probability = 0.95
    noise: Positive = 30.0
    noise_rate: NotNegative = 0.4
    drift: NotNegative = 1.25
    first_variance: Positive = 20.0
    settle_time: PositiveOrInfinite = 3.0
    pooling: NotNegative = 0.3
    follow_light: bool = True
    sleep: bool = True
    name: str = "background"

    @property
    def ports(self) -> tuple[Port, ...]:
        """The light of a frame is estimated from its image before the pixels are predicted."""
        cavity = Cavity.IMAGE if self.follow_light else Cavity.NOTHING
        return (Port(PixelLabels, cavity, sole="background"),)

    def initial(self, frame: Frame) -> BackgroundState:
        """Return a state with the first image as background, with the variance of one observation."""
        image = frame.required_image()
        height, width = image.shape[:2]
        variance, noise = (np.full(height * width, x, np.float32) for x in (self.first_variance, self.noise))
        grid = light_grid(height, width)
        return BackgroundState(
            size=(height, width),
            **fixed_point(colour.to_planes(image), variance, noise)._asdict(),
            light=np.ones(grid, np.float32),
            covered=np.zeros(grid, np.float32),
            sway=np.zeros(grid, np.float32),
            shade=np.zeros((3, *grid), np.float32),
            mirror=np.zeros((2, grid[1]), np.float32),
            candidate=np.zeros(image.size, np.uint8),
            seen=np.zeros(height * width, np.uint16),
            elapsed=0.0,
            age=0.0,
            frames=0,
        )

    def predict(self, state: BackgroundState, dt: float) -> BackgroundState:
        """Predict the background `dt` seconds ahead; variances grow when they are next used."""
        return replace(state, elapsed=state.elapsed + dt)

    def message(self, state: BackgroundState, feature: PixelLabels, incoming: Incoming) -> PixelMessage:
        """Return P(B) and the predicted value of every pixel (mu_{R -> F}), under the light of this frame."""
        return PixelMessage(background=self._predicted(state, incoming))

    def update(self, state: BackgroundState, incoming: Incoming) -> BackgroundState:
        """Update the background by the frame, each pixel weighted by r = P(B=1 | everything).

        With prediction N(R; m, s), d = I - m and K = s / (s + noise) the mean becomes m + r K d and the
        variance (1 - r K) s + r (1 - r) K^2 d^2. Where a new scene begins, it is known as far as this frame
        shows it, or it is behind objects.
        """
        after, view = self._updated(state, incoming), incoming[PixelLabels].view
        if view is None or view.begins is None:
            return after
        message = incoming[PixelLabels] * PixelMessage(background=self._predicted(state, incoming))
        fresh = self.initial(Frame(view.begins, 0.0, 1))
        return after.seen_by(view.map, message.are_known(), fresh)

    def _updated(self, state: BackgroundState, incoming: Incoming) -> BackgroundState:
        image = incoming.evidence(PixelLabels).image
        if image is None:
            return state
        prediction = self._predicted(state, incoming)
        subtraction, after = prediction.compare(image), prediction.update(image)
        covered = np.zeros(subtraction.log_odds.shape, np.uint8)
        light = prediction.light.along_rows
        second = SecondColours(state.candidate.copy(), state.seen.copy())
        channels = len(state.mean)
        flat = np.ascontiguousarray(image).reshape(-1)
        composed = incoming.others(PixelLabels).layers.composition(image, state.size)
        if len(composed.regions):
            update_behind(
                composed.regions, composed.shift, flat, subtraction.unshaded, prediction.pixels, light,
                prediction.model, prediction.rounding, colour.to_pixels(channels), after, second, covered,
            )  # fmt: skip
        mirrored = prediction.mirrored(image)
        if mirrored is not None:  # it tells nothing of the scene, and of its light
            covered |= mirrored
            for now, before in zip(after, prediction.pixels, strict=True):
                now[..., mirrored > 0] = before[..., mirrored > 0]
        sway = update_rates(
            prediction.sway, flat, prediction.pixels, light, subtraction.log_odds, covered, state.age,
            state.elapsed,
        )  # fmt: skip
        if state.elapsed > 0 and np.isfinite(self.settle_time):
            scale = SETTLED / self.settle_time
            settling = Settling(
                np.float32(prediction.tolerance),
                min(max(round(scale * state.elapsed), 1), SETTLED // 4),  # at least four times
                min(round(scale * LEAST_TIME), SETTLED),
                np.float32(self.first_variance),
                np.float32(UNSURE_VARIANCE if state.age < BOOTSTRAP_TIME else np.inf),
            )
            learn_second_colours(
                flat, subtraction.unshaded, covered, light,
                colour.from_pixels(channels), colour.to_pixels(channels), settling, after, second,
            )  # fmt: skip
        mirror = state.mirror
        if prediction.looks_for_mirrors:
            mirror = update_mirror(mirror, prediction.mirror_seen(image), state.age, EVERY * state.elapsed)
        return replace(
            state,
            **after._asdict(),
            light=prediction.light.blocks,
            covered=share_of_blocks(covered.reshape(state.size), state.light.shape),
            sway=sway,
            shade=update_shade(
                state.shade, prediction.shade_counts(image), state.size, state.age, state.elapsed
            ),
            mirror=mirror,
            candidate=second.colours,
            seen=second.seen,
            elapsed=0.0,
            age=state.age + state.elapsed,
            frames=state.frames + 1,
        )

    def empty_scene(
        self,
        images: Sequence[NDArray[np.uint8]],
        times: NDArray[np.float64],
        covered: Sequence[NDArray[np.bool_]] | None = None,
    ) -> EmptyScene:
        """Estimate the background image from a sample of images.

        First without changes of the light, then with the light of each image relative to the first estimate.

        Parameters
        ----------
        images
            uint8 `(height, width[, 3])`, all alike, in order of time; one at least.
        times
            `(n_images,)` s.
        covered
            `(height, width)` for every image: pixels of known objects, which are excluded unless an object is
            always there.
        """
        first = self.initial(Frame(images[0], 0.0, 1))
        steady = LightField(first.light, first.size)
        scene = empty_scene(images, times, [steady], self.noise, covered)
        for _ in range(LIGHT_ROUNDS if len(images) > 1 else 0):
            fields = [self._light(scene, image) for image in images]
            scene = empty_scene(images, times, fields, self.noise, covered)
        return scene

    def initial_in(self, scene: EmptyScene) -> BackgroundState:
        """Return the state before the first frame, given the background image."""
        state = self.initial(Frame(np.zeros(scene.shape, np.uint8), 0.0, 1))
        pixels = fixed_point(scene.mean, scene.variance, scene.noise)
        return replace(state, **pixels._asdict(), light=scene.light)

    def _light(self, scene: EmptyScene, image: NDArray[np.uint8]) -> LightField:
        """The light of an image of the scene, with all the time to follow it."""
        state = self.predict(self.initial_in(scene), LONG)
        return self._prediction(state, image if self.follow_light else None).light

    def _predicted(self, state: BackgroundState, incoming: Incoming) -> BackgroundPrediction:
        image = incoming.evidence(PixelLabels).image if self.follow_light else None
        return incoming.once(self._prediction, state, image)

    def _prediction(self, state: BackgroundState, image: NDArray[np.uint8] | None) -> BackgroundPrediction:
        light = LightField(state.light, state.size)
        if image is not None:
            light = track_light(light, image, state.mean, state.covered, state.elapsed)
        return BackgroundPrediction(
            size=state.size,
            pixels=state.pixels,
            frames=state.frames,
            light=light,
            prior=self.prior,
            drift=min(self.drift * state.elapsed, WIDEST_VARIANCE),
            noise_share=min(-math.expm1(-self.noise_rate * state.elapsed), MOST_NOISE_SHARE),
            first_variance=self.first_variance,
            unknown_variance=WIDEST_VARIANCE if state.age < FIRST_TIME else 0.0,
            pooling=self.pooling,
            second=SecondColours(state.candidate, state.seen),
            tolerance=8.0 * len(state.mean) * self.noise,
            sway=Sway(state.sway, sway_reach(state.size)),
            shade=shade_in(state.shade, state.size),
            mirroring=mirroring(state.mirror),
            in_turn=self._in_turn(state),
        )

    def _in_turn(self, state: BackgroundState) -> Flags:
        """Return the blocks that do not sleep: all of them until their values and noises are known."""
        in_turn = blocks_in_turn(state.size, state.age, state.elapsed)
        return in_turn if self.sleep and state.age >= BOOTSTRAP_TIME else np.ones_like(in_turn)
