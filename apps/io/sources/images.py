"""Still pictures, one or a sequence: from a file's bytes to an array, and never more than memory holds."""

import configparser
import hashlib
import io
import math
import os
import re
import threading
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ....models.core.checks import MOST_PIXELS
from ....models.core.frame import Frame
from ...options.libraries import quiet_libraries
from .reader import DEFAULT_RATE, Reader, Selection

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".jpg", ".jpeg", ".jp2", ".pbm", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"}
)
_FORMATS = ("BMP", "JPEG", "JPEG2000", "PNG", "PPM", "TIFF", "WEBP")  # Pillow's names of them

# What is damaged is told by what `read_image` returns; OpenCV's own lines on standard error would only tear
# the progress bar, and so would Pillow's warnings.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
warnings.filterwarnings("ignore", module=r"PIL\.")


def read_image(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """Read a picture, turned upright as its EXIF data say; `None` if it is damaged.

    It is `(height, width)`, or `(height, width, 3)` BGR; transparency is left out.

    Raises
    ------
    ValueError
        if it has more than `MOST_PIXELS` pixels, or values of neither 8 nor 16 bits.
    """
    # Without IMREAD_UNCHANGED, which does not turn the picture.
    image = _decoded(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    if image is not None and image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: has {image.dtype} values, expected 8 or 16 bits a channel")
    return image


def read_grey(path: Path) -> NDArray[np.uint8] | None:
    """Read a picture as `(height, width)` grey levels; the rest as of `read_image`."""
    return _decoded(path, cv2.IMREAD_GRAYSCALE)


def to_8_bits(image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Scale values of 16 bits, so that 65535 becomes 255; values of 8 bits stay."""
    if image.dtype == np.uint16:
        return np.asarray(cv2.convertScaleAbs(image, alpha=255 / 65535), np.uint8)
    return np.asarray(image, np.uint8)


def _decoded(path: Path, flags: int) -> NDArray[Any] | None:
    if path.stat().st_size > 8 * MOST_PIXELS:
        raise ValueError(f"{path}: has {path.stat().st_size} bytes, more than a picture may have")
    data = path.read_bytes()
    with quiet_libraries():
        if not _has_its_end(data) or not _is_small_enough(data, path):
            return None
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            return None


def _is_small_enough(data: bytes, path: Path) -> bool:
    """Refuse a picture whose header states too many pixels; tell whether header and check sums are right."""
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:  # reads the header only
            n_pixels = picture.width * picture.height
            picture.verify()  # of a PNG, all check sums and the end
    except Image.DecompressionBombError:  # above Pillow's own bound, which is above ours
        n_pixels = MOST_PIXELS + 1
    except MemoryError:
        raise
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return False
    if n_pixels > MOST_PIXELS:
        raise ValueError(f"{path}: has more than {MOST_PIXELS} pixels, which is the most a picture may have")
    return True


def _header_size(path: Path) -> tuple[int, int]:
    """`(width, height)` px as stored, not yet turned upright; 0 if the header cannot be read."""
    try:
        with Image.open(path, formats=_FORMATS) as picture:
            return picture.size
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return (0, 0)


def _has_its_end(data: bytes) -> bool:
    """Tell whether a JPEG has its end; other data pass.

    The decoders of some OpenCV versions fill up what a truncated file lacks, and report on standard error.
    """
    if not data.startswith(b"\xff\xd8"):
        return len(data) > 0
    position = 2
    while data[position : position + 1] == b"\xff" and len(data) >= position + 4:
        # Walking the segments steps over thumbnails, which have an end marker of their own.
        if data[position + 1] == 0xDA:
            return data.find(b"\xff\xd9", position) >= 0
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return False


SCALED = "Pictures of 16 bits a channel are scaled to 8: 65535 becomes 255."


def images_among(paths: Iterable[Path]) -> list[Path]:
    """Return the image files among some, in natural order."""
    return in_natural_order(path for path in paths if _is_image(path))


def in_natural_order(paths: Iterable[Path]) -> list[Path]:
    """Return paths sorted as people count: `frame2` before `frame10`."""

    def key(path: Path) -> tuple[tuple[str | int, ...], str]:
        parts = re.split(r"(\d+)", str(path))  # text and numbers alternate, so that equals meet equals
        return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), str(path)

    return sorted(paths, key=key)


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()


class ImageReader(Reader):
    """Images of one folder or glob."""

    kind = "images"
    counted = True

    def __init__(self, source: str, folder: Path, files: list[Path]) -> None:
        self.name = source
        self.total = self.last_number = len(files)
        self.rate = _sequence_rate(folder)
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"{source}: got {self.rate} frames per second, expected more than 0")
        self.pictures = [path.name for path in files]
        self.header_size = _header_size(files[0])
        self._files = files

    def frames(self, selection: Selection, _stopping: threading.Event) -> Iterator[Frame]:
        """Yield the selected images; one that is damaged is a missing frame."""
        for number in selection.numbers(len(self._files)):
            if number in selection:
                yield Frame(self._image(self._files[number - 1]), (number - 1) / self.rate, number)

    def _image(self, path: Path) -> NDArray[np.uint8] | None:
        image = read_image(path)
        if image is None:
            return None
        if image.dtype != np.uint8 and not self.notes:
            self.notes = (SCALED,)
        return to_8_bits(image)

    def fingerprint(self) -> dict[str, Any]:
        """Return names and sizes of all files, as one hash."""
        digest = hashlib.sha256()
        for path in self._files:
            digest.update(f"{path.name}\0{path.stat().st_size}\n".encode("utf-8", "surrogateescape"))
        return {
            "kind": self.kind,
            "name": os.path.abspath(self.name),
            "count": len(self._files),
            "sha256": digest.hexdigest(),
        }


def _sequence_rate(folder: Path) -> float:
    """Return the frame rate of a MOT sequence, or the default for images that are none."""
    for candidate in (folder / "seqinfo.ini", folder.absolute().parent / "seqinfo.ini"):
        if candidate.is_file():
            parser = configparser.ConfigParser()
            try:
                parser.read(candidate, encoding="utf-8")
                return parser.getfloat("Sequence", "frameRate", fallback=DEFAULT_RATE)
            except (configparser.Error, ValueError):
                raise ValueError(f"{candidate}: frameRate under [Sequence] cannot be read") from None
    return DEFAULT_RATE


DETAILS = 0x8769
"""The EXIF directory with what the camera was set to."""
FOCAL_MM, FOCAL_35MM = 0x920A, 0xA405
PLANE_RESOLUTION, PLANE_UNIT = 0xA20E, 0xA210
MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
DIAGONAL_35MM = math.hypot(36, 24)
"""mm: the equivalent focal length compares the pictures' diagonals (CIPA DCG-001)."""


def focal_of_picture(path: Path) -> float | None:
    """Focal length in px of the picture in a file; `None` where nothing usable is stated.

    From the equivalent focal length for 35 mm film, or else from the focal length and the resolution of the
    sensor.
    """
    try:
        with Image.open(path) as picture:
            details: dict[int, Any] = dict(picture.getexif().get_ifd(DETAILS))
            diagonal = math.hypot(picture.width, picture.height)
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return None
    try:
        if float(details.get(FOCAL_35MM, 0)) > 0:
            return float(details[FOCAL_35MM]) * diagonal / DIAGONAL_35MM
        millimetres, resolution = float(details.get(FOCAL_MM, 0)), float(details.get(PLANE_RESOLUTION, 0))
        focal = millimetres * resolution / MM_OF_UNIT[int(details.get(PLANE_UNIT, 2))]
    except (ArithmeticError, KeyError, TypeError, ValueError):
        return None
    return focal if math.isfinite(focal) and focal > 0 else None
