"""What the structure application is asked for."""

from dataclasses import dataclass
from typing import Any, Literal

from ..options.job import Job

Coherence = Literal["second-order", "none"]
Association = Literal["dual-chain", "none"]


@dataclass(frozen=True, kw_only=True)
class StructureJob(Job):
    """Of what to find the structure, and how.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, or a track file: an .npz with tracks (n_frames, n_points, 2)
        in px, NaN where a point is missing, or as CoTracker or TAP-Vid have them. At least 3 frames and 4
        points.
    coherence
        second-order: the camera moves smoothly. none: every frame's camera is on its own.
    association
        dual-chain: shape and tracker correct each other, and tracks that show one point become one. none: the
        tracker hears nothing of the shape, every track is a point of its own.
    resume
        Go on with the run whose results are in the folder, from its last saved round.
    """

    coherence: Coherence = "second-order"
    association: Association = "dual-chain"

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source."""
        return {"coherence": self.coherence, "association": self.association, **super().settings()}
