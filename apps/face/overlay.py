"""A tracked face as pictures: on its frames, as Fig. 4 of the G-flow paper shows it, and its texture."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import Poses
from ...models.face.surface_texels import SurfaceTexels
from ...models.face.visibility import front_triangles, visible
from ...models.numerics.rotations import exponential
from ..drawing.boxes import draw_overlay
from ..drawing.overlay_video import enlargement

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LEAST_HEIGHT = (
    480  # px; smaller frames are enlarged, so that the shape's views beside the face can be made out
)
MOST_DOTS = 80  # of an expert: the whole mesh of a fine model would hide the face
PANEL_WIDTH = 0.32  # of the picture's height
VIEWS = 0.4, 0.4, 0.2  # of the panel's height: from the front, from the side, axes
ROOM = 1.1  # a view's sides, by those of the typical shape
FACES_OF_DOTS = 110.0  # radii of a dot that the height of the face has, so that dots of one vertex stay apart
TEXTURE_HEIGHT = 480

DOT = (40, 240, 255)  # BGR; bright in a dark rim: one of them stands out from any skin
LANDMARK = (255, 200, 0)
RIM = (20, 20, 20)
LOST = (40, 40, 255)
PANEL = (45, 45, 45)
AXES = (((80, 80, 255), (1, 0, 0)), ((80, 220, 80), (0, -1, 0)), ((255, 150, 60), (0, 0, -1)))
"""Colour and direction, in the object's axes: to the right, up, and to where the face looks."""
SKIN = np.array([150.0, 175.0, 215.0])
LIGHT = np.array([-0.35, -0.45, -0.82])  # from the upper left, in front
FRONT = np.zeros((1, 3))
PROFILE = np.array([[0.0, np.pi / 2, 0.0]])


@dataclass(frozen=True, eq=False)
class TrackedFace:
    """What is known of the face in a frame.

    Parameters
    ----------
    experts
        all hypotheses.
    mean
        one pose: their mean.
    landmarks
        `(n_landmarks, 2)` px, NaN where there is none.
    lost
        whether the tracker says that it has lost the face.
    """

    experts: Poses
    mean: Poses
    landmarks: Array
    lost: bool


class FaceOverlay:
    """Draws tracked faces.

    Yellow dots are vertices of all experts (of a fine model, some that are spread evenly), light blue ones
    the landmarks. The mean is shown beside the picture, where it hides nothing: its shape from the front and
    from the side, and its axes.

    Parameters
    ----------
    model
        of the face.
    """

    def __init__(self, model: MorphableModel) -> None:
        self._model = model
        self._dots = spread_vertices(model.bases[0], MOST_DOTS)
        low, high = model.bases[0].min(axis=0), model.bases[0].max(axis=0)
        self._middle, self._sides = (low + high) / 2, ROOM * (high - low)

    def draw(self, image: Image, face: TrackedFace, caption: str) -> Image:
        """Draw a face on a copy of its frame.

        Parameters
        ----------
        image
            `(height, width)` or `(height, width, 3)` BGR.
        face
            what is known of it.
        caption
            text in the upper left corner.

        Returns
        -------
        NDArray[np.uint8]
            `(height, wider, 3)` BGR, enlarged by a whole number below 480 lines.
        """
        scale = enlargement(image, LEAST_HEIGHT)
        large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        canvas: NDArray[Any] = draw_overlay(np.asarray(large, np.uint8), None, (), {}, caption)
        unit = canvas.shape[0] / LEAST_HEIGHT
        mean = scale * self._model.project(face.mean)[0]
        radius = float(np.clip(np.ptp(mean[:, 1]) / FACES_OF_DOTS, 0.6 * unit, 2 * unit))
        dots = self._model.project(face.experts)[:, self._dots].reshape(-1, 2)
        # the larger dots below the smaller ones: landmarks may be vertices of the model
        _draw_dots(canvas, (face.landmarks + 0.5) * scale - 0.5, LANDMARK, 1.7 * radius, unit)
        _draw_dots(canvas, (dots + 0.5) * scale - 0.5, DOT, radius, unit)
        if face.lost:
            size, thickness = 1.6 * unit, max(2, round(4 * unit))
            (width, height), _ = cv2.getTextSize("LOST", cv2.FONT_HERSHEY_SIMPLEX, size, thickness)
            corner = ((canvas.shape[1] - width) // 2, 2 * height)
            cv2.putText(canvas, "LOST", corner, cv2.FONT_HERSHEY_SIMPLEX, size, LOST, thickness, cv2.LINE_AA)
        return np.hstack([np.asarray(canvas, np.uint8), self._panel(face.mean, canvas.shape[0])])

    def view(self, morphs: Array, turn: Array, height: int) -> tuple[Image, NDArray[np.bool_]]:
        """A shape by itself, shaded.

        Parameters
        ----------
        morphs
            `(n_bases,)` px; its size does not matter.
        turn
            `(1, 3)` rad: the rotation vector by which it is turned.
        height
            px.

        Returns
        -------
        tuple
            picture `(height, width, 3)` BGR, and where in it the shape is, `(height, width)`.
        """
        pose = Poses(exponential(turn), np.zeros((1, 2)), morphs[None] / morphs[0])
        sides = np.abs(pose.rotations[0]) @ self._sides
        px = sides[1] / height
        size = np.array([max(1, round(sides[0] / px)), height])
        vertices = self._model.positions(pose)[0] - pose.rotations[0] @ self._middle
        a, b, c = (vertices[self._model.triangles[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
        # the back of an open surface is shown as well, in the shade
        brightness = 0.35 + 0.65 * np.clip(normals @ LIGHT / lengths, 0, 1)
        places = vertices / px
        places[:, :2] += (size - 1) / 2
        seen = front_triangles(places, self._model.triangles, (int(size[0]), height))
        shades = np.vstack([brightness[:, None] * SKIN, np.zeros(3)]).astype(np.uint8)
        return shades[seen], seen >= 0

    def _panel(self, mean: Poses, height: int) -> Image:
        """The mean by itself: `(height, width, 3)` BGR."""
        width = round(PANEL_WIDTH * height)
        panel: NDArray[Any] = np.full((height, width, 3), PANEL, np.uint8)
        top = 0.0
        for turn, share in zip((FRONT, PROFILE), VIEWS, strict=False):
            sides = np.abs(exponential(turn)[0]) @ self._sides
            tall = max(1, int(min(share * height, width * sides[1] / sides[0])))
            picture, covered = self.view(mean.morphs[0], turn, tall)
            covered = covered[:, :width]
            row, column = round(top + (share * height - tall) / 2), (width - covered.shape[1]) // 2
            panel[row : row + tall, column : column + covered.shape[1]][covered] = picture[:, :width][covered]
            top += share * height
        _draw_axes(panel, mean.rotations[0], top, VIEWS[2] * height)
        return np.asarray(panel, np.uint8)


def spread_vertices(shape: Array, most: int) -> NDArray[np.int64]:
    """At most so many of the vertices `(n_vertices, 3)`, each as far as can be from those before it."""
    if len(shape) <= most:
        return np.arange(len(shape), dtype=np.int64)
    chosen = [int(np.argmin(shape[:, 2]))]
    distance = np.full(len(shape), np.inf)
    for _ in range(most - 1):
        distance = np.minimum(distance, ((shape - shape[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen, np.int64)


def _places(texels: SurfaceTexels, vertices: Array) -> Array:
    """`(n_texels, n)`: texels as weighted means of `vertices` `(n_vertices, n)`."""
    corners = vertices[texels.groups[texels.group_of_texel]]
    places: Array = np.einsum("ta,tac->tc", texels.weights, corners)
    return places


def _draw_dots(
    canvas: NDArray[Any], places: Array, colour: tuple[int, int, int], radius: float, rim: float
) -> None:
    """Draw a dot with a rim (px) at every place `(n, 2)` that is known; no rim covers another dot."""
    _fill_discs(canvas, places, RIM, radius + rim)
    _fill_discs(canvas, places, colour, radius)


def _fill_discs(canvas: NDArray[Any], places: Array, colour: tuple[int, int, int], radius: float) -> None:
    """Set the pixels within a radius (px) of every place `(n, 2)` that is known."""
    height, width = canvas.shape[:2]
    reach = np.arange(-int(radius) - 1, int(radius) + 2)
    down, across = (offsets.ravel() for offsets in np.meshgrid(reach, reach, indexing="ij"))
    within = np.hypot(down, across) <= radius
    # far outside, whole numbers would overflow
    known = (np.abs(places) < 10 * max(height, width)).all(axis=1)
    columns, rows = np.rint(places[known]).astype(np.int64).T[..., None]
    rows, columns = (rows + down[within]).ravel(), (columns + across[within]).ravel()
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    canvas[rows[inside], columns[inside]] = colour


def _draw_axes(panel: NDArray[Any], rotation: Array, top: float, height: float) -> None:
    """Draw the object's axes into the rows of a panel that begin at `top`."""
    centre, length = np.array([panel.shape[1] / 2, top + height / 2]), 0.45 * height
    thickness = max(2, round(panel.shape[0] / 240))
    tips = [(rotation @ direction, colour) for colour, direction in AXES]
    for tip, colour in sorted(tips, key=lambda each: -each[0][2]):  # the nearest above the others
        start, end = (
            tuple(np.rint(place).astype(int).tolist()) for place in (centre, centre + length * tip[:2])
        )
        cv2.arrowedLine(panel, start, end, RIM, thickness + 2, cv2.LINE_AA, tipLength=0.2)
        cv2.arrowedLine(panel, start, end, colour, thickness, cv2.LINE_AA, tipLength=0.2)


def texture_picture(model: MorphableModel, morphs: Array, texels: SurfaceTexels, values: Array) -> Array:
    """A texture on its shape, seen from the front.

    Parameters
    ----------
    model
        of the face.
    morphs
        `(n_bases,)` px, of its shape.
    texels
        where the texture's elements are.
    values
        `(n_texels,)`.

    Returns
    -------
    NDArray[np.float64]
        `(480, width)`: mean of the values round each pixel; NaN where there is no texel near.
    """
    _, shown, places = _from_the_front(model, morphs, texels)
    low, high, px = _picture_of(places)
    shape = (TEXTURE_HEIGHT, max(1, round(float((high - low)[0]) / px)))
    rows, columns = np.indices(shape)
    tree = KDTree(places)
    spacing = float(np.median(np.asarray(tree.query(places, 2)[0])[:, 1]))
    pixels = np.stack([columns, rows], axis=2) * px + low
    distance, nearest = tree.query(pixels, 4, distance_upper_bound=2.5 * spacing)
    weights = np.exp(-0.5 * (distance / (0.6 * spacing)) ** 2)  # 0 beyond the bound, where it is infinite
    total = weights.sum(axis=2)
    known = np.append(values[shown].astype(np.float64), 0.0)  # the last one stands for "none near"
    return np.where(total > 0, (weights * known[nearest]).sum(axis=2) / np.maximum(total, 1e-300), np.nan)


def vertices_on_texture(model: MorphableModel, morphs: Array, texels: SurfaceTexels) -> Array:
    """`(n_vertices, 2)` px: where vertices are on a picture of `texture_picture`."""
    positions, _, places = _from_the_front(model, morphs, texels)
    low, _, px = _picture_of(places)
    on_texture: Array = (positions[:, :2] - low) / px
    return on_texture


def _from_the_front(
    model: MorphableModel, morphs: Array, texels: SurfaceTexels
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Vertices `(n_vertices, 3)`, which texels are seen, and the places `(n_seen, 2)` of these, px."""
    frontal = Poses(exponential(FRONT), np.zeros((1, 2)), morphs[None])
    positions = model.positions(frontal)
    shown = visible(positions, model.triangles, texels)[0]
    return positions[0], shown, (_places(texels, positions[0, :, :2]) + texels.offsets)[shown]


def _picture_of(places: Array) -> tuple[Array, Array, float]:
    """Corners of the picture of texels at `places` `(n, 2)`, and the side of its pixels."""
    low, high = places.min(axis=0), places.max(axis=0)
    return low, high, float((high - low)[1]) / TEXTURE_HEIGHT
