"""What the background application is asked for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from cyclopts import Parameter

from ..options.job import Bounds, FilmJob

Camera = Literal["fixed", "moving"]
Engine = Literal["recursive-bp", "feed-forward", "stand-alone", "coordinate-ascent"]
WHOLE_FILM: Engine = "coordinate-ascent"
WHOLE = f"--engine {WHOLE_FILM}"
Masks = Literal["none", "png", "video"]


@dataclass(frozen=True, kw_only=True)
class BackgroundJob(FilmJob):
    """What to separate from the background.

    Parameters
    ----------
    engine
        recursive-bp: background and objects correct each other. feed-forward: the background hears nothing of
        the objects. stand-alone: the background only, no tracks. coordinate-ascent: the whole film at once;
        the empty scene is found from all of it, and tracks know what comes later. The source is read four
        times, which a camera or stream cannot be.
    camera
        fixed, or moving: it shakes, turns or drifts a little about where it looks in the first frame, and
        every frame is registered with that scene. Where a frame does not show it, nothing is known.
    warm_up
        Find the empty scene from the first so many seconds before any frame is answered, so that people who
        are there from the beginning are no part of it. These frames are held in memory.
    config
        TOML file with options under their names, and with parameters of the chains, in sections [background],
        [blobs], [ground], [detector], [camera-motion], and [chains.NAME] for those of other packages; what is
        typed goes first.
    chain
        Connect a chain of another package as well, by the name under which it is announced (entry points
        rsmcm.chains); several times for several.
    roi
        Region of interest: x,y,width,height in px from 0, or a picture that is not black inside. Foreground
        outside is 0, and objects that stand outside are not reported.
    learned
        Begin with what a run over another film of the scene has learned, its background, tracks and
        identities: the state.npz of its results. A recording is taken to go on where that one ended.
    masks
        Foreground masks as foreground/bin000001.png and so on, as one lossless foreground.mkv, or none.
    ground_truth
        A MOT gt.txt, a folder that holds one, or CVAT's zip of MOT 1.1; or a CDnet folder with groundtruth/.
    detections
        What a detector has found in the film: MOT det.txt, COCO JSON, or CSV with a header (frame, x, y,
        width, height, score, class).
    classes
        Names of classes of detections to take, with commas; all if not given.
    zones
        Zones and lines of the picture, TOML: who enters, leaves, crosses, stays or stands still is written
        to events.csv.
    """

    engine: Engine = "recursive-bp"
    camera: Camera = "fixed"
    warm_up: float | None = None
    roi: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    masks: Masks = "png"
    ground_truth: Path | None = None
    detections: Path | None = None
    classes: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = ()
    zones: Path | None = None
    chain: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = ()

    BOUNDS: ClassVar[Bounds] = {"warm_up": (lambda seconds: 0 < seconds < math.inf, "seconds, more than 0")}
    EXCLUSIVE: ClassVar[Sequence[tuple[str, ...]]] = (
        ("--chain", "--engine stand-alone"),
        ("--detections", "--camera moving"),
        ("--detections", "--engine stand-alone"),
        ("--zones", "--engine stand-alone"),
        ("--warm-up", WHOLE, "the second finds the empty scene from the whole film"),
        ("--warm-up", "--camera moving"),
        ("--warm-up", "--from", "--from knows the empty scene"),
        (WHOLE, "--camera moving"),
        (WHOLE, "--from", "--from knows the empty scene"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.classes and self.detections is None:
            raise ValueError("--classes: got it without --detections, expected both")

    @property
    def class_names(self) -> list[str]:
        """Of the detections to take."""
        return [name.strip() for typed in self.classes for name in typed.split(",")]

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source; with every parameter of the chains."""
        from ..io.tables import digest
        from .parameters import read_parameters, with_defaults

        settings = self.plain(
            (*self.OF_RUNS, "engine", "camera", "warm_up", "roi", "masks", "ground_truth", "detections")
        )
        settings |= {"classes": self.class_names, **self.plain(("zones",))}
        for name in ("detections", "zones"):
            if (path := getattr(self, name)) is not None:
                settings[name] = {"file": settings[name], "sha256": digest(path)}
        return {**settings, **with_defaults(read_parameters(self.config, self.chain))}
