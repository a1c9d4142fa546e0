"""A YOLO network of poses as a detector, through OpenCV: run it on a film, and write what it finds as CSV.

python yolo_pose.py film.mp4 yolo11n-pose.onnx found.csv --every 2
rsmcm body film.mp4 --out results/film --keypoints found.csv
"""

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.io import open_source, with_keypoints
from rsmcm.models import KEYPOINTS, Frame


class YoloPose:
    """A network of the family YOLOv8-pose and later, exported as ONNX; called with a frame, it finds persons.

    Its input is `(1, 3, size, size)`, RGB from 0 to 1; its output `(1, 56, n)`: of n boxes centre, size and
    score, then x, y and score of 17 points, in px of the input.

    Parameters
    ----------
    path
        of the `.onnx` file.
    size
        px: width and height of the network's input.
    least
        score from which a person counts.
    overlap
        IoU from which the weaker of two boxes is dropped.
    """

    def __init__(self, path: str | Path, size: int = 640, least: float = 0.25, overlap: float = 0.6) -> None:
        self._network = cv2.dnn.readNetFromONNX(str(path))
        self._size = size
        self._least = least
        self._overlap = overlap

    def __call__(self, frame: Frame) -> NDArray[np.float64]:
        """Points `(n, 17, 3)`: x, y px and score, in COCO's order."""
        assert frame.image is not None
        image = frame.image if frame.image.ndim == 3 else cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
        scale = self._size / max(image.shape[:2])
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        canvas = np.full((self._size, self._size, 3), 114, np.uint8)
        canvas[: small.shape[0], : small.shape[1]] = small  # in the corner: no offset to be taken off
        self._network.setInput(cv2.dnn.blobFromImage(canvas, 1 / 255, swapRB=True))
        rows = np.asarray(self._network.forward(), np.float64)[0].T
        boxes = np.column_stack([rows[:, :2] - rows[:, 2:4] / 2, rows[:, 2:4]])  # left, top, width, height
        kept = cv2.dnn.NMSBoxes(boxes.tolist(), rows[:, 4].tolist(), self._least, self._overlap)
        points = rows[np.asarray(kept, int).ravel(), 5:].reshape(-1, 17, 3)
        points[..., :2] = (points[..., :2] + 0.5) / scale - 0.5
        return points


def main() -> None:
    """Write what a network finds in a film."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("film")
    parser.add_argument("network", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=1, help="run it on every n-th frame only")
    parser.add_argument("--size", type=int, default=640, help="width and height of its input, px")
    chosen = parser.parse_args()
    detector = YoloPose(chosen.network, chosen.size)
    with open_source(chosen.film) as film, chosen.out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "person", "joint", "x", "y", "score"])
        for frame in with_keypoints(film, detector, chosen.every):
            found = frame.keypoints
            if found is None:
                continue
            for person, (places, scores) in enumerate(zip(found.positions, found.scores, strict=True)):
                for joint, place, score in zip(KEYPOINTS, places, scores, strict=True):
                    if score > 0:
                        writer.writerow([frame.number, person, joint, *place.round(2), round(score, 4)])


if __name__ == "__main__":
    main()
