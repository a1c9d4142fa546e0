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
        The face is found by a detector: OpenCV's YuNet with this model file (.onnx), or the Haar cascade that
        OpenCV 4 brings along.
    head
        x,y,width,height in px of the head in the first frame, from chin to the top of the skull. Instead of a
        detector; it is then followed by its colour and edges. With --detector, it says whose face is meant
        where there are several; otherwise that is the largest.
    joints
        CSV file with the columns frame,joint,x,y: joints that were clicked in a few frames, from which the
        lengths of the person's arms are taken. Without it, proportions are usual ones. Joints: head, neck
        (between the shoulders), left_shoulder, left_elbow, left_hand, and right; left is the person's own.
    keypoints
        File of what a detector of poses or hands has found: CSV with the columns frame, person, joint, x, y
        and score, COCO's JSON of results, or the folder of OpenPose's JSON. Without --detector and --head,
        the largest person in it is followed.
    samples
        How many poses are drawn a frame.
    lag
        Frames that are waited for before one is answered, so that what they show of it counts: 12 if not
        given, and 0 for cameras and streams.
    learned
        Begin with what a run over another film of the person has learned, lengths, colour and pose: the
        state.npz of its results. A recording is taken to go on where that one ended.
    """

    detector: Path | None = None
    head: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    joints: Path | None = None
    keypoints: Path | None = None
    samples: int = 1000
    lag: int | None = None

    SETTINGS: ClassVar[Sequence[str]] = ("detector", "joints", "keypoints", "head", "samples", "lag")
    BOUNDS: ClassVar[Bounds] = {
        "samples": (lambda samples: samples >= FEWEST_SAMPLES, f"{FEWEST_SAMPLES} or more"),
        "lag": (lambda frames: 0 <= frames <= MOST_LAG, f"0 to {MOST_LAG} frames"),
    }
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (
        ("--head", "--from", "--from says what the person is like"),
        ("--joints", "--from", "--from says what the person is like"),
    )

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source; with the content of the key points."""
        from ..io.keypoints import digest_of

        settings = super().settings()
        if self.keypoints is not None:
            settings["keypoints"] = {"file": settings["keypoints"], "sha256": digest_of(self.keypoints)}
        return settings
