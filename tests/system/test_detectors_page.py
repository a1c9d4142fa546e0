"""The page on detectors: its commands and its Python run as printed, on a small film with a small network."""

import json
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.io import read_detections
from rsmcm.apps.io.files import PLAYABLE, SegmentedVideo
from rsmcm.models import Frame

from ..fuzz.networks import bright_cells
from ..support.pages import ROOT, Reader

pytestmark = pytest.mark.slow

N_FRAMES = 32
SIDE = 24


def place(number: int) -> tuple[int, int]:
    """Where the square is in a frame: x and y of its upper left corner, px."""
    return 10 + 3 * number, 40


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to be in, with all that the page names: a bright square that moves over a dark noise."""
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(0)
    video = SegmentedVideo(Path("film.mp4"), 25.0, PLAYABLE)
    mot, csv, results = "", "frame,x,y,width,height,score,class\n", []
    for number in range(1, N_FRAMES + 1):
        image = random.integers(0, 9, (96, 160, 3), dtype=np.uint8)
        x, y = place(number)
        image[y : y + SIDE, x : x + SIDE] = 255
        video.write(image, number, (number - 1) / 25)
        mot += f"{number},-1,{x + 1},{y + 1},{SIDE},{SIDE},40,-1,-1,-1\n"
        csv += f"{number},{x},{y},{SIDE},{SIDE},0.9,{'car' if number % 2 else 'truck'}\n"
        results.append({"image_id": number, "category_id": 1, "bbox": [x, y, SIDE, SIDE], "score": 0.8})
    video.close()
    Path("det.txt").write_text(mot)
    Path("found.csv").write_text(csv)
    Path("results.json").write_text(json.dumps(results))
    Path("network.onnx").write_bytes(bright_cells(640, 40, 60))
    return tmp_path


def test_the_page_can_be_typed(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "examples"))
    names = Reader(ROOT / "docs" / "detectors.md").read().names
    counts = {
        name: json.loads(Path(f"results/{name}/summary.json").read_text())["detections"]
        for name in ("film", "cars", "part", "network")
    }
    assert counts["film"] == counts["cars"] == {"boxes": N_FRAMES, "frames": N_FRAMES}
    assert counts["part"] == {"boxes": 11, "frames": 11}
    assert counts["network"]["frames"] == len(range(1, N_FRAMES + 1, 5))
    found = read_detections("found.csv")  # by the network: whole cells, the brightest one near the middle
    for number in range(1, N_FRAMES + 1, 5):
        boxes = found.at(number)
        assert boxes is not None
        assert boxes.confidence is not None
        left, top, right, bottom = boxes.xyxy[boxes.confidence.argmax()]
        x, y = place(number)
        assert abs((left + right) / 2 - (x + SIDE / 2)) < 10
        assert abs((top + bottom) / 2 - (y + SIDE / 2)) < 10
    last = names["belief"].frame
    assert last.number == N_FRAMES
    assert last.boxes is None, "32 is no fifth frame from 1"
    (box,) = names["bright_objects"](Frame(np.full((4, 6, 3), 255, np.uint8), 0.0, 1))
    assert box[:4] == [0, 0, 6, 4]
