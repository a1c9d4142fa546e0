"""Chains of other distributions reach the command line, its settings and the model."""

import json
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from rsmcm.apps.background import parameters
from rsmcm.apps.background.application import build_model
from rsmcm.apps.background.parameters import read_parameters, with_defaults
from rsmcm.apps.command_line import main
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import sleeping_man
from rsmcm.inference.engine.protocols import Incoming, Port
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.body.parts import BodyParts


@dataclass(frozen=True)
class Clock:
    """Counts seconds, and says nothing of the pixels."""

    box: tuple[int, int]
    hours: tuple[tuple[float, float], ...] = ((9, 17),)
    rate: float = 1.0
    name: str = "clock"
    ports = (Port(PixelLabels),)

    def __post_init__(self) -> None:
        if self.rate < 0:
            raise ValueError(f"rate: got {self.rate}, expected 0 or more")

    def initial(self, frame: Frame) -> float:
        return 0.0

    def predict(self, state: float, dt: float) -> float:
        return state + self.rate * dt

    def message(self, state: float, feature: PixelLabels, incoming: Incoming) -> Any:
        return feature.uniform()

    def update(self, state: float, incoming: Incoming) -> float:
        return state


@dataclass(frozen=True)
class Deaf(Clock):
    """Meets no feature of this application."""

    box: tuple[int, int] = (0, 0)
    ports = (Port(BodyParts),)


ANNOUNCED = {"clock": "Clock", "deaf": "Deaf", "gone": "Gone"}


@pytest.fixture(autouse=True)
def announced(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a distribution with these entry points were installed."""
    points = [EntryPoint(name, f"{__name__}:{kind}", parameters.GROUP) for name, kind in ANNOUNCED.items()]
    monkeypatch.setattr(parameters, "entry_points", lambda group: points if group == "rsmcm.chains" else [])


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_chain_of_others_is_connected(tmp_path: Path) -> None:
    path = written(
        tmp_path / "a.toml", "[chains.clock]\nbox = [3, 4]\nhours = [[1, 2], [3, 4.5]]\nrate = 2\n"
    )
    read = read_parameters(path, ["clock"])
    model = build_model("recursive-bp", read)
    assert model.chains["clock"] == Clock((3, 4), ((1, 2), (3, 4.5)), 2)
    assert with_defaults(read)["chains"] == {"clock": {"box": [3, 4], "hours": [[1, 2], [3, 4.5]], "rate": 2}}
    assert "clock" not in build_model("stand-alone", read).chains
    assert "chains" not in with_defaults({})


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (
            "",
            ["--chain", "clok"],
            "--chain: got 'clok', expected clock, deaf, gone, did you mean clock?",
        ),
        ("", ["--chain", "clock"], "chain clock: missing a required argument: 'box'"),
        ("", ["--chain", "gone"], "Gone cannot be loaded: module"),
        ("", ["--chain", "deaf", "--engine", "stand-alone"], "--chain and --engine stand-alone: got both"),
        ("", ["--chain", "deaf"], "--chain: deaf meets none of pixels, objects"),
        (
            "[chains.clock]\nboks = [1, 2]",
            [],
            "[chains.clock]: unknown key 'boks', expected box, hours",
        ),
        ("[chains.clock]\nbox = [1, 2, 3]", [], "box = [1, 2, 3], expected tuple[int, int]"),
        ("[chains.clock]\nbox = [1, 2]\nrate = -1", [], "[chains.clock]: rate: got -1, expected 0 or more"),
        ("[chains]\nclock = 1", [], "[chains.clock]: got 1, expected a section"),
        ("[chain.clock]\nbox = [1, 2]", [], "unknown key 'chain', expected sections"),
    ],
)
def test_what_is_wrong_is_named(
    text: str, options: list[str], words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_scene(sleeping_man(2, size=(64, 48), enter=0), tmp_path)
    config = ["--config", str(written(tmp_path / "a.toml", text))] if text else []
    source = ["background", str(tmp_path / "input"), "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main([*source, *config, *options])
    assert ended.value.code == 2
    error = capfd.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_run_with_options_and_chains_from_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Everything from the file but what is typed, which goes first; it is resumed with the same."""
    write_scene(sleeping_man(6, size=(64, 48), enter=0), tmp_path)
    path = written(
        tmp_path / "a.toml",
        f"""source = "{tmp_path / "input"}"
        out = "{tmp_path / "out"}"
        stop = 4
        masks = "none"
        ground-truth = "{tmp_path}"
        chain = ["clock"]
        [background]
        prior = 0.8
        [chains.clock]
        box = [1, 2]
        """,
    )
    for more in ([], ["--resume"]):
        with pytest.raises(SystemExit) as ended:
            main(["background", "--config", str(path), "--masks", "png", *more])
        assert ended.value.code == 0, capfd.readouterr().err
    assert len(list((tmp_path / "out" / "foreground").iterdir())) == 4
    said = json.loads((tmp_path / "out" / "summary.json").read_text())["parameters"]
    assert said["chains"] == {"clock": {"box": [1, 2], "hours": [[9, 17]], "rate": 1.0}}
    assert said["background"]["prior"] == 0.8
    assert (said["stop"], said["masks"]) == (4, "png")
