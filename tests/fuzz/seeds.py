"""Sound inputs of every reader, small and made by code: files by their names in a folder."""

import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.evaluation.predictions import FILE, PairRecord, ScoreRecord, write_predictions
from rsmcm.apps.io.files import LineWriter
from rsmcm.apps.io.tracks import HEADER, TABLE, TrackedBox, columns_of, table_lines
from rsmcm.inference import RecursiveBP
from rsmcm.inference.validity import RecordedPredictions
from rsmcm.models.face.model_files import write_model
from rsmcm.models.face.morphable_model import MorphableModel, rms_radius

from .folders import (
    batches,
    event_tables,
    finished_folders,
    moving_shapes,
    posed_folders,
    stopped_folders,
    watched_folders,
)
from .mutations import Files
from .networks import tiny_network
from .runs import finished_runs, first_round, runs_to_learn_from, saved_trackers, stopped_runs

WIDTH, HEIGHT = 64, 48
FILMS = {
    "film.mp4": ("libx264", "yuv420p"),
    "film.mkv": ("libx264", "yuv420p"),
    "film.avi": ("mjpeg", "yuvj420p"),
    "film.mjpeg": ("mjpeg", "yuvj420p"),
    "film.ts": ("mpeg2video", "yuv420p"),
    "film.mov": ("mpeg4", "yuv420p"),
    "foreground.mkv": ("ffv1", "gray"),
}
PICTURES = ("png", "jpg", "bmp", "tif", "webp", "ppm", "jp2")


def _picture(number: int = 0) -> NDArray[np.uint8]:
    texture = (60 + np.indices((HEIGHT, WIDTH, 3)).T @ [37, 53, 29] % 140).T.astype(np.uint8)
    return np.roll(np.asarray(cv2.GaussianBlur(texture, (9, 9), 0), np.uint8), number, axis=1)


def _encoded(suffix: str, image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(f".{suffix}", image)[1])


def _npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def _npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _films(folder: Path) -> list[Files]:
    made = []
    for name, (codec, pixels) in FILMS.items():
        with av.open(str(folder / name), "w") as file:
            stream = file.add_stream(codec, rate=Fraction(25))
            assert isinstance(stream, av.VideoStream)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
            for number in range(8):
                file.mux(stream.encode(av.VideoFrame.from_ndarray(_picture(number), format="bgr24")))
            file.mux(stream.encode(None))
        made.append({name: (folder / name).read_bytes()})
    return made


def _pictures(_: Path) -> list[Files]:
    grey = np.ascontiguousarray(_picture()[:, :, 0])
    made = [
        {f"frame{number}.{suffix}": _encoded(suffix, _picture(number)) for number in (1, 2)}
        for suffix in PICTURES
    ]
    clear = np.dstack([_picture(), grey])
    made += [{"a.png": _encoded("png", image)} for image in (clear, grey)]
    made += [{"a.pgm": _encoded("pgm", grey)}, {"a.jpg": _encoded("jpg", grey)}]
    for files in made[:2]:
        files["seqinfo.ini"] = b"[Sequence]\nname=a\nframeRate=14\nseqLength=2\nimExt=.png\n"
    return made


def _masks(_: Path) -> list[Files]:
    grey = np.ascontiguousarray(_picture()[:, :, 0])
    made: Files = {f"groundtruth/gt00000{number}.png": _encoded("png", grey) for number in (1, 2)}
    return [made | {"ROI.bmp": _encoded("bmp", grey), "temporalROI.txt": b"1 2\n"}]


def _regions(_: Path) -> list[Files]:
    return [{f"roi.{suffix}": _encoded(suffix, _picture())} for suffix in ("png", "jpg", "bmp", "tif")]


def _boxes(_: Path) -> list[Files]:
    rows = [(frame, who, 3 + frame, 5, 10, 20) for frame in range(1, 6) for who in (1, 2)]
    endings = ("1,-1,-1,-1", "1,3,0.5", "1")
    return [
        {"gt.txt": "".join(f"{','.join(map(str, row))},{ending}\n" for row in rows).encode()}
        for ending in endings
    ]


def _archives(_: Path) -> list[Files]:
    """Boxes as CVAT packs them, with labels and without."""
    lines = "".join(f"{frame},{who},{3 + frame},5,10,20,1,{who},1\n" for frame in (1, 2) for who in (1, 2))
    made = []
    for members in ({"gt/gt.txt": lines, "gt/labels.txt": "person\ncar\n"}, {"gt.txt": lines}):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in members.items():
                archive.writestr(name, text)
        made.append({"gt.txt": stream.getvalue()})
    return made


def _detections(_: Path) -> list[Files]:
    rows = [(frame, 3 + frame, 5, 10, 20, 0.5) for frame in range(1, 6) for _ in range(2)]
    results = [{"image_id": row[0], "category_id": 1, "bbox": row[1:5], "score": row[5]} for row in rows]
    data_set = {
        "images": [{"id": frame, "file_name": f"a/{frame:06d}.jpg"} for frame in range(1, 8)],
        "annotations": results,
        "categories": [{"id": 1, "name": "person"}],
    }
    lines = "".join(f"{','.join(map(str, row))},person\n" for row in rows)
    mot = "".join(f"{row[0]},-1,{','.join(map(str, row[1:]))},-1,-1,-1\n" for row in rows)
    return [
        {"det.txt": mot.encode()},
        {"found.csv": f"frame,x,y,width,height,score,class\n{lines}".encode()},
        {"results.json": json.dumps(results).encode()},
        {"data_set.json": json.dumps(data_set, indent=1).encode()},
    ]


def _keypoints(_: Path) -> list[Files]:
    places = [number for k in range(25) for number in (5 + k, 40 - k, 0.5)]
    results = [{"image_id": frame, "keypoints": places[:51], "score": 0.9} for frame in range(1, 6)]
    people = [{"pose_keypoints_2d": places, "hand_left_keypoints_2d": places[:63]}]
    names = ("nose", "neck", "left_shoulder", "left_wrist", "left_knee")
    rows = [
        f"{frame},{person},{name},{5 + k},{30 - k},0.5\n"
        for frame in range(1, 6)
        for person in (1, 2)
        for k, name in enumerate(names)
    ]
    files = {
        f"film_{number:012d}_keypoints.json": json.dumps({"version": 1.3, "people": people}).encode()
        for number in range(3)
    }
    return [
        {"found.csv": ("frame,person,joint,x,y,score\n" + "".join(rows)).encode()},
        {"results.json": json.dumps(results).encode()},
        files,
    ]


def _parameters(_: Path) -> list[Files]:
    return [
        {"a.toml": b"[background]\nprior = 0.9 # P\nsettle_time = 10.0\n\n[blobs]\nmax_hidden_time = 5.0\n"},
        {"a.toml": b'[background]\nmodel = "mixture"\n\n[ground]\n[blobs]\n'},
    ]


def _zones(_: Path) -> list[Files]:
    toml = (
        'units = "px"\nstill_after = 2.0\nmax_coast_time = 3\n\n[[zone]]\nname = "a"\n'
        "polygon = [[5, 5], [60, 5], [60.5, 40], [5, 40]]\n\n"
        '[[line]]\nname = "b"\nfrom = [1, 40]\nto = [60, 2]\nleft_to_right = "in"\nright_to_left = "out"\n'
    )
    shapes = [
        {"label": "a", "shape_type": "polygon", "points": [[5, 5], [60, 5], [60, 40]]},
        {"label": "b", "shape_type": "line", "points": [[5, 5], [60, 5]]},
    ]
    labelme = {"imageWidth": 64, "imageHeight": 48, "shapes": shapes}
    return [{"zones.toml": toml.encode()}, {"zones.json": json.dumps(labelme, indent=1).encode()}]


def _points(_: Path) -> list[Files]:
    points = np.random.default_rng(0).uniform(0, 99, (6, 7, 2))
    whole = points.astype(np.int16)
    points[1, 2] = np.nan
    flags, video = np.arange(42).reshape(6, 7) % 5 > 0, np.zeros((6, 48, 64, 3), np.uint8)
    return [
        {"a.npz": _npz(tracks=whole[None], visibility=flags[None])},
        {"a.npz": _npz(points=whole.swapaxes(0, 1) / 100, occluded=~flags.T, video=video)},
        {"a.npz": _npz(tracks=points)},
        {"a.npz": _npz(some=points.astype(np.float32))},
        {"a.npy": _npy(points)},
        {"a.npy": _npy(whole)},
    ]


def _models(folder: Path) -> list[Files]:
    random = np.random.default_rng(0)
    bases = random.normal(size=(3, 9, 3))
    model = MorphableModel(
        bases / rms_radius(bases[0]),
        random.integers(9, size=(5, 3)),
        1,
        ("mean", "wide", "smile"),
        np.arange(-1, 6),
    )
    write_model(model, folder / "a.npz")
    candide = (
        "# VERTEX LIST:\n4\n-1 1 0\n1 1 0\n0 -1 0.5\n7 7 7\n# FACE LIST:\n1\n0 2 1\n"
        "# ANIMATION UNITS LIST:\n1\n"
        "# Smile\n2\n0 0 0.1 0\n2 0.2 0 0.3\n# SHAPE UNITS LIST:\n1\n# Width\n1\n0 -0.3 0 0\n"
    )
    mesh = "# a square\nv -1 1 0\nv 1 1 0 1.0\nv 1 -1 0\nv -1 -1 0\nvt 0 0\nf 4/1 3/1/2 2//3 1\nf -4 -1 -2\n"
    return [
        {"a.npz": (folder / "a.npz").read_bytes()},
        {"a.wfm": candide.encode()},
        {"a.obj": mesh.encode()},
        _surrey(),
    ]


def _surrey() -> Files:
    random = np.random.default_rng(0)

    def matrix(*shape: int) -> bytes:
        values = np.abs(random.normal(size=shape)).astype("<f4")
        return np.array(shape, "<i4").tobytes() + values.tobytes("F")

    triangles = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 0]], "<i4")
    shape = np.array([1], "<i4").tobytes() + matrix(18, 1) + matrix(18, 2) + matrix(2, 1)
    return {
        "sfm_shape_3448.bin": shape + np.array([3], "<u8").tobytes() + triangles.tobytes() + b"texture",
        "expression_blendshapes_3448.bin": np.array([1, 5], "<u8").tobytes() + b"happy" + matrix(18, 1),
        "sfm_reference.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "ibug_to_sfm.txt": b"# words\n[landmark_mappings]\n  2 = 1 # nose\n30 = 5\n",
    }


def _correspondences(_: Path) -> list[Files]:
    return [{"pairs.txt": b"# index = number\n0 = 1\n1 = 2\n 7=9 # chin\n12 = 3\n"}]


def _states(folder: Path) -> list[Files]:
    from .readers import background_engine

    engine: RecursiveBP = background_engine()
    *_, belief = engine.run([_picture(number) for number in range(4)])
    engine.save(folder / "state.npz", belief.state, {"settings": {"a": 1}})
    return [{"state.npz": (folder / "state.npz").read_bytes()}]


def _predictions(folder: Path) -> list[Files]:
    random = np.random.default_rng(0)
    first, second, observed = random.normal(size=(3, 24, 2))
    noise = np.tile(np.eye(2), (24, 1, 1))
    predictions = RecordedPredictions(first, second, observed, noise, noise, noise)
    tracks, frames = np.arange(24) % 6, np.arange(24) // 6 + 1
    scores = ScoreRecord("a", "b", "pixels", "a pixel", random.normal(size=(24, 3)), frames)
    write_predictions(folder, [PairRecord("a", "b", "points", "px", predictions, tracks, frames), scores])
    return [{FILE: (folder / FILE).read_bytes()}]


def _exports(folder: Path) -> list[Files]:
    with LineWriter(folder / TABLE, [HEADER]) as table:
        for number in (1, 2, 3):
            tracks = [TrackedBox(who, (5.0 * who, 6.0, 20.0, 30.0)) for who in range(1, number)]
            table.append(table_lines(number, number / 25, columns_of(tracks)))
    summary = {"size": [WIDTH, HEIGHT], "rate": 25.0, "first_frame": 1, "last_frame": 3}
    summary |= {"source": "film.mp4", "frames": 3, "parameters": {"step": 1}}
    masks = {f"foreground/bin00000{number}.png": _encoded("png", _picture()) for number in (1, 2, 3)}
    return [
        {
            "manifest.json": json.dumps({"application": "background", "files": [TABLE]}).encode(),
            "summary.json": json.dumps(summary).encode(),
            TABLE: (folder / TABLE).read_bytes(),
            **masks,
        }
    ]


def _detectors(_: Path) -> list[Files]:
    return [{"faces.onnx": tiny_network()}]


MAKERS: dict[str, Callable[[Path], list[Files]]] = {
    "films": _films,
    "pictures": _pictures,
    "masks": _masks,
    "regions": _regions,
    "boxes": _boxes,
    "archives": _archives,
    "results": _boxes,
    "detections": _detections,
    "keypoints": _keypoints,
    "parameters": _parameters,
    "zones": _zones,
    "tracks": _points,
    "landmarks": _points,
    "models": _models,
    "correspondences": _correspondences,
    "states": _states,
    "predictions": _predictions,
    "exports": _exports,
    "detectors": _detectors,
    "continued": stopped_folders,
    "poses": posed_folders,
    "videos": finished_folders,
    "recounts": watched_folders,
    "summaries": batches,
    "events": event_tables,
    "shapes": moving_shapes,
    "resumed": stopped_runs,
    "learned": runs_to_learn_from,
    "rounds": first_round,
    "finished": finished_runs,
    "trackers": saved_trackers,
}


def made(readers: Iterable[str]) -> dict[str, list[Files]]:
    """The inputs of some readers."""
    with tempfile.TemporaryDirectory() as top:
        found = {}
        for name in readers:
            folder = Path(top) / name
            folder.mkdir()
            found[name] = MAKERS[name](folder)
        return found
