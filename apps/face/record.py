"""What summary and page need of a face-tracking run."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..runs.row_log import RowLog
from ..view.page import FrameRecord, listed, listed_periods, notes_on_missing, periods

Array = NDArray[np.float64]
ANGLES = ("turned to the left", "tilted down", "leaned clockwise")
START_SECONDS, START_FIT = 1.0, 0.9
"""s after the start, and the mean fit in them below which it is called poor. Of 20 starts spread over a film
of a talking face all had more, and errors below 6.2 % of the pupils' distance; one with bent head less."""


def angles(rotation: Array) -> Array:
    """`(3,)` degrees by which a face that looks at the viewer was turned, as he sees it.

    First about the axis towards the viewer (clockwise), then about the horizontal one (down), at last about
    the vertical one (to the viewer's left), each counted positive.
    """
    turned, tilted, leaned = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    return np.array([turned, tilted, leaned])


class FaceRecord(FrameRecord):
    """What summary and page need of a run, a few numbers a frame.

    Parameters
    ----------
    log
        the rows of the run.

    Attributes
    ----------
    lost, restarted
        numbers of the frames in which that was so.
    log_evidence
        nats; NaN in the first frame, and where nothing was to be seen.
    fits
        share of the picture under the face that the texture explained, at most 1; NaN as above.
    errors
        px: mean distance of the landmarks from the given ones; NaN where none is given.
    experts
        effective number of experts, 1 / sum of squared weights.
    angles, morphs
        `(n_frames, 3)` degrees, see `angles`, and `(n_frames, n_bases)` px, of the mean.
    """

    def __init__(self, log: RowLog) -> None:
        super().__init__(log)
        self.lost, self.restarted = (log["number"][log[name]].tolist() for name in ("lost", "reinitialised"))
        self.log_evidence, self.fits, self.errors = log["log_evidence"], log["fit"], log["error"]
        self.experts = 1 / np.square(log["weights"]).sum(axis=1)
        self.angles, self.morphs = np.array([*map(angles, log["mean_rotation"])]), log["mean_morphs"]

    @property
    def lost_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which the face was lost."""
        return periods(self.numbers, self.lost)

    @property
    def start_fit(self) -> float:
        """Share of the picture that the start's texture explained in the first second; NaN if unknown."""
        fits = np.array(self.fits)[np.array(self.times) <= self.times[0] + START_SECONDS]
        known = fits[np.isfinite(fits)]
        return float(known.mean()) if len(known) else np.nan

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = notes_on_missing(self.missing)
        if self.start_fit < START_FIT - 1e-6:
            notes.append(
                f"The start may be poor: its texture explains {self.start_fit:.3f} of the face in the first "
                f"second, usual is {START_FIT} or more. Start where the face looks at the camera with its "
                "mouth closed (--start), or give --landmarks."
            )
        if self.lost:
            notes.append(f"Lost in {listed_periods(self.lost_periods)}.")
        if self.restarted:
            notes.append(f"Found again: {listed(self.restarted)}.")
        return notes

    @property
    def evidence_measures(self) -> dict[str, Any]:
        """Statistics of the log evidence, nats, over frames in which something was to be seen."""
        values = np.array(self.log_evidence)
        if not np.isfinite(values).any():
            return {}
        return {
            "mean": float(np.nanmean(values)),
            "median": float(np.nanmedian(values)),
            "lowest": float(np.nanmin(values)),
            "lowest_frame": self.numbers[int(np.nanargmin(values))],
        }

    def error_measures(self, size: float) -> dict[str, Any] | None:
        """Distances from given landmarks that are `size` px large; `None` where there are none."""
        values = np.array(self.errors)
        known = np.isfinite(values)
        if not known.any():
            return None
        mean = float(values[known].mean())
        return {
            "frames": int(np.count_nonzero(known)),
            "mean_px": mean,
            "median_px": float(np.median(values[known])),
            "worst_px": float(values[known].max()),
            "worst_frame": self.numbers[int(np.nanargmax(values))],
            "last_px": float(values[known][-1]),
            "size_of_landmarks_px": size,
            "mean_percent_of_size": 100 * mean / size if size else None,
        }
