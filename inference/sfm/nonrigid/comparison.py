"""How far shapes are from each other, or from the truth, up to what orthography cannot tell."""

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

MIRRORED = np.array([1.0, 1.0, -1.0])


def shape_error(found: Numbers, truth: Numbers) -> float:
    """Mean 3-D error of points over the mean standard deviation of the true ones: e3D.

    Gotardo and Martinez (2011) after Akhter et al. (2008): sum_tj |s_tj - s*_tj| / (n_frames n_points sigma),
    sigma the mean over frames of (sigma_x + sigma_y + sigma_z) / 3, the standard deviations of the true
    points of a frame. Shapes are in the axes of the camera and about their centroids; the one of the two
    mirror images in depth that is nearer counts, the same for all frames. Nothing else is aligned.

    Parameters
    ----------
    found, truth
        `(n_frames, n_points, 3)`, in one unit; frames with NaN in either are left out.

    Raises
    ------
    ValueError
        if shapes of the arrays differ, or they have no frame in common.
    """
    if np.shape(found) != np.shape(truth) or np.ndim(found) != 3 or np.shape(found)[2] != 3:
        raise ValueError(
            f"shapes: got {np.shape(found)} and {np.shape(truth)}, expected (n_frames, n_points, 3) twice"
        )
    known = np.isfinite(found).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
    if not known.any():
        raise ValueError("shapes: got no frame that is known in both")
    goal = about_centroids(truth[known])
    size = goal.std(axis=1).mean()
    return float(np.linalg.norm(nearer_image(found[known], goal) - goal, axis=2).mean() / size)


def nearer_image(shapes: Numbers, truth: Numbers) -> Numbers:
    """The shapes about their centroids, or their mirror images in depth, all frames alike."""
    goal = about_centroids(truth)
    images = [about_centroids(shapes), about_centroids(shapes) * MIRRORED]
    return min(images, key=lambda image: float(np.linalg.norm(image - goal, axis=2).sum()))


def about_centroids(shapes: Numbers) -> Numbers:
    """Shapes `(n_frames, n_points, 3)` about their centroids."""
    about: Numbers = shapes - shapes.mean(axis=1, keepdims=True)
    return about
