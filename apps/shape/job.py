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
    """Options of a shape run.

    Parameters
    ----------
    source
        Tracks of its points: .npy, or .npz with an array tracks or a single one, (n_frames, n_points, 2) px,
        NaN where missing; or as CoTracker or TAP-Vid have them; or motion capture (.mat).
    bases
        Number of shapes that are mixed, the mean among them: 2 or more; auto: as many as predict positions
        best that were held out.
    smooth
        The tracks are a film, its frames are successive: weights and turns change smoothly, by as much as the
        tracks tell. Turns then shake less; the error in depth hardly changes.
    truth
        Where the points really are in space: .npy or .npz, (n_frames, n_points, 3), or motion capture (.mat),
        as many frames as the tracks. The error in 3-D is reported.
    """

    bases: int | Literal["auto"]
    smooth: Flag = False
    truth: Path | None = None
    # there is nothing to go on with between the first step and the end, and tracks are no stream
    resume: Annotated[Flag, Parameter(parse=False)] = False
    reconnect: Annotated[float | None, Parameter(parse=False)] = None

    SETTINGS: ClassVar[Sequence[str]] = ("bases", "smooth", "truth")
