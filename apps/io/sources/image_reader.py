"""Frames from images: a folder of them, those that a glob matches, or a single one."""

import configparser
import hashlib
import math
import os
import re
import threading
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from .images import IMAGE_SUFFIXES, read_image, to_8_bits
from .reader import DEFAULT_RATE, Gap, Selection

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


class ImageReader:
    """Images of one folder or glob, `rate` a second."""

    kind = "images"
    live = False
    counted = True
    truncated = False
    lost: str | None = None
    gaps: tuple[Gap, ...] = ()

    def __init__(self, source: str, folder: Path, files: list[Path], rate: float | None) -> None:
        self.name = source
        self.total: int | None = len(files)
        self.header_size = (0, 0)
        self.rate = _sequence_rate(folder) if rate is None else rate
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"{source}: got {self.rate} frames per second, expected more than 0")
        self.last_number = len(files)
        self.notes: list[str] = []
        self.pictures: Sequence[str] = [path.name for path in files]
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
            self.notes.append(SCALED)
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

    def close(self) -> None:
        """Nothing is open."""


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
