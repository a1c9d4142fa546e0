"""What a run is asked for: command line, TOML file and call from Python are one dataclass.

The docstrings are the command line's help. Nothing here takes long to import.
"""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from cyclopts import Group, Parameter

from ..live.address import read_address
from .complaints import not_negative

T = TypeVar("T")
Flag = Annotated[bool, Parameter(negative="")]
Seed = Annotated[int, Parameter(validator=not_negative)]
OfRuns = Annotated[T, Parameter(group=Group("Of every run", sort_key=1))]


@dataclass(frozen=True)
class Job:
    """What to do with a source.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, the number of a camera, or an rtsp or http address.
    out
        Folder for the results.
    config
        TOML file with options under their names; what is typed goes first.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Go on with the run whose results are in the folder, from its last saved state.
    overwrite
        Remove the results that are in the folder.
    reconnect
        When a camera or stream is lost, try for so many seconds to get it back. The gap is missing frames.

    Raises
    ------
    ValueError
        if fields contradict each other.
    """

    source: str
    _: KW_ONLY
    out: Path
    config: OfRuns[Path | None] = None
    start: OfRuns[int] = 1
    stop: OfRuns[int | None] = None
    step: OfRuns[int] = 1
    resume: OfRuns[Flag] = False
    overwrite: OfRuns[Flag] = False
    reconnect: OfRuns[float | None] = None

    def __post_init__(self) -> None:
        if self.resume and self.overwrite:
            raise ValueError("--resume and --overwrite: got both, expected one of them")

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source: a run is resumed only with the same."""
        return {"start": self.start, "stop": self.stop, "step": self.step}


@dataclass(frozen=True, kw_only=True)
class FilmJob(Job):
    """What to do with a film, frame after frame.

    Parameters
    ----------
    every
        Save the state each time that so many frames are done.
    learned
        Begin with what a run over another film has learned: the state.npz of its results. A recording is
        taken to go on where that one ended.
    seed
        Of random numbers; recorded with the results.
    live
        Show the run in the browser while it goes on, on this port of this machine, or of HOST:PORT, where
        anybody can look who gets there; 0 is any port that is free.
    """

    every: OfRuns[int] = 500
    learned: Annotated[Path | None, Parameter(name="--from", group="Of every run")] = None
    seed: OfRuns[Seed] = 0
    live: OfRuns[str | None] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.live is not None:
            read_address(self.live)
        if self.every < 1:
            raise ValueError(f"--every: got {self.every}, expected 1 or more frames")

    def settings(self) -> dict[str, Any]:
        """What the results depend on, beside the source: a run is resumed only with the same."""
        return {"from": resolved(self.learned), **super().settings(), "seed": self.seed}


def resolved(path: Path | None) -> str | None:
    """A path as it stands in settings."""
    return None if path is None else str(path.resolve())
