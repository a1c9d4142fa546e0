"""Runs that were stopped and trackers that were saved, and what goes on from their states."""

import contextlib
import json
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps import BodyTracker, FaceTracker, ObjectTracker, PointTracker
from rsmcm.apps.background.application import Background, run_background
from rsmcm.apps.batch.application import run_film as run_one_of_many
from rsmcm.apps.batch.job import job_of
from rsmcm.apps.batch.summary import Line, Summary
from rsmcm.apps.body.application import Body
from rsmcm.apps.face.application import Face, _given_landmarks
from rsmcm.apps.io.row_log import RowLog
from rsmcm.apps.io.sources.open_source import open_source
from rsmcm.apps.options.job import FilmJob
from rsmcm.apps.runs.loop import Application, Output, Start, run_film
from rsmcm.apps.runs.saved_run import STATE, SavedRun, save_run
from rsmcm.apps.runs.session import Session
from rsmcm.apps.scenes import cylinder, face, signer, turntable
from rsmcm.apps.structure.application import read_film, run_structure
from rsmcm.apps.structure.job import StructureJob
from rsmcm.apps.structure.recursive import RecursiveRun
from rsmcm.chains.reconstruction import structure_engine
from rsmcm.models.body.upper_body import JOINTS
from rsmcm.models.face.built_in_model import face_model

from .mutations import Files

RUN = "run.json"
"""What was run: the application, its options, and of a tracker which one."""
N_FRAMES, STOPPED, SHAPED = 28, 25, 16
MIXTURE = b'[background]\nmodel = "mixture"\n'
ZONES = b'[[zone]]\nname = "a"\npolygon = [[5, 5], [60, 5], [60, 40], [5, 40]]\n'
TRACKERS: dict[str, Callable[[], Any]] = {
    "objects": ObjectTracker,
    "face": lambda: FaceTracker(experts=3),
    "body": lambda: BodyTracker(samples=20),
    "points": PointTracker,
}

Images = list[NDArray[np.uint8]]


@cache
def _job_of(name: str, *options: str) -> Any:
    return job_of(name, options)


def application_of(words: list[str]) -> Application[Any]:
    """The application with its job, from its name and options."""
    name, *_ = words
    job = _job_of(*words)
    if name == "face":
        return Face(job, face_model(), _given_landmarks(job))
    kinds: dict[str, Any] = {"background": Background, "body": Body, "structure": RecursiveRun}
    return kinds[name](job)


# --- what is stopped ----------------------------------------------------------------------------------------


def walker(shaken: bool = False) -> Images:
    """Somebody bright who comes in before the last frames, before a texture."""
    random = np.random.default_rng(0)
    scene = np.kron(random.integers(40, 160, (13, 17, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    images = []
    for number in range(1, N_FRAMES + 1):
        shift = (number % 3, number % 2) if shaken else (0, 0)
        image = np.roll(scene, shift, axis=(0, 1))[:64, :96].copy()
        if number > N_FRAMES - 10:
            image[20:50, 3 * (number - 14) : 3 * (number - 14) + 12] = 230
        images.append(image)
    return images


def _film(path: Path, images: Iterable[NDArray[np.uint8]]) -> str:
    with av.open(str(path), "w") as file:
        for number, image in enumerate(images):
            if not number:
                stream = file.add_stream("ffv1", rate=Fraction(25))
                stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "bgr0"
            whole = np.ascontiguousarray(np.broadcast_to(np.atleast_3d(image), (*image.shape[:2], 3)))
            file.mux(stream.encode(av.VideoFrame.from_ndarray(whole, format="bgr24")))
        file.mux(stream.encode(None))
    return str(path)


def _signer() -> tuple[Images, str]:
    scene = signer(8, 3, 0.0, 0.3, (160, 120))
    width, height = scene.body.head_width, scene.body.head_height
    x, y = scene.joints[0, JOINTS.index("head"), :2] - (width / 2, height / 2)
    return list(scene.images()), f"{x:.0f},{y:.0f},{width:.0f},{height:.0f}"


def stopped_runs(folder: Path) -> list[Files]:
    """States of runs that a signal has stopped, of every application and engine, with their sources."""
    (folder / "mixture.toml").write_bytes(MIXTURE)
    (folder / "zones.toml").write_bytes(ZONES)
    boxes = [f"{number},-1,{3 * (number - 14)},20,12,30,0.9,-1,-1,-1\n" for number in range(20, N_FRAMES + 1)]
    (folder / "det.txt").write_text("".join(boxes))
    (folder / "gt.txt").write_text("".join(line.replace(",-1,", ",1,", 1) for line in boxes))
    talking, (signing, head) = face(8, 3, (100, 80)), _signer()
    np.save(folder / "landmarks.npy", talking.vertices)
    _film(folder / "street.mkv", walker())
    _film(folder / "shaken.mkv", walker(shaken=True))
    given = ("zones.toml", "det.txt", "gt.txt")
    options = ("--zones", "--detections", "--ground-truth")
    known = [word for pair in zip(options, given, strict=True) for word in pair]
    background = ["background", "street.mkv", "--masks", "none"]
    runs: list[tuple[list[str], int, tuple[str, ...]]] = [
        ([*background, *known], STOPPED, given),
        ([*background, "--config", "mixture.toml"], STOPPED, ("mixture.toml",)),
        ([*background, "--engine", "feed-forward"], STOPPED, ()),
        ([*background, "--engine", "stand-alone"], STOPPED, ()),
        ([*background, "--engine", "coordinate-ascent"], STOPPED, ()),
        ([*background, "--warm-up", "0.4"], STOPPED, ()),
        (["background", "shaken.mkv", "--masks", "none", "--camera", "moving"], STOPPED, ()),
        (["structure", "turned.mkv", "--engine", "recursive-bp"], SHAPED, ()),
        (["face", "face.mkv", "--landmarks", "landmarks.npy", "--experts", "3"], 4, ("landmarks.npy",)),
        (["body", "body.mkv", "--head", head, "--samples", "20", "--lag", "0"], 4, ()),
        (["body", "body.mkv", "--head", head, "--samples", "20", "--lag", "2"], 4, ()),
    ]
    _film(folder / "turned.mkv", turntable(SHAPED + 3, (96, 120), 4.0).images)
    _film(folder / "face.mkv", talking.images())
    _film(folder / "body.mkv", signing)
    made = []
    with contextlib.chdir(folder):
        for number, (words, after, files) in enumerate(runs):
            out = folder / str(number)
            _stop(application_of([*words, "--out", str(out)]), after)
            made.append(
                {
                    RUN: json.dumps(words).encode(),
                    STATE: (out / STATE).read_bytes(),
                    **{name: (folder / name).read_bytes() for name in (words[1], *files)},
                }
            )
    return made


def runs_to_learn_from(folder: Path) -> list[Files]:
    """Those of the runs whose options `--from` goes with."""
    without = (b"coordinate-ascent", b"--warm-up")
    return [files for files in stopped_runs(folder) if not any(each in files[RUN] for each in without)]


def _stop(application: Application[Any], after: int) -> None:
    """Run it until a signal comes in a frame."""
    columns = application.columns

    def until(belief: Any) -> Any:
        if belief.frame.number == after:
            signal.raise_signal(signal.SIGTERM)
        return columns(belief)

    application.columns = until  # type: ignore[method-assign]
    run_film(application)


def first_round(folder: Path) -> list[Files]:
    """A state of the ascent of `rsmcm structure`, after its first round."""
    tracks = 100 * cylinder(n_frames=8, n_points=20, p_loose=0.1, p_drift=0.1, seed=1).tracks() + 200
    np.savez(folder / "tracks.npz", tracks=tracks)
    film, engine = _ascent(folder)
    engine.save(folder / STATE, next(iter(engine.rounds(film.frames))))
    return [{name: (folder / name).read_bytes() for name in (STATE, "tracks.npz")}]


def _ascent(folder: Path) -> tuple[Any, Any]:
    job = StructureJob(str(folder / "tracks.npz"), out=folder)
    film = read_film(job)
    return film, structure_engine(film.frames, job.coherence, job.association, job.robust)


def finished_runs(folder: Path) -> list[Files]:
    """States of runs that have come to their end, with their sources."""
    made = []
    _film(folder / "street.mkv", walker()[-12:])
    np.savez(folder / "tracks.npz", tracks=np.random.default_rng(0).uniform(0, 99, (4, 5, 2)))
    with contextlib.chdir(folder):
        for number, (name, source) in enumerate((("background", "street.mkv"), ("structure", "tracks.npz"))):
            out = folder / str(number)
            assert run_one_of_many(name, job_of(name, [source, "--out", str(out)])).state
            kept = {f"out/{each}": (out / each).read_bytes() for each in ("manifest.json", "summary.json")}
            made.append(
                {
                    RUN: json.dumps([name, source, "--out", "out", "--resume"]).encode(),
                    STATE: (out / STATE).read_bytes(),
                    source: (folder / source).read_bytes(),
                    **kept,
                }
            )
    return made


def saved_trackers(folder: Path) -> list[Files]:
    """States of trackers, with the image that comes next."""
    made = []
    signing, head = _signer()
    x, y, width, height = map(float, head.split(","))
    talking = face(8, 3, (100, 80))
    low, high = (getattr(talking.vertices[0], name)(axis=0) for name in ("min", "max"))
    given: dict[str, tuple[Images, dict[str, Any]]] = {
        "objects": (walker(), {}),
        "face": (list(talking.images()), {"box": (*low, *high)}),
        "body": (signing, {"head": (x, y, x + width, y + height)}),
        "points": (walker(shaken=True), {}),
    }
    for name, (images, first) in given.items():
        tracker = TRACKERS[name]()
        for number, image in enumerate(images[:-1]):
            tracker.update(image, **(first if number == 0 else {}))
        tracker.save(folder / STATE)
        np.save(folder / "next.npy", images[-1])
        files = {each: (folder / each).read_bytes() for each in (STATE, "next.npy")}
        made.append({RUN: json.dumps(name).encode(), **files})
    return made


# --- what goes on -------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _in(folder: Path) -> Iterator[None]:
    """Inside, the folder is the current one; errors name it, and warnings of huge numbers are left out."""
    with contextlib.chdir(folder), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield
        except (ValueError, MemoryError) as error:
            raise ValueError(f"{folder}: {error}") from error


def resumed(folder: Path) -> None:
    """A run from the state that another one has left: as `--resume` does, for two frames."""
    with _in(folder):
        _go_on(folder, resume=True)


def learned(folder: Path) -> None:
    """A run that takes what another one has learned: as `--from` does, for two frames."""
    with _in(folder):
        _go_on(folder, resume=False)


def _go_on(folder: Path, resume: bool) -> None:
    application = application_of([*json.loads((folder / RUN).read_bytes()), "--out", "."])
    job: FilmJob = application.job
    saved = SavedRun(folder / STATE, application.name)
    with open_source(job.source, after=saved.number if resume else 0) as source:
        session = Session(application.name, job, application.settings)
        session.fingerprint = source.fingerprint()
        start = Start(
            job,
            source,
            session,
            saved if resume else None,
            None if resume else saved,
            application.blank_is_missing,
        )
        engine = application.build(start)
        rate, after = source.rate, engine.state.number
        with RowLog(folder / "rows", after) as log, contextlib.ExitStack() as files:
            for sink in application.sinks(Output(folder, rate, after, log)):
                if sink.file is not None:
                    files.enter_context(sink.file)
            beliefs = [belief for frame in islice(start.frames, 2) for belief in engine.step(frame)]
            for belief in [*beliefs, *engine.flush()]:
                application.columns(belief).view_row()
        about = {**saved.about, "before": [], "blank": [], "notes": [], "clock": 0.0}
        state, memory = engine.state, application.state_dict()
        save_run(folder / STATE, about, state, engine.model.chains, memory, application.schema)


def rounds(folder: Path) -> None:
    """A round of the ascent of `rsmcm structure` from a state, and what is saved of it."""
    with _in(folder):
        film, engine = _ascent(folder)
        solution, _ = engine.load(folder / STATE, film.frames)
        for better in islice(engine.rounds(film.frames, after=solution), 1):
            engine.save(folder / STATE, better)


def finished(folder: Path) -> None:
    """A run and a batch that find everything done, by what its state says."""
    with _in(folder):
        name, *words = json.loads((folder / RUN).read_bytes())
        job: Any = _job_of(name, *words)
        (folder / STATE).rename(folder / "out" / STATE)
        status = run_one_of_many(name, job)
        Summary(folder).tell(Line(job.source, "out", status))
        run = {"background": run_background, "structure": run_structure}[name](job)
        assert all(isinstance(line, str) for line in run.words)


def trackers(folder: Path) -> None:
    """A tracker that takes up a state, and answers one more image."""
    with _in(folder):
        tracker = TRACKERS[json.loads((folder / RUN).read_bytes())]()
        tracker.load(folder / STATE)
        tracker.update(np.load(folder / "next.npy"))
        tracker.save(folder / STATE)
