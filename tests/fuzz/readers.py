"""How the applications read each kind of input, from a folder with its files, up to its first use."""

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
from rsmcm.apps.background.application import build_model
from rsmcm.apps.background.parameters import read_parameters, with_defaults
from rsmcm.apps.evaluation.scoring import Scoring
from rsmcm.apps.evaluation.tracks import track_rows
from rsmcm.apps.evaluation.validity import report_validity
from rsmcm.apps.events import Sighting, Watch, read_zones
from rsmcm.apps.exports import to_coco, to_cvat, to_movement
from rsmcm.apps.io.detections import read_detections
from rsmcm.apps.io.ground_truth import BoxTruth, read_ground_truth
from rsmcm.apps.io.keypoints import read_keypoints
from rsmcm.apps.io.point_files import read_points
from rsmcm.apps.io.sources.open_source import IMAGE_SUFFIXES, open_source
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.runs.region import read_region
from rsmcm.apps.structure.application import read_film
from rsmcm.apps.structure.job import StructureJob
from rsmcm.inference import RecursiveBP
from rsmcm.models.core.frame import Frame
from rsmcm.models.face.detectors import default_faces
from rsmcm.models.face.model_files import read_correspondences, read_model
from rsmcm.models.face.morphable_model import Poses

from .folders import continued, events, poses, recounts, shapes, summaries, videos
from .runs import finished, learned, resumed, rounds, trackers

SIZE = (64, 48)
MOST_FRAMES = 10_000  # of a film that has eight: more are made up
IMAGE = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)


def _file(folder: Path) -> Path:
    """The only file of a folder, also of one in which it is not there."""
    return min((path for path in folder.rglob("*") if path.is_file()), default=folder / "nothing")


def background_engine() -> RecursiveBP:
    """The engine of the background application."""
    return RecursiveBP(build_model())


def films(folder: Path) -> None:
    """A film, to its end."""
    with open_source(str(_file(folder))) as source:
        if sum(1 for _ in islice(source, MOST_FRAMES)) == MOST_FRAMES:
            raise AssertionError(f"{MOST_FRAMES} frames and more")


def pictures(folder: Path) -> None:
    """A folder of images, and the first image by itself."""
    with open_source(str(folder)) as source:
        for _ in source:
            pass
    first = min(path for path in folder.iterdir() if path.suffix in IMAGE_SUFFIXES)
    with open_source(str(first)) as source:
        next(source)


def masks(folder: Path) -> None:
    """Labelled masks with both regions of interest."""
    truth = read_ground_truth(folder)
    scoring = Scoring(truth)
    for number in islice(truth.frames, 10):
        scoring.add(number, np.zeros((SIZE[1], SIZE[0]), np.uint8))
    scoring.measures(None)


def regions(folder: Path) -> None:
    """A picture of a region of interest."""
    read_region(str(_file(folder)), SIZE)


def boxes(folder: Path) -> None:
    """True boxes, and scores against them."""
    truth = read_ground_truth(folder / "gt.txt")
    assert isinstance(truth, BoxTruth)
    scoring = Scoring(truth)
    for number in islice(truth.frames, 10):
        scoring.add(number, np.zeros((SIZE[1], SIZE[0]), np.uint8))
    scoring.measures(np.array([[1.0, 1, 3, 5, 10, 20]]))


def archives(folder: Path) -> None:
    """True boxes in a zip file."""
    boxes(folder)


def results(folder: Path) -> None:
    """Boxes that a run has written."""
    track_rows(read_tracks(folder / "gt.txt"))


def detections(folder: Path) -> None:
    """Boxes that a detector has found, checked against a film, and those of its frames."""
    found = read_detections(_file(folder), film=str(folder))
    found.check(str(folder), SIZE, MOST_FRAMES)
    for number in range(20):
        found.at(number)


def keypoints(folder: Path) -> None:
    """Points that a detector has found of persons, checked against a film, and those of its frames."""
    path = folder if any(folder.glob("*_keypoints.json")) else _file(folder)
    found = read_keypoints(path, film=str(folder))
    found.check(str(folder), SIZE, MOST_FRAMES)
    for number in range(20):
        found.at(number)


def parameters(folder: Path) -> None:
    """Parameters, as far as chains that have them."""
    read = read_parameters(_file(folder))
    build_model("recursive-bp", read)
    with_defaults(read)


def zones(folder: Path) -> None:
    """Zones and lines, and somebody who walks through the picture."""
    watch = Watch(read_zones(_file(folder), SIZE))
    for number in range(1, 20):
        watch.update(number / 5, number, [Sighting(1, 3.0 * number, 2.0 * number, 20.0, number % 3 > 0)])
    watch.end(19)


def tracks(folder: Path) -> None:
    """Tracks for structure from motion."""
    read_film(StructureJob(str(_file(folder)), out=folder / "out"))


def landmarks(folder: Path) -> None:
    """Landmarks, or tracks for a shape."""
    read_points(_file(folder))


def models(folder: Path) -> None:
    """A morphable model, drawn in a pose."""
    path = folder if (folder / "sfm_shape_3448.bin").exists() else _file(folder)
    model = read_model(path)
    morphs = np.zeros((1, model.n_bases))
    morphs[0, 0] = 30
    assert np.isfinite(model.project(Poses(np.eye(3)[None], np.full((1, 2), 30.0), morphs))).all()


def correspondences(folder: Path) -> None:
    """Pairs of landmarks."""
    read_correspondences(_file(folder))


def states(folder: Path) -> None:
    """A saved state, and one more step from it."""
    engine = background_engine()
    state, _ = engine.load(_file(folder))
    engine.step(state, Frame(IMAGE, state.time + 0.04, state.number + 1))


def predictions(folder: Path) -> None:
    """What chains predicted, and what it says of them."""
    report_validity(folder)


def exports(folder: Path) -> None:
    """Results of a run, for other tools."""
    for to in (to_coco, to_cvat, to_movement):
        to(folder, folder / f"{to.__name__}.out")


def detectors(folder: Path) -> None:
    """A network that finds faces, and what it finds."""
    default_faces(_file(folder))(Frame(IMAGE, 0.0, 1))


FORGED = {"resumed", "learned", "rounds", "finished", "trackers"}
"""Those whose inputs are states with other values, not damaged files."""

SLOW = {"detectors": 20, "continued": 5, "videos": 2, **dict.fromkeys(FORGED, 2)}
"""How many times fewer inputs: each starts a process of its own, is a run, or ends with a video."""

READERS: dict[str, Callable[[Path], None]] = {
    reader.__name__: reader
    for reader in (
        films, pictures, masks, regions, boxes, archives, results, detections, keypoints, parameters, zones,
        tracks, landmarks, models, correspondences, states, predictions, exports, detectors,
        continued, poses, videos, recounts, summaries, events, shapes,
        resumed, learned, rounds, finished, trackers,
    )
}  # fmt: skip
