"""Still pictures: from a file's bytes to an array, and never more of them than memory holds."""

import io
import warnings
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ....models.files.limits import MOST_PIXELS
from .quiet import quiet_libraries

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

    Returns
    -------
    NDArray[np.uint8] | NDArray[np.uint16] | None
        `(height, width)`, or `(height, width, 3)` BGR; transparency is left out.

    Raises
    ------
    ValueError
        if it has more than `MOST_PIXELS` pixels, or values of neither 8 nor 16 bits.
    OSError
        if the file cannot be read at all.
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
        if not _is_complete(data) or not _is_small_enough(data, path):
            return None
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            return None


def _is_small_enough(data: bytes, path: Path) -> bool:
    """Refuse a picture whose header states too many pixels; tell whether it has a header that can be read."""
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:  # reads the header only
            n_pixels = picture.width * picture.height
    except Image.DecompressionBombError:  # above Pillow's own bound, which is above ours
        n_pixels = MOST_PIXELS + 1
    except MemoryError:
        raise
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return False
    if n_pixels > MOST_PIXELS:
        raise ValueError(f"{path}: has more than {MOST_PIXELS} pixels, which is the most a picture may have")
    return True


def _is_complete(data: bytes) -> bool:
    """Tell whether a JPEG or PNG has its end (and a PNG its check sums); other data pass.

    The decoders of some OpenCV versions fill up what a truncated file lacks, and report on standard error.
    """
    if data.startswith(b"\xff\xd8"):
        position = 2
        while data[position : position + 1] == b"\xff" and len(data) >= position + 4:
            # Walking the segments steps over thumbnails, which have an end marker of their own.
            if data[position + 1] == 0xDA:
                return data.find(b"\xff\xd9", position) >= 0
            position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        return False
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        position = 8
        while len(data) >= position + 12:
            length = int.from_bytes(data[position : position + 4], "big")
            kind_and_content = memoryview(data)[position + 4 : position + 8 + length]
            check_sum = data[position + 8 + length : position + 12 + length]
            if int.from_bytes(check_sum, "big") != zlib.crc32(kind_and_content) or len(check_sum) < 4:
                return False
            if bytes(kind_and_content[:4]) == b"IEND":
                return True
            position += 12 + length
        return False
    return len(data) > 0
