"""Options of the body application."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from cyclopts import Parameter

from ..options.job import Bounds, FilmJob

FEWEST_SAMPLES = 10

LAG, MOST_LAG = 12, 250  # frames: default, and bound by memory


@dataclass(frozen=True, kw_only=True)
class BodyJob(FilmJob):
    """Options of `rsmcm body`.

    Parameters
    ----------
    detector
        Model file (.onnx) of OpenCV's face detector YuNet. Default: the Haar cascade of OpenCV 4.
    head
        x,y,width,height in px of the head in the first frame, from chin to the top of the skull. It replaces
        the detector: the head is then tracked by colour and edges. With --detector, it selects one of several
        faces; by default that is the one with most hands below, or the largest.
    keypoints
        Keypoints of a detector of poses or hands, or clicked in a few frames: CSV with the columns frame,
        person, joint, x, y and score (person and score may be left out), COCO's JSON of results, or a folder
        of OpenPose's JSON. They are evidence, and give the lengths of the arms. Without --detector and
        --head, the largest person in it is tracked.
    samples
        Number of pose samples per frame.
    lag
        Number of later frames that the result of a frame uses. Default: 12; 0 for cameras and streams.
    learned
        Start with the lengths, colour and pose of another run over the same person: its state.npz. A
        recording is assumed to continue where that one ended.
    """

    detector: Path | None = None
    head: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    keypoints: Path | None = None
    samples: int = 1000
    lag: int | None = None

    SETTINGS: ClassVar[Sequence[str]] = ("detector", "keypoints", "head", "samples", "lag")
    BOUNDS: ClassVar[Bounds] = {
        "samples": (lambda samples: samples >= FEWEST_SAMPLES, f"{FEWEST_SAMPLES} or more"),
        "lag": (lambda frames: 0 <= frames <= MOST_LAG, f"0 to {MOST_LAG} frames"),
    }
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (("--head", "--from", "--from contains the person"),)

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source; with the content of the keypoints."""
        from ..io.keypoints import digest_of

        settings = super().settings()
        if self.keypoints is not None:
            settings["keypoints"] = {"file": settings["keypoints"], "sha256": digest_of(self.keypoints)}
        return settings
