"""A textured body that turns on black before a perspective camera: pictures far apart, known geometry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Count, CountFrom0, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from .random_fields import mottle
from .rendering_kernels import EMPTY_DEPTH, average_samples, draw_mesh

Numbers = NDArray[np.float64]

TILT = 25.0  # degrees by which the camera looks down on the upright axis

DISTANCE, FOCAL = 16.0, 4.8
"""Of the camera from the axis, in radii of the body; focal length in heights of the picture."""

BUMPS = 0.1  # standard deviation of the body's radius, as a share of it
AROUND, DOWN = 480, 240  # vertices of the mesh around the axis and from pole to pole
SAMPLES = 2  # samples a pixel, along either side
NOISE = 1.5  # grey levels, standard deviation of the camera's noise

AMBIENT = 0.35
"""Share of the light that comes from everywhere; the rest comes from the left above, and does not turn."""


@short_repr
@dataclass(frozen=True, eq=False)
class Turntable:
    """Images of a rotating object; build it with `turntable`.

    Lengths are in radii of the object; axes are those of the image: x right, y down, z away.

    Parameters
    ----------
    images
        `(n_frames, height, width)` uint8.
    depth
        `(n_frames, height, width)` float32, depth along z from the camera at the centre of each pixel;
        infinite in the black background.
    rotations, translation
        `(n_frames, 3, 3)` and `(3,)`: a point X of the body is at `rotations[t] @ X + translation` from the
        camera.
    focal
        px; the principal point is the picture's middle.
    """

    images: NDArray[np.uint8]
    depth: NDArray[np.float32]
    rotations: Numbers
    translation: Numbers
    focal: float

    def frames(self) -> list[Frame]:
        """The film, 25 pictures a second."""
        return [Frame(image, number / 25, number + 1) for number, image in enumerate(self.images)]


@checked
def turntable(
    n_frames: Count = 36,
    size: tuple[Count, Count] = (576, 720),
    degrees_per_frame: float = 10.0,
    seed: CountFrom0 = 0,
) -> Turntable:
    """Make images of a bumpy, mottled object that rotates under a fixed light.

    Parameters
    ----------
    n_frames
        how many pictures.
    size
        `(height, width)` px of them.
    degrees_per_frame
        rotation about the vertical axis.
    seed
        of all random numbers.
    """
    generator = np.random.default_rng(seed)
    body, normals, texel = _body(generator)
    albedo = 0.5 + 0.12 * mottle((1024, 2048), 60.0, 1.5, generator)
    texture = np.ascontiguousarray(np.clip(albedo, 0.08, 1.0)[..., None] * np.float32(255))
    triangles = _triangles()
    height, width = size
    focal = FOCAL * height
    tilt = np.radians(TILT)
    down = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    translation = np.array([0, 0, DISTANCE])
    light, middle = np.array([-0.5, -0.6, -0.62]), np.array([(width - 1) / 2, (height - 1) / 2])
    film = Turntable(
        np.zeros((n_frames, height, width), np.uint8),
        np.full((n_frames, height, width), np.inf, np.float32),
        np.stack([down @ _about_y(np.radians(degrees_per_frame * t)) for t in range(n_frames)]),
        translation,
        focal,
    )
    for t, rotation in enumerate(film.rotations):
        points = body @ rotation.T + translation
        # sample s of a pixel has its middle at (s + 0.5) / SAMPLES - 0.5 px
        places = np.column_stack(
            [(focal * points[:, :2] / points[:, 2:] + middle + 0.5) * SAMPLES - 0.5, points[:, 2]]
        )
        shade = AMBIENT + (1 - AMBIENT) * np.maximum(normals @ rotation.T @ light, 0) / np.linalg.norm(light)
        shown = np.zeros((height * SAMPLES, width * SAMPLES), np.float32)
        depth = np.full(shown.shape, EMPTY_DEPTH, np.float32)
        draw_mesh(shown[..., None], depth, places, np.column_stack([texel, shade]), triangles, texture)
        picture, covered = np.zeros((2, height, width), np.float32)
        average_samples(picture, covered, shown, depth, SAMPLES, 0, 0)
        picture += np.float32(NOISE) * generator.standard_normal(size, np.float32)
        film.images[t] = np.clip(np.rint(picture), 0, 255)
        middles = depth.reshape(height, SAMPLES, width, SAMPLES)
        film.depth[t] = np.where(covered >= 1, middles.mean(axis=(1, 3)), np.inf)
    return film


def _body(generator: np.random.Generator) -> tuple[Numbers, Numbers, Numbers]:
    """Vertices `(n, 3)`, their normals, and their places `(n, 2)` in the texture."""
    around = np.linspace(0, 2 * np.pi, AROUND + 1)
    down = np.linspace(0, np.pi, DOWN)
    bumps = mottle((DOWN, AROUND), 60.0, 9.0, generator).astype(np.float64)
    # poles are points: bumps fade towards them, and the seam is closed
    radius = 1 + BUMPS * np.sin(down)[:, None] * np.concatenate([bumps, bumps[:, :1]], axis=1)
    sine, cosine = np.sin(down)[:, None], np.cos(down)[:, None]
    body = radius[..., None] * np.stack(
        [sine * np.cos(around), -cosine * np.ones_like(around), sine * np.sin(around)], axis=-1
    )
    normals = np.cross(np.gradient(body, axis=1), np.gradient(body, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    normals *= np.sign((normals * body).sum(axis=-1, keepdims=True))
    rows, columns = np.meshgrid(np.linspace(0, 1023, DOWN), np.linspace(0, 2047, AROUND + 1), indexing="ij")
    return body.reshape(-1, 3), normals.reshape(-1, 3), np.stack([columns, rows], -1).reshape(-1, 2)


def _triangles() -> NDArray[np.int64]:
    first = (np.arange(DOWN - 1)[:, None] * (AROUND + 1) + np.arange(AROUND)).reshape(-1)
    below = first + AROUND + 1
    return np.concatenate(
        [np.stack([first, first + 1, below], axis=1), np.stack([first + 1, below + 1, below], axis=1)]
    )


def _about_y(angle: float) -> Numbers:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
