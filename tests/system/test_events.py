"""Who stands still is still there: the whole chain from a film to dwell times."""

import json
from pathlib import Path

import cv2
import pytest
from rsmcm.apps.background.application import run_background
from rsmcm.apps.background.job import BackgroundJob, Engine
from rsmcm.apps.events import Event, Kind, Sighting, Watch, read_events, read_zones
from rsmcm.apps.scenes import Scene, sleeping_man

pytestmark = pytest.mark.slow

SIZE = (200, 150)
ZONES = """
[[zone]]
name = "middle"
polygon = [[60, 100], [140, 100], [140, 150], [60, 150]]
"""
WITHIN = 0.3
"""s, by which a dwell time may be off: at 0.75 heights a second, a fifth of a height."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    """He walks in, stands for 16 s, and walks out."""
    return sleeping_man(620, size=SIZE, stand=400, enter=20, car_leaves=620)


@pytest.fixture(scope="module")
def film(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for frame in scene:
        assert frame.image is not None
        cv2.imwrite(str(folder / f"{frame.number:03d}.png"), frame.image)
    (folder / "zones.toml").write_text(ZONES)
    return folder


def found_by(engine: Engine, film: Path, out: Path) -> list[Event]:
    zones = film / "zones.toml"
    job = BackgroundJob(str(film / "*.png"), out=out, engine=engine, masks="none", zones=zones)
    run_background(job)
    assert "middle" in json.loads((out / "summary.json").read_text())["events"]
    return read_events(out / "events.csv")


def truth(scene: Scene, film: Path) -> list[Event]:
    """Events of the true boxes."""
    watch, found = Watch(read_zones(film / "zones.toml", SIZE)), list[Event]()
    for index in range(len(scene)):
        boxes = [(each.identity, *each.box) for each in scene.boxes(index) if each.kind == "pedestrian"]
        people = [Sighting(who, x + w / 2, y + h, h, True) for who, x, y, w, h in boxes]
        found += watch.update(index * scene.dt, index + 1, people)
    return found + watch.end(len(scene))


@pytest.mark.parametrize("engine", ["recursive-bp", "coordinate-ascent"])
def test_his_dwell_time_is_his_whole_stay(engine: Engine, scene: Scene, film: Path, tmp_path: Path) -> None:
    expected, found = truth(scene, film), found_by(engine, film, tmp_path / "out")
    (left,) = [event for event in expected if event.kind == Kind.LEFT]
    assert left.duration is not None
    assert left.duration > 16
    assert [event.kind for event in found] == [Kind.ENTERED, Kind.STANDS, Kind.LEFT, Kind.STOOD]
    assert [event.kind for event in expected] == [event.kind for event in found]
    assert len({event.identity for event in found}) == 1
    for event, true in zip(found, expected, strict=True):
        assert event.moment.time == pytest.approx(true.moment.time, abs=WITHIN)
        if true.duration is not None:
            assert event.duration == pytest.approx(true.duration, abs=WITHIN)


def test_without_feedback_he_is_lost(film: Path, tmp_path: Path) -> None:
    found = found_by("feed-forward", film, tmp_path / "out")
    assert max(event.duration or 0 for event in found) < 8, "half of his stay"
    assert any(event.kind == Kind.DISAPPEARED for event in found)
