"""What of a face-tracking run grows with the frames: `poses.npz`, and the record."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow, GFlowState
from ...models.core.frame import Frame
from ..io.row_writer import RowWriter
from .landmark_files import GivenLandmarks
from .record import FaceRecord
from .start import FaceStart

Array = NDArray[np.float64]


class FaceWriter(RowWriter):
    """What grows with the frames: `poses.npz`, and the record for summary and page.

    `poses.npz` holds, a row a frame: `frame_numbers`, `times` s; of the experts `weights (n_experts,)`,
    `rotations (n_experts, 3, 3)`, `translations (n_experts, 2)` px, `morphs (n_experts, n_bases)` px; of
    their mean `mean_rotation`, `mean_translation`, `mean_morphs`; `vertices_2d (n_vertices, 2)` px,
    `vertices_3d (n_vertices, 3)` px with depth, and `covariance (n_vertices, 3, 3)` px squared, how the
    experts differ; `landmarks (n_landmarks, 2)` px, NaN for those that were missing at the start;
    `log_evidence` nats and `fit`, the share of the picture under the face that the texture explains, NaN
    where there is none; `lost`, `reinitialised`, `missing`. `bases (n_bases,
    n_vertices, 3)` and `triangles (n_triangles, 3)` of the person's model come once.

    Parameters
    ----------
    folder
        of the results.
    after
        number of the frame after which this run goes on; 0 for a new one.
    chain
        that tracks.
    start
        with the points that the landmarks are attached to.
    given
        landmarks to compare with.
    record
        to add to.
    """

    def __init__(
        self,
        folder: Path,
        after: int,
        chain: GFlow,
        start: FaceStart,
        given: GivenLandmarks | None,
        record: FaceRecord,
    ) -> None:
        constants = {"bases": start.model.bases, "triangles": start.model.triangles}
        super().__init__(folder / "poses.npz", constants, after)
        self._chain = chain
        self._start = start
        self._given = given
        self._record = record

    def add(self, frame: Frame, state: GFlowState, seconds: float, *, restarted: bool) -> Mapping[str, Any]:
        """Take in a frame, which took the tracker so long; it may have found the face again in it.

        Its row of `poses.npz` is returned.
        """
        mean = self._chain.mean_pose(state)
        vertices, covariance = self._chain.vertices(state)
        present = self._start.present
        landmarks = np.full((len(present), 2), np.nan)
        if present.any():
            landmarks[present] = self._chain.points(state, self._start.points)
        # the first picture shows the texture, which nothing could predict
        unpredicted = frame.missing or state.frames_seen == 1
        evidence, fit = (np.nan, np.nan) if unpredicted else (state.log_evidence, state.fit)
        row = {
            "frame_numbers": np.int64(frame.number),
            "times": np.float64(frame.time),
            "weights": state.weights,
            "rotations": state.poses.rotations,
            "translations": state.poses.translations,
            "morphs": state.poses.morphs,
            "mean_rotation": mean.rotations[0],
            "mean_translation": mean.translations[0],
            "mean_morphs": mean.morphs[0],
            "vertices_2d": vertices[:, :2].astype(np.float32),
            "vertices_3d": vertices.astype(np.float32),
            "covariance": covariance.astype(np.float32),
            "landmarks": landmarks,
            "log_evidence": np.float64(evidence),
            "fit": np.float64(fit),
            "lost": np.bool_(state.lost),
            "reinitialised": np.bool_(restarted),
            "missing": np.bool_(frame.missing),
        }
        self.append(frame.number, row)
        self._record.add(
            frame,
            mean,
            state.weights,
            evidence,
            fit,
            np.nan if self._given is None else self._given.error(frame.number, landmarks),
            seconds,
            lost=state.lost,
            restarted=restarted,
        )
        return row
