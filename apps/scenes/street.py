"""The street: a man who stands still, and a car that leaves; every frame with its exact foreground.

A scene renders any of its frames on its own, from the seed and the frame's index only: 10,000 frames take no
more memory than one, and two runs over the same scene see the same bytes.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.checks import Bound, Count, CountFrom0, NotNegative, checked
from ...models.core.frame import Frame
from .generated_film import GeneratedFilm, Lazy

Pixels = NDArray[np.float32]
Mask = NDArray[np.bool_]


def paint_street(size: tuple[int, int], generator: np.random.Generator) -> Pixels:
    """Paint the street, `(height, width, 3)` float32: house, fence and hedge, pavement, road, grass."""
    width, height = size
    unit = height / 240
    picture = np.empty((height, width, 3), np.float32)

    def row(share: float) -> int:
        return round(share * height)

    def column(share: float) -> int:
        return round(share * width)

    def fill(
        top: float, bottom: float, colour: tuple[int, int, int], rough: float, grain: float,
        left: float = 0.0, right: float = 1.0,
    ) -> Pixels:  # fmt: skip
        part = picture[row(top) : row(bottom), column(left) : column(right)]
        texture = rough * mottle((part.shape[1], part.shape[0]), grain * unit, generator)
        part[:] = np.array(colour, np.float32) + texture[..., None]
        return part

    wall = fill(0, 0.46, (112, 128, 152), 9, 5)
    course, brick = max(3, round(6 * unit)), max(6, round(15 * unit))
    for number, y in enumerate(range(0, wall.shape[0], course)):
        for x in range(-(number % 2) * brick // 2, wall.shape[1], brick):
            stone = wall[y : y + course, max(x, 0) : max(x + brick, 0)]
            stone += generator.normal(0, 7)
            stone[:, :1] += 14
        wall[y : y + 1] += 14
    for left in (0.06, 0.30, 0.54, 0.80):
        frame = picture[row(0.06) : row(0.30), column(left) : column(left + 0.12)]
        frame[:] = (196, 204, 206)
        rim = max(1, round(2.5 * unit))
        pane = frame[rim:-rim, rim:-rim]
        sky = np.linspace(1.0, 0.45, pane.shape[0], dtype=np.float32)[:, None, None]
        pane[:] = np.array((138, 118, 98), np.float32) * sky
        pane += 8 * mottle((pane.shape[1], pane.shape[0]), 8 * unit, generator)[..., None]
        pane[:, pane.shape[1] // 2 - rim // 2 : pane.shape[1] // 2 - rim // 2 + rim] = (190, 198, 200)
        pane[pane.shape[0] // 3 : pane.shape[0] // 3 + rim] = (190, 198, 200)
    fill(0.40, 0.59, (52, 92, 70), 24, 4)  # hedge
    fence = fill(0.38, 0.59, (66, 92, 130), 9, 10, 0.34, 0.62)  # as brown as the person's jacket
    plank = max(4, round(11 * unit))
    for x in range(0, fence.shape[1], plank):
        fence[:, x : x + plank] += generator.normal(0, 6)
        fence[:, x : x + 1] -= 34
    fill(0.59, 0.70, (150, 158, 164), 8, 6)  # pavement
    for x in range(-3, 14):  # its slabs, meeting far away
        ends = [
            (width * (0.5 + (x - 5) * 0.10), 0.59 * height),
            (width * (0.5 + (x - 5) * 0.125), 0.70 * height),
        ]
        _line(picture, ends, (118, 124, 130), unit)
    _line(picture, [(0, 0.638 * height), (width, 0.638 * height)], (120, 126, 132), unit)
    fill(0.70, 0.725, (176, 180, 182), 6, 4)  # kerb
    fill(0.725, 0.90, (108, 104, 102), 10, 2.5)  # road, as grey as the trousers
    for share in (0.02, 0.24, 0.46, 0.68, 0.90):  # the line in the middle of the road
        stroke = [(share * width, 0.855 * height), ((share + 0.11) * width, 0.855 * height)]
        _line(picture, stroke, (196, 200, 202), 3 * unit)
    fill(0.90, 1.0, (64, 112, 92), 22, 3)  # grass
    lens = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.6 * max(unit, 0.5)), np.float32)
    lens += 5 * mottle(size, 60 * unit, generator)[..., None]  # large, soft differences of the light
    return np.asarray(np.clip(lens, 12, 240), np.float32)


def _line(
    picture: Pixels, ends: Sequence[tuple[float, float]], colour: tuple[int, int, int], thickness: float
) -> None:
    start, stop = ((round(x), round(y)) for x, y in ends)
    cv2.line(picture, start, stop, colour, max(1, round(thickness)))


def mottle(size: tuple[int, int], grain: float, generator: np.random.Generator) -> Pixels:
    """Return `(height, width)` noise of unit variance in octaves, from spots of `grain` px to single px."""
    width, height = size
    field = np.zeros((height, width), np.float32)
    spot = max(grain, 1.0)
    while True:
        cells = (int(np.ceil(width / spot)) + 2, int(np.ceil(height / spot)) + 2)
        coarse = generator.standard_normal((cells[1], cells[0]), np.float32)
        layer = cv2.resize(
            coarse, (round(cells[0] * spot), round(cells[1] * spot)), interpolation=cv2.INTER_CUBIC
        )
        field += np.asarray(layer, np.float32)[:height, :width]
        if spot <= 1.0:
            break
        spot = max(spot / 2, 1.0)
    deviation = float(field.std())
    return field / np.float32(deviation if deviation > 0 else 1.0)


DETAIL = 2  # texels a px, at which objects are composed before they are averaged down: smooth outlines
STRIDE = 0.85  # body heights that one cycle of both legs covers


@dataclass(frozen=True, eq=False)
class Layer:
    """Patch with premultiplied colour and coverage, and the place of its top-left corner in the picture."""

    patch: Pixels  # (height, width, 4): blue, green, red in 0..255 times coverage; coverage in 0..1
    left: int
    top: int

    def _overlap(self, size: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """The rows and columns that patch and picture share: in the picture, and in the patch."""
        height, width = self.patch.shape[:2]
        x0, x1 = (min(max(x, 0), size[0]) for x in (self.left, self.left + width))
        y0, y1 = (min(max(y, 0), size[1]) for y in (self.top, self.top + height))
        inside = (slice(y0 - self.top, y1 - self.top), slice(x0 - self.left, x1 - self.left))
        return (slice(y0, y1), slice(x0, x1)), inside

    def paint(self, picture: Pixels) -> None:
        """Lay the patch over `picture`, `(height, width, 3)`, in place."""
        there, here = self._overlap((picture.shape[1], picture.shape[0]))
        patch = self.patch[here]
        picture[there] = patch[..., :3] + picture[there] * (1 - patch[..., 3:])

    def mask(self, size: tuple[int, int]) -> Mask:
        """`(height, width)` bool: pixels covered by more than half."""
        covered = np.zeros((size[1], size[0]), np.bool_)
        there, here = self._overlap(size)
        covered[there] = self.patch[here][..., 3] > 0.5
        return covered


@dataclass(frozen=True, eq=False)
class Sprite:
    """Drawn part, `DETAIL` texels a px, with the texel that its joint lies on."""

    texels: Pixels  # (height, width, 4), premultiplied as in `Layer`
    joint: tuple[float, float]

    def standing(self, x: float, y: float) -> Layer:
        """Place the sprite upright, with its joint at `(x, y)` px."""
        height, width = self.texels.shape[:2]
        left, top = (np.floor(np.array([x, y]) - np.array(self.joint) / DETAIL).astype(int) - 1).tolist()
        return compose([(self, _shift(x, y))], (left, top, width // DETAIL + 4, height // DETAIL + 4))


def compose(parts: Sequence[tuple[Sprite, NDArray[np.float64]]], reach: tuple[int, int, int, int]) -> Layer:
    """Lay parts over each other, the first at the back; matrices map px about the joint to the picture."""
    left, top, width, height = reach
    canvas = np.zeros((DETAIL * height, DETAIL * width, 4), np.float32)
    half = (DETAIL - 1) / 2  # from the corner of a px to the centre of its first texel, in texels
    to_canvas = _shift(-half, -half) @ _scale(DETAIL) @ _shift(-left, -top)
    for sprite, matrix in parts:
        from_texels = _scale(1 / DETAIL) @ _shift(-sprite.joint[0], -sprite.joint[1])
        warp = (to_canvas @ matrix @ from_texels)[:2]
        part = cv2.warpAffine(sprite.texels, warp, (DETAIL * width, DETAIL * height), flags=cv2.INTER_LINEAR)
        canvas *= 1 - part[..., 3:]
        canvas += part
    patch = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    return Layer(np.asarray(patch, np.float32), left, top)


@dataclass(frozen=True, eq=False)
class Figure:
    """Person, cut into parts that turn about joints; lengths in hundredths of the body's height."""

    height: float  # px
    head: Sprite
    torso: Sprite
    thigh: Sprite
    shank: Sprite
    upper_arm: Sprite
    forearm: Sprite

    @classmethod
    def sewn(cls, height: float, generator: np.random.Generator) -> "Figure":
        """Make a person of `height` px with textured clothes."""
        unit = height / 100
        jacket, trousers, skin, shoe = (62, 84, 122), (104, 88, 80), (128, 156, 200), (38, 40, 46)
        limb = [(-4.8, -4.0), (4.8, -4.0), (3.9, 25.0), (-3.9, 25.0)]
        shank = [(-3.9, -3.0), (3.9, -3.0), (2.8, 21.0), (-2.8, 21.0)]
        foot = [(-3.2, 20.0), (2.9, 20.0), (8.6, 22.6), (8.6, 24.0), (-3.4, 24.0)]
        torso = [(-7.0, -2.0), (0.0, -4.5), (6.5, -2.0), (9.0, 12.0), (8.0, 25.0), (8.6, 39.0)]
        torso += [(-8.2, 39.0), (-7.4, 24.0), (-8.6, 10.0)]
        arm = [(-3.4, -3.0), (3.4, -3.0), (2.7, 18.0), (-2.7, 18.0)]
        sleeve = [(-2.8, -2.0), (2.8, -2.0), (2.2, 14.0), (-2.2, 14.0)]
        hand = [(-2.1, 13.5), (2.1, 13.5), (2.3, 19.0), (-1.6, 19.5)]
        collar = [(-3.0, -5.5), (3.4, -5.5), (2.8, 0.5), (-3.2, 0.5)]
        head = [(6.2 * np.cos(a) + 0.3, 7.8 * np.sin(a) - 11.2) for a in np.linspace(0, 2 * np.pi, 25)]
        hair = [(x, y) for x, y in head if y < -13.5 or x < -3.5]
        stripe = [(-8.6, 11.0), (9.2, 12.0), (9.0, 16.0), (-8.2, 15.0)]
        belt = [(-8.0, 36.5), (8.4, 36.5), (8.5, 39.0), (-8.1, 39.0)]

        def cut(*shapes: tuple[list[tuple[float, float]], tuple[int, int, int]]) -> Sprite:
            return _draw([(np.array(points), colour) for points, colour in shapes], unit, 11.0, generator)

        return cls(
            height,
            head=cut((collar, skin), (head, skin), (hair, (34, 42, 58))),
            torso=cut((torso, jacket), (stripe, (70, 120, 150)), (belt, (44, 52, 66))),
            thigh=cut((limb, trousers)),
            shank=cut((shank, trousers), (foot, shoe)),
            upper_arm=cut((arm, jacket)),
            forearm=cut((sleeve, jacket), (hand, skin)),
        )

    def posed(self, x: float, y: float, walked: float, gait: float, seconds: float) -> Layer:
        """Pose the person with the feet at `(x, y)` px after `walked` px, legs swinging by `gait` in 0..1."""
        unit = self.height / 100
        phase = 2 * np.pi * walked / (STRIDE * self.height)
        rest = 1 - gait
        # standing people sway: feet stay, the head moves by a pixel or two at 120 px of height
        sway = unit * (1.1 * np.sin(2 * np.pi * 0.23 * seconds) + 0.5 * np.sin(2 * np.pi * 0.61 * seconds))
        lean = np.array([[1.0, -rest * sway / (100 * unit), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        bob = unit * gait * (1.2 * np.cos(2 * phase) - 1.2)
        body = _shift(x, y) @ lean @ _shift(0, -bob - 0.2 * unit)
        hip, shoulder = body @ _shift(0, -47.5 * unit), body @ _shift(0, -81.5 * unit)
        parts = []

        def limb(root: NDArray[np.float64], upper: float, lower: float, arm: bool) -> None:
            first = root @ _turn(upper)
            second = first @ _shift(0, (16.5 if arm else 23.5) * unit) @ _turn(lower)
            parts.append((self.forearm if arm else self.shank, second))
            parts.append((self.upper_arm if arm else self.thigh, first))

        for side in (-1, 1):  # the far side first
            swing = side * gait * np.sin(phase)
            lift = gait * max(0.0, side * np.cos(phase)) * 0.75
            if side > 0:
                limb(hip, -0.46 * swing - 0.3 * lift - 0.05 * rest, lift + 0.02, arm=False)
                parts.append((self.torso, body @ _shift(0, -80 * unit)))
                parts.append((self.head, body @ _shift(0.8 * unit, -81 * unit)))
                limb(shoulder, 0.42 * swing + 0.06 * rest, -0.28 - 0.15 * gait, arm=True)
            else:
                limb(shoulder, 0.42 * swing, -0.3 - 0.15 * gait, arm=True)
                limb(hip, -0.46 * swing - 0.3 * lift + 0.1 * rest, lift + 0.02, arm=False)
        left, top = int(np.floor(x - 0.4 * self.height)), int(np.floor(y - 1.05 * self.height))
        return compose(parts, (left, top, int(0.8 * self.height) + 2, int(1.1 * self.height) + 2))


def _draw(
    shapes: Sequence[tuple[NDArray[np.float64], tuple[int, int, int]]],
    unit: float,
    roughness: float,
    generator: np.random.Generator,
) -> Sprite:
    """Draw polygons (in `unit` px about the joint, BGR) over each other as one shaded piece of cloth."""
    fine = 4  # texels are drawn four times finer and averaged: their outline has a coverage
    points = np.concatenate([shape for shape, _ in shapes]) * unit * DETAIL
    low = np.floor(points.min(axis=0)) - 2
    width, height = (np.ceil(points.max(axis=0)) + 2 - low).astype(int)
    colour = np.zeros((height * fine, width * fine, 3), np.float32)
    covered = np.zeros((height * fine, width * fine), np.float32)
    for shape, paint in shapes:
        outline = np.rint((shape * unit * DETAIL - low) * fine * 16).astype(np.int32)[None]
        part = np.zeros_like(covered)
        cv2.fillPoly(part, outline, 1.0, shift=4)
        rounded = cv2.GaussianBlur(part, (0, 0), 0.7 * unit * DETAIL * fine) > 0.5  # no corners on people
        colour[rounded] = paint
        covered[rounded] = 1.0
    # darker towards the outline, as round things are
    depth = cv2.distanceTransform(covered.astype(np.uint8), cv2.DIST_L2, 3)
    shading = 0.78 + 0.27 * np.sqrt(np.minimum(depth / (depth.max() + 1e-6), 1.0))
    colour *= shading[..., None].astype(np.float32)
    texels = cv2.resize(
        np.dstack([colour * covered[..., None], covered]), (width, height), interpolation=cv2.INTER_AREA
    )
    cloth = roughness * mottle((width, height), 4.0 * unit, generator)
    texels[..., :3] = np.maximum(texels[..., :3] + texels[..., 3:] * cloth[..., None], 0)
    return Sprite(np.asarray(texels, np.float32), (-low[0] - 0.5, -low[1] - 0.5))


def car_sprite(length: float, generator: np.random.Generator) -> Sprite:
    """Draw a car from the side, `length` px long, its joint below the rear bumper on the ground."""
    paint, glass, tyre, hub = (128, 92, 62), (92, 84, 74), (30, 30, 32), (150, 150, 152)
    body = [(0.5, -22), (3, -27), (20, -29), (31, -41), (36, -43), (62, -43), (67, -41), (79, -29)]
    body += [(94, -26), (99, -21), (99.5, -10), (97, -7), (2, -7), (0.5, -11)]
    windows = [
        [(24.5, -29.5), (33, -39.5), (46, -40), (46, -29.5)],
        [(48.5, -29.5), (48.5, -40), (62, -40), (65, -39), (74, -29.5)],
    ]
    below = [(9, -9), (91, -9), (88, -2.5), (12, -2.5)]
    sill, lamp = [(2, -12), (97, -12), (97, -9), (2, -9)], [(93, -22.5), (98, -20.5), (98, -17), (93, -18)]
    seam = [(47, -29), (47.7, -29), (47.7, -10), (47, -10)]
    shapes: list[tuple[ArrayLike, tuple[int, int, int]]] = [(below, (34, 34, 36)), (body, paint)]
    shapes += [(sill, (84, 60, 40)), (seam, (60, 44, 30)), (lamp, (190, 215, 225))]
    shapes += [(window, glass) for window in windows]
    turn = np.linspace(0, 2 * np.pi, 33)
    for wheel in (19.0, 80.0):
        for radius, colour in ((8.6, (24, 24, 26)), (7.8, tyre), (4.4, hub)):
            down = np.minimum(radius * np.sin(turn), 7.8)
            shapes.append((np.column_stack([wheel + radius * np.cos(turn), -7.8 + down]), colour))
    return _draw([(np.array(points), colour) for points, colour in shapes], length / 100, 6.0, generator)


def _shift(x: float, y: float) -> NDArray[np.float64]:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _scale(factor: float) -> NDArray[np.float64]:
    return np.diag([factor, factor, 1.0])


def _turn(angle: float) -> NDArray[np.float64]:
    """Rotation by `angle` radians; positive swings a hanging limb towards the left, behind a walker."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


WALKING_SPEED = 0.75  # body heights a second
PAUSE = 60  # frames between the end of a visit and the next
LIGHT_AFTER_JUMP = 0.78  # light after the sudden change, as a share of the light before
CLOUD_SHADE = 0.35  # how much of the light a cloud takes


@dataclass(frozen=True)
class TruthBox:
    """Box of the visible part of an object in a frame.

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


LARGE_ENOUGH = Bound(lambda size: size[0] >= 64 and size[1] >= 48, "(width, height) of at least (64, 48) px")
DRIFT_RANGE = Bound(lambda share: 0 <= share < 1, "0 or more and less than 1")


@checked
@dataclass(frozen=True, eq=False)
class Scene(GeneratedFilm):
    """A street: a person walks in, stands almost still, and walks out; a parked car leaves meanwhile.

    Parts of the clothes have nearly the colour of the background. In long scenes, the person returns
    repeatedly.

    Parameters
    ----------
    n_frames
        length of the scene, 25 frames a second.
    seed
        of textures, noise and the phase of the light.
    size
        `(width, height)` px.
    light_jump
        index of the frame from which on the light is 22 % weaker; `None`: never.
    stand
        frames for which the person stands, swaying by a pixel or two.
    enter
        index of the frame at which the person starts to walk towards the image.
    car_leaves
        index of the first frame in which the car has moved; `n_frames` or more: never.
    light_drift
        relative amplitude of a slow change of the light, a sine of 14 seconds.
    noise
        standard deviation of the sensor's noise, grey levels per channel.
    clouds
        shadows of clouds with soft edges, taking up to 35 % of the light, drift over the picture.

    Raises
    ------
    ValueError
        if the picture is smaller than 64 x 48 px, there is no frame, or noise or drift is out of range.
    """

    n_frames: Count = 400
    seed: CountFrom0 = 0
    size: Annotated[tuple[int, int], LARGE_ENOUGH] = (320, 240)
    light_jump: int | None = None
    _: KW_ONLY
    stand: CountFrom0 = 200
    enter: CountFrom0 = 40
    car_leaves: CountFrom0 = 200
    light_drift: Annotated[float, DRIFT_RANGE] = 0.06
    noise: NotNegative = 4.0
    clouds: bool = False

    @property
    def masks(self) -> Sequence[Mask]:
        """Exact foreground, `(height, width)` bool for every frame, made on request."""
        return _Masks(self)

    def make(self, index: int) -> Frame:
        """Make frame `index` with its time; the picture has colours."""
        picture = self._composed(index)
        picture *= np.float32(self._light(index))
        if self.clouds:
            picture *= self._shade(index)[..., None]
        return self._seen(picture, self.noise, 1, index)

    def foreground(self, index: int) -> Mask:
        """Return `(height, width)` bool: the person, and the car from its first movement on.

        A car parked since the first frame is background until it leaves; the uncovered ground is background
        at once.
        """
        return self.person(index) | (self.car(index) if index >= self.car_leaves else False)

    def person(self, index: int) -> Mask:
        """Return `(height, width)` bool: pixels that the person covers by more than half."""
        return self._visible(index)[1]

    def car(self, index: int) -> Mask:
        """Return `(height, width)` bool: pixels that the car covers, parked or moving, and the person does
        not.
        """
        return self._visible(index)[0]

    def boxes(self, index: int) -> list[TruthBox]:
        """Return boxes around the visible part of all foreground in frame `index`."""
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
        for layer in _layers_of(self, index):
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
        _, feet, walked, gait = self._visit(index)
        car = self._car_sprite.standing(left, 0.80 * height)
        return car, self._figure.posed(feet, 0.94 * height, walked, gait, index * self.dt)

    def _visible(self, index: int) -> tuple[Mask, Mask]:
        car, person = (layer.mask(self.size) for layer in _layers_of(self, index))
        return car & ~person, person


@lru_cache(maxsize=1)  # the picture and the masks of a frame show the same layers
def _layers_of(scene: Scene, index: int) -> tuple[Layer, Layer]:
    return scene._layers(index)


@dataclass(frozen=True, eq=False)
class _Masks(Lazy[Mask]):
    scene: Scene

    def __len__(self) -> int:
        return len(self.scene)

    def make(self, index: int) -> Mask:
        return self.scene.foreground(index)


sleeping_man = Scene


def _bounding_box(mask: Mask) -> tuple[float, float, float, float]:
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return float(left), float(top), float(width), float(height)
