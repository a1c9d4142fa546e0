"""Source distribution, wheel, and the installed command; the targets of make."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import sleeping_man

ROOT = Path(__file__).parents[2]
PACKAGES = ("models", "inference", "chains", "apps")
LEFT_OUT = shutil.ignore_patterns("__pycache__", "_build", "generated", "*.nb[ic]")
MOST_SECONDS = 900


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy: the checkout stays as it is, and leftovers of older builds stay out."""
    folder = tmp_path_factory.mktemp("source")
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    for name in (*PACKAGES, "docs", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=LEFT_OUT)
    return folder


@pytest.fixture(scope="module")
def built(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the source distribution of the copy, and the wheel that is built from that."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-P", "-m", "build", "--no-isolation", "--outdir", str(folder), str(source)]
    subprocess.run(build, check=True, timeout=MOST_SECONDS)
    return folder


@pytest.fixture(scope="module")
def environment(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A fresh environment with the wheel in it; what that needs is this environment's."""
    folder = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, timeout=MOST_SECONDS)
    (packages,) = folder.glob("[Ll]ib/**/site-packages")
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))
    (wheel,) = built.glob("*.whl")
    install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([_program(folder, "python"), *install], check=True, env=_clean(), timeout=MOST_SECONDS)
    yield folder
    shutil.rmtree(folder)


def _program(environment: Path, name: str) -> str:
    return str(environment / ("Scripts" if os.name == "nt" else "bin") / name)


def _clean() -> dict[str, str]:
    """Without the checkout on the path."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@pytest.mark.slow
def test_the_installed_command_tracks(environment: Path, tmp_path: Path) -> None:
    write_scene(sleeping_man(6, size=(64, 48), enter=0), tmp_path / "scene")
    run = [
        _program(environment, "rsmcm"), "background", str(tmp_path / "scene" / "input"),
        "--out", str(tmp_path / "found"),
    ]  # fmt: skip
    subprocess.run(run, check=True, env=_clean(), cwd=tmp_path, timeout=MOST_SECONDS)
    assert len(list((tmp_path / "found" / "foreground").iterdir())) == 6
    assert (tmp_path / "found" / "view.html").stat().st_size > 0


def test_help_of_make_tells_every_target() -> None:
    text = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):", text, re.MULTILINE)) - {"help"}
    assert targets == set(re.findall(r'@echo "make ([\w-]+) ', text))
    assert targets | {"help"} == set(re.findall(r"^\.PHONY: ((?:[\w-]+ ?)+)$", text, re.MULTILINE)[0].split())
