"""Face detectors: their protocol, and those of OpenCV."""

import subprocess
import sys
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.checks import Count, Positive, checked
from ..core.frame import Frame
from ..core.pictures import grey_of
from ..core.short_repr import short_repr

Array = NDArray[np.float64]

FRONTAL, PROFILE = "haarcascade_frontalface_default.xml", "haarcascade_profileface.xml"
UPRIGHT = "haarcascade_frontalface_alt2.xml"
"""At a known size and place, this cascade detects 118 of 120 faces that turn and talk; `FRONTAL` detects 111
with twice as many errors."""

LEAST_SURE = 0.6  # least score of a detection of YuNet's

MOST_BYTES = 1 << 26  # of a file; YuNet's has 230,000, OpenCV's largest cascade 3 million
PROBE_TIMEOUT = 8.0  # seconds
NETWORK_PROBE = """
import sys, cv2, numpy
network = cv2.FaceDetectorYN.create(sys.argv[1], "", (320, 320))
network.detect(numpy.zeros((320, 320, 3), numpy.uint8))
"""
CASCADE_PROBE = """
import sys, cv2, numpy
cascade = cv2.CascadeClassifier()
content = open(sys.argv[1], encoding="utf-8").read()
mode = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
storage = cv2.FileStorage(content, mode)
assert cascade.read(storage.getFirstTopLevelNode())
cascade.detectMultiScale(numpy.random.default_rng(0).integers(0, 255, (120, 160)).astype(numpy.uint8))
"""

FRONTAL_PIXELS, PROFILE_PIXELS = 52.0, 36.0
"""px: height to which a face of known size is scaled. The cascades were trained at 24 and 20, and often miss
faces below these sizes; larger ones only cost time."""

SIZES = (0.7, 1.5)  # range of detected heights over the given one
STEP, MIN_NEIGHBORS = 1.1, 4  # OpenCV's `scaleFactor` and `minNeighbors`
FACE = 52  # px: width of a face in pictures made for a detector, twice that of the cascades' training
SURELY = 9
"""`min_neighbors` of the cascade's second look, which confirms a face. In 69 pictures of things without one,
the first look finds 13, of which it confirms none; in 140 of four films with a face 129, of which 118."""


@runtime_checkable
class PartDetector(Protocol):
    """Face detector: an object or a function."""

    def __call__(self, frame: Frame) -> Array:
        """Return boxes `(k, 4)` px of faces: x, y, width, height, the surest or largest first; k may be 0."""
        ...


@checked
@short_repr
@dataclass(frozen=True)
class HaarFaces:
    """Face detector by the Haar cascades of OpenCV 4.

    Faces of any size are detected from the front; of a given height, if there are none, also in profile. On
    125 frames of a signer this raises the number of detected faces from 81 to 122, in less time.

    Parameters
    ----------
    height
        px: of a face's box. Faces from 0.7 to 1.5 times as high are detected; by default those above an
        eighth of the image's shorter side.
    min_neighbors
        minimum number of neighbouring detections, for faces of known height.
    upright
        whether to detect upright frontal faces only.
    file
        cascade file (`.xml`) to use instead, of Haar features or LBP.

    Raises
    ------
    FileNotFoundError
        if there is no such file.
    ValueError
        if this OpenCV has no cascades, the file is none, or the height is not above 0.
    """

    height: Positive | None = None
    min_neighbors: Count = MIN_NEIGHBORS
    upright: bool = False
    file: Path | None = None
    _frontal: Any = field(init=False, repr=False, compare=False)
    _profile: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:

        if self.file is not None:
            cascades = _given_cascade(self.file), None
        elif self.upright:
            cascades = _cascade(UPRIGHT), None
        else:
            cascades = _cascade(FRONTAL), _cascade(PROFILE)
        for name, cascade in zip(("_frontal", "_profile"), cascades, strict=True):
            object.__setattr__(self, name, cascade)

    def __reduce__(self) -> tuple[type[Self], tuple[float | None, int, bool, Path | None]]:
        # cascades cannot be copied
        return type(self), (self.height, self.min_neighbors, self.upright, self.file)

    @checked
    def __call__(self, frame: Frame) -> Array:
        """Return boxes `(k, 4)` px: x, y, width, height, the largest first."""
        if frame.image is None:
            return np.zeros((0, 4))
        grey = grey_of(frame.image)
        if self.height is None:
            least = max(24, min(grey.shape) // 8)
            return _largest_first(self._frontal.detectMultiScale(grey, 1.1, 5, minSize=(least, least)))
        found = _search(self._frontal, grey, self.height, FRONTAL_PIXELS, self.min_neighbors)
        if self._profile is None:
            return found
        if not len(found):
            found = _search(self._profile, grey, self.height, PROFILE_PIXELS, self.min_neighbors)
        if not len(found):  # the cascade knows faces that look to the left
            found = _search(self._profile, cv2.flip(grey, 1), self.height, PROFILE_PIXELS, self.min_neighbors)
            found[:, 0] = grey.shape[1] - found[:, 0] - found[:, 2]
        return found


@checked
@short_repr
@dataclass(frozen=True)
class YuNetFaces:
    """Face detector by OpenCV's network YuNet, from a model file.

    Parameters
    ----------
    path
        the file (`.onnx`).

    Raises
    ------
    FileNotFoundError
        if there is no such file.
    ValueError
        if it is no such model.
    """

    path: Path
    _networks: dict[tuple[int, int], Any] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path}: no such file")
        if not _is_harmless(self.path, NETWORK_PROBE):
            raise self._no_model()
        self._network((320, 320))

    def __reduce__(self) -> tuple[type[Self], tuple[Path]]:
        return type(self), (self.path,)  # networks cannot be copied

    @checked
    def __call__(self, frame: Frame) -> Array:
        """Return boxes `(k, 4)` px: x, y, width, height, the surest first.

        Raises `ValueError` if the model is another network's.
        """
        if frame.image is None:
            return np.zeros((0, 4))
        image = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR) if frame.image.ndim == 2 else frame.image
        network = self._network((image.shape[1], image.shape[0]))
        try:
            _, found = network.detect(image)
        except cv2.error:
            raise self._no_model() from None
        if found is None:
            return np.zeros((0, 4))
        return np.asarray(found[np.argsort(-found[:, -1], kind="stable"), :4], np.float64)

    def _network(self, size: tuple[int, int]) -> Any:
        """Return the network for images of `size` (width, height)."""
        if size not in self._networks:
            try:
                self._networks[size] = cv2.FaceDetectorYN.create(str(self.path), "", size, LEAST_SURE)
            except cv2.error:
                raise self._no_model() from None
        return self._networks[size]

    def _no_model(self) -> ValueError:
        return ValueError(f"{self.path}: is no model of OpenCV's face detector YuNet")


def _is_harmless(path: Path, probe: str) -> bool:
    stat = path.stat()
    return stat.st_size <= MOST_BYTES and _is_survived(str(path), probe, stat.st_mtime_ns)


@lru_cache
def _is_survived(path: str, probe: str, _changed: int) -> bool:
    """Return whether a detector runs in a process of its own: a damaged file may crash OpenCV."""
    command = [sys.executable, "-c", probe, path]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PROBE_TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def default_faces(path: Path | None = None, otherwise: str = "a model file of YuNet") -> PartDetector:
    """Return YuNet or a cascade (`.xml`) if a file is given, OpenCV's own cascades otherwise.

    `otherwise` is what the error says is expected if this OpenCV has none.

    Raises `ValueError` if there is no detector, or the file is none; `FileNotFoundError` if there is no such
    file.
    """
    if path is not None:
        return HaarFaces(file=path) if path.suffix.lower() == ".xml" else YuNetFaces(path)
    try:
        return HaarFaces()
    except ValueError as error:
        raise ValueError(f"{error}, expected {otherwise}") from None


def for_height(
    detector: PartDetector, height: float, min_neighbors: int = MIN_NEIGHBORS, *, upright: bool = True
) -> PartDetector:
    """Return the detector for faces about `height` px high; only cascades depend on it."""
    if not isinstance(detector, HaarFaces):
        return detector
    return replace(detector, height=height, min_neighbors=min_neighbors, upright=upright)


def confirmed_faces(image: NDArray[np.uint8], boxes: Array, detector: PartDetector) -> Array:
    """Return the boxes of `(n, 4)` px in which a cascade finds a face once more, closer by; all of others."""
    if not isinstance(detector, HaarFaces):
        return boxes
    again = for_height(detector, FACE, SURELY, upright=False)
    sure = [len(again(Frame(_cut_out(image, box), 0.0, 1))) > 0 for box in boxes]
    return np.asarray(boxes[np.array(sure, bool)])


def _cut_out(image: NDArray[np.uint8], box: Array) -> NDArray[np.uint8]:
    """Return the picture about a face, of twice its width, in which it is `FACE` px wide."""
    scale = FACE / box[2]
    if scale < 1:  # anti-aliasing
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 / scale), np.uint8)
    shift = FACE - scale * (box[:2] + 0.5 * box[2:])
    matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    view = cv2.warpAffine(image, matrix, (2 * FACE, 2 * FACE), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(view, np.uint8)


def _cascade(name: str) -> Any:
    """Return a cascade of OpenCV's."""
    path = Path(cv2.__file__).parent / "data" / name
    try:
        if not path.is_file():
            raise ImportError(f"no file {path}", name="cv2")
        return _read_cascade(path)
    except (AttributeError, ImportError) as error:
        raise ValueError(f"OpenCV {cv2.__version__} has no face detector") from error


def _given_cascade(path: Path) -> Any:
    """Return the cascade in a user's file."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if not hasattr(cv2, "CascadeClassifier"):
        raise ValueError(
            f"{path}: OpenCV {cv2.__version__} knows no cascades, expected a model file of YuNet"
        )
    if not _is_harmless(path, CASCADE_PROBE):
        raise ValueError(f"{path}: is no cascade of OpenCV's")
    return _read_cascade(path)


def _read_cascade(path: Path) -> Any:
    cascade = cv2.CascadeClassifier()
    # On Windows, OpenCV opens no file in a folder whose name has letters that its code page lacks.
    mode = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
    content = cv2.FileStorage(path.read_text(encoding="utf-8"), mode)
    cascade.read(content.getFirstTopLevelNode())
    return cascade


def _search(cascade: Any, grey: Any, height: float, pixels: float, min_neighbors: int) -> Array:
    """Return boxes of faces about `height` px high, detected in an image where they have `pixels`."""
    scale = min(1.0, pixels / height)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    least, most = (round(size * height * scale) for size in SIZES)
    found = cascade.detectMultiScale(grey, STEP, min_neighbors, minSize=(least, least), maxSize=(most, most))
    return _largest_first(found) / scale


def _largest_first(detections: Any) -> Array:
    """Return the boxes in a fixed order: OpenCV's depends on its threads."""
    boxes = np.asarray(detections, np.float64).reshape(-1, 4)
    left, top, width, height = boxes.T
    return boxes[np.lexsort((left, top, -width * height))]
