"""What moves in the street: a person of jointed parts and a car, drawn as sprites over the picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .street_ground import Mask, Pixels, mottle

DETAIL = 2
"""Texels a px, at which objects are composed before they are averaged down: smooth outlines."""

STRIDE = 0.85
"""Body heights that one cycle of both legs covers."""


@dataclass(frozen=True, eq=False)
class Layer:
    """A patch with premultiplied colour and coverage, and where its top-left corner lies in the picture."""

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
    """A drawn part, `DETAIL` texels a px, with the texel that its joint lies on."""

    texels: Pixels  # (height, width, 4), premultiplied as in `Layer`
    joint: tuple[float, float]

    def placed(self, x: float, y: float) -> tuple["Sprite", NDArray[np.float64]]:
        """This sprite with its joint at `(x, y)` px, upright."""
        return self, _shift(x, y)

    def reach(self, x: float, y: float) -> tuple[int, int, int, int]:
        """Left, top, width, height of a patch that holds the sprite with its joint at `(x, y)` px."""
        height, width = self.texels.shape[:2]
        left, top = (
            int(np.floor(x - self.joint[0] / DETAIL)) - 1,
            int(np.floor(y - self.joint[1] / DETAIL)) - 1,
        )
        return left, top, width // DETAIL + 4, height // DETAIL + 4


def compose(parts: Sequence[tuple[Sprite, NDArray[np.float64]]], reach: tuple[int, int, int, int]) -> Layer:
    """Lay parts over each other, the first at the back; matrices take px about the joint to the picture."""
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
    """The person, cut into parts that turn about joints; lengths in hundredths of the body's height."""

    height: float  # px
    head: Sprite
    torso: Sprite
    thigh: Sprite
    shank: Sprite
    upper_arm: Sprite
    forearm: Sprite

    @classmethod
    def sewn(cls, height: float, generator: np.random.Generator) -> "Figure":
        """A person of `height` px with textured clothes."""
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
            return _drawn([(np.array(points), colour) for points, colour in shapes], unit, 11.0, generator)

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
        """The person with the feet at `(x, y)` px after `walked` px, legs swinging by `gait` in 0..1."""
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


def _drawn(
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
    """A car seen from the side, `length` px long, its joint below the rear bumper on the ground."""
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
    shapes = [
        (below, (34, 34, 36)),
        (body, paint),
        (sill, (84, 60, 40)),
        (seam, (60, 44, 30)),
        (lamp, (190, 215, 225)),
    ]
    shapes += [(window, glass) for window in windows]
    for wheel in (19.0, 80.0):
        for radius, colour in ((8.6, (24, 24, 26)), (7.8, tyre), (4.4, hub)):
            turn = np.linspace(0, 2 * np.pi, 33)
            shapes.append(
                (
                    list(
                        zip(
                            wheel + radius * np.cos(turn),
                            -7.8 + np.minimum(radius * np.sin(turn), 7.8),
                            strict=True,
                        )
                    ),
                    colour,
                )
            )
    return _drawn([(np.array(points), colour) for points, colour in shapes], length / 100, 6.0, generator)


def _shift(x: float, y: float) -> NDArray[np.float64]:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _scale(factor: float) -> NDArray[np.float64]:
    return np.diag([factor, factor, 1.0])


def _turn(angle: float) -> NDArray[np.float64]:
    """Rotation by `angle` radians; positive swings a hanging limb towards the left, behind a walker."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
