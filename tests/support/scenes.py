"""What is known of generated scenes beyond what they say themselves."""

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.scenes import FaceScene, Turntable

Array = NDArray[np.float64]


def visible(scene: FaceScene, index: int) -> NDArray[np.bool_]:
    """Vertices of the model that are in picture `index` and not hidden, without a grid of pixels.

    A vertex is seen if a triangle at it faces the viewer, and no triangle that it is not part of is in front.
    """
    places, triangles = scene._mesh.positions(scene.poses[index])[0], scene._mesh.triangles
    vertices = np.arange(scene.model.n_vertices)
    corners = places[triangles][None] - places[vertices][:, None, None] * [
        1,
        1,
        0,
    ]
    x, y, z = np.moveaxis(corners, -1, 0)
    shares = np.stack(
        [x[..., b] * y[..., c] - y[..., b] * x[..., c] for b, c in ((1, 2), (2, 0), (0, 1))], -1
    )
    area = shares.sum(axis=-1)
    own = (triangles[None] == vertices[:, None, None]).any(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (shares * z).sum(axis=-1) / area
    covers = ~own & (area != 0) & (shares * area[..., None] >= 0).all(axis=-1)
    hidden = (covers & (depth < places[vertices, 2][:, None])).any(axis=1)
    seen: NDArray[np.bool_] = (own & (area < 0)).any(axis=1) & ~hidden
    inside = (scene.vertices[index] > -0.5) & (scene.vertices[index] < np.array(scene.size) - 0.5)
    return seen & inside.all(axis=-1)


def transferred(film: Turntable, positions: Array, one: int, other: int) -> Array:
    """Where `other` has, or would have behind something, what `one` shows at `positions` `(n, 2)` px.

    Not finite where there is nothing at the pixel.
    """
    column, row = np.rint(positions).astype(int).T
    depth = film.depth[one, row, column].astype(np.float64)[:, None]
    middle = (np.array(film.images.shape[:0:-1]) - 1) / 2
    with np.errstate(invalid="ignore"):
        seen = np.concatenate([(positions - middle) / film.focal, np.ones((len(positions), 1))], 1)
        body = (seen * depth - film.translation) @ film.rotations[one]
        points = body @ film.rotations[other].T + film.translation
        return film.focal * points[:, :2] / points[:, 2:] + middle
