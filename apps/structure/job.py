"""Job of the structure application."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

from ..options.job import Bounds, FilmJob, Job

Engine = Literal["coordinate-ascent", "recursive-bp"]
ASCENT, RECURSIVE = (f"--engine {engine}" for engine in get_args(Engine))
Coherence = Literal["second-order", "none"]
Association = Literal["dual-chain", "none"]
Robust = Literal["outliers", "none"]
Camera = Literal["auto", "affine", "perspective"]


@dataclass(frozen=True, kw_only=True)
class StructureJob(FilmJob):
    """Options of `rsmcm structure`.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, or a track file: an .npz with tracks (n_frames, n_points, 2)
        in px, NaN where a point is missing, or a file of CoTracker or TAP-Vid. At least 3 frames and 4
        points. With --engine recursive-bp also a camera or a stream, but no track file.
    engine
        coordinate-ascent: from all frames together. recursive-bp: frame by frame, with an affine camera.
    coherence
        second-order: the camera moves smoothly. none: cameras of different frames are independent.
    association
        dual-chain: shape and tracker correct each other, and tracks of the same point are joined. none: no
        messages from the shape to the tracker, every track is a separate point.
    robust
        outliers: positions may be wrong, and then count less. none: all count alike, as in least squares.
    camera
        affine: for a distant camera. perspective: one focal length, square pixels, the principal point in the
        middle of the image. auto: perspective if that explains the video better.
    focal
        Focal length in px. Default: from the images (EXIF), or estimated.
    resume
        Continue the run in the folder from its last saved round.
    """

    engine: Engine = "coordinate-ascent"

    coherence: Coherence = "second-order"
    association: Association = "dual-chain"
    robust: Robust = "outliers"
    camera: Camera = "auto"
    focal: float | None = None

    BOUNDS: ClassVar[Bounds] = {"focal": (lambda px: 0 < px < math.inf, "px, more than 0")}
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (
        ("--live", ASCENT, "the second, which is the default, takes all frames together"),
        ("--from", ASCENT, "the second, which is the default, takes all frames together"),
        ("--coherence none", RECURSIVE),
        ("--association none", RECURSIVE),
        ("--robust none", RECURSIVE),
        ("--camera affine", RECURSIVE),
        ("--camera perspective", RECURSIVE),
        ("--focal", RECURSIVE),
        ("--focal", "--camera affine"),
    )

    def settings(self) -> dict[str, Any]:
        """Return what the results depend on, beside the source."""
        if self.engine == "recursive-bp":
            return {"engine": self.engine, **super().settings()}
        return self.plain(("coherence", "association", "robust", "camera", "focal", *Job.OF_RUNS))
