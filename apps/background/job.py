"""Options of the background application."""

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
    """Options of `rsmcm background`.

    Parameters
    ----------
    engine
        recursive-bp: background and objects correct each other. feed-forward: no messages from the objects to
        the background. stand-alone: the background only, no tracks. coordinate-ascent: the whole video at
        once; background and tracks use all frames. The source is read four times, so it cannot be a camera or
        stream.
    camera
        fixed, or moving: the camera shakes, turns, zooms or walks. Every frame is registered to a view of the
        scene; a camera that leaves it begins the next one.
    first_frame
        With --camera moving, also write the tracks in coordinates of the first frame: tracks-first-frame.csv.
    warm_up
        Seconds at the beginning from which the background is estimated before the first result, so that
        people in the first frame are not part of it. These frames are held in memory.
    config
        TOML file with options by name, and with parameters of the chains, in sections [background], [blobs],
        [ground], [detector], [camera-motion], and [chains.NAME] for those of other packages. The command line
        has precedence.
    chain
        Name of a chain of another package to connect as well (entry point of the group rsmcm.chains); may be
        repeated.
    roi
        Region of interest: x,y,width,height in px from 0, or an image that is not black inside. There is no
        foreground outside, and objects that stand outside are not reported.
    learned
        Start with the background, tracks and identities of another run over the same scene: its state.npz. A
        recording is assumed to continue where that one ended.
    masks
        Foreground masks as foreground/bin000001.png and so on, as one lossless foreground.mkv, or none.
    ground_truth
        Ground truth: a MOT gt.txt, a folder with one, CVAT's zip of MOT 1.1, or a CDnet folder with
        groundtruth/.
    detections
        Boxes of a detector: MOT det.txt, COCO JSON, or CSV with a header (frame, x, y, width, height, score,
        class).
    classes
        Names of the classes of detections to use, separated by commas. Default: all.
    zones
        TOML file with zones and lines of the image: entries, exits, crossings, stays and standing are written
        to events.csv.
    """

    engine: Engine = "recursive-bp"
    camera: Camera = "fixed"
    first_frame: Annotated[bool, Parameter(negative="")] = False
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
        ("--detections", "--engine stand-alone"),
        ("--zones", "--engine stand-alone"),
        ("--warm-up", WHOLE, "the second estimates the background from the whole video"),
        ("--warm-up", "--camera moving"),
        ("--warm-up", "--from", "--from contains the background"),
        (WHOLE, "--camera moving"),
        (WHOLE, "--from", "--from contains the background"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.classes and self.detections is None:
            raise ValueError("--classes: got it without --detections, expected both")
        if self.first_frame and (self.camera == "fixed" or self.engine == "stand-alone"):
            raise ValueError("--first-frame: got it without tracks of --camera moving, expected both")

    @property
    def class_names(self) -> list[str]:
        """Of the detections to take."""
        return [name.strip() for typed in self.classes for name in typed.split(",")]

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source; with every parameter of the chains."""
        from ..io.tables import digest
        from .parameters import read_parameters, with_defaults

        settings = self.plain(
            (*self.OF_RUNS, "engine", "camera", "first_frame", "warm_up", "roi", "masks", "ground_truth")
        )
        settings |= {"classes": self.class_names, **self.plain(("detections", "zones"))}
        for name in ("detections", "zones"):
            if (path := getattr(self, name)) is not None:
                settings[name] = {"file": settings[name], "sha256": digest(path)}
        return {**settings, **with_defaults(read_parameters(self.config, self.chain))}
