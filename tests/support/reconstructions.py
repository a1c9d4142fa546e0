"""Reconstructions made from the truth of generated scenes, with known errors."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.scenes import Cylinder, cylinder
from rsmcm.chains.reconstruction import Reconstruction
from rsmcm.models.core.frame import Frame

SIZE = (96, 80)
SCALE = 25.0  # px per radius of the cylinder
CENTRE = np.array([48.0, 40.0])


def small_cylinder(n_frames: int = 12) -> Cylinder:
    return cylinder(n_points=15, n_frames=n_frames, p_loose=0.1, p_drift=0.0, seed=2)


def in_px(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cylinder's coordinates in a picture of `SIZE`."""
    return SCALE * positions + CENTRE


def reconstruction(truth: Cylinder) -> Reconstruction:
    """The truth itself; residuals are what was drawn."""
    cameras = SCALE * truth.cameras
    cameras[:, :, 3] += CENTRE
    n_frames, n_points = truth.visible.shape
    return Reconstruction(
        positions=in_px(truth.positions),
        covariances=np.tile(0.04 * np.eye(2), (n_frames, n_points, 1, 1)),
        observed=truth.visible,
        residuals=in_px(truth.observed) - in_px(truth.positions),
        point_of_track=truth.point_of_track,
        cameras=cameras,
        shape=truth.shape,
        shape_covariances=np.tile(1e-4 * np.eye(3), (n_points, 1, 1)),
        noise_variance=(0.01 * SCALE) ** 2,
        objective=(-300.0, -120.0, -119.5),
        converged=True,
        geometry="euclidean",
    )


def pictures(truth: Cylinder, colours: NDArray[np.uint8]) -> list[Frame]:
    """Frames on which every visible point is a dot in its colour, where it was observed."""
    frames = []
    for index, places in enumerate(in_px(truth.observed)):
        image = np.full((SIZE[1], SIZE[0], 3), 30, np.uint8)
        for point in np.flatnonzero(truth.visible[index]):
            x, y = np.rint(places[point]).astype(int)
            cv2.circle(image, (int(x), int(y)), 1, [int(value) for value in colours[point]], cv2.FILLED)
        frames.append(Frame(image, index / 25, index + 1))
    return frames


def without_images(frames: Sequence[Frame]) -> list[Frame]:
    return [Frame(None, frame.time, frame.number) for frame in frames]


def write_film(folder: Path, n_frames: int) -> None:
    """Pictures, `frame1.png` and so on, in which patches of cloth move like points of a cylinder."""
    moving = cylinder(30, n_frames, p_loose=0, p_drift=0, noise=0, seed=6, degrees_per_frame=2)
    patches = np.random.default_rng(0).integers(0, 256, (30, 5, 5), dtype=np.uint8)
    size = (200, 160)
    for number, places in enumerate(60 * moving.positions + (100, 80), start=1):
        image = np.full((size[1], size[0]), 120, np.uint8)
        for patch, (x, y) in zip(patches, places, strict=True):
            shift = np.array([[2.0, 0.0, x - 4.5], [0.0, 2.0, y - 4.5]])
            large = cv2.warpAffine(patch, shift, size, flags=cv2.INTER_LINEAR)
            cover = cv2.warpAffine(np.ones_like(patch), shift, size, flags=cv2.INTER_NEAREST)
            image = np.where(cover > 0, np.asarray(large, np.uint8), image)
        cv2.imwrite(str(folder / f"frame{number}.png"), image)
