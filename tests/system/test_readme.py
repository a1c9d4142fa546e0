"""What README tells people to type works."""

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from rsmcm.apps.background.demo import SIGNER, write_body, write_cylinder, write_face, write_scene
from rsmcm.apps.command_line import app, main
from rsmcm.apps.io import TrackWriter
from rsmcm.apps.io.mot import TrackedBox
from rsmcm.apps.io.segmented_video import PLAYABLE, SegmentedVideo
from rsmcm.apps.scenes import Scene, face, signer, sleeping_man

ROOT = Path(__file__).parents[2]
LONG = ("rsmcm demo", "rsmcm reproduce")  # only read, not run; tests of their own run them


def blocks(language: str) -> list[str]:
    text = (ROOT / "README.md").read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def commands(program: str) -> list[str]:
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    return [line for line in lines if line.split()[0] == program]


def test_every_command_is_of_a_known_program() -> None:
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    assert sorted(lines) == sorted([*commands("rsmcm"), *commands("make"), "pip install ."])


def test_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """In order, in a folder of their own, with a short scene in place of the demo's."""
    monkeypatch.chdir(tmp_path)
    write_scene(sleeping_man(24, enter=0), Path("results/demo/scene"))
    write_cylinder(Path("results/demo/cylinder.npz"))
    write_face(face(24), Path("results/demo/face"))
    write_body(signer(8, SIGNER), Path("results/demo/body"))
    (settings,) = blocks("toml")
    Path("settings.toml").write_text(settings)
    assert len(commands("rsmcm")) > 8
    for line in commands("rsmcm"):
        arguments = shlex.split(line)[1:]
        if line.startswith(LONG):
            app.parse_args(arguments, exit_on_error=False, print_error=False)
            continue
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0, capfd.readouterr().err
    text = (ROOT / "README.md").read_text()
    street, rest = text.split("## Structure from motion")
    shape, rest = rest.split("## Faces")
    talking, signing = rest.split("## Articulated bodies")
    for folder, text in (("street", street), ("shape", shape), ("face", talking), ("body", signing)):
        for name in re.findall(r"^\| `([^`]+)`", text, re.MULTILINE):
            if not name.endswith("/"):
                assert (Path("results") / folder / name).stat().st_size > 0
    assert len(list(Path("results/part/foreground").iterdir())) == 4
    assert json.loads(Path("results/body/summary.json").read_text())["seen"]["head"] > 0.8


def test_make_targets() -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for line in commands("make"):
        assert line.split()[1] in targets


def test_files_that_are_named_are_there() -> None:
    text = (ROOT / "README.md").read_text()
    named = re.findall(r"\]\(([^)#:]+)\)", text)
    assert named
    for name in named:
        assert (ROOT / name).exists()


def film_of_a_street(scene: Scene) -> None:
    """`film.mp4` and `gt.txt` here."""
    film = SegmentedVideo(Path("film.mp4"), 25.0, PLAYABLE)
    with TrackWriter("gt.txt") as truth:
        for frame in scene:
            assert frame.image is not None
            film.write(frame.image, frame.number, frame.time)
            boxes = scene.boxes(frame.number - 1)
            truth.write(frame.number, [TrackedBox(box.identity, box.box) for box in boxes])
    film.close(finished=True)


def test_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks in order, in one namespace, as somebody would paste them."""
    monkeypatch.chdir(tmp_path)
    film_of_a_street(sleeping_man(60, enter=0))
    printed: list[str] = []
    names: dict[str, Any] = {"__name__": "readme", "print": printed.append}
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), names)
    assert (names["together"][names["person"]] > 0).mean() > (
        names["apart"][names["person"]] > 0
    ).mean() + 0.2
    assert len(list(Path("found/foreground").iterdir())) == 60
    assert names["scores"].n_frames > 40
    assert names["belief"]._repr_png_()
    assert "<svg" in names["model"]._repr_svg_()
    assert printed[0].endswith("with feedback,")
    assert names["evidence"] < 0
    assert names["about"] == {"camera": "street"}
    assert names["state"].number == 15
    assert 0 < names["height"][0] < names["height"][1] < 240
    assert names["belief"].frame.number == 30
    assert "<svg" in Path("model.svg").read_text()
    assert names["joints"].shape == (8, 3)
    off = names["joints"][0, :2] - names["signing"].joints[-1, 0, :2]
    assert (abs(off) < 0.3 * names["body"].head_height).all()
    assert names["usual"]["condensation"].effective > 1
