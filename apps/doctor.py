"""`rsmcm doctor`: what is installed, what each command lacks, and whether tracking works on this machine."""

import importlib.metadata
import platform
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import av
import cv2
import numba
import numpy as np
from joblib import cpu_count

from ..models.numerics import compiled
from ..models.numerics.threads import thread_count
from .io.files import LOSSLESS_GRAY, PLAYABLE
from .runs.progress import Progress
from .runs.session import versions
from .scenes import sleeping_man
from .trackers.objects import ObjectTracker

EXTRAS = {
    "dask": ("distributed", "--dask of rsmcm batch and reproduce"),
    "xarray": ("xarray", "rsmcm export --to movement"),
    "tune": ("optuna", "rsmcm tune"),
    "supervision": ("supervision", "results as supervision.Detections, in Python"),
}
"""Of `pyproject.toml`: the package that each brings, and what lacks without it."""

DECODERS = ("h264", "hevc", "mjpeg", "mpeg4", "vp9", "av1")

SELF_TEST_SECONDS = 10.0
SELF_TEST_FRAMES = 200
LEAST_OVERLAP = 0.3
"""Of the found foreground with the true one, intersection over union, in the mean over frames."""


def examine() -> bool:
    """Print a line for each finding; return whether all that every run needs is there."""
    wrong = []
    for about, text, is_right in _findings():
        print(f"{about + ':':<14} {text}", flush=True)
        if not is_right:
            wrong.append(about)
    print(f"wrong: {', '.join(wrong)}" if wrong else "all that every run needs is there")
    return not wrong


def _findings() -> Iterator[tuple[str, str, bool]]:
    """What is examined, what was found, and whether a run can do with it."""
    yield "versions", ", ".join(f"{name} {version}" for name, version in versions().items()), True
    yield "system", f"{platform.platform()}, {sys.executable}", True
    yield "threads", f"{thread_count()} of {cpu_count()} cores (--threads)", True

    folder = compiled.cache_folder(Path(compiled.__file__), numba.config.CACHE_DIR)  # type: ignore[attr-defined]
    kept = "not kept, each process compiles anew (see NUMBA_CACHE_DIR)" if folder is None else folder.parent
    yield "compiled code", str(kept), True

    lacking = [form.codec for form in (PLAYABLE, LOSSLESS_GRAY) if not _has_codec(form.codec, "w")]
    yield "videos written", f"cannot encode {', '.join(lacking)}" if lacking else "yes", not lacking
    readable = [name for name in DECODERS if _has_codec(name, "r")]
    yield "videos read", ", ".join(readable), "h264" in readable

    cameras = sorted(path.name.removeprefix("video") for path in Path("/dev").glob("video*"))
    unknown = "not looked for on this system" if sys.platform != "linux" else "none"
    yield "cameras", ", ".join(cameras) or unknown, True

    for extra, (package, use) in EXTRAS.items():
        found = find_spec(package) is not None
        lacks = f"needed for {use}: pip install 'rsmcm[{extra}]'"
        yield extra, importlib.metadata.version(package) if found else lacks, True
    lacks = f"OpenCV {cv2.__version__} brings none: rsmcm face needs landmarks, or a file of YuNet"
    yield "face detector", "Haar cascades" if hasattr(cv2, "CascadeClassifier") else lacks, True

    yield "self test", *_self_test()


def _has_codec(name: str, mode: Literal["r", "w"]) -> bool:
    try:
        av.Codec(name, mode)
    except av.codec.codec.UnknownCodecError:
        return False
    return True


def _self_test() -> tuple[str, bool]:
    """Track a person in a generated street for up to ten seconds; how that went, and whether he was found."""
    scene = sleeping_man(SELF_TEST_FRAMES, size=(160, 120), enter=20)
    tracker = ObjectTracker()
    overlaps: list[float] = []
    seconds = 0.0
    with Progress("self test", len(scene)) as progress:
        for frame, truth in zip(scene, scene.masks, strict=True):
            assert frame.image is not None
            began = compiled.work_clock()
            found = tracker.update(frame.image, time=frame.time).foreground > 0
            seconds += compiled.work_clock() - began
            if truth.any():
                overlaps.append(np.count_nonzero(found & truth) / np.count_nonzero(found | truth))
            if seconds > SELF_TEST_SECONDS and overlaps:
                break
            progress.update()
    overlap = float(np.mean(overlaps))
    speed = f"{frame.number} frames of 160x120, {frame.number / seconds:.0f} a second"
    return f"{speed}, overlap of masks with the truth {overlap:.2f}", overlap >= LEAST_OVERLAP
