"""Stand-ins for packages, cameras and files of others that recipes name, with the same interfaces."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

PERSON = np.array([[60.0, 40.0, 100.0, 200.0]])


class Tensor(np.ndarray):
    """Of torch, the methods that are used."""

    @classmethod
    def of(cls, values: Any) -> "Tensor":
        return np.asarray(values).view(cls)

    def permute(self, *axes: int) -> "Tensor":
        return self.transpose(axes)  # type: ignore[return-value]

    def numpy(self) -> np.ndarray:
        return np.asarray(self)


class Nothing:
    """A context in which nothing is different."""

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


class Yolo:
    """`ultralytics.YOLO`: one result for each image."""

    def __init__(self, path: str) -> None:
        assert path.endswith(".pt")

    def __call__(self, image: np.ndarray, conf: float) -> list[Any]:
        assert image.dtype == np.uint8
        return [SimpleNamespace(boxes=SimpleNamespace(xyxy=PERSON, conf=np.array([0.9]), cls=np.array([0])))]


class FasterRcnn:
    """A network of torchvision: `(3, height, width)` from 0 to 1 in, a dictionary of each picture out."""

    def eval(self) -> "FasterRcnn":
        return self

    def __call__(self, pictures: list[Tensor]) -> list[dict[str, Tensor]]:
        assert [picture.shape[0] for picture in pictures] == [3]
        assert 0.5 < pictures[0].max() <= 1
        boxes = np.vstack([PERSON, PERSON + 9])
        return [{"boxes": Tensor.of(boxes), "scores": Tensor.of([0.9, 0.8]), "labels": Tensor.of([1, 3])}]


def install(monkeypatch: pytest.MonkeyPatch, folder: Path) -> list[tuple[Any, ...]]:
    """Put them in place, and COLMAP's and DeepLabCut's files into `folder`; returns what Rerun was told."""
    told: list[tuple[Any, ...]] = []
    rerun = {
        "init": lambda name, spawn: None,
        "set_time": lambda timeline, duration: told.append((timeline, duration)),
        "log": lambda path, thing: told.append((path, thing)),
        "Image": lambda image, color_model: image,
        "SegmentationImage": lambda image: image,
        "Boxes2D": lambda array, array_format, class_ids: array,
    }
    cat = lambda parts, axis: Tensor.of(np.concatenate(parts, axis))  # noqa: E731
    torch = {"from_numpy": Tensor.of, "no_grad": Nothing, "cat": cat}
    detection = SimpleNamespace(fasterrcnn_resnet50_fpn=lambda weights: FasterRcnn())
    for name, contents in (
        ("ultralytics", {"YOLO": Yolo}),
        ("torch", torch),
        ("torchvision", {"models": SimpleNamespace(detection=detection)}),
        ("rerun", rerun),
    ):
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    opened = cv2.VideoCapture  # of the camera, a film
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: opened("film.mp4" if source == 0 else source))

    (folder / "colmap").mkdir()
    (folder / "colmap" / "images.txt").write_text(
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# POINTS2D[] as (X Y POINT3D_ID)\n"
        "2 1 0 0 0 0 0 1 1 b.png\n3.5 4.5 1 7.5 8.5 -1\n1 1 0 0 0 0 0 1 1 a.png\n1.5 2.5 1 5.5 6.5 2\n"
    )
    (folder / "deeplabcut.csv").write_text(
        "scorer,net,net,net,net,net,net\nbodyparts,nose,nose,nose,tail,tail,tail\n"
        "coords,x,y,likelihood,x,y,likelihood\n0,1,2,0.99,3,4,0.9\n1,5,6,0.98,7,8,0.1\n"
    )
    return told
