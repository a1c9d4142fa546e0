"""The street: a man who stands still, and a car that leaves; every frame with its exact foreground.

A scene renders any of its frames on its own, from the seed and the frame's index only: 10,000 frames take no
more memory than one, and two runs over the same scene see the same bytes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, overload

import numpy as np

from ...models.core.frame import Frame
from .street_actors import Figure, Layer, Sprite, car_sprite, compose
from .street_ground import Mask, Pixels, paint_street

WALKING_SPEED = 0.75  # body heights a second
PAUSE = 60  # frames between the end of a visit and the next
LIGHT_AFTER_JUMP = 0.78  # light after the sudden change, as a share of the light before
CLOUD_SHADE = 0.35  # how much of the light a cloud takes


@dataclass(frozen=True)
class TruthBox:
    """Where an object is seen in a frame.

    Parameters
    ----------
    identity
        1 for the car; 2, 3, ... for the person's first, second, ... visit.
    kind
        what it is, in the paper's two classes.
    box
        `(x, y, width, height)` px of the visible part, 0-based coordinates of the top-left corner.
    """

    identity: int
    kind: Literal["pedestrian", "vehicle"]
    box: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Scene(Sequence[Frame]):
    """The sleeping-man scene; build it with `sleeping_man`, which explains the parameters.

    A sequence of `Frame`s, rendered when asked for. Indices count from 0, `Frame.number` from 1.
    """

    n_frames: int
    seed: int
    size: tuple[int, int]
    stand: int
    enter: int
    car_leaves: int
    light_jump: int | None
    light_drift: float
    noise: float
    clouds: bool
    dt: float = 1 / 25

    def __post_init__(self) -> None:
        width, height = self.size
        if width < 64 or height < 48:
            raise ValueError(f"size: got {self.size}, expected (width, height) of at least (64, 48) px")
        if self.n_frames < 1:
            raise ValueError(f"n_frames: got {self.n_frames}, expected 1 or more")
        if self.stand < 0 or self.enter < 0 or self.car_leaves < 0:
            raise ValueError(
                f"stand, enter, car_leaves: got {self.stand}, {self.enter}, {self.car_leaves} frames, "
                "expected 0 or more"
            )
        if self.noise < 0 or not 0 <= self.light_drift < 1:
            raise ValueError(
                f"noise, light_drift: got {self.noise}, {self.light_drift}, expected 0 or more and [0, 1)"
            )

    def __len__(self) -> int:
        return self.n_frames

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        if isinstance(index, slice):
            return [self.render(i) for i in range(*index.indices(self.n_frames))]
        return self.render(range(self.n_frames)[index])

    def __iter__(self) -> Iterator[Frame]:
        return (self.render(index) for index in range(self.n_frames))

    @property
    def masks(self) -> "Masks":
        """The exact foreground, `(height, width)` bool for every frame, worked out when asked for."""
        return Masks(self)

    def render(self, index: int) -> Frame:
        """Frame `index` (from 0): `(height, width, 3)` uint8 BGR."""
        picture = self._composed(index)
        picture *= np.float32(self._light(index))
        if self.clouds:
            picture *= self._shade(index)[..., None]
        if self.noise > 0:
            # its own generator for every frame, so that frames can be rendered in any order
            generator = np.random.default_rng([self.seed, 1, index])
            picture += self.noise * generator.standard_normal(picture.shape, np.float32)
        image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        return Frame(image, index * self.dt, index + 1)

    def foreground(self, index: int) -> Mask:
        """`(height, width)` bool: the person, and the car from its first movement on.

        A car parked since the first frame is background until it leaves; the ground that it uncovers is
        background from the frame in which it can be seen.
        """
        return self.person(index) | (self.car(index) if index >= self.car_leaves else False)

    def person(self, index: int) -> Mask:
        """`(height, width)` bool: pixels that the person covers by more than half."""
        return self._visible(index)[1]

    def car(self, index: int) -> Mask:
        """`(height, width)` bool: pixels that the car covers, parked or moving, and the person does not."""
        return self._visible(index)[0]

    def boxes(self, index: int) -> list[TruthBox]:
        """Boxes around the visible part of everything that is foreground in frame `index`."""
        car, person = self._visible(index)
        boxes = []
        if index >= self.car_leaves and car.any():
            boxes.append(TruthBox(1, "vehicle", _bounding_box(car)))
        if person.any():
            boxes.append(TruthBox(2 + self._visit(index)[0], "pedestrian", _bounding_box(person)))
        return boxes

    # What happens when

    @property
    def _body(self) -> float:
        """Height of the person in px."""
        return 0.5 * self.size[1]

    def _visit(self, index: int) -> tuple[int, float, float, float]:
        """The person at frame `index`: visit, place of the feet (px), distance walked (px), gait in 0..1."""
        width = self.size[0]
        speed = WALKING_SPEED * self._body * self.dt  # px a frame
        outside = 0.35 * self._body  # far enough for a stretched leg
        way_in, way_out = 0.45 * width + outside, 0.55 * width + outside
        frames_in, frames_out = round(way_in / speed), round(way_out / speed)
        period = frames_in + self.stand + frames_out + PAUSE
        visit, since = divmod(index - self.enter, period)
        leaving = since - frames_in - self.stand
        ease = 8.0  # frames in which the legs come to rest
        if index < self.enter:
            return 0, -outside, 0.0, 1.0
        if since < frames_in:
            walked = way_in * since / frames_in
            return visit, walked - outside, walked, min(1.0, (frames_in - since) / ease)
        if leaving < 0:
            return visit, way_in - outside, way_in, 0.0
        walked = way_in + way_out * min(leaving / frames_out, 1.0)
        return visit, walked - outside, walked, min(1.0, leaving / ease)

    def _light(self, index: int) -> float:
        drift = self.light_drift * np.sin(2 * np.pi * (index * self.dt / 14.0 + self.seed * 0.37))
        jumped = self.light_jump is not None and index >= self.light_jump
        return float((1 + drift) * (LIGHT_AFTER_JUMP if jumped else 1.0))

    # How it looks

    def _composed(self, index: int) -> Pixels:
        """`(height, width, 3)` float32 of frame `index` under even light, without noise."""
        picture = self._ground.copy()
        for layer in self._layers(index):
            layer.paint(picture)
        return picture

    @cached_property
    def _ground(self) -> Pixels:
        return paint_street(self.size, np.random.default_rng([self.seed, 0]))

    @cached_property
    def _figure(self) -> Figure:
        return Figure.sewn(self._body, np.random.default_rng([self.seed, 2]))

    @cached_property
    def _car_sprite(self) -> Sprite:
        return car_sprite(0.34 * self.size[0], np.random.default_rng([self.seed, 3]))

    @cached_property
    def _clouds(self) -> Pixels:
        """`(height, 4 width)` share of the light that clouds take, periodic in x."""
        width, height = self.size
        generator = np.random.default_rng([self.seed, 4])
        across, down = np.fft.fftfreq(4 * width) * width, np.fft.fftfreq(height) * width
        keep = np.exp(-0.5 * (across[None, :] ** 2 + down[:, None] ** 2) / 1.2**2)
        field = np.fft.ifft2(np.fft.fft2(generator.standard_normal((height, 4 * width))) * keep).real
        field = np.clip(0.5 + field / field.std() * 1.2, 0, 1)
        return np.asarray(CLOUD_SHADE * field * field * (3 - 2 * field), np.float32)

    def _shade(self, index: int) -> Pixels:
        """`(height, width)` light that clouds, drifting a quarter of the picture a second, let through."""
        width = self.size[0]
        moved = (0.25 * width * index * self.dt) % (4 * width)
        whole, part = int(moved), moved - int(moved)
        columns = np.arange(whole, whole + width + 1) % (4 * width)
        strip = self._clouds[:, columns]
        shade: Pixels = 1 - (strip[:, :-1] * np.float32(1 - part) + strip[:, 1:] * np.float32(part))
        return shade

    def _layers(self, index: int) -> tuple[Layer, Layer]:
        """The car and, in front of it, the person."""
        width, height = self.size
        driven = max(0, index - self.car_leaves + 1) * self.dt
        left = 0.62 * width + 0.5 * 0.25 * width * driven**2  # accelerates by a quarter of the width
        wheels = 0.80 * height
        car = compose([self._car_sprite.placed(left, wheels)], self._car_sprite.reach(left, wheels))
        _, feet, walked, gait = self._visit(index)
        return car, self._figure.posed(feet, 0.94 * height, walked, gait, index * self.dt)

    def _visible(self, index: int) -> tuple[Mask, Mask]:
        car, person = (layer.mask(self.size) for layer in self._layers(index))
        return car & ~person, person


@dataclass(frozen=True, eq=False)
class Masks(Sequence[Mask]):
    """A scene's foreground masks as a sequence, `(height, width)` bool each."""

    scene: Scene

    def __len__(self) -> int:
        return len(self.scene)

    @overload
    def __getitem__(self, index: int) -> Mask: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Mask]: ...
    def __getitem__(self, index: int | slice) -> Mask | Sequence[Mask]:
        if isinstance(index, slice):
            return [self.scene.foreground(i) for i in range(*index.indices(len(self)))]
        return self.scene.foreground(range(len(self))[index])


def sleeping_man(
    n_frames: int = 400,
    seed: int = 0,
    size: tuple[int, int] = (320, 240),
    light_jump: int | None = None,
    *,
    stand: int = 200,
    enter: int = 40,
    car_leaves: int = 200,
    light_drift: float = 0.06,
    noise: float = 4.0,
    clouds: bool = False,
) -> Scene:
    """A person walks into a street, stands almost still, and walks out; a parked car leaves meanwhile.

    Parts of the person's clothes have nearly the colour of what is behind them. If the scene is long enough,
    the person comes back again and again.

    Parameters
    ----------
    n_frames
        length of the scene, 25 frames a second.
    seed
        decides textures, noise and the phase of the light.
    size
        `(width, height)` px.
    light_jump
        index of the frame from which on the light is 22 % weaker; `None`: it never jumps.
    stand
        frames for which the person stands, swaying by a pixel or two.
    enter
        index of the frame at which the person sets out for the picture.
    car_leaves
        index of the first frame in which the car has moved; at least `n_frames`: it stays parked.
    light_drift
        slow change of the light, as a share of it: a sine of 14 seconds.
    noise
        standard deviation of the sensor's noise, grey levels per channel.
    clouds
        shadows of clouds with soft edges, taking up to 35 % of the light, drift over the picture.

    Raises
    ------
    ValueError
        if the picture is smaller than 64 x 48 px, there is no frame, or noise or drift is out of range.
    """
    return Scene(n_frames, seed, size, stand, enter, car_leaves, light_jump, light_drift, noise, clouds)


def _bounding_box(mask: Mask) -> tuple[float, float, float, float]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        float(columns[0]),
        float(rows[0]),
        float(columns[-1] - columns[0] + 1),
        float(rows[-1] - rows[0] + 1),
    )
