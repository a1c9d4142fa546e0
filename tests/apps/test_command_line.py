"""The command `rsmcm`: whatever is wrong is one line on standard error and exit code 2."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from cyclopts import App
from rsmcm.apps import command_line
from rsmcm.apps.command_line import main
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import sleeping_man

from ..conftest import Command, modified, names

SIZE = (64, 48)
COMMAND = [sys.executable, "-m", "rsmcm.apps.command_line"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve frames in CDnet's layout."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(sleeping_man(12, size=SIZE, enter=0), folder)
    return folder


@pytest.fixture(scope="module")
def finished(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run."""
    out = tmp_path_factory.mktemp("finished") / "out"
    with pytest.raises(SystemExit) as ended:
        main(["background", str(scene / "input"), "--out", str(out), "--every", "5"])
    assert ended.value.code == 0
    return out


def complaint(capfd: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a wrong command leads to."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    out, err = capfd.readouterr()
    assert ended.value.code == 2
    assert out == ""
    *before, err = err.splitlines(keepends=True)
    assert all(" frames" in line for line in before), "progress, where the machine is slow"
    assert err.startswith("rsmcm: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1, err
    return err


def write(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--out is needed"),
        (["--out"], "--out: got no value, expected one"),
        (["--out="], "--out: got no value, expected one"),
        (
            ["--out", "OUT", "--engine", "magic"],
            "--engine: got 'magic', expected recursive-bp, feed-forward,",
        ),
        (["--out", "OUT", "--frobnicate"], "unknown option --frobnicate"),
        (["--out", "OUT", "--overwrit"], "unknown option --overwrit, did you mean --overwrite?"),
        (["--out", "OUT", "--overwrite=maybe"], "--overwrite: got a value, expected none"),
        (["--out", "OUT", "--masks", "gif"], "--masks: got 'gif', expected none, png or video"),
        (["--out", "OUT", "another"], "got 'another' as well"),
        (["--out", "OUT", "--out", "OUT"], "--out: got it twice"),
        (["--out", "OUT", "--seed", "-1"], "--seed: got -1, expected 0 or more"),
        (["--out", "OUT", "--quiet", "--verbose"], "--quiet and --verbose: got both"),
        (["--out", "OUT", "--start", "0"], "--start: got 0"),
        (["--out", "OUT", "--start", "13"], "--start: got 13, but"),
        (["--out", "OUT", "--start", "5", "--stop", "4"], "--stop: got 4"),
        (["--out", "OUT", "--step", "0"], "--step: got 0"),
        (["--out", "OUT", "--every", "0"], "--every: got 0"),
        (["--out", "OUT", "--threads", "0"], "--threads: got 0"),
        (["--out", "OUT", "--resume", "--overwrite"], "--resume and --overwrite"),
        (["--out", "OUT", "--roi", "0,0,65,48"], "inside the picture of 64x48"),
        (["--out", "OUT", "--roi=-1,0,5,5"], "inside the picture of 64x48"),
        (["--out", "OUT", "--roi", "100,100,5,5"], "inside the picture of 64x48"),
        (["--out", "OUT", "--roi", "1,2,3"], "expected x,y,width,height"),
        (["--out", "OUT", "--roi", "nowhere.png"], "neither x,y,width,height nor a file"),
        (["--out", "OUT", "--config", "nowhere.toml"], "nowhere.toml: No such file"),
        (["--out", "OUT", "--ground-truth", "nowhere"], "--ground-truth: no such file or folder: nowhere"),
    ],
)
def test_wrong_options(
    arguments: list[str], words: str, scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = [str(out) if argument == "OUT" else argument for argument in arguments]
    assert words in complaint(capfd, "background", scene / "input", *arguments)
    assert not out.exists(), "nothing is written"


def test_wrong_subcommands(capfd: pytest.CaptureFixture[str]) -> None:
    assert "unknown command 'backgroud', did you mean background?" in complaint(capfd, "backgroud")
    assert "unknown command 'x', expected background, structure, " in complaint(capfd, "x")
    assert "unknown command 'nothing', expected compare, " in complaint(capfd, "reproduce", "nothing")
    assert "unknown option --frobnicate" in complaint(capfd, "--frobnicate")
    assert "SOURCE is needed" in complaint(capfd, "face")
    assert "SOURCE: got no value" in complaint(capfd, "face", "")


def options() -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Every option of every command, with the type of its value."""

    def of(app: App, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str, Any]]:
        if app.default_command is not None:
            for argument in app.assemble_argument_collection():
                if argument.field_info.is_keyword_only and argument.parse and not argument.children:
                    yield path, argument.name, argument.hint
        for name in app:
            if not name.startswith("-"):
                yield from of(app[name], (*path, name))

    yield from of(command_line.app, ())
    for name, hint in (("--threads", int), ("--quiet", bool), ("--verbose", bool)):
        yield ("background",), name, hint


@pytest.mark.parametrize(
    ("path", "option", "hint"), [pytest.param(*each, id=" ".join((*each[0], each[1]))) for each in options()]
)
def test_every_option_is_named_in_what_is_wrong_with_it(
    path: tuple[str, ...], option: str, hint: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    wrong: dict[Any, list[str]] = {
        int: ["1.5", "1e3", "0x10", "True", "nan", "1_0", "x", "9" * 5000],
        float: ["x", "1,5", "0x10"],
        bool: [],
        str: [],
        Path: [],
    }
    kinds = [kind for kind in get_args(hint) or [hint] if kind is not NoneType]
    values = wrong.get(kinds[0], ["no such choice"])
    alone = path[0] == "demo" or (path[0] == "reproduce" and path[1:] != ("compare",))
    needed = [] if alone else ["nowhere"]
    for other, value in (("--out", "x"), ("--bases", "3"), ("--to", "coco")):
        if other != option and {"--bases": "shape", "--to": "export"}.get(other, path[0]) == path[0]:
            needed += [other, value]
    for value in values:
        line = complaint(capfd, *path, *needed, f"{option}={value}")
        assert line.startswith(f"rsmcm: {option}: got {value!r}, expected "), line
    if kinds == [bool]:
        assert f" {option}: got a value, expected none" in complaint(capfd, *path, *needed, f"{option}=maybe")
    else:
        for nothing in ([option], [f"{option}="]):
            line = complaint(capfd, *path, *needed, *nothing)
            assert line.startswith(f"rsmcm: {option}: got no value, expected "), line


def test_whole_numbers_keep_their_sign_and_zeros() -> None:
    for typed, number in (("7", 7), ("007", 7), ("+7", 7), ("-7", -7), ("0", 0)):
        _, bound, _ = command_line.app.parse_args(["face", "film", "--out", "x", "--start", typed])
        assert bound.arguments["job"].start == number


def say(capfd: pytest.CaptureFixture[str], *arguments: object) -> tuple[str, str]:
    """What a command prints that comes to its end."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert ended.value.code == 0
    out, err = capfd.readouterr()
    return out, err


def test_quiet_and_verbose(scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Quiet says nothing at all, verbose what the usual run does and more, and neither lasts."""
    folder = tmp_path / "input"
    shutil.copytree(scene / "input", folder)
    (folder / "in000004.png").write_bytes(b"damaged")
    start = ("background", folder, "--overwrite", "--every", "5", "--out", tmp_path / "out")
    assert say(capfd, *start, "--quiet") == ("", "")
    results = sorted(path.name for path in (tmp_path / "out").iterdir())
    out, err = say(capfd, *start, "--verbose", "--threads", "1")
    assert "12 frames" in out
    for word in ("threads: 1", "frame 4 is missing or unreadable", "state saved after frame 5"):
        assert f"{word}\n" in err
    out, err = say(capfd, *start)
    assert "12 frames" in out
    assert "missing" not in err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == results
    assert "nowhere" in complaint(capfd, "background", "nowhere", "--out", tmp_path / "x", "--quiet")


def test_results_are_not_written_into_the_source(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "input"
    shutil.copytree(scene / "input", folder)
    before = names(folder)
    for out in (folder, folder / "results", tmp_path / "input" / ".." / "input"):
        words = "which is the source or lies in it"
        assert words in complaint(capfd, "background", folder, "--out", out, "--overwrite")
        assert words in complaint(capfd, "body", folder, "--out", out, "--overwrite")
        for pattern in (folder / "*.p*", tmp_path / "in*" / "*", tmp_path / "**" / "*.png"):
            assert words in complaint(capfd, "background", pattern, "--out", out, "--overwrite")
    assert names(folder) == before


def test_wrong_sources(scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    text = write(tmp_path / "text.mp4", "this is no video" * 100)
    for source, words in (
        (tmp_path / "nowhere.mp4", "no such file or folder"),
        (text, "text.mp4"),
        (empty, "holds no images"),
        (tmp_path / "*.png", "matches no images"),
        ("gopher://example", "expected an address"),
        ("97", "camera 97: cannot be opened"),
    ):
        assert words in complaint(capfd, "background", source, "--out", tmp_path / "out")
    (empty / "frame1.png").write_bytes(b"\x89PNG\r\n")
    assert "no readable frame" in complaint(capfd, "background", empty, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "prior = 0.5",
            "unknown key 'prior', expected an option of the command, or a section",
        ),
        ("threads = 1", "settings.toml: unknown key 'threads', expected an option of the command"),
        ("config = 'b.toml'", "settings.toml: unknown key 'config', expected an option of the command"),
        ("mask = 'none'", "settings.toml: unknown key 'mask', did you mean masks?"),
        ("masks = 'gif'", "settings.toml: masks: got 'gif', expected none, png or video"),
        ("start = 1.5", "settings.toml: start: got '1.5', expected a whole number"),
        ("resume = 'perhaps'", "settings.toml: resume: got 'perhaps', expected true or false"),
        ("stop = [1, 2]", "settings.toml: stop: got '[1, 2]', expected a whole number"),
        ("[sky]\ncolour = 1", "unknown key 'sky', expected sections background, blobs"),
        ("[background]\nprioor = 0.5", "[background]: unknown key 'prioor', expected model, prior, noise"),
        ("[background]\nprior = 'much'", "[background]: prior = 'much', expected a number"),
        ("[background]\nprior = true", "[background]: prior = True, expected a number"),
        ("[background]\nprior = 1.5", "[background]: prior: got 1.5, expected a probability"),
        ("[background]\nmodel = 'mixtur'", "[background]: model = 'mixtur', expected gaussian, mixture"),
        ("[background]\nmodel = ['mixture']", "model = ['mixture'], expected gaussian, mixture"),
        ("[background]\nmodel = 'mixture'\nsettle_time = 1.0", "unknown key 'settle_time', expected model, "),
        ("[blobs]\npatience = 1.0", "[blobs]: unknown key 'patience', it is max_coast_time now"),
        ("[blobs]\nname = 'x'", "[blobs]: unknown key 'name'"),
        ("[blobs]\npixels = 'x'", "[blobs]: unknown key 'pixels'"),
        ("[background", "not a TOML file"),
        (b"\xff\xfe", "not a TOML file"),
    ],
)
def test_wrong_parameters(
    content: bytes | str, words: str, scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "settings.toml", content)
    message = complaint(capfd, "background", scene / "input", "--out", tmp_path / "out", "--config", path)
    assert words in message
    assert "settings.toml" in message
    assert not (tmp_path / "out").exists()


def test_wrong_regions(scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    start = ("background", scene / "input", "--out", tmp_path / "out", "--roi")
    assert "not a readable picture" in complaint(capfd, *start, write(tmp_path / "text.png", "text"))
    for name, shape, words in (
        ("small", (10, 10), "has 10x10 px, expected 64x48"),
        ("black", (48, 64), "is black everywhere"),
    ):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros(shape, np.uint8))
        assert words in complaint(capfd, *start, tmp_path / f"{name}.png")


def test_wrong_ground_truth(scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    start = ("background", scene / "input", "--out", tmp_path / "out", "--ground-truth")
    late = write(tmp_path / "late.txt", "100,1,5,5,10,10,1,-1,-1,-1\n")
    assert "annotates frames 100 to 100, but frames 1 to 12" in complaint(capfd, *start, late)
    assert "line 1" in complaint(capfd, *start, write(tmp_path / "text.txt", "1,2,three\n"))
    assert "holds no boxes" in complaint(capfd, *start, write(tmp_path / "empty.txt", ""))
    assert "holds no gt/gt.txt" in complaint(capfd, *start, tmp_path)
    masks = tmp_path / "other" / "groundtruth"
    masks.mkdir(parents=True)
    cv2.imwrite(str(masks / "gt000001.png"), np.zeros((10, 20), np.uint8))
    assert "has 20x10 px, expected 64x48" in complaint(capfd, *start, masks.parent)
    assert not (tmp_path / "out").exists()


def test_existing_results(scene: Path, finished: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = modified(finished)
    start = ("background", scene / "input", "--out", finished)
    assert "already holds results: use --overwrite or --resume" in complaint(capfd, *start)
    for wrong in (("--start", 40), ("--roi", "0,0,500,500"), ("--config", "nowhere.toml")):
        complaint(capfd, *start, "--overwrite", *wrong)
    assert modified(finished) == before


def test_resuming_something_else(
    scene: Path, finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    start = ("background", scene / "input", "--out", finished, "--resume")
    config = write(tmp_path / "settings.toml", "[background]\nprior = 0.6\n")
    for wrong, words in (
        (("--stop", 5), "stop was None, now 5"),
        (("--engine", "stand-alone"), "engine was 'recursive-bp', now 'stand-alone'"),
        (("--engine", "feed-forward"), "engine was 'recursive-bp', now 'feed-forward'"),
        (("--config", config), "background.prior was"),
        (("--masks", "none"), "masks was 'png', now 'none'"),
        (("--seed", 1), "seed was 0, now 1"),
    ):
        assert words in complaint(capfd, *start, *wrong)
    other = tmp_path / "input"
    shutil.copytree(scene / "input", other)
    (other / "in000012.png").unlink()
    message = complaint(capfd, "background", other, "--out", finished, "--resume")
    assert "other source than in the saved run: count was 12, now 11" in message


def test_broken_state_files(
    scene: Path, finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished, out)
    state = (out / "state.npz").read_bytes()
    for content in (b"", b"nonsense", state[: len(state) // 2]):
        (out / "state.npz").write_bytes(content)
        message = complaint(capfd, "background", scene / "input", "--out", out, "--resume")
        assert "state.npz: got " in message
        assert "expected a state that was saved here" in message
    (out / "state.npz").unlink()
    message = complaint(capfd, "background", scene / "input", "--out", out, "--resume")
    assert "start again with --overwrite" in message


def test_a_full_disk(scene: Path, tmp_path: Path) -> None:
    Command("background").on_a_full_disk(tmp_path / "out", 20_000, scene / "input")


@pytest.mark.slow
def test_comparison(scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for truth in ([], ["--ground-truth", str(scene)]):
        arguments = ["reproduce", "compare", str(scene / "input"), "--out", str(tmp_path)]
        with pytest.raises(SystemExit) as ended:
            main([*arguments, *truth])
        assert ended.value.code == 0
        for name in ("index.html", "results.json", "compare-pictures.png"):
            assert (tmp_path / name).stat().st_size > 0
        assert ("Errors, as in" in (tmp_path / "index.html").read_text()) == bool(truth)
        (table,) = json.loads((tmp_path / "results.json").read_text())["tables"]
        assert len(table["rows"]) == 8
        assert ("ghosts" in table["header"]) == bool(truth)


def test_help_comes_at_once() -> None:
    """0.3 s on an idle machine, since nothing that takes long to import is."""
    done = subprocess.run([*COMMAND, "--help"], capture_output=True, text=True, check=True)
    assert "background" in done.stdout
    heavy = "import sys, rsmcm.apps.command_line; print(*sys.modules, sep='\\n')"
    loaded = subprocess.run([sys.executable, "-c", heavy], capture_output=True, text=True, check=True)
    assert not {"numpy", "cv2", "scipy", "av", "numba", "matplotlib"} & set(loaded.stdout.splitlines())
