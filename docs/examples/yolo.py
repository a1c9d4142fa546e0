"""A YOLO network as a detector, through OpenCV: run it on a film, and write what it finds as CSV.

python yolo.py film.mp4 yolo11n.onnx found.csv --every 5
rsmcm background film.mp4 --out results/film --detections found.csv --classes 0
"""

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.io import open_source, with_boxes
from rsmcm.models import Frame


class Yolo:
    """A network of the family YOLOv8 and later, exported as ONNX; called with a frame, it finds boxes.

    Its input is `(1, 3, size, size)`, RGB from 0 to 1; its output `(1, 4 + classes, n)`: centre and size in
    px of the input, and a score for every class. (YOLOv5 and v7 have `(1, n, 5 + classes)`: there, leave out
    the transposition, and multiply the scores of the classes by the fifth column.)

    Parameters
    ----------
    path
        of the `.onnx` file.
    size
        px: width and height of the network's input.
    least
        score from which a box counts. Take it low: the tracker learns what a score is worth.
    overlap
        IoU from which the weaker of two boxes of a class is dropped.
    """

    def __init__(self, path: str | Path, size: int = 640, least: float = 0.1, overlap: float = 0.6) -> None:
        self._network = cv2.dnn.readNetFromONNX(str(path))
        self._size = size
        self._least = least
        self._overlap = overlap

    def __call__(self, frame: Frame) -> NDArray[np.float64]:
        """Boxes `(n, 6)`: left, top, right, bottom px, score, number of the class."""
        assert frame.image is not None
        image = frame.image if frame.image.ndim == 3 else cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
        scale = self._size / max(image.shape[:2])
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        canvas = np.full((self._size, self._size, 3), 114, np.uint8)
        canvas[: small.shape[0], : small.shape[1]] = small  # in the corner: no offset to be taken off
        self._network.setInput(cv2.dnn.blobFromImage(canvas, 1 / 255, swapRB=True))
        rows = np.asarray(self._network.forward(), np.float64)[0].T
        classes = rows[:, 4:].argmax(axis=1)
        scores = rows[:, 4:].max(axis=1)
        sizes = np.column_stack([rows[:, :2] - rows[:, 2:4] / 2, rows[:, 2:4]])  # left, top, width, height
        kept = np.asarray(
            cv2.dnn.NMSBoxesBatched(
                sizes.tolist(), scores.tolist(), classes.tolist(), self._least, self._overlap
            ),
            int,
        ).ravel()
        corners = np.column_stack([sizes[:, :2], sizes[:, :2] + sizes[:, 2:]])[kept] / scale
        corners = corners.clip(0, np.tile(image.shape[1::-1], 2))
        inside = (corners[:, 2:] > corners[:, :2]).all(axis=1)
        found: NDArray[np.float64] = np.column_stack([corners, scores[kept], classes[kept]])[inside]
        return found


def main() -> None:
    """Write what a network finds in a film."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("film")
    parser.add_argument("network", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=1, help="run it on every n-th frame only")
    parser.add_argument("--size", type=int, default=640, help="width and height of its input, px")
    chosen = parser.parse_args()
    detector = Yolo(chosen.network, chosen.size)
    with open_source(chosen.film) as film, chosen.out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "left", "top", "right", "bottom", "confidence", "class"])
        for frame in with_boxes(film, detector, chosen.every):
            boxes = frame.boxes
            if boxes is not None and boxes.confidence is not None and boxes.classes is not None:
                for xyxy, score, kind in zip(boxes.xyxy, boxes.confidence, boxes.classes, strict=True):
                    writer.writerow([frame.number, *xyxy.round(2), round(score, 4), kind])


if __name__ == "__main__":
    main()
