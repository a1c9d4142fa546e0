"""A face that turns, talks and moves in front of a room, with its exact pose in every frame.

The tracker's model is the built-in face; the renderer draws the same surface with a finer mesh, so that the
model is nearly right, as in life. Any frame is rendered on its own, from the seed and the frame's index only.
"""

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Bound, Count, CountFrom0, NotNegative, between, checked
from ...models.core.frame import Frame
from ...models.face.built_in_model import (
    HALF_HEIGHT,
    HALF_WIDTH,
    RIM,
    face_model,
    face_plane,
    front_view,
    on_shield,
    unit_length,
)
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.numerics.rotations import exponential
from .generated_film import GeneratedFilm
from .random_fields import inside, mottle, wander
from .rendering_kernels import EMPTY_DEPTH, average_samples, draw_mesh

Numbers = NDArray[np.float64]
Pixels = NDArray[np.float32]

SKIN = 140.0  # mean grey level of the skin under full light
WALL = 115.0  # mean grey level of the room
MARGIN = 1.03  # extent of a skin's picture, in extents of the surface


def skin_texels(plane: Numbers, density: float) -> Numbers:
    """Return column and row in a skin's picture of points `(n, 2)` of `face_plane`, at `density` texels a
    unit.
    """
    corner = MARGIN * RIM * np.array([HALF_WIDTH, HALF_HEIGHT])
    texels: Numbers = (plane + corner) * density
    return texels


def paint_skin(density: float, contrast: float, generator: np.random.Generator) -> Pixels:
    """Paint a face's albedo as grey levels under full light, `density` texels a unit of `face_plane`.

    Blotches of all sizes, freckles, brows, eyes, nostrils, lips and hair. `contrast`
    scales all differences from `SKIN`.
    """
    columns, rows = np.ceil(2 * skin_texels(np.zeros((1, 2)), density)[0]).astype(int) + 1
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) / density
    plane = grid - MARGIN * RIM * np.array([HALF_WIDTH, HALF_HEIGHT])
    x, y = np.moveaxis(front_view(plane), -1, 0)
    shape = (int(rows), int(columns))

    blotches = mottle(shape, 0.5 * density, 0.018 * density, generator)
    hairs = mottle(shape, 0.06 * density, 0.018 * density, generator)
    picture = (11.0 * blotches + _freckles(shape, density, generator)).astype(np.float64)
    right = np.abs(x)

    def cover(amount: Numbers, grey: Numbers | Pixels | float) -> None:
        picture[...] += amount * (grey - SKIN - picture)

    arch = -0.35 - 0.35 * (right - 0.10) * (0.42 - right)
    brow = inside(0.042 - 0.06 * (right - 0.1) - np.abs(y - arch)) * inside(0.2 - np.abs(right - 0.3))
    cover(0.85 * brow, 55 + 14 * hairs)
    opening = 1 - ((right - 0.285) / 0.135) ** 2
    lid = -0.14 + 0.005 - 0.065 * opening
    open_eye = inside(opening * 0.055 - np.abs(y + 0.14)) * inside(0.135 - np.abs(right - 0.285))
    cover(open_eye, 195.0)
    from_iris = np.hypot(right - 0.285, y + 0.142)
    cover(open_eye * inside(0.058 - from_iris), 85 + 10 * hairs)
    cover(open_eye * inside(0.026 - from_iris), 25.0)
    lashes = inside(0.018 - np.abs(y - lid)) * inside(0.145 - np.abs(right - 0.285))
    cover(0.8 * lashes, 45.0)
    cover(0.8 * inside(0.035 - np.hypot((right - 0.06) / 1.3, y - 0.235)), 45.0)  # nostrils
    bow = 0.075 * (1 - (x / 0.26) ** 2) + 0.012 * np.cos(x / 0.045) * np.exp(-((x / 0.12) ** 2))
    cover(0.9 * inside(bow - np.abs(y - 0.475)) * inside(0.25 - right), 98 + 6 * hairs)
    cover(0.85 * inside(0.014 - np.abs(y - 0.47 - 0.012 * np.cos(x / 0.05))) * inside(0.25 - right), 45.0)
    hair_line = -0.80 + 0.35 * x**2 + 0.02 * hairs
    cover(0.9 * inside(hair_line - y, 0.03), 62 + 16 * hairs)
    shield = on_shield(plane.reshape(-1, 2)).reshape(shape)
    picture[shield] = (3.0 * blotches + 40 * np.sign(np.sin(plane @ (50.0, 35.0))) - 30)[shield]
    return np.asarray(np.clip(SKIN + contrast * picture, 8, 245), np.float32)


def paint_room(size: tuple[int, int], contrast: float, generator: np.random.Generator) -> Pixels:
    """Paint the room behind the face, `(height, width)`: a wall with boxes, some striped like books."""
    width, height = size
    unit = height / 240
    picture = 14.0 * mottle((height, width), 60 * unit, 1.2 * unit, generator)
    for _ in range(34):
        left, top = generator.uniform(-0.1, 1, 2) * size
        wide, high = generator.uniform(12, 70, 2) * unit
        box = (
            slice(max(0, int(top)), max(0, int(top + high))),
            slice(max(0, int(left)), max(0, int(left + wide))),
        )
        grey, share = generator.normal(0, 38), 0.75
        if generator.random() < 0.4:
            stripe = max(2, round(generator.uniform(3, 9) * unit))
            stripes = generator.normal(0, 32, width // stripe + 2).repeat(stripe)[:width]
            picture[box] += share * (grey + stripes[box[1]][None, :] - picture[box])
        else:
            picture[box] += share * (grey - picture[box])
    soft = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7 * unit), np.float32)
    return np.asarray(np.clip(WALL + contrast * soft, 8, 245), np.float32)


def _freckles(shape: tuple[int, int], density: float, generator: np.random.Generator) -> Pixels:
    """Dark spots of three sizes, `(rows, columns)`, 0 or below."""
    freckles = np.zeros(shape, np.float32)
    for size in np.array([0.014, 0.022, 0.034]) * density:
        points = np.zeros(shape, np.float32)
        rows, columns = generator.uniform(0.12, 0.88, (2, 40)) * np.array(shape)[:, None]
        points[rows.astype(int), columns.astype(int)] = -generator.uniform(15, 55, 40)
        # a single point of weight 2 pi size^2 becomes a spot of height 1
        freckles += 2 * np.pi * size**2 * np.asarray(cv2.GaussianBlur(points, (0, 0), size), np.float32)
    return freckles


Mask = NDArray[np.bool_]

FINENESS = 4  # of the renderer's mesh: its facets are a fourth of the tracker's
SAMPLES = 3  # of a pixel, across and down
TEXELS = 2.5  # of the skin's picture in a pixel of a face seen from the front
SIZE = 0.18  # c_1 in heights of the picture
NECK = np.array([0.0, 0.5, 1.1])  # the point about which the head turns, in units of c_1 from its origin
MAX_PITCH, MAX_ROLL = 14.0, 10.0  # degrees
JAW = 0.5  # the mouth is a little open on average, in standard deviations of that expression
MOST = 2.5  # largest expression, in standard deviations
AMBIENT = 0.4  # share of the light that has no direction


@dataclass(frozen=True)
class Manner:
    """Manner of moving: shortest and longest periods (s) of the sines that are summed, and amplitudes."""

    # head, travel, expression: periods of rotations and scale, of translation, and of expressions
    head: tuple[float, float]
    travel: tuple[float, float]
    expression: tuple[float, float]
    reach: tuple[float, float]  # standard deviation of translation, in units of c_1: across and down
    liveliness: float  # standard deviation of each expression, in its own


MANNERS = {
    "natural": Manner((3.0, 8.0), (3.0, 8.0), (0.8, 4.0), (0.30, 0.15), 0.8),
    "fast": Manner((1.4, 4.0), (1.2, 4.0), (0.4, 1.5), (0.45, 0.25), 1.3),
}


LARGE_ENOUGH = Bound(lambda size: min(size) >= 64, "(width, height) of at least (64, 64) px")


@checked
@dataclass(frozen=True, eq=False)
class FaceScene(GeneratedFilm):
    """A face that rotates, talks and moves in front of a room.

    It starts at rest, seen from the front, and reaches its full motion within a second; slow and fast
    intervals alternate. c_1 is 18 % of the height of the image, with a variation of 8 %. The first frames of
    a longer scene are those of a shorter one. The room and its light are constant.

    Parameters
    ----------
    n_frames
        length of the scene, 25 frames a second.
    seed
        of motion, textures, light and noise.
    size
        `(width, height)` px.
    motion
        "natural", or "fast": two or three times as fast, with large expressions.
    max_yaw
        largest yaw, degrees, at most 80; from 50 on a large part of the face is self-occluded.
    shields
        whether two round shields in front of the cheeks occlude parts of the face (see `face_model`).
    texture
        contrast of the skin, relative to the default; 0 is uniform grey.
    change
        standard deviation, grey levels, of patches of the texture that change within seconds.
    light
        strength of shading and changes of light: 1, a lamp that moves and flickers slowly; 0, uniform light.
    background
        contrast of the room; 0 is uniform grey.
    noise
        standard deviation of the sensor's noise, grey levels.

    Raises
    ------
    ValueError
        if the picture is smaller than 64 x 64 px, there is no frame, or a parameter is out of its range.
    """

    n_frames: Count = 200
    seed: CountFrom0 = 0
    size: Annotated[tuple[int, int], LARGE_ENOUGH] = (320, 240)
    _: KW_ONLY
    motion: Literal["natural", "fast"] = "natural"
    max_yaw: Annotated[float, between(0, 80)] = 35.0
    shields: bool = False
    texture: NotNegative = 1.0
    change: NotNegative = 0.0
    light: Annotated[float, between(0, 1)] = 1.0
    background: NotNegative = 1.0
    noise: NotNegative = 2.0

    def make(self, index: int) -> Frame:
        """Make frame `index` with its time."""
        return self._seen(self._render(index)[0], self.noise, 5, index)

    def foreground(self, index: int) -> Mask:
        """Return `(height, width)` bool: pixels that the face covers by more than half."""
        return self._render(range(self.n_frames)[index])[1] > 0.5

    # The truth

    @cached_property
    def model(self) -> MorphableModel:
        """Model for trackers: the coarse mesh of the face."""
        return face_model(1, shields=self.shields)

    @cached_property
    def poses(self) -> Poses:
        """Pose of every frame, exact for `model` (whose vertices the renderer's mesh shares)."""
        return _poses(self)

    @cached_property
    def vertices(self) -> Numbers:
        """Positions of the vertices of `model`, `(n_frames, n_vertices, 2)` px."""
        return self.model.project(self.poses)

    # What it looks like

    @property
    def _times(self) -> Numbers:
        return self.dt * np.arange(self.n_frames, dtype=np.float64)

    @cached_property
    def _mesh(self) -> MorphableModel:
        return face_model(FINENESS, shields=self.shields)

    @cached_property
    def _density(self) -> float:
        """Texels of the skin's picture in one unit of `face_plane`."""
        return TEXELS * SIZE * self.size[1] * unit_length()

    @cached_property
    def _skin(self) -> Pixels:
        return paint_skin(self._density, self.texture, np.random.default_rng([self.seed, 0]))

    @cached_property
    def _room(self) -> Pixels:
        return paint_room(self.size, self.background, np.random.default_rng([self.seed, 1]))

    @cached_property
    def _changes(self) -> tuple[Pixels, Numbers, Numbers]:
        """Blotches that come and go: `(8, rows, columns)` of unit variance, their periods (s) and phases."""
        generator = np.random.default_rng([self.seed, 3])
        fields = [
            mottle(self._skin.shape, 0.3 * self._density, 0.04 * self._density, generator) for _ in range(8)
        ]
        return np.stack(fields), generator.uniform(1.5, 5.0, 8), generator.uniform(0, 2 * np.pi, 8)

    @cached_property
    def _lights(self) -> tuple[Numbers, Numbers]:
        """Directions to the light, `(n_frames, 3)` of unit length, and its gains, `(n_frames,)`."""
        generator = np.random.default_rng([self.seed, 4])
        azimuth, elevation, gain = (wander(self._times, (3.0, 9.0), generator) for _ in range(3))
        azimuth, elevation = 0.75 * np.tanh(azimuth), 0.6 + 0.35 * np.tanh(elevation)
        across, down = np.sin(azimuth) * np.cos(elevation), -np.sin(elevation)
        towards = -np.cos(azimuth) * np.cos(elevation)
        return np.stack([across, down, towards], axis=1), 1 + 0.2 * np.tanh(gain)

    def _albedo(self, index: int) -> Pixels:
        if self.change == 0:
            return self._skin
        fields, periods, phases = self._changes
        amounts = self.change / 2 * np.cos(2 * np.pi * index * self.dt / periods + phases)
        changed = self._skin + np.tensordot(amounts.astype(np.float32), fields, 1)
        return np.clip(changed, 8, 245, out=changed)

    def _shading(self, index: int, places: Numbers) -> Numbers:
        """Light at every vertex of the mesh at `places` `(n, 3)`, as a share of full light (Lambert)."""
        normals = np.zeros_like(places)
        first, second, third = (places[self._mesh.triangles[:, corner]] for corner in range(3))
        faces = np.cross(second - first, third - first)
        for corner in range(3):
            np.add.at(normals, self._mesh.triangles[:, corner], faces)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        directions, gains = self._lights
        lambertian = np.maximum(normals @ directions[index], 0)
        shade: Numbers = gains[index] * (AMBIENT + (1.15 - AMBIENT) * lambertian)
        return 1 + self.light * (shade - 1)

    def _render(self, index: int) -> tuple[Pixels, Pixels]:
        """The picture before noise, and the share of every pixel that the face covers."""
        places = self._mesh.positions(self.poses[index])[0]
        picture = self._room.copy()
        covered = np.zeros_like(picture)
        lowest = np.floor(places[:, :2].min(axis=0)).astype(int)
        highest = np.ceil(places[:, :2].max(axis=0)).astype(int) + 1
        left, top = np.clip(lowest, 0, self.size)
        right, bottom = np.clip(highest, 0, self.size)
        if right > left and bottom > top:
            shape = ((bottom - top) * SAMPLES, (right - left) * SAMPLES)
            grey, depth = np.zeros(shape, np.float32), np.full(shape, EMPTY_DEPTH, np.float32)
            # sample k of a pixel lies at (k - (SAMPLES - 1) / 2) / SAMPLES from its centre
            samples = places.copy()
            samples[:, :2] = (places[:, :2] - (left, top) + 0.5) * SAMPLES - 0.5
            texels = skin_texels(face_plane(FINENESS, shields=self.shields), self._density)
            attributes = np.column_stack([texels, self._shading(index, places)])
            albedo = self._albedo(index)[..., None]
            draw_mesh(grey[..., None], depth, samples, attributes, self._mesh.triangles, albedo)
            average_samples(picture, covered, grey, depth, SAMPLES, left, top)
        return picture, covered


face = FaceScene


def _poses(scene: FaceScene) -> Poses:
    generator = np.random.default_rng([scene.seed, 2])
    manner = MANNERS[scene.motion]
    width, height = scene.size
    pace = np.exp(0.45 * np.tanh(wander(scene._times, (1.5, 6.0), generator)))
    own_times = np.concatenate([[0.0], np.cumsum(pace[:-1]) * scene.dt])
    beginning = np.tanh(own_times) ** 2  # the first second

    def from_start(periods: tuple[float, float]) -> Numbers:
        wandered: Numbers = beginning * wander(own_times, periods, generator)
        return wandered

    yaw, pitch, roll = (
        np.radians(most) * np.tanh(1.2 * from_start(manner.head))
        for most in (scene.max_yaw, MAX_PITCH, MAX_ROLL)
    )
    zero = np.zeros_like(yaw)
    turn, nod, tilt = (
        exponential(np.stack(vector, axis=1))
        for vector in ((zero, yaw, zero), (pitch, zero, zero), (zero, zero, roll))
    )
    rotations = tilt @ nod @ turn
    sizes = SIZE * height * (1 + 0.08 * np.tanh(from_start(manner.head)))
    travel = np.stack([reach * from_start(manner.travel) for reach in manner.reach], axis=1)
    # the head turns about the neck, not about the origin, and so swings to the side
    swing = NECK[:2] - (rotations @ NECK)[:, :2]
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    translations = middle + sizes[:, None] * (swing + travel)
    morphs = np.zeros((scene.n_frames, scene.model.n_bases))
    morphs[:, 0] = 1
    for number in range(1, scene.model.n_bases):
        strength = manner.liveliness * from_start(manner.expression)
        morphs[:, number] = MOST * np.tanh(strength / MOST)
    morphs[:, 1] += JAW * beginning
    return Poses(rotations, translations, morphs * sizes[:, None])
