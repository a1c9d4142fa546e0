"""A crowd in front of a textured wall: any number of walkers of one size in a picture of any size.

Walkers are as large and as fast however many there are and however large the picture is, so that what a
tracker spends on each can be told from what it spends on the picture. They cross in lanes, to the right and
to the left, a body and a half apart from who walks ahead; lanes below are in front of those above.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from .random_fields import mottle

BODY = (60, 22)  # height and width px of a walker
SPEED = 50.0  # px/s of most walkers; lanes differ by a fifth
ROOM = 2.5  # bodies' widths from one walker to the next in a lane
RATE = 25.0  # frames a second
NOISE = 3.0  # grey levels, standard deviation of a pixel's


def crowd(n_walkers: int, n_frames: int, size: tuple[int, int], seed: int = 0) -> Iterator[Frame]:
    """Yield frames of `n_walkers` who cross a picture of `size` `(height, width)`, the first one empty.

    Raises
    ------
    ValueError
        if they do not fit in.
    """
    height, width = size
    generator = np.random.default_rng(seed)
    # a lane that is left on one side is entered again on the other, out of sight
    length = width + 4 * BODY[1]
    most = int(length // (ROOM * BODY[1]))
    n_lanes = max(-(-n_walkers // most), min(n_walkers, (height - BODY[0]) // (2 * BODY[0])))
    if height < BODY[0] + n_lanes:
        raise ValueError(f"n_walkers: got {n_walkers}, expected fewer in a picture of {height}x{width} px")
    wall = _textured(size, np.array([110.0, 120.0, 115.0]), 12.0, generator)
    bodies = [
        _textured(BODY, generator.uniform(20, 235, 3), 25.0, generator) for _ in range(min(n_walkers, 40))
    ]
    shape = _ellipse()
    grain = [generator.normal(0, NOISE, (*size, 1)).astype(np.float32) for _ in range(4)]
    tops = np.linspace(0, height - BODY[0], n_lanes).round().astype(int)
    lanes = np.arange(n_walkers) % n_lanes
    ranks = np.arange(n_walkers) // n_lanes
    shares = generator.uniform(0, 1, n_lanes)[lanes] + ranks * n_lanes / n_walkers
    speeds = np.where(lanes % 2 == 0, SPEED, -SPEED) * (1 + 0.2 * np.sin(1.7 * lanes))
    for number in range(1, n_frames + 1):
        image = wall.copy()
        time = number / RATE
        lefts = (shares * length + speeds * time) % length - 2 * BODY[1]
        for walker in np.argsort(lanes, kind="stable") if number > 1 else ():
            _draw(image, bodies[walker % len(bodies)], shape, tops[lanes[walker]], round(lefts[walker]))
        image += grain[number % len(grain)]
        yield Frame(np.clip(image, 0, 255).astype(np.uint8), time, number)


def _draw(
    image: NDArray[np.float32], body: NDArray[np.float32], shape: NDArray[np.bool_], top: int, left: int
) -> None:
    first, end = max(-left, 0), min(body.shape[1], image.shape[1] - left)
    if first < end:
        part, inside = slice(first, end), shape[:, first:end]
        window = image[top : top + body.shape[0], left + first : left + end]
        window[inside] = body[:, part][inside]


def _textured(
    size: tuple[int, int], colour: NDArray[np.float64], contrast: float, generator: np.random.Generator
) -> NDArray[np.float32]:
    """A surface `(height, width, 3)` of a BGR colour, lighter and darker in spots."""
    spots = mottle(size, 0.5 * BODY[0], 2.0, generator)[..., None]
    return np.asarray(colour + contrast * spots, np.float32)


def _ellipse() -> NDArray[np.bool_]:
    """What of a walker's box is the walker."""
    y, x = np.ogrid[: BODY[0], : BODY[1]]
    across = (x - 0.5 * (BODY[1] - 1)) / (0.5 * BODY[1])
    down = (y - 0.5 * (BODY[0] - 1)) / (0.5 * BODY[0])
    return np.asarray(across**2 + down**2 <= 1)
