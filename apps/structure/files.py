"""Files of a structure-from-motion run: the shape, the cameras, the tracks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.reconstruction import Numbers, Reconstruction
from ...chains.structure.factor_structure import StructureTrajectory, without_observations
from ...inference import Solution
from ...inference.sfm.affine_camera import scaled_rotations
from ...inference.sfm.perspective.structure import PerspectiveStructure
from ...models.core.frame import Frame
from ...models.files import write_atomically
from ..evaluation.predictions import PairRecord, PairRecorder
from ..io.files import write_json

GREY = 128  # grey level of points without a colour
VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("deviation", "<f4"),
        ("observations", "<i4"),
    ]
)
"""What `structure.ply` says of a point; `deviation` is its uncertainty along an axis, in the unit of x, y, z,
`observations` the number of frames in which it was seen."""
PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}

CONVENTION = (
    "position in the picture (x right, y down, px, pixel centres at whole numbers) = "
    "matrix[:, :3] @ point + matrix[:, 3]; euclidean: matrix[:, :3] is scale times the first two rows of "
    "rotation, whose third row points away from the camera"
)
PERSPECTIVE_CONVENTION = (
    "position in the picture (x right, y down, px, pixel centres at whole numbers) = principal_point + "
    "focal_length * (x, y) / z with (x, y, z) = rotation @ point + translation; centre = where the camera "
    "stands; an inverse focal length (1/px) that is a few of its standard deviations from 0 or less leaves "
    "the focal length unknown; determined: halves of the points that other frames determine place the "
    "camera where it is; those of other frames lie between their neighbours"
)


def write_ply(path: Path, result: Reconstruction, colours: NDArray[np.uint8]) -> None:
    """Write the points as binary little-endian PLY, whole or not at all, in colours `(n_points, 3)` BGR."""
    vertices = np.zeros(result.n_points, VERTEX)
    for name, values in zip("xyz", result.shape.T, strict=True):
        vertices[name] = values
    for name, channel in zip(("blue", "green", "red"), colours.T, strict=True):
        vertices[name] = channel
    vertices["deviation"] = result.deviations
    vertices["observations"] = np.count_nonzero(result.observed, axis=0)
    properties = (f"property {PLY_TYPES[VERTEX[name].str]} {name}" for name in VERTEX.names or ())
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {result.geometry} shape; x right, y down, z away from the camera",
        f"element vertex {result.n_points}",
        *properties,
        "end_header",
    ]
    with write_atomically(path) as unfinished:
        unfinished.write_bytes("\n".join([*header, ""]).encode("ascii") + vertices.tobytes())


def write_cameras(path: Path, result: Reconstruction, frames: Sequence[Frame]) -> None:
    """Write every frame's camera as JSON; unknown values are `null`."""
    entries = []
    scales, rotations = orthographic_parts(result.cameras)
    for frame, camera, scale, rotation in zip(frames, result.cameras, scales, rotations, strict=True):
        entry: dict[str, Any] = {"frame": frame.number, "time": frame.time, "matrix": camera}
        if result.geometry == "euclidean":
            entry |= {"scale": scale, "rotation": rotation, "translation": camera[:, 3]}
        entries.append(entry)
    if result.dropped is not None:
        seen = result.observed.sum(axis=1).tolist()
        for entry, used, dropped in zip(entries, seen, result.dropped.tolist(), strict=True):
            entry |= {"observations": used, "dropped_observations": dropped}
    content = {"geometry": result.geometry, "camera": "affine", "convention": CONVENTION, "frames": entries}
    if result.perspective is not None:
        content |= _perspective(result.perspective, entries)
    write_json(path, content)


def _perspective(structure: PerspectiveStructure, entries: list[dict[str, Any]]) -> dict[str, Any]:
    """What is said of a perspective camera; the frames' entries become those of one."""
    cameras = structure.cameras
    known = structure.frame_determined.tolist()
    poses = zip(cameras.rotations, cameras.translations, cameras.centres, known, strict=True)
    for entry, (rotation, translation, centre, determined) in zip(entries, poses, strict=True):
        entry |= {"rotation": rotation, "translation": translation, "centre": centre}
        entry["determined"] = determined
        del entry["matrix"], entry["scale"]
    return {
        "camera": "perspective",
        "convention": PERSPECTIVE_CONVENTION,
        "size": {"width": structure.size[1], "height": structure.size[0]},
        "principal_point": cameras.principal,
        "focal_length": cameras.focal,
        "focal_length_deviation": structure.focal_deviation,
        "inverse_focal_length": cameras.curvature,
        "inverse_focal_length_deviation": structure.curvature_deviation,
    }


def orthographic_parts(cameras: Numbers) -> tuple[Numbers, Numbers]:
    """Return scales `(n_frames,)`, rotations `(n_frames, 3, 3)` nearest to cameras; NaN for unknown ones."""
    known = np.isfinite(cameras).all(axis=(1, 2))
    scales, rotations = np.full(len(cameras), np.nan), np.full((len(cameras), 3, 3), np.nan)
    scales[known], rotations[known] = scaled_rotations(cameras[known, :, :3])
    return scales, rotations


def write_tracks(path: Path, result: Reconstruction, frames: Sequence[Frame]) -> None:
    """Write `tracks.npz`, whole or not at all.

    It holds `position (n_frames, n_points, 2)` px in every frame, seen or not, `covariance
    (n_frames, n_points, 2, 2)` px^2, `observed (n_frames, n_points)` bool, `point_of_track (n_tracks,)`, -1
    where a track was rejected, and `frame (n_frames,)` and `time (n_frames,)` s of every frame.
    """
    with write_atomically(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            position=result.positions,
            covariance=result.covariances,
            observed=result.observed,
            point_of_track=result.point_of_track,
            frame=np.array([frame.number for frame in frames], np.int64),
            time=np.array([frame.time for frame in frames], np.float64),
        )


def recorded_predictions(solution: Solution) -> tuple[PairRecord, ...]:
    """Record the final predictions of both chains for `rsmcm validity`.

    The tracker's messages come from the other frames' observations of the same point, the shape's from all
    but that of the point in the frame.
    """
    structure: StructureTrajectory = solution["structure"]
    recorder = PairRecorder("tracker", "structure", "points")
    for frame, by_tracker, by_shape, evidence in zip(
        solution.frames,
        solution.messages("tracker", "points"),
        solution.messages("structure", "points"),
        solution.evidence("points"),
        strict=True,
    ):
        without = without_observations(by_shape.positions, evidence.positions, structure)
        recorder.add(frame.number, by_tracker.positions, without, evidence.positions)
    record = recorder.record()
    return () if record is None else (record,)


def point_colours(frames: Sequence[Frame], result: Reconstruction) -> NDArray[np.uint8]:
    """Return each point's median colour where it was seen, `(n_points, 3)` BGR; grey where there is none."""
    samples = np.full((len(frames), result.n_points, 3), np.nan, np.float32)
    for frame, places, seen, colours in zip(frames, result.places, result.observed, samples, strict=True):
        if frame.image is not None:
            near = np.rint(np.where(seen[:, None], places, -1))
            inside = ((near >= 0) & (near < frame.image.shape[1::-1])).all(axis=1)
            colours[inside] = colours_at(frame, places[inside])
    coloured = ~np.isnan(samples[:, :, 0]).all(axis=0)
    median = np.full((result.n_points, 3), GREY, np.uint8)
    median[coloured] = np.rint(np.nanmedian(samples[:, coloured], axis=0))
    return median


def colours_at(frame: Frame, places: Numbers) -> NDArray[np.uint8]:
    """Return the picture's colours `(n, 3)` BGR at places `(n, 2)` px; grey without a picture."""
    colours = np.full((len(places), 3), GREY, np.uint8)
    if frame.image is not None and len(places):
        height, width = frame.image.shape[:2]
        columns, rows = np.rint(places).astype(np.int64).T
        values = frame.image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        colours[:] = values if values.ndim == 2 else values[:, None]
    return colours
