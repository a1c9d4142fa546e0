"""Built-in face model: one smooth surface with five expressions, sampled at any fineness.

The surface is the front of an ellipsoid with brow ridge, eye sockets, nose, lips and chin as Gaussian bumps,
a height field over the frontal plane, so that it never intersects itself. Lengths in this file are in half
heights of the head; `face_model` scales them. All numbers are by eye, after proportions of adults.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Count, checked
from .morphable_model import MorphableModel

Array = NDArray[np.float64]

HALF_WIDTH, HALF_HEIGHT, DEPTH = 0.78, 1.0, 0.85
RIM = np.radians(80.0)  # between the gaze and the normal where the surface ends, short of the ears

# where vertices of the right half of the picture are put, (x, y) in front view; the left half mirrors it
MIDDLE = {
    "forehead": (0.0, -0.75),
    "brow": (0.0, -0.53),
    "glabella": (0.0, -0.36),
    "nasion": (0.0, -0.19),
    "nose ridge": (0.0, -0.03),
    "nose tip": (0.0, 0.11),
    "nose base": (0.0, 0.23),
    "upper lip": (0.0, 0.385),
    "mouth": (0.0, 0.47),
    "lower lip": (0.0, 0.56),
    "chin groove": (0.0, 0.68),
    "chin": (0.0, 0.82),
}
SIDE = {
    "inner brow": (0.12, -0.33),
    "middle brow": (0.30, -0.38),
    "outer brow": (0.48, -0.31),
    "inner eye": (0.15, -0.14),
    "upper lid": (0.29, -0.20),
    "lower lid": (0.29, -0.08),
    "outer eye": (0.42, -0.13),
    "nose flank": (0.085, -0.02),
    "nose side": (0.07, 0.12),
    "nose wing": (0.14, 0.18),
    "nostril": (0.065, 0.23),
    "upper lip side": (0.11, 0.39),
    "mouth side": (0.12, 0.47),
    "lower lip side": (0.11, 0.555),
    "mouth corner": (0.25, 0.47),
    "chin groove side": (0.15, 0.69),
    "chin side": (0.16, 0.83),
    "under the eye": (0.23, 0.04),
    "cheek bone": (0.42, 0.04),
    "cheek": (0.30, 0.20),
    "outer cheek": (0.48, 0.21),
    "cheek fold": (0.24, 0.32),
    "jaw muscle": (0.40, 0.42),
    "jaw": (0.31, 0.62),
    "inner forehead": (0.19, -0.55),
    "outer forehead": (0.40, -0.58),
    "hair line": (0.21, -0.77),
}
INNER_RING = (np.radians(58.0), np.radians([-48, -28, -10, 6, 22, 38, 58]))
OUTER_RING = (RIM, np.radians([-72, -54, -36, -19, -4, 10, 25, 40, 56, 73]))

# bumps (x, y, width in x, width in y, height towards the viewer)
RELIEF = np.array(
    [
        (0.27, -0.33, 0.20, 0.08, 0.045),  # brow ridge
        (0.29, -0.14, 0.13, 0.09, -0.085),  # eye socket
        (0.40, 0.12, 0.15, 0.15, 0.04),  # cheek bone
        (0.0, 0.48, 0.17, 0.085, 0.065),  # lips
        (0.0, 0.68, 0.15, 0.05, -0.025),  # groove
        (0.0, 0.83, 0.15, 0.10, 0.07),  # chin
        (0.0, 0.12, 0.105, 0.075, 0.20),  # tip of the nose
        (0.0, -0.04, 0.075, 0.13, 0.13),  # bridge
    ]
)

# middle of the right one of two shields, half a half height off the cheek
SHIELD = np.array([0.42, 0.18, -1.35])
SHIELD_RADIUS = 0.27
SHIELD_IN_PLANE, SHIELD_RADIUS_IN_PLANE = np.array([0.93, 1.21]), 0.14  # beyond the rim, in a corner

EXPRESSIONS = ("jaw opens", "smile", "brows rise", "pucker", "mouth aside")


@checked
def face_model(fineness: Count = 1, *, shields: bool = False) -> MorphableModel:
    """Return the built-in model: 102 vertices, 180 triangles, a typical shape and five expressions.

    Its origin is the centroid of the typical shape.

    Parameters
    ----------
    fineness
        number of parts of every edge, 1 or more. The surface stays the same: vertices of the coarse mesh come
        first, unchanged, and the new ones lie on the smooth surface, not on the coarse triangles. The scale
        is that of the coarse mesh.
    shields
        whether to add two round flat shields in front of the cheeks, which move with the head and occlude
        another part from every side: 18 vertices and 16 triangles more.

    Raises
    ------
    ValueError
        if `fineness` is below 1.
    """

    plane, (origin, scale) = face_plane(fineness, shields=shields), _frame()
    typical = _typical(plane) - origin
    bases = np.concatenate([typical[None], _expressions(plane)]) / scale
    return MorphableModel(bases, _refined(fineness, shields)[1].copy(), names=("typical", *EXPRESSIONS))


def face_plane(fineness: int = 1, *, shields: bool = False) -> Array:
    """Return texture coordinates of the vertices of `face_model(...)`, `(n_vertices, 2)`.

    The unrolled surface: directions from the middle are kept and arcs of the ellipsoid become lengths, in
    half heights of the head, x right and y down.
    """
    weights, _ = _refined(fineness, shields)
    plane: Array = weights @ _coarse_mesh(shields)[0]
    return plane


def unit_length() -> float:
    """Return the unit of `face_plane`, a half height of the head, in px for c_1 = 1 px."""
    return 1 / _frame()[1]


def front_view(plane: Array) -> Array:
    """Return the front view, before relief, of points of the plane `(n, 2)`."""
    across = plane / (HALF_WIDTH, HALF_HEIGHT)
    angle = np.linalg.norm(across, axis=-1, keepdims=True)
    seen: Array = plane * np.sinc(angle / np.pi)
    return seen


def _from_front(seen: Array) -> Array:
    """Inverse of `front_view`."""
    sine = np.linalg.norm(seen / (HALF_WIDTH, HALF_HEIGHT), axis=-1, keepdims=True)
    plane: Array = seen / np.sinc(np.arcsin(sine) / np.pi)
    return plane


@cache
def _coarse_mesh(shields: bool) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices in the plane `(n, 2)` and triangles `(n, 3)` in the order of `MorphableModel`."""
    from scipy.spatial import Delaunay

    mirror = np.array([-1.0, 1.0])
    right = _from_front(np.array(list(SIDE.values())))
    middle = _from_front(np.array(list(MIDDLE.values())))
    rings = []
    for angle, directions in (INNER_RING, OUTER_RING):
        around = np.stack([np.cos(directions), np.sin(directions)], axis=1)
        rings.append(angle * around * (HALF_WIDTH, HALF_HEIGHT))
    ring = np.concatenate(rings)
    ends = RIM * HALF_HEIGHT * np.array([(0.0, -1.0), (0.0, 1.0)])
    plane = np.concatenate([middle, right, right * mirror, ring, ring * mirror, ends])
    triangles = Delaunay(plane).simplices.astype(np.int64)
    first, second = (plane[triangles[:, corner]] - plane[triangles[:, 0]] for corner in (1, 2))
    turns = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles[turns > 0] = triangles[turns > 0][:, [0, 2, 1]]  # normals of what the viewer sees have z < 0
    if not shields:
        return plane, triangles
    turn = np.arange(8) * np.pi / 4
    disc = np.concatenate([np.zeros((1, 2)), np.stack([np.cos(turn), -np.sin(turn)], axis=1)])
    fan = np.stack([np.zeros(8, np.int64), np.arange(1, 9), np.roll(np.arange(1, 9), -1)], axis=1)
    for side in (1, -1):
        triangles = np.concatenate([triangles, len(plane) + fan])
        middle = SHIELD_IN_PLANE * (side, 1)
        plane = np.concatenate([plane, middle + SHIELD_RADIUS_IN_PLANE * disc])
    return plane, triangles


@cache
def _refined(fineness: int, shields: bool) -> tuple[Array, NDArray[np.int64]]:
    """Return coarse vertices' weights in each vertex `(n, n_coarse)`, and triangles."""
    plane, coarse = _coarse_mesh(shields)
    steps = fineness + 1
    corners = np.array([(a, b, fineness - a - b) for a in range(steps) for b in range(steps - a)])
    # a vertex is identified by its coarse vertices and their shares; a missing share counts as -1, so that
    # sorting puts the coarse vertices themselves first
    keys = np.where(corners > 0, coarse[:, None, :] * steps + corners, -1)
    unique, numbers = np.unique(np.sort(keys.reshape(-1, 3), axis=1), axis=0, return_inverse=True)
    numbers = numbers.reshape(len(coarse), len(corners))
    shares = np.zeros((len(unique), len(plane)))
    for column in unique.T:
        has = np.flatnonzero(column >= 0)
        shares[has, column[has] // steps] = column[has] % steps / fineness
    place = {(a, b): number for number, (a, b, _) in enumerate(corners.tolist())}
    upright = [(place[a + 1, b], place[a, b + 1], place[a, b]) for a, b in place if a + b < fineness]
    turned = [(place[a - 1, b], place[a, b - 1], place[a, b]) for a, b in place if a > 0 and b > 0]
    cut = np.array(upright + turned)
    triangles = numbers[:, cut].reshape(-1, 3).astype(np.int64)
    return shares, triangles


@cache
def _frame() -> tuple[Array, float]:
    """Return centroid and root mean square distance from it in front view, of the coarse mesh."""
    typical = _typical(face_plane())
    origin = typical.mean(axis=0)
    return origin, float(np.sqrt(((typical - origin)[:, :2] ** 2).sum(axis=1).mean()))


def _bumps(seen: Array, bumps: Array) -> Array:
    """Return the height of the bumps at points `(n, 2)` of the front view, mirrored unless in the middle."""
    height = np.zeros(len(seen))
    for x, y, width, length, top in bumps:
        for side in (x, -x) if x > 0 else (x,):
            away = ((seen[:, 0] - side) / width) ** 2 + ((seen[:, 1] - y) / length) ** 2
            height += top * np.exp(-0.5 * away)
    return height


def _step(x: Array) -> Array:
    """Return a smooth step from 0 to 1 over a few units around 0."""
    step: Array = 0.5 * (1 + np.tanh(x))
    return step


def _on_right_side(plane: Array) -> Array:
    """Mirror the points `(n, 2)` of the left half."""
    return np.stack([np.abs(plane[:, 0]), plane[:, 1]], axis=1)


def on_shield(plane: Array) -> NDArray[np.bool_]:
    """Return which points `(n, 2)` of the plane belong to a shield."""
    away = np.linalg.norm(_on_right_side(plane) - SHIELD_IN_PLANE, axis=1)
    on: NDArray[np.bool_] = away < 1.01 * SHIELD_RADIUS_IN_PLANE
    return on


def _typical(plane: Array) -> Array:
    """Return the face at rest `(n, 3)`."""
    seen = front_view(plane)
    angle = np.linalg.norm(plane / (HALF_WIDTH, HALF_HEIGHT), axis=1)
    z = -DEPTH * np.cos(angle) - _bumps(seen, RELIEF)
    narrowed = seen[:, 0] * (1 - 0.16 * _step((seen[:, 1] - 0.5) / 0.3))  # towards the chin
    typical = np.stack([narrowed, seen[:, 1], z], axis=1)
    on = on_shield(plane)
    from_middle = (_on_right_side(plane[on]) - SHIELD_IN_PLANE) * SHIELD_RADIUS / SHIELD_RADIUS_IN_PLANE
    typical[on] = SHIELD
    typical[on, :2] += from_middle
    typical[on, 0] *= np.sign(plane[on, 0])
    return typical


def _expressions(plane: Array) -> Array:
    """Return the motion of the surface for one standard deviation of each expression, `(5, n, 3)`."""
    x, y = front_view(plane).T

    def near(middle: float, height: float, width: float, length: float) -> Array:
        share: Array = np.exp(-0.5 * (((x - middle) / width) ** 2 + ((y - height) / length) ** 2))
        return share

    moves = np.zeros((len(EXPRESSIONS), len(plane), 3))
    jaw, smile, brows, pucker, aside = moves
    falls = 0.085 * _step((y - 0.53) / 0.14) * np.exp(-0.5 * (x / 0.5) ** 2)
    jaw[:, 1], jaw[:, 2] = falls, 0.4 * falls
    corner_right, corner_left = near(0.25, 0.45, 0.13, 0.12), near(-0.25, 0.45, 0.13, 0.12)
    cheeks = near(0.36, 0.2, 0.14, 0.12) + near(-0.36, 0.2, 0.14, 0.12)
    smile[:, 0] = 0.05 * (corner_right - corner_left)
    smile[:, 1] = -0.04 * (corner_right + corner_left) - 0.02 * cheeks
    smile[:, 2] = 0.025 * (corner_right + corner_left) - 0.02 * cheeks
    brows[:, 1] = -0.055 * (near(0.28, -0.36, 0.2, 0.13) + near(-0.28, -0.36, 0.2, 0.13))
    lips = near(0.0, 0.47, 0.24, 0.14)
    pucker[:, 0], pucker[:, 2] = -0.18 * x * lips, -0.07 * lips
    pushed = near(0.0, 0.52, 0.25, 0.2)
    aside[:, 0], aside[:, 2] = 0.05 * pushed, 0.05 * x / 0.25 * pushed
    moves[:, on_shield(plane)] = 0
    return moves
