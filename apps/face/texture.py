"""The texture of a tracked face as a picture, and vertices that are spread over its surface."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...chains.face.gflow import GFlow, GFlowState
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.face.surface import SurfaceTexels, visible
from ...models.numerics.rotations import exponential
from ..io.files import write_image

Numbers = NDArray[np.float64]
Image = NDArray[np.uint8]

TEXTURE_HEIGHT = 480  # px
FRONT = np.zeros((1, 3))
"""Rotation vector, rad."""

SUREST = 0.01
"""Squared grey levels below which variances of texels are not told apart (of a template it is 0)."""


def distant_vertices(shape: Numbers, most: int) -> NDArray[np.int64]:
    """Return up to so many of the vertices `(n_vertices, 3)`, each farthest from those before it."""
    if len(shape) <= most:
        return np.arange(len(shape), dtype=np.int64)
    chosen = [int(np.argmin(shape[:, 2]))]
    distance = np.full(len(shape), np.inf)
    for _ in range(most - 1):
        distance = np.minimum(distance, ((shape - shape[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen, np.int64)


def _places(texels: SurfaceTexels, vertices: Numbers) -> Numbers:
    """`(n_texels, n)`: texels as weighted means of `vertices` `(n_vertices, n)`."""
    corners = vertices[texels.groups[texels.group_of_texel]]
    places: Numbers = np.einsum("ta,tac->tc", texels.weights, corners)
    return places


def texture_picture(
    model: MorphableModel, morphs: Numbers, texels: SurfaceTexels, values: Numbers
) -> Numbers:
    """Render a texture `values (n_texels,)` on a shape of `morphs (n_bases,)` px, seen from the front.

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


def vertices_on_texture(model: MorphableModel, morphs: Numbers, texels: SurfaceTexels) -> Numbers:
    """Return where vertices are on a picture of `texture_picture`, `(n_vertices, 2)` px."""
    positions, _, places = _from_the_front(model, morphs, texels)
    low, _, px = _picture_of(places)
    on_texture: Numbers = (positions[:, :2] - low) / px
    return on_texture


def _from_the_front(
    model: MorphableModel, morphs: Numbers, texels: SurfaceTexels
) -> tuple[Numbers, NDArray[np.bool_], Numbers]:
    """Vertices `(n_vertices, 3)`, which texels are seen, and the places `(n_seen, 2)` of these, px."""
    frontal = Poses(exponential(FRONT), np.zeros((1, 2)), morphs[None])
    positions = model.positions(frontal)
    shown = visible(positions, model.triangles, texels)[0]
    return positions[0], shown, (_places(texels, positions[0, :, :2]) + texels.offsets)[shown]


def _picture_of(places: Numbers) -> tuple[Numbers, Numbers, float]:
    """Corners of the picture of texels at `places` `(n, 2)`, and the side of its pixels."""
    low, high = places.min(axis=0), places.max(axis=0)
    return low, high, float((high - low)[1]) / TEXTURE_HEIGHT


def write_textures(folder: Path, chain: GFlow, state: GFlowState) -> tuple[float, dict[str, Image]]:
    """Write texture and variance of the most probable expert as pictures, on the mean shape from the front.

    Returns
    -------
    tuple
        the variance (squared grey levels) that is white, and the pictures by their captions.
    """
    best = int(np.argmax(state.weights))
    morphs = chain.mean_pose(state).morphs[0]
    mean, variance = (
        texture_picture(chain.model, morphs, chain.object.texels, values)
        for values in (state.texture.mean[best, 0], state.texture.variance[best])
    )
    # some texels are thousands of times less sure than others: a scale of logs shows both
    variance = np.maximum(variance, SUREST)
    black, white = float(np.nanmin(variance)), float(np.nanmax(variance))
    pictures = [_grey(mean, 255.0), _grey(np.log(variance / black), float(np.log(white / black)))]
    for name, picture in zip(("texture.png", "texture_variance.png"), pictures, strict=True):
        write_image(folder / name, picture)
    captions = ("mean", f"variance, {black:.3g} (black) to {white:.3g} squared grey levels, on a log scale")
    return white, dict(zip(captions, pictures, strict=True))


def _grey(values: Numbers, highest: float) -> Image:
    """A picture of values from 0 (black) to `highest` (white); black where there is none."""
    shades = np.clip(255 * values / max(highest, 1e-12), 0, 255)
    return np.rint(np.nan_to_num(shades)).astype(np.uint8)
