"""What a face-tracking run leaves: arrays and a video that grow with the frames, pictures of the texture."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow, GFlowState
from ...models.core.frame import Frame
from ..drawing.overlay_video import caption
from ..io.files import write_image
from ..runs.pose_writer import PoseWriter
from .landmark_files import GivenLandmarks
from .overlay import FaceOverlay, TrackedFace, texture_picture
from .report import FaceRecord
from .start import FaceStart

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SUREST = 0.01
"""Squared grey levels below which variances of texels are not told apart (of a template it is 0)."""


class FaceWriter(PoseWriter):
    """What grows with the frames: `poses.npz`, `overlay.mp4` and the record for summary and report.

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
    size
        `(width, height)` px of the frames.
    rate
        frames per second.
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
    show
        is given each picture of the video, in another thread.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        rate: float,
        after: int,
        chain: GFlow,
        start: FaceStart,
        given: GivenLandmarks | None,
        record: FaceRecord,
        show: Callable[[Image], None] | None = None,
    ) -> None:
        constants = {"bases": start.model.bases, "triangles": start.model.triangles}
        super().__init__(folder, size, rate, after, constants, show)
        self._chain = chain
        self._start = start
        self._given = given
        self._record = record
        self._overlay = FaceOverlay(start.model)

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
        face = TrackedFace(state.poses, mean, landmarks, state.lost)
        drawn = self.write(frame, row, lambda image: self._overlay.draw(image, face, caption(frame)))
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
            overlay=drawn,
        )
        return row


def write_textures(folder: Path, chain: GFlow, state: GFlowState) -> tuple[float, dict[str, Image]]:
    """Write texture and variance of the most credible expert as pictures, on the mean shape from the front.

    Returns
    -------
    tuple
        the variance (squared grey levels) that is white, and the pictures by their captions.
    """
    best = int(np.argmax(state.weights))
    morphs = chain.mean_pose(state).morphs[0]
    mean, variance = (
        texture_picture(chain.model, morphs, chain.object.texels, values)
        for values in (state.texture.mean[best, 0], state.texture.variance[best])
    )
    # some texels are thousands of times less sure than others: a scale of logs shows both
    variance = np.maximum(variance, SUREST)
    black, white = float(np.nanmin(variance)), float(np.nanmax(variance))
    pictures = [_grey(mean, 255.0), _grey(np.log(variance / black), float(np.log(white / black)))]
    for name, picture in zip(("texture.png", "texture_variance.png"), pictures, strict=True):
        write_image(folder / name, picture)
    captions = ("mean", f"variance, {black:.3g} (black) to {white:.3g} squared grey levels, on a log scale")
    return white, dict(zip(captions, pictures, strict=True))


def _grey(values: Array, highest: float) -> Image:
    """A picture of values from 0 (black) to `highest` (white); black where there is none."""
    shades = np.clip(255 * values / max(highest, 1e-12), 0, 255)
    return np.rint(np.nan_to_num(shades)).astype(np.uint8)
