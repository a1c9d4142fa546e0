"""Films of finished runs with their results drawn on them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import av
import cv2
import numpy as np

from ...models.array_files import read_arrays
from ...models.core.checks import checked
from ...models.core.frame import Frame
from ...models.files import fitting, write_atomically
from ..body.page import drawing, with_final_names
from ..io.zones import read_zones
from ..runs.progress import Progress
from ..view.film import FILM, ROWS, Film, read_film
from ..view.overlay import Draw, OverlayVideo, PointsOverlay, TracksOverlay, draw_face
from .finished_run import SUMMARY, FinishedRun
from .movement import POSES


@checked
def to_video(run: str | Path, out: str | Path) -> str:
    """Write the film of a run, which its page plays, with the results drawn on it, as MP4.

    Its pictures are of the size of the source, but their detail is that of `film.mp4`, whose sides are at
    most 640 px; `--video` of the run itself draws on the frames as they are. Returns a
    line on what was written.

    Raises
    ------
    ValueError
        if the folder holds no run with a film, or its files are damaged.
    OSError
        if a file cannot be read or written.
    """
    finished = FinishedRun.of(run, *_DRAWINGS)
    if not (finished.folder / FILM).exists() or not (finished.folder / ROWS).exists():
        raise ValueError(f"{finished.folder}: holds no film, expected {FILM} and {ROWS}")
    film = read_film(finished.folder)
    if finished.summary.get("relabelled"):
        path, expected = finished.folder / POSES, "expected the poses of a body"
        with fitting(path, expected):
            film = with_final_names(film, read_arrays(path, expected, most=path.stat().st_size))
    with fitting(finished.folder / SUMMARY, f"expected the summary of rsmcm {finished.application}"):
        draw = _DRAWINGS[finished.application](finished)
    span = film.times[-1] - film.times[0]
    rate = (len(film.times) - 1) / span if span > 0 else 25.0
    with (
        fitting(finished.folder / ROWS, f"expected the film of rsmcm {finished.application}"),
        write_atomically(Path(out)) as unfinished,
        OverlayVideo(unfinished, rate, draw) as video,
        Progress("video", len(film.numbers)) as progress,
    ):
        for index, frame in enumerate(_frames(film)):
            video.add(frame, lambda index=index: film.row(index))  # type: ignore[misc]
            progress.update()
    return f"{len(film.numbers)} frames"


def _frames(film: Film) -> Iterator[Frame]:
    """The pictures of a film in the size of its source."""
    assert film.path is not None
    numbered = zip(film.numbers.tolist(), film.times.tolist(), strict=True)
    try:
        with av.open(str(film.path)) as container:
            for picture, (number, time) in zip(container.decode(video=0), numbered, strict=True):
                image = cv2.resize(picture.to_ndarray(format="bgr24"), film.size)
                yield Frame(np.asarray(image, np.uint8), time, number)
    except (av.FFmpegError, ValueError) as error:
        raise ValueError(f"{film.path}: got a damaged film ({error})") from None


def _of_tracks(finished: FinishedRun) -> Draw:
    """Zones are drawn if their file is still there."""
    about = finished.summary.get("parameters", {}).get("zones")
    path = Path(about["file"]) if isinstance(about, dict) else None
    return TracksOverlay(read_zones(path, finished.size) if path is not None and path.exists() else None)


def _of_a_body(finished: FinishedRun) -> Draw:
    lengths = finished.summary["body"]["lengths"]
    return drawing(lengths["upper_arm"] + lengths["forearm"])


_DRAWINGS: dict[str, Callable[[FinishedRun], Draw]] = {
    "background": _of_tracks,
    "structure": lambda _: PointsOverlay(),
    "face": lambda _: draw_face,
    "body": _of_a_body,
}
