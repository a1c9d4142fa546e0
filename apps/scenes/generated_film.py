"""Base of generated films: each frame is made on its own, on request."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame

T = TypeVar("T")


class Lazy(Sequence[T]):
    """Sequence whose items are made on request."""

    @abstractmethod
    def make(self, index: int) -> T:
        """Make item `index`, from 0."""

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[T]: ...
    def __getitem__(self, index: int | slice) -> T | Sequence[T]:
        if isinstance(index, slice):
            return [self.make(i) for i in range(*index.indices(len(self)))]
        return self.make(range(len(self))[index])

    def __iter__(self) -> Iterator[T]:
        return (self.make(index) for index in range(len(self)))


class GeneratedFilm(Lazy[Frame]):
    """Frames of a scene, 25 a second; indices count from 0, `Frame.number` from 1."""

    n_frames: int
    seed: int
    dt: float = 1 / 25

    def __len__(self) -> int:
        return self.n_frames

    @abstractmethod
    def make(self, index: int) -> Frame:
        """Make frame `index` with its time."""

    def frame(self, index: int) -> Frame:
        """Return `self[index]`."""
        return self[index]

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return the picture of frame `index`: `(height, width[, 3])` uint8, BGR."""
        image = self[index].image
        assert image is not None
        return image

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures."""
        return (self.image(index) for index in range(len(self)))

    def _seen(self, picture: NDArray[np.float32], noise: float, stream: int, index: int) -> Frame:
        """A frame of a picture as a sensor sees it, whose noise has a standard deviation in grey levels."""
        if noise > 0:
            # a generator of its own for each frame, so that frames can be made in any order
            generator = np.random.default_rng([self.seed, stream, index])
            picture = picture + np.float32(noise) * generator.standard_normal(picture.shape, np.float32)
        image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        return Frame(image, index * self.dt, index + 1)
