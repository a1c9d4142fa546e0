"""A deforming shape with its poses and its uncertainty, as learned from tracks, and errors of shapes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....models.core.short_repr import short_repr
from ....models.face.morphable_model import RIGID, MorphableModel, Poses
from .em import ALIKE, basis_covariance

Array = NDArray[np.float64]

MIRRORED = np.array([1.0, 1.0, -1.0])


def shape_error(estimate: Array, truth: Array) -> float:
    """Return mean 3-D error of points over the mean standard deviation of the true ones: e3D.

    Gotardo and Martinez (2011) after Akhter et al. (2008): sum_tj |s_tj - s*_tj| / (n_frames n_points
    sigma), sigma the mean over frames of (sigma_x + sigma_y + sigma_z) / 3, the standard deviations of the
    true points of a frame. Shapes are in the axes of the camera and about their centroids; the nearer one of
    the two mirror images in depth counts, the same for all frames. Frames with NaN in either are left out.

    Raises
    ------
    ValueError
        if shapes of the arrays differ, or they have no frame in common.
    """
    if np.shape(estimate) != np.shape(truth) or np.ndim(estimate) != 3 or np.shape(estimate)[2] != 3:
        raise ValueError(
            f"shapes: got {np.shape(estimate)} and {np.shape(truth)}, expected (n_frames, n_points, 3) twice"
        )
    known = np.isfinite(estimate).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
    if not known.any():
        raise ValueError("shapes: got no frame that is known in both")
    goal = about_centroids(truth[known])
    size = goal.std(axis=1).mean()
    return float(np.linalg.norm(nearer_image(estimate[known], goal) - goal, axis=2).mean() / size)


def nearer_image(shapes: Array, truth: Array) -> Array:
    """Return the shapes about their centroids, or their mirror images in depth, all frames alike."""
    goal = about_centroids(truth)
    images = [about_centroids(shapes), about_centroids(shapes) * MIRRORED]
    return min(images, key=lambda image: float(np.linalg.norm(image - goal, axis=2).sum()))


def about_centroids(shapes: Array) -> Array:
    """Return shapes `(n_frames, n_points, 3)` about their centroids."""
    about: Array = shapes - shapes.mean(axis=1, keepdims=True)
    return about


def without_triangles(bases: Array) -> MorphableModel:
    """Return a model of points without triangles."""
    return MorphableModel(bases, np.zeros((0, 3), np.int64))


def frame_changes(bases: Array, poses: Poses) -> Array:
    """Return derivatives `(n_frames, n_points, 3, 6 + n_modes)` px by pose and weights."""
    model = without_triangles(bases)
    by_morph = model.jacobian(poses, 3)
    growth = model.turned(poses)[..., None]
    along_weights = poses.sizes[:, None, None, None] * by_morph[..., RIGID + 1 :]
    return np.concatenate([by_morph[..., :3], growth, by_morph[..., 3:RIGID], along_weights], axis=3)


def frame_covariances(bases: Array, poses: Poses, seen: NDArray[np.bool_], noise: float) -> Array:
    """Return covariances `(n_frames, 6 + n_modes, 6 + n_modes)` of pose and weights, given the bases."""
    rows = frame_changes(bases, poses)[:, :, :2] * seen[..., None, None] / noise
    flat = rows.reshape(len(rows), -1, rows.shape[-1])
    information = flat.transpose(0, 2, 1) @ flat
    every = np.arange(information.shape[1])
    # before, a pose is known to a radian, a factor of e and its size: the turn of a line about itself, which
    # nothing shows, stays finite
    information[:, every, every] += np.where((every == 4) | (every == 5), 1 / poses.sizes[:, None] ** 2, 1.0)
    return np.linalg.inv(information).astype(np.float64)


def basis_covariances(
    bases: Array, poses: Poses, weights: Array, spread: Array, seen: NDArray[np.bool_], noise: float
) -> Array:
    """Return covariances `(n_points, 3 n_bases, 3 n_bases)` of the bases, given poses and weights."""
    axes = poses.sizes[:, None, None] * poses.rotations[:, :2]
    extended = np.concatenate([np.ones((len(weights), 1)), weights], axis=1)
    second = extended[:, :, None] * extended[:, None]
    second[:, 1:, 1:] += spread
    products = np.einsum("nkl,nab->nkalb", second, axes.transpose(0, 2, 1) @ axes) / noise**2
    size = 3 * len(bases)
    information = (seen.T.astype(np.float64) @ products.reshape(len(seen), -1)).reshape(-1, size, size)
    prior = ALIKE * np.linalg.inv(basis_covariance(bases, axes))
    return np.linalg.inv(information + np.kron(prior, np.eye(3)))


@short_repr
@dataclass(frozen=True)
class Rival:
    """Another optimum: nats by which it is less likely, and how far its shapes are off (`shape_error`)."""

    log_likelihood_gap: float
    disagreement: float


@short_repr
@dataclass(frozen=True, eq=False)
class NonrigidShape:
    """Mean shape and modes of deformation, and in each frame the pose and the weights of modes.

    Point j of frame t is seen at scale_t * (rotation_t @ (bases[0, j] + sum_k weights[t, k - 1] bases[k, j]))
    + translation_t, of which x and y are seen, z points away from the viewer. Finer modes, `details`, are
    added in the same way. The first basis has root mean square distance 1 from its centroid, the origin, over
    x and y; weights are standard normal; the mean of all rotations is the identity. Of the two mirror images
    in depth, which orthography cannot distinguish, it is the one that is convex towards the viewer, like a
    face.

    Parameters
    ----------
    bases, weights
        `(n_bases, n_points, 3)`: mean shape, and modes in the order of their size; `(n_frames, n_bases -
        1)`.
    details, detail_weights
        `(n_details, n_points, 3)` and `(n_frames, n_details)`: finer modes, as many as the tracks determine.
    rotations, scales, translations
        `(n_frames, 3, 3)`, `(n_frames,)` px, `(n_frames, 2)` px.
    noise, rmse
        px: standard deviation of a coordinate, and root mean square residual of `shapes()`.
    log_likelihood, history
        nats: of the tracks in px with weights integrated out; and with the prior of the bases, before each
        iteration of the last ascent, never decreasing.
    frame_determined
        `(n_frames,)` bool: the frame shows four points or more. Poses and weights of others are NaN.
    frame_covariances
        `(n_frames, 6 + n_modes, 6 + n_modes)`: of the rotation of a frame (rad, about the camera's axes), the
        logarithm of its scale, its translation (px), its weights and those of details, given the bases.
    basis_covariances
        `(n_points, 3 (1 + n_modes), 3 (1 + n_modes))`: of the positions of a point in all bases and details,
        x, y, z of the first basis first, given poses and weights.
    rivals
        other optima of nearly equal likelihood, the most likely first.
    """

    bases: Array
    weights: Array
    details: Array
    detail_weights: Array
    rotations: Array
    scales: Array
    translations: Array
    noise: float
    rmse: float
    log_likelihood: float
    history: tuple[float, ...]
    frame_determined: NDArray[np.bool_]
    frame_covariances: Array
    basis_covariances: Array
    rivals: tuple[Rival, ...] = ()

    @property
    def poses(self) -> Poses:
        """Every frame's pose of `model()`."""
        return posed(self.rotations, self.translations, self.scales, self.weights)

    @property
    def _whole(self) -> tuple[Array, Poses]:
        """Bases with details, and poses of them."""
        weights = np.concatenate([self.weights, self.detail_weights], axis=1)
        poses = posed(self.rotations, self.translations, self.scales, weights)
        return np.concatenate([self.bases, self.details]), poses

    @property
    def relative_error(self) -> float:
        """Root mean square distance between points and where they were seen, in parts of the object's size.

        The size is their root mean square distance from the centroid, as they are seen.
        """
        return float(np.sqrt(2) * self.rmse / np.nanmean(self.scales))

    def shapes(self) -> Array:
        """Return `(n_frames, n_points, 3)` px: positions, and depths behind the object's origin.

        With all details: the best that is known of the points. `model().positions(poses)` are without.
        """
        bases, poses = self._whole
        return without_triangles(bases).positions(poses)

    def shape_covariances(self) -> Array:
        """Return covariances `(n_frames, n_points, 3, 3)` px^2 of `shapes()`.

        Frames given bases, and bases given frames, to first order; without the noise of observations.
        """
        bases, poses = self._whole
        rows = frame_changes(bases, poses)
        covariances: Array = rows @ self.frame_covariances[:, None] @ rows.transpose(0, 1, 3, 2)
        n_bases, n_points, _ = bases.shape
        by_basis = self.basis_covariances.reshape(n_points, n_bases, 3, n_bases, 3)
        inner = np.einsum("nk,vkalb,nl->nvab", poses.morphs, by_basis, poses.morphs, optimize=True)
        turned = self.rotations[:, None]
        covariances += turned @ inner @ turned.transpose(0, 1, 3, 2)
        return covariances

    def model(self) -> MorphableModel:
        """Return the object's model, with triangles between neighbours as they are seen from the front."""
        return MorphableModel(self.bases, triangles_in_front(self.bases[0]))


def posed(rotations: Array, translations: Array, scales: Array, weights: Array) -> Poses:
    """Return poses with weights `(n_frames, n_modes)` of modes in units of the scale."""
    extended = np.pad(weights, ((0, 0), (1, 0)), constant_values=1)
    return Poses(rotations, translations, scales[:, None] * extended)


def convex(shape: Array) -> bool:
    """Return whether a shape `(n_points, 3)` is nearer to the viewer in its middle than at its margin."""
    centred = shape - shape.mean(axis=0)
    outwards = np.sum(centred[:, :2] ** 2, axis=1)
    return bool(np.sum(centred[:, 2] * (outwards - outwards.mean())) >= 0)


def triangles_in_front(shape: Array) -> NDArray[np.int64]:
    """Return Delaunay triangles `(n_triangles, 3)` of a shape `(n_points, 3)` as seen from the front.

    Their normals (cross products of edges) have z < 0. Points on a line are a `ValueError`.
    """
    from scipy.spatial import Delaunay, QhullError

    try:
        triangles = Delaunay(shape[:, :2]).simplices.astype(np.int64)
    except QhullError:
        raise ValueError("shape: got points on a line, expected some with triangles between them") from None
    first, second, third = (shape[triangles[:, corner]] for corner in range(3))
    away = np.cross(second - first, third - first)[:, 2] > 0
    triangles[away] = triangles[away][:, ::-1]
    return triangles
