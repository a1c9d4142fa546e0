"""The main job on a generated scene: write it to disk, run on it as on any other source, compare.

Tracks of a turning cylinder and films of a talking face and of a signer are written beside it, for the other
applications.
"""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..models.body.upper_body import JOINTS
from ..models.files import write_atomically, write_text
from .background.application import run_background
from .background.job import BackgroundJob
from .experiments.compare import run_compare
from .io.files import write_image
from .runs.interruption import Outcome
from .runs.progress import Progress
from .scenes import FaceScene, Scene, SignerScene, cylinder, face, signer, sleeping_man
from .view.page import VIEW

N_FRAMES = 400
FACE_FRAMES = 100
BODY_FRAMES = 100

SIGNER = 2
"""Seed of the signer."""

CLICKED_FRAMES = 5
"""Of the signer, in which joints are given."""

P_LOOSE = 0.1
PX, MIDDLE = 100.0, (320.0, 240.0)
"""px per radius of the cylinder, and where its middle is."""


def run_demo(out: Path) -> Outcome:
    """Track the person who stands still, and compare with and without feedback.

    The folder holds the scene (in CDnet's layout), `cylinder.npz`, `face`, `body` and the results afterwards.
    The outcome is that of what ran last.
    """
    scene = out / "scene"
    write_scene(sleeping_man(N_FRAMES), scene)
    write_cylinder(out / "cylinder.npz")
    write_face(face(FACE_FRAMES, light=0.5), out / "face")
    write_body(signer(BODY_FRAMES, SIGNER, detector_dropout=0.05, clutter=0.5), out / "body")
    job = BackgroundJob(str(scene / "input"), out=out, overwrite=True, ground_truth=scene)
    outcome = run_background(job)
    if outcome.signal is None:
        outcome = run_compare(replace(job, out=out / "comparison"))
    print(f"\npage:       {out / VIEW}")
    print(f"comparison: {out / 'comparison' / 'index.html'}")
    return outcome


def write_scene(scene: Scene, folder: Path) -> None:
    """Write a scene in CDnet's layout, `input/` and `groundtruth/`; an earlier one there is replaced."""
    for name in ("input", "groundtruth"):
        if (folder / name).exists():
            shutil.rmtree(folder / name)
        (folder / name).mkdir(parents=True)
    with Progress("scene", len(scene)) as progress:
        for frame, mask in zip(scene, scene.masks, strict=True):
            assert frame.image is not None
            write_image(folder / "input" / f"in{frame.number:06d}.png", frame.image)
            labels = np.where(mask, np.uint8(255), np.uint8(0))
            write_image(folder / "groundtruth" / f"gt{frame.number:06d}.png", labels)
            progress.update()


def write_cylinder(path: Path) -> None:
    """Write partial tracks of points on a turning cylinder, not saying which show the same point."""
    with write_atomically(path) as unfinished:
        np.savez(unfinished, tracks=PX * cylinder(p_loose=P_LOOSE, p_drift=0.1, seed=0).tracks() + MIDDLE)


def write_face(scene: FaceScene, folder: Path) -> None:
    """Write a film of a face as images, and where its landmarks are in every frame (`landmarks.npy`).

    The landmarks are the vertices of the built-in model.
    """
    _write_film("face", scene.images(), len(scene), folder / "input")
    with write_atomically(folder / "landmarks.npy") as unfinished:
        np.save(unfinished, scene.vertices)


def write_body(scene: SignerScene, folder: Path) -> None:
    """Write a film of a signer as images, and the joints in a few frames as if clicked (`joints.csv`)."""
    _write_film("signer", scene.images(), len(scene), folder / "input")
    clicked = np.unique(np.linspace(0, len(scene) - 1, CLICKED_FRAMES).astype(int))
    lines = [
        f"{index + 1},{name},{x:.1f},{y:.1f}"
        for index in clicked
        for name, (x, y) in zip(JOINTS, scene.joints[index, :, :2], strict=True)
    ]
    write_text(folder / "joints.csv", "\n".join(["frame,joint,x,y", *lines, ""]))


def _write_film(name: str, images: Iterator[NDArray[np.uint8]], count: int, folder: Path) -> None:
    """Write `count` images, numbered from 1; an earlier film in the folder is replaced."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    with Progress(name, count) as progress:
        for number, image in enumerate(images, start=1):
            write_image(folder / f"in{number:06d}.png", image)
            progress.update()
