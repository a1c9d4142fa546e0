"""Job of the shape application."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from cyclopts import Parameter

from ..options.job import Flag, Job

AUTO: Literal["auto"] = "auto"


@dataclass(frozen=True, kw_only=True)
class ShapeJob(Job):
    """Options of `rsmcm shape`.

    Parameters
    ----------
    source
        Tracks of points: .npy, or .npz with an array tracks or a single array, (n_frames, n_points, 2) px,
        NaN where missing; files of CoTracker or TAP-Vid; or motion capture (.mat).
    bases
        Number of basis shapes, including the mean: 2 or more; auto: chosen by the prediction of held-out
        positions.
    smooth
        The frames are successive: weights and rotations change smoothly, by a learned amount. Rotations are
        then less noisy; the error in depth hardly changes.
    truth
        True positions of the points in 3-D, to report the error: .npy or .npz, (n_frames, n_points, 3), or
        motion capture (.mat), with as many frames as the tracks.
    """

    bases: int | Literal["auto"]
    smooth: Flag = False
    truth: Path | None = None
    # there is nothing to go on with between the first step and the end, and tracks are no stream
    resume: Annotated[Flag, Parameter(parse=False)] = False
    reconnect: Annotated[float | None, Parameter(parse=False)] = None

    SETTINGS: ClassVar[Sequence[str]] = ("bases", "smooth", "truth")
