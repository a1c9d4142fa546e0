"""Diagnosis of runs without a structure: what is missing, the figures that show it, and what to do."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...chains.reconstruction import FEWEST_FRAMES, FEWEST_POINTS, UNKNOWN_CAMERAS, Numbers
from ...inference.sfm.depth import Kind, Motion, motion_of, picture_motion, stands_still
from ...models.core.frame import Frame
from ...models.core.pictures import grey_of

SHORT = 3.0
"""Frames: of tracks that live no longer, most are in too few views to have depth."""
FAST = 10.0
"""px a frame, beyond which following by small patches loses points: twice their width."""
CONTRAST = 4.0
"""Grey levels (standard deviation): pictures with less are uniform, or so dark that noise is all there is."""


@dataclass(frozen=True)
class Diagnosis:
    """Why there is no structure: what is missing, the cause, the advice, and the figures behind them.

    Figures are in px, frames and grey levels; `None` where one could not be measured.
    """

    missing: str
    why: str
    advice: str
    figures: dict[str, float | None]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is missing, why, and what to do."""
        return self.missing, self.why, self.advice

    def facts(self) -> dict[str, Any]:
        """Return the entries of `summary.json`."""
        return {
            "tracks": int(self.figures.get("tracks") or 0),
            "points": 0,
            "shape": "none",
            "shape_reason": self.missing,
            "diagnosis": asdict(self),
        }


def too_little(frames: Sequence[Frame], n_tracks: int | None) -> Diagnosis | None:
    """Diagnose too few frames, or too few of `n_tracks` tracks in place of pictures; else return `None`."""
    present = sum(not frame.missing for frame in frames)
    if present < FEWEST_FRAMES:
        what = "frame" if present == 1 else "frames"
        return Diagnosis(
            f"No structure: {present} {what} to look at, and {FEWEST_FRAMES} are needed.",
            "Depth is only visible from several sides.",
            "Give a film, or a folder or glob of its pictures; --start, --stop and --step leave frames out.",
            {"frames": present},
        )
    if n_tracks is None:
        return None
    seen = {int(point) for frame in frames if frame.points is not None for point in frame.points.identities}
    if len(seen) < FEWEST_POINTS:
        return Diagnosis(
            f"No structure: {len(seen)} points with an observation in {present} frames, and {FEWEST_POINTS} "
            "are needed.",
            "With fewer, any motion of the camera fits.",
            "Give tracks of more points.",
            {"frames": present, "tracks": len(seen)},
        )
    places = [frame.points.positions for frame in frames if frame.points is not None]
    if not any((each != each[:1]).any() for each in places):
        return Diagnosis(
            f"No structure: all {len(seen)} points are in one place in every frame.",
            "They may be one point that was given several times.",
            "Give tracks of points that differ.",
            {"frames": present, "tracks": len(seen)},
        )
    return None


def standing(frames: Sequence[Frame]) -> Diagnosis | None:
    """Diagnose pictures of a camera that stands, in front of a scene that does; else return `None`."""
    pictures = [grey_of(frame.image) for frame in frames if frame.image is not None]
    if not pictures or not stands_still(pictures):
        return None
    return Diagnosis(
        "No structure: half of what the pictures show, or more, is in one place in all of them.",
        "The camera stands still, and so does most of the scene: there is nothing to see depth by.",
        f"{ADVICE['still'].removesuffix('.')} so that it fills most of the picture.",
        {"frames": len(pictures), "picture_motion_px": _finite_or_none(picture_motion(pictures))},
    )


def no_points(frames: Sequence[Frame], tracks: Numbers, reason: str) -> Diagnosis:
    """Diagnose that none of the tracked points became a point of a shape.

    `tracks` are `(n_frames, n_tracks, 2)` px, NaN where not seen; `reason` is what else is known of it.
    """
    motion = motion_of(tracks)
    pictures = [grey_of(frame.image) for frame in frames if frame.image is not None]
    contrast = float(np.median([picture.std() for picture in pictures])) if pictures else math.nan
    moved = picture_motion(pictures)
    figures = {
        **_figures(motion),
        "picture_motion_px": _finite_or_none(moved),
        "contrast": _finite_or_none(contrast),
    }
    missing = f"No structure: none of {motion.tracks} tracks became a point of a shape."
    if contrast < CONTRAST and motion.tracks < FEWEST_POINTS:
        return Diagnosis(
            f"No structure: {motion.tracks} points can be tracked, and {FEWEST_POINTS} are needed.",
            f"The images are nearly uniform: the standard deviation of grey levels is {contrast:.2g} of 255.",
            "Use images with texture, in focus, with enough light.",
            figures,
        )
    if motion.tracks < FEWEST_POINTS:
        return Diagnosis(
            f"No structure: {motion.tracks} points can be tracked, and {FEWEST_POINTS} are needed.",
            "Only corners can be tracked, and they must stay in view for some frames.",
            "Use images of an object with more texture, or a closer view.",
            figures,
        )
    if motion.life <= SHORT:
        speed = motion.per_frame if math.isnan(moved) else moved
        fast = f"; the pictures move by {speed:.3g} px a frame" if math.isfinite(speed) else ""
        advice = "Give more frames of the same motion, or a slower one, or leave fewer frames out (--step)."
        if not speed > FAST:
            advice = "Use a video in which the same objects stay in view, in focus, under constant light."
        return Diagnosis(
            missing,
            f"Half of the tracks live {motion.life:.3g} frame{'s' * (motion.life != 1)} or fewer{fast}.",
            advice,
            figures,
        )
    why = f"Half of them live {motion.life:.3g} frames or more, and move by {motion.per_frame:.3g} px a frame"
    return Diagnosis(
        missing,
        f"{why}, but they do not belong to one rigid object{f': {reason}' if reason else ''}.",
        "Use a video of one rigid rotating object, or of a scene in which nothing else moves.",
        figures,
    )


WHY: dict[Kind, str] = {
    "still": "nothing moves, neither the camera nor an object",
    "similarity": "translations, rotations and zooms of the image explain all motion: the camera "
    "only zooms, or turns a little, or looks straight at one plane",
    "rotation": "a camera that rotates and zooms in place, without depth, explains all motion",
    "plane": "one plane explains all motion",
    "unknown": "tracks are too short to compare distant frames",
}
ADVICE: dict[Kind, str] = {
    "still": "Move the camera sideways, or rotate the object.",
    "similarity": "Move the camera sideways, by a tenth of the distance or more, or rotate the object.",
    "rotation": "Move the camera sideways while it films; a tripod, or a pan from one place, shows no depth.",
    "plane": "Film something that is not flat, or more than the wall, and move the camera sideways.",
    "unknown": "Use more frames of the same motion, or a smaller --step.",
}


def no_shape(reason: str, tracks: Numbers) -> Diagnosis:
    """Diagnose why there is no shape, from tracks `(n_frames, n_tracks, 2)` px, NaN where not seen."""
    motion = motion_of(tracks)
    if reason == UNKNOWN_CAMERAS:
        return Diagnosis(
            f"No camera is known, and no shape is given: {reason}.",
            f"Half of {motion.tracks} tracks are in {motion.life:.3g} pictures or fewer, and points move by "
            f"{motion.per_frame:.3g} px from one to the next.",
            "Take pictures nearer to each other, such as every 10 degrees, of sides that differ.",
            _figures(motion),
        )
    parallax = ""
    if math.isfinite(motion.parallax):
        parallax = (
            f" Homographies between distant frames have a residual of {motion.parallax:.2g} px per point"
        )
        parallax += ", no more than noise: no parallax."
    return Diagnosis(
        f"The shape is undetermined, and none is given: {reason}.",
        f"Points move by {motion.per_frame:.3g} px a frame, and {WHY[motion.kind]}.{parallax}",
        ADVICE[motion.kind],
        _figures(motion),
    )


def _figures(motion: Motion) -> dict[str, float | None]:
    return {
        "tracks": motion.tracks,
        "median_life_frames": motion.life,
        "motion_px_per_frame": _finite_or_none(motion.per_frame),
        "parallax_px_per_point": _finite_or_none(motion.parallax),
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
