"""Job of the face application."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from ..options.job import Bounds, FilmJob


@dataclass(frozen=True, kw_only=True)
class FaceJob(FilmJob):
    """Options of `rsmcm face`.

    Parameters
    ----------
    model
        Morphable model: an .npz (for example from rsmcm shape), Candide-3 (.wfm), the Surrey model's folder
        or .bin, or an .obj. Default: a small built-in face.
    landmarks
        An .npy with landmarks (n_frames, n_landmarks, 2) in px, NaN where one is missing. Those of the first
        frame start the track; the others only measure the error. The first row belongs to the first processed
        frame, unless there are as many rows as the source has frames.
    correspondences
        Text file that assigns landmarks to those of the model, one pair per line: index from 0 = number from
        1. Not needed if they are in the order of the model's landmarks or vertices.
    detector
        Face detector, to start without landmarks and to find a lost face: a model file (.onnx) of OpenCV's
        YuNet, or a cascade (.xml). Default: the Haar cascade of OpenCV 4.
    experts
        Number of experts (pose hypotheses).
    gain
        Gain of the texture's Kalman filter, from 0 (a template) to 1 (optic flow); learned: estimated for
        each texel.
    learned
        Start with the shape and texture of another run over the same face: its state.npz. A recording is
        assumed to continue where that one ended.
    """

    model: Path | None = None
    landmarks: Path | None = None
    correspondences: Path | None = None
    detector: Path | None = None
    experts: int = 20
    gain: float | Literal["learned"] = 0.1

    SETTINGS: ClassVar[Sequence[str]] = (
        "model", "landmarks", "correspondences", "detector", "experts", "gain",
    )  # fmt: skip
    BOUNDS: ClassVar[Bounds] = {"experts": (lambda experts: experts >= 1, "1 or more")}
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = tuple(
        (option, "--from", "--from contains the face") for option in ("--model", "--landmarks", "--detector")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gain != "learned" and not 0 <= self.gain <= 1:
            raise ValueError(f"--gain: got {self.gain}, expected 0 to 1, or learned")
        if self.landmarks is None and self.correspondences is not None:
            raise ValueError("--correspondences: got them without landmarks, expected --landmarks as well")
