"""The files that pages name: what the demo leaves, shorter, and a film of one's own."""

from pathlib import Path

from rsmcm.apps.demo import SIGNER, write_body, write_cylinder, write_face, write_scene
from rsmcm.apps.io import TrackWriter
from rsmcm.apps.io.files import PLAYABLE, SegmentedVideo
from rsmcm.apps.io.tracks import TrackedBox
from rsmcm.apps.scenes import Scene, face, signer, sleeping_man


def write_demo(folder: Path) -> None:
    """The scenes of `rsmcm demo`, as they lie below the folder where it was run."""
    demo = folder / "results" / "demo"
    write_scene(sleeping_man(24, enter=0), demo / "scene")
    write_cylinder(demo / "cylinder.npz")
    write_face(face(24), demo / "face")
    write_body(signer(8, SIGNER), demo / "body")


def write_film(folder: Path, scene: Scene) -> None:
    """`film.mp4`, and `gt.txt` with the boxes in it."""
    film = SegmentedVideo(folder / "film.mp4", 25.0, PLAYABLE)
    with TrackWriter(folder / "gt.txt") as truth:
        for frame in scene:
            assert frame.image is not None
            film.write(frame.image, frame.number, frame.time)
            boxes = scene.boxes(frame.number - 1)
            truth.write(frame.number, [TrackedBox(box.identity, box.box) for box in boxes])
    film.close()
