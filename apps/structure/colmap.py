"""A perspective reconstruction as COLMAP has it: a folder of three text files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...models.core.frame import Frame
from ...models.files.atomic_files import write_atomically
from .reconstruction import Reconstruction

FOLDER = "colmap"
FILES = ("cameras.txt", "images.txt", "points3D.txt")
HALF = 0.5
"""px: in COLMAP the middle of the upper left pixel is at (0.5, 0.5)."""


def write_colmap(
    folder: Path,
    found: Reconstruction,
    frames: Sequence[Frame],
    colours: NDArray[np.uint8],
    names: Sequence[str],
) -> None:
    """Write `cameras.txt`, `images.txt` and `points3D.txt`, each whole or not at all.

    Frames that show too little for a camera are left out, as COLMAP leaves out pictures that it cannot
    register.

    Parameters
    ----------
    folder
        to write to; it is made.
    found
        with a perspective camera.
    frames
        all of them.
    colours
        `(n_points, 3)` BGR.
    names
        of the frames' pictures.
    """
    perspective = found.perspective
    assert perspective is not None
    folder.mkdir(exist_ok=True)
    cameras, (height, width) = perspective.cameras, perspective.size
    middle = (cameras.principal + HALF).tolist()
    lens = f"1 SIMPLE_PINHOLE {width} {height} {cameras.focal:.10g} {middle[0]:g} {middle[1]:g}"
    _write(folder / "cameras.txt", ["# CAMERA_ID MODEL WIDTH HEIGHT F CX CY", lens])

    seen = found.observed & perspective.frame_determined[:, None] & np.isfinite(found.places).all(axis=2)
    turns = Rotation.from_matrix(cameras.rotations).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    images = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", "# POINTS2D[] as (X Y POINT3D_ID)"]
    for index in np.flatnonzero(perspective.frame_determined).tolist():
        pose = " ".join(f"{value:.12g}" for value in (*turns[index], *cameras.translations[index]))
        images.append(f"{frames[index].number} {pose} 1 {names[index]}")
        shown = np.flatnonzero(seen[index])
        places = found.places[index, shown] + HALF
        images.append(
            " ".join(f"{x:.4f} {y:.4f} {point + 1}" for (x, y), point in zip(places, shown, strict=True))
        )
    _write(folder / "images.txt", images)

    place_in_image = np.cumsum(seen, axis=1) - 1
    points = ["# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)"]
    errors = np.linalg.norm(found.residuals, axis=2)
    for point in np.flatnonzero(seen.any(axis=0)).tolist():
        in_frames = np.flatnonzero(seen[:, point]).tolist()
        where = " ".join(f"{value:.10g}" for value in found.shape[point])
        colour = " ".join(str(value) for value in colours[point, ::-1].tolist())
        track = " ".join(f"{frames[t].number} {place_in_image[t, point]}" for t in in_frames)
        points.append(f"{point + 1} {where} {colour} {errors[in_frames, point].mean():.4f} {track}")
    _write(folder / "points3D.txt", points)


def _write(path: Path, lines: Sequence[str]) -> None:
    with write_atomically(path) as unfinished:
        unfinished.write_text("\n".join([*lines, ""]), encoding="utf-8")
