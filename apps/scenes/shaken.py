"""A steady film as seen by a camera that shakes, with every frame's map."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.camera.moving_camera import UNKNOWNS, AffineMap
from ...models.core.checks import NOT_EMPTY, CountFrom0, NotNegative, checked
from ...models.core.frame import Frame
from .generated_film import Lazy

SHAKE_TIME = 0.15  # s, time constant of the shake
TURNING = 0.25  # of the shake's px: how far rotation, zoom and shear move the corners


@checked
@dataclass(frozen=True, eq=False)
class ShakenFilm(Lazy[Frame]):
    """A steady video as seen by a shaking camera.

    The first frame is not shaken. The map from the scene to a frame (see `AffineMap`) is an
    Ornstein-Uhlenbeck process of 0.15 s: translations, and a quarter as much of rotation, zoom and shear.

    Parameters
    ----------
    film
        frames with images of one size.
    amount
        px, standard deviation of the shifts along each axis.
    seed
        of shake and noise.
    margin
        px by which the image is cropped on each side, the range of the shake.
    noise
        standard deviation of the sensor's noise, grey levels, to be added.

    Raises
    ------
    ValueError
        if a number is negative, or the film is empty.
    """

    film: Annotated[Sequence[Frame], NOT_EMPTY]
    amount: NotNegative = 3.0
    seed: CountFrom0 = 0
    margin: CountFrom0 = 16
    noise: NotNegative = 0.0

    def __len__(self) -> int:
        return len(self.film)

    def make(self, index: int) -> Frame:
        """Make frame `index` with its time."""
        frame = self.film[index]
        if frame.image is None:
            return frame
        image = self._seen(frame.image, index, cv2.INTER_CUBIC).astype(np.float32)
        if self.noise > 0:
            generator = np.random.default_rng([self.seed, 1, index])
            image += self.noise * generator.standard_normal(image.shape, np.float32)
        return Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), frame.time, frame.number)

    @cached_property
    def size(self) -> tuple[int, int]:
        """`(width, height)` px of its frames."""
        image = next(frame.image for frame in self.film if frame.image is not None)
        return image.shape[1] - 2 * self.margin, image.shape[0] - 2 * self.margin

    @cached_property
    def views(self) -> list[AffineMap]:
        """Map from the cropped steady image to each frame."""
        random = np.random.default_rng([self.seed, 0])
        shares = self.amount * np.where(np.arange(UNKNOWNS) % 3 == 0, 1.0, TURNING)
        parameters, views, before = np.zeros(UNKNOWNS), [], self.film[0].time
        for frame in self.film:
            stays = np.exp(-(frame.time - before) / SHAKE_TIME)
            parameters = stays * parameters + np.sqrt(1 - stays**2) * shares * random.normal(size=UNKNOWNS)
            views.append(AffineMap(parameters, self.size[::-1]))
            before = frame.time
        return views

    def mask(self, steady: NDArray[np.bool_], index: int) -> NDArray[np.bool_]:
        """Return the foreground `(height, width)` of frame `index`, from a mask of the steady film."""
        return self._seen(steady.astype(np.float32), index, cv2.INTER_LINEAR) > 0.5

    def _seen(
        self, picture: NDArray[np.uint8] | NDArray[np.float32], index: int, how: int
    ) -> NDArray[np.float32]:
        back = cv2.invertAffineTransform(self.views[index].matrix)
        back[:, 2] += self.margin
        shown = cv2.warpAffine(
            picture, back, self.size, flags=how | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(shown)


shaken = ShakenFilm
