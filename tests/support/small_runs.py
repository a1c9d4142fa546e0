"""Commands on small films, with their options."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps import command_line
from rsmcm.apps.scenes import cylinder, face, signer, sleeping_man
from rsmcm.models.body.upper_body import JOINTS

N_FRAMES = 24
SIZE = (200, 160)
EVERY = ("--every", "4")


@dataclass(frozen=True)
class SmallRun:
    """A command on a small film, with its options."""

    name: str
    source: Path
    options: tuple[str, ...]

    def arguments(self, out: Path, *more: str) -> list[str]:
        return [self.name, str(self.source), "--out", str(out), *self.options, *more]

    def run(self, out: Path, *more: str) -> int:
        with pytest.raises(SystemExit) as ended:
            command_line.main(self.arguments(out, *more))
        return int(ended.value.code or 0)


def small_run(name: str, folder: Path) -> SmallRun:
    """Write the source of an application."""
    if name == "background":
        images = (frame.image for frame in sleeping_man(N_FRAMES, size=SIZE) if frame.image is not None)
        return SmallRun(name, _write_film(folder / "street", images), EVERY)
    if name == "structure":
        tracks = 100 * cylinder(p_loose=0.1, p_drift=0.1, seed=1).tracks() + 200
        np.savez(folder / "tracks.npz", tracks=tracks)
        return SmallRun(name, folder / "tracks.npz", ())
    if name == "face":
        talking = face(N_FRAMES, 3, SIZE)
        np.save(folder / "landmarks.npy", talking.vertices)
        options = ("--landmarks", str(folder / "landmarks.npy"), "--experts", "4", *EVERY)
        return SmallRun(name, _write_film(folder / "face", talking.images()), options)
    scene = signer(N_FRAMES, 3, 0.0, 0.3, (320, 180))
    width, height = scene.body.head_width, scene.body.head_height
    x, y = scene.joints[0, JOINTS.index("head"), :2] - (width / 2, height / 2)
    options = ("--head", f"{x:.0f},{y:.0f},{width:.0f},{height:.0f}", "--samples", "100", *EVERY)
    return SmallRun(name, _write_film(folder / "body", scene.images()), options)


def _write_film(folder: Path, images: Iterator[NDArray[np.uint8]]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number:03d}.png"), image)
    return folder
