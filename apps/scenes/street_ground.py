"""The street without anybody: house, hedge, fence, pavement, road and grass from random numbers."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.float32]
Mask = NDArray[np.bool_]


def paint_street(size: tuple[int, int], generator: np.random.Generator) -> Pixels:
    """`(height, width, 3)` float32: house, fence and hedge, pavement, road, grass."""
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
    """`(height, width)` noise of unit variance in octaves, from spots of `grain` px down to single px."""
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
