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
Camera = Literal["auto", "affine", "perspective"]


@dataclass(frozen=True, kw_only=True)
class StructureJob(FilmJob):
    """Options of a structure run.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, or a track file: an .npz with tracks (n_frames, n_points, 2)
        in px, NaN where a point is missing, or as CoTracker or TAP-Vid have them. At least 3 frames and 4
        points. With --engine recursive-bp also a camera or a stream, and no track file.
    engine
        coordinate-ascent: from all frames together. recursive-bp: while frames come in, before an affine
        camera; it goes on as long as they do.
    coherence
        second-order: the camera moves smoothly. none: every frame's camera is on its own.
    association
        dual-chain: shape and tracker correct each other, and tracks that show one point become one. none: the
        tracker hears nothing of the shape, every track is a point of its own.
    camera
        affine: it is far away. perspective: it has one focal length, square pixels, and the middle of the
        picture as its principal point. auto: perspective where that explains the film better.
    focal
        Focal length in px, where it is known; else pictures may state it, or it is estimated.
    resume
        Go on with the run whose results are in the folder, from its last saved round.
    """

    engine: Engine = "coordinate-ascent"

    coherence: Coherence = "second-order"
    association: Association = "dual-chain"
    camera: Camera = "auto"
    focal: float | None = None

    BOUNDS: ClassVar[Bounds] = {"focal": (lambda px: 0 < px < math.inf, "px, more than 0")}
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (
        ("--live", ASCENT, "the second, which is the default, takes all frames together"),
        ("--from", ASCENT, "the second, which is the default, takes all frames together"),
        ("--coherence none", RECURSIVE),
        ("--association none", RECURSIVE),
        ("--camera affine", RECURSIVE),
        ("--camera perspective", RECURSIVE),
        ("--focal", RECURSIVE),
        ("--focal", "--camera affine"),
    )

    def settings(self) -> dict[str, Any]:
        """Return what the results depend on, beside the source."""
        if self.engine == "recursive-bp":
            return {"engine": self.engine, **super().settings()}
        return self.plain(("coherence", "association", "camera", "focal", *Job.OF_RUNS))
