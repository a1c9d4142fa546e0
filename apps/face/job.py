"""Job of the face application."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from ..options.job import Bounds, FilmJob


@dataclass(frozen=True, kw_only=True)
class FaceJob(FilmJob):
    """Options of a face run.

    Parameters
    ----------
    model
        Morphable model: an .npz (of rsmcm shape, say), Candide-3 (.wfm), the Surrey model's folder or .bin,
        or an .obj. A small built-in face if not given.
    landmarks
        An .npy with landmarks (n_frames, n_landmarks, 2) in px, NaN where one is missing. Those of the first
        frame start the track. The others do not help it; it is measured by them. The first row belongs to the
        first frame that is processed, unless there are as many rows as the source has frames.
    correspondences
        Text that says which landmark is which of the model's: a line per pair, index from 0 = number from 1.
        Not needed where the landmarks are in the order of the model's landmarks or vertices.
    detector
        Without landmarks, the face is found by a detector; it is also asked where a face is that is lost.
        OpenCV's YuNet with this model file (.onnx), this cascade (.xml), or the Haar cascade that OpenCV 4
        brings along.
    experts
        How many hypotheses are tracked.
    gain
        How fast the texture follows the picture, from 0 (a template) to 1 (optic flow); learned: by
        each texel for itself.
    learned
        Begin with what a run over another film of the face has learned, its shape and texture: the
        state.npz of its results. A recording is taken to go on where that one ended.
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
        (option, "--from", "--from says what the face is like")
        for option in ("--model", "--landmarks", "--detector")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gain != "learned" and not 0 <= self.gain <= 1:
            raise ValueError(f"--gain: got {self.gain}, expected 0 to 1, or learned")
        if self.landmarks is None and self.correspondences is not None:
            raise ValueError("--correspondences: got them without landmarks, expected --landmarks as well")
