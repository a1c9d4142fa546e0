import json
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.view import live as module
from rsmcm.apps.view.live import INTERVAL, SHOWN_EVENTS, Picture, Running
from rsmcm.models.core.frame import Frame

Image = NDArray[np.uint8]


def grey(level: int, size: tuple[int, int] = (32, 24)) -> Image:
    return np.full((size[1], size[0], 3), level, np.uint8)


def level_of(picture: Picture | None) -> float:
    assert picture is not None
    return float(cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR).mean())


@pytest.fixture
def running(tmp_path: Path) -> Running:
    return Running(tmp_path)


@pytest.fixture
def encodings(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Moments of all encodings."""
    moments: list[float] = []
    encode = module._jpeg

    def counting(picture: Image) -> bytes:
        moments.append(time.monotonic())
        return encode(picture)

    monkeypatch.setattr(module, "_jpeg", counting)
    return moments


def test_all_who_look_share_an_encoding(running: Running, encodings: list[float]) -> None:
    seen: list[list[Picture]] = [[] for _ in range(4)]

    def look(pictures: list[Picture]) -> None:
        after = 0
        while (picture := running.picture(after, 5.0)) is not None:
            pictures.append(picture)
            after = picture.number

    threads = [threading.Thread(target=look, args=(pictures,)) for pictures in seen]
    for thread in threads:
        thread.start()
    for level in range(100):
        running.show(grey(level))
        time.sleep(0.003)
    running.end([])
    for thread in threads:
        thread.join(5)
        assert not thread.is_alive()
    different = {picture.number for pictures in seen for picture in pictures}
    assert len(encodings) == len(different) < 100
    assert np.diff(encodings).min() >= 0.99 * INTERVAL, "however fast the film is processed"
    for pictures in seen:
        numbers = [picture.number for picture in pictures]
        assert numbers == sorted(set(numbers))
        assert numbers[-1] == 100, "the last one is seen"
        for picture in pictures:
            assert level_of(picture) == pytest.approx(picture.number - 1, abs=2)


def test_what_is_said_of_a_run(running: Running) -> None:
    said = running.status()
    assert (said["state"], said["frame"], said["seconds_since"]) == ("starting", None, None)
    running.begin("street: recursive-bp", 50, lambda: {"gaps": [], "lost": None, "dropped_frames": 2})
    for number in range(1, 31):
        time.sleep(0.002)
        frame = Frame(None if number == 30 else grey(0), number / 25, number)
        running.on_frame(frame, {"tracks": number}, [f"event {number}"])
    said = running.status()
    assert said["state"] == "running"
    assert (said["frame"], said["frames"], said["time"], said["missing"]) == (30, 50, 1.2, True)
    assert said["facts"] == {"tracks": 30}
    assert said["events"] == [f"event {number}" for number in range(31 - SHOWN_EVENTS, 31)]
    assert said["stream"]["dropped_frames"] == 2
    assert 10 < said["frames_per_second"] < 500
    assert 0 <= said["seconds_since"] < 5
    assert json.loads(json.dumps(said, allow_nan=False)) == said
    running.finish()
    assert running.status()["state"] == "finishing"
    running.end(["30 frames"])
    running.end(None)
    said = running.status()
    assert (said["state"], said["words"]) == ("ended", ["30 frames"]), "what was said first"
