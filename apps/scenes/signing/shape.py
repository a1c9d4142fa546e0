"""Surface of a signer in a pose: tubes around limbs, head, trunk and fingers.

Everything is a tube: rings around a line, with two half widths each. Orders of axes: rings, then around.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ....models.body.upper_body import BodyPoses, UpperBody, transport
from ....models.numerics.rotations import exponential
from .faults import Distractor
from .paint import Palette, hairiness

Array = NDArray[np.float64]

AROUND = 20  # vertices of a ring
FINGER_AROUND = 8
SLEEVE = 0.55  # of an upper arm, that a short sleeve covers
BARE = 0.85  # width of a bare arm over a clothed one
SPREAD = np.array([-0.42, -0.15, 0.05, 0.22, 0.40])  # rad, of thumb, then fingers, across the palm
ROOTS = np.array([-0.30, -0.30, -0.10, 0.10, 0.28])  # where they begin across the palm, in palms
LENGTHS = np.array([0.85, 1.12, 1.25, 1.18, 0.95])  # in hand radii


@dataclass(frozen=True, eq=False)
class Solid:
    """A piece of surface of one material."""

    material: str  # name of its texture
    # places, normals: `(n, 3)` px, z away from the viewer; outward unit vectors
    places: Array
    normals: Array
    texels: Array  # `(n, 2)`: px along the surface, around and along, of the texture
    triangles: NDArray[np.int64]  # `(m, 3)` indices of vertices


@dataclass(frozen=True, eq=False)
class HandShape:
    """Shape of a hand: roll (rad) about the forearm, bend (rad) of the wrist, and curl (5,) of thumb and
    fingers, 0 straight, 1 closed."""

    roll: float
    bend: float
    curl: Array


@lru_cache
def _grid(tubes: int, rings: int, around: int) -> NDArray[np.int64]:
    """Return triangles of `tubes` grids, `rings` x (`around` + 1) vertices each."""
    number = np.arange(rings * (around + 1)).reshape(rings, around + 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    one = np.stack([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)]).reshape(-1, 3)
    return (one + number.size * np.arange(tubes)[:, None, None]).reshape(-1, 3)


def tube(
    material: str, centres: Array, across: Array, over: Array, wide: Array, deep: Array, around: int = AROUND
) -> Solid:
    """Tubes with rings around `centres` `(..., rings, 3)`.

    `across` and `over`, unit vectors `(..., rings, 3)` or broadcast to it, span the rings; `wide` and `deep`,
    `(..., rings)`, are half widths along them. Texels are counted from the first ring, where `over` is.
    """
    angles = np.linspace(0, 2 * np.pi, around + 1)
    centres, across, over = np.broadcast_arrays(centres, across, over)
    wide, deep = np.broadcast_arrays(wide, deep)
    rings = centres.shape[-2]
    places = centres[..., None, :] + (
        (wide[..., None] * np.sin(angles))[..., None] * across[..., None, :]
        + (deep[..., None] * np.cos(angles))[..., None] * over[..., None, :]
    )
    places = places.reshape(-1, rings, around + 1, 3)
    forward = np.empty_like(places)
    forward[:, 1:-1] = places[:, 2:] - places[:, :-2]
    forward[:, 0], forward[:, -1] = places[:, 1] - places[:, 0], places[:, -1] - places[:, -2]
    round_it = np.empty_like(places)
    round_it[:, :, 1:-1] = places[:, :, 2:] - places[:, :, :-2]
    round_it[:, :, 0] = round_it[:, :, -1] = places[:, :, 1] - places[:, :, -2]
    normals = np.cross(round_it, forward)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    outwards = places - centres.reshape(-1, rings, 1, 3)
    if (normals * outwards).sum() < 0:
        normals = -normals
    steps = np.linalg.norm(np.diff(centres, axis=-2), axis=-1).reshape(-1, rings - 1)
    along = np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=1)], axis=1)
    texels = np.empty((*places.shape[:3], 2))
    texels[..., 0] = angles * float(np.max(wide))
    texels[..., 1] = along[:, :, None]
    return Solid(
        material,
        places.reshape(-1, 3),
        normals.reshape(-1, 3),
        texels.reshape(-1, 2),
        _grid(len(places), rings, around),
    )


def limb(
    material: str, start: Array, end: Array, frame: Array, first: float, last: float, flat: float = 1.0
) -> Solid:
    """A round tapered limb with rounded ends, half as wide as `first` at `start` and `last` at `end`.

    `frame` (3, 3): its columns are across, along and over the limb; `flat`: depth over width.
    """
    length = float(np.linalg.norm(end - start))
    cap = np.sin(np.linspace(-np.pi / 2, 0, 5))
    along = np.concatenate([first * cap, length * np.linspace(0.12, 0.88, 6), length - last * cap[::-1]])
    round_start, round_end = np.sqrt(1 - cap**2), np.sqrt(1 - cap[::-1] ** 2)
    middle = first + (last - first) * np.linspace(0.12, 0.88, 6)
    radii = np.concatenate([first * round_start, middle, last * round_end]) + 1e-3
    centres = start + along[:, None] * frame[:, 1]
    return tube(material, centres, frame[:, 0], frame[:, 2], radii, flat * radii)


def surface(
    body: UpperBody, palette: Palette, pose: BodyPoses, hands: list[HandShape], bare: bool = False
) -> list[Solid]:
    """Return the surfaces of a person in the first of `pose`, with `bare` forearms or in sleeves.

    Materials are skin, head, top, left hand, right hand and trousers.
    """
    joints = body.joints(pose)[0]
    root = np.array([*pose.roots[0], 0.0])
    torso, turn = exponential(pose.torsos)[0], exponential(pose.necks)[0]
    solids = _trunk(body, root, torso)
    solids += [*_head(body, joints[0], turn, palette), _neck(body, root, torso, joints[0])]
    for side, name in enumerate(("left", "right")):
        shoulder, elbow, hand = joints[2 + 3 * side : 5 + 3 * side]
        upper, fore = transport(pose.arms[0, side])
        wrist = hand - 0.75 * body.hand * fore[:, 1]
        cuff = wrist - 0.25 * body.hand * fore[:, 1]
        solids.extend(
            _bare_arm(body, shoulder, elbow, cuff, upper, fore)
            if bare
            else [
                limb("top", shoulder, elbow, upper, 0.5 * body.upper_arm_width, 0.52 * body.forearm_width),
                limb("top", elbow, cuff, fore, 0.5 * body.forearm_width, 0.58 * body.wrist_width),
            ]
        )
        solids.append(
            limb(f"{name} hand", cuff, wrist, fore, 0.45 * body.wrist_width, 0.42 * body.wrist_width)
        )
        solids.extend(_hand(body, f"{name} hand", side, hand, fore, hands[side]))
    return solids


def _bare_arm(
    body: UpperBody, shoulder: Array, elbow: Array, wrist: Array, upper: Array, fore: Array
) -> list[Solid]:
    """A short sleeve, and the skin of upper arm and forearm."""
    thick, bent = 0.5 * body.upper_arm_width, 0.5 * BARE * body.forearm_width
    hem = shoulder + SLEEVE * (elbow - shoulder)
    return [
        limb("top", shoulder, hem, upper, thick, thick + SLEEVE * (0.52 * body.forearm_width - thick)),
        limb("skin", hem, elbow, upper, BARE * thick, bent),
        limb("skin", elbow, wrist, fore, bent, 0.45 * body.wrist_width),
    ]


def _trunk(body: UpperBody, root: Array, torso: Array) -> list[Solid]:
    """Torso, turned about the root by `torso` (3, 3), and legs, which do not turn."""
    h, half = body.head_height, body.shoulder_width / 2
    down = np.array([-0.35, -0.30, -0.25, -0.17, 0.04, 0.3, 0.7, 1.2, 1.7, 2.0, 2.3, 2.45]) * h
    down *= body.torso_height / (2.3 * h)
    hips = body.torso_width / 2
    top = [0.23 * h, 0.36 * h, 0.62 * half, 0.86 * half, half, 0.98 * half, 0.93 * half]
    wide = np.array([*top, 0.5 * half + 0.42 * hips, 0.95 * hips, hips, 1.05 * hips, 0.9 * hips])
    deep = h * np.array([0.16, 0.18, 0.2, 0.24, 0.27, 0.3, 0.33, 0.33, 0.33, 0.33, 0.33, 0.3])
    x, y, z = torso.T
    centres = root + down[:, None] * y + 0.08 * h * z
    solids = [tube("top", centres, x, z, wide, deep, around=2 * AROUND)]
    seat = root + body.torso_height * y + np.array([0.0, 0.0, 0.1 * h])
    for sign in (1.0, -1.0):
        hip = seat + np.array([0.45 * sign * hips, 0.1 * h, 0.0])
        knee = hip + h * np.array([0.75 * sign, 0.5, -1.5])
        along = knee - hip
        frame = transport((along / np.linalg.norm(along))[None])[0]
        solids.append(limb("trousers", hip, knee, frame, 0.42 * h, 0.33 * h))
    return solids


def _neck(body: UpperBody, root: Array, torso: Array, head: Array) -> Solid:
    height = body.head_height
    start = head + height * np.array([0.0, 0.22, 0.06])
    along = root + height * (torso @ np.array([0.0, -0.27, 0.06])) - start
    frame = transport((along / np.linalg.norm(along))[None])[0]
    return limb("skin", start, start + along, frame, 0.22 * height, 0.22 * height)


def _head(body: UpperBody, centre: Array, turn: Array, palette: Palette) -> list[Solid]:
    """The head: an ellipsoid with a chin, a nose and hair; texels are longitude and latitude, rad from 0."""
    rings, around = 28, 40
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings)[:, None]  # chin down is positive
    longitude = np.linspace(-np.pi, np.pi, around + 1)[None, :]  # 0 is the face
    x = np.cos(latitude) * np.sin(longitude)
    y = np.sin(latitude) * np.ones_like(longitude)
    z = -np.cos(latitude) * np.cos(longitude)
    narrow = 1 - 0.16 * np.clip(y, 0, 1) ** 2
    nose = 0.20 * np.exp(-((x / 0.13) ** 2)) * np.clip((y + 0.1) / 0.42, 0, 1) * (y < 0.34) * (z < 0)
    half = np.array([body.head_width / 2, body.head_height / 2, 0.46 * body.head_height])
    thick = 1 + 0.07 * hairiness(palette, x, y, z)
    shape = np.stack([x * narrow, y, z - nose], axis=-1) * half * thick[..., None]
    around_it = np.gradient(shape, axis=1)
    around_it[:, 0] = around_it[:, -1] = shape[:, 1] - shape[:, -2]
    normals = np.cross(np.gradient(shape, axis=0), around_it)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    normals *= np.sign((normals * shape).sum())
    texels = np.stack(np.broadcast_arrays(longitude + np.pi, latitude + np.pi / 2), axis=-1)
    solids = [
        Solid(
            "head",
            centre + shape.reshape(-1, 3) @ turn.T,
            normals.reshape(-1, 3) @ turn.T,
            texels.reshape(-1, 2),
            _grid(1, rings, around),
        )
    ]
    for sign in (1.0, -1.0):
        ear = centre + turn @ (half * np.array([0.98 * sign, 0.08, 0.05]))
        size = body.head_height
        solids.append(limb("skin", ear, ear + 0.12 * size * turn[:, 1], turn, 0.07 * size, 0.05 * size, 0.7))
    return solids


def _hand(
    body: UpperBody, material: str, side: int, centre: Array, fore: Array, shape: HandShape
) -> list[Solid]:
    """Palm and five fingers, shifted so that the middle of their surface is the hand's centre."""
    radius = 1.18 * body.hand  # a spread hand is larger than its disc, a fist smaller
    sine, cosine = np.sin(shape.roll), np.cos(shape.roll)
    across = cosine * fore[:, 0] + sine * fore[:, 2]
    over = np.cross(across, fore[:, 1])
    along = np.cos(shape.bend) * fore[:, 1] + np.sin(shape.bend) * over
    over = np.cross(across, along)
    palm_end = 0.92 * radius * along
    t = np.linspace(0, 1, 9)
    wide = radius * np.array([0.02, 0.36, 0.45, 0.53, 0.57, 0.60, 0.58, 0.46, 0.02])
    centres = (-0.05 + 0.95 * t)[:, None] * palm_end * 1.15
    palm = tube(material, centres, across, over, wide, 0.45 * wide, 14)
    thumbs = 1 - 2 * side
    roots = 1.9 * radius * ROOTS[:, None] * thumbs * across + 0.80 * palm_end
    roots[0] = 0.25 * palm_end - 0.34 * thumbs * radius * across
    lengths = radius * LENGTHS * np.array([0.85, 1, 1, 1, 1])
    spread = thumbs * SPREAD * (1 - 0.6 * shape.curl)
    spread[0] *= 2.0
    straight = np.cos(spread)[:, None] * along + np.sin(spread)[:, None] * across
    s = np.linspace(0, 1, 7)
    # a finger that curls is an arc, 2.8 rad at most
    bent = 2.8 * np.clip(shape.curl, 0, 1)[:, None] * s
    step = np.cos(bent)[..., None] * straight[:, None] + np.sin(bent)[..., None] * over
    centre_lines = roots[:, None] + np.cumsum(step, axis=1) * (lengths / len(s))[:, None, None]
    outward = np.cos(bent)[..., None] * over - np.sin(bent)[..., None] * straight[:, None]
    sideways = np.cross(straight, over)[:, None]
    radii = radius * np.array([0.17, 0.17, 0.165, 0.155, 0.145, 0.125, 0.01])
    fingers = tube(material, centre_lines, sideways, outward, radii, radii, FINGER_AROUND)
    middle = 0.5 * (palm.places.mean(axis=0) + fingers.places.mean(axis=0))
    for solid in (palm, fingers):
        solid.places[:] += centre - middle
    return [palm, fingers]


def blob(thing: Distractor, moment: float, head_height: float) -> Solid:
    """Return the surface of a distractor at frame `moment`."""
    generator = np.random.default_rng(thing.seed)
    angle, bump = generator.uniform(0, np.pi), generator.uniform(0.6, 1.1, 9)
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 9)
    depth = -0.5 * head_height if thing.in_front else 0.8 * head_height
    centre = np.array([*thing.place(moment), depth])
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    wide = thing.radius * (np.cos(latitude) * bump + 1e-3)
    centres = centre + (thing.radius * 1.1 * np.sin(latitude))[:, None] * along
    return tube("skin", centres, across, np.array([0.0, 0.0, 1.0]), wide, 0.4 * wide)
