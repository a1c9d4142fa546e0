"""Tracks as MOTChallenge takes them, and TrackEval: a text file for each sequence of a benchmark."""

from pathlib import Path

from ...models.core.checks import checked
from ...models.files import write_text
from ..io.tracks import PICTURES, mot_line
from .finished_run import SUMMARY, FinishedRun

DATA = "data"
"""TrackEval's folder of a tracker has the files in a folder of this name."""


@checked
def to_motchallenge(run: str | Path, out: str | Path) -> str:
    """Write `data/SEQUENCE.txt` for a background run, or for each run in the folder of a batch.

    The folder is that of a tracker for TrackEval; packed, its `data` is what MOTChallenge takes. A sequence
    has the name of its folder where its source is `img1` there, else that of the run's folder. A line is
    frame, identity, x, y, width, height (px from 1, two decimals), confidence, -1, -1, -1.

    Returns
    -------
    str
        what was written, in words.

    Raises
    ------
    ValueError
        if the folder holds no background run, its files are damaged, or two sequences have one name.
    OSError
        if a file cannot be read or written.
    """
    run, folders = Path(run), [Path(run)]
    if run.is_dir() and not (run / SUMMARY).exists():  # of a batch
        folders = sorted(path.parent for path in run.glob(f"*/{SUMMARY}")) or folders
    runs: dict[str, FinishedRun] = {}
    for finished in (FinishedRun.of(folder, "background") for folder in folders):
        source = Path(finished.source)
        name = source.absolute().parent.name if source.name == PICTURES else finished.folder.absolute().name
        if name in runs:
            raise ValueError(f"{finished.folder}: got the sequence {name} twice, also {runs[name].folder}")
        runs[name] = finished
    (Path(out) / DATA).mkdir(parents=True, exist_ok=True)
    boxes = 0
    for name, finished in runs.items():
        lines = [mot_line(frame.number, track) for frame in finished.frames(False) for track in frame.tracks]
        write_text(Path(out) / DATA / f"{name}.txt", "".join(f"{line}\n" for line in lines))
        boxes += len(lines)
    return f"{boxes} boxes of {len(runs)} sequence{'s' * (len(runs) != 1)}"
