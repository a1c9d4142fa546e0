"""Pictures and JSON, written whole or not at all."""

import errno
import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.files import write_atomically, write_text


def write_json(path: Path, content: Any) -> None:
    """Write JSON, whole or not at all; numpy values are taken, and NaN and infinity become `null`."""
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def _plain(content: Any) -> Any:
    if isinstance(content, np.ndarray | np.generic):
        content = content.tolist()
    if isinstance(content, dict):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    if isinstance(content, Path):
        return str(content)
    return content


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an image `(height, width)` or `(height, width, 3)` BGR in the format of the suffix."""
    encoded, data = cv2.imencode(path.suffix, image)
    if not encoded:
        raise OSError(errno.EIO, "the image cannot be encoded", str(path))
    with write_atomically(path) as unfinished:
        unfinished.write_bytes(data.tobytes())
