"""Perspective cameras and points as COLMAP has them: a folder of three text files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...inference.sfm.perspective.structure import PerspectiveStructure
from ...models.files import write_text

FILES = ("cameras.txt", "images.txt", "points3D.txt")
HALF = 0.5
"""px: in COLMAP the middle of the upper left pixel is at (0.5, 0.5)."""


def write_colmap(
    folder: Path,
    structure: PerspectiveStructure,
    places: NDArray[np.float64],
    observed: NDArray[np.bool_],
    colours: NDArray[np.uint8],
    images: Sequence[tuple[int, str]],
) -> None:
    """Write `cameras.txt`, `images.txt` and `points3D.txt` to a folder, each whole or not at all.

    Frames that show too little for a camera are left out, as COLMAP leaves out pictures that it cannot
    register.

    Parameters
    ----------
    places, observed
        `(n_frames, n_points, 2)` px and `(n_frames, n_points)`: where points were seen.
    colours
        `(n_points, 3)` BGR.
    images
        number and name of each frame's picture.
    """
    folder.mkdir(exist_ok=True)
    cameras, (height, width) = structure.cameras, structure.size
    middle = (cameras.principal + HALF).tolist()
    lens = f"1 SIMPLE_PINHOLE {width} {height} {cameras.focal:.10g} {middle[0]:g} {middle[1]:g}"
    write_text(folder / FILES[0], f"# CAMERA_ID MODEL WIDTH HEIGHT F CX CY\n{lens}\n")

    seen = observed & structure.frame_determined[:, None]
    turns = Rotation.from_matrix(cameras.rotations).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", "# POINTS2D[] as (X Y POINT3D_ID)"]
    for index in np.flatnonzero(structure.frame_determined).tolist():
        number, name = images[index]
        pose = " ".join(f"{value:.12g}" for value in (*turns[index], *cameras.translations[index]))
        lines.append(f"{number} {pose} 1 {name}")
        shown = np.flatnonzero(seen[index])
        places_here = places[index, shown] + HALF
        lines.append(
            " ".join(f"{x:.4f} {y:.4f} {point + 1}" for (x, y), point in zip(places_here, shown, strict=True))
        )
    write_text(folder / FILES[1], "\n".join([*lines, ""]))

    place_in_image = np.cumsum(seen, axis=1) - 1
    lines = ["# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)"]
    errors = np.linalg.norm(places - structure.positions, axis=2)
    for point in np.flatnonzero(seen.any(axis=0)).tolist():
        frames = np.flatnonzero(seen[:, point]).tolist()
        where = " ".join(f"{value:.10g}" for value in structure.shape[point])
        colour = " ".join(str(value) for value in colours[point, ::-1].tolist())
        track = " ".join(f"{images[t][0]} {place_in_image[t, point]}" for t in frames)
        lines.append(f"{point + 1} {where} {colour} {errors[frames, point].mean():.4f} {track}")
    write_text(folder / FILES[2], "\n".join([*lines, ""]))
