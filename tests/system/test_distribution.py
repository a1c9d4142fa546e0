"""Source distribution, wheel, and the installed command; the targets of make."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from rsmcm.apps.command_line import app
from rsmcm.apps.demo import write_scene
from rsmcm.apps.scenes import sleeping_man

ROOT = Path(__file__).parents[2]
PACKAGES = ("package", "models", "inference", "chains", "apps")
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
    quiet = ["--quiet", "--no-deps", "--no-index", "--ignore-installed"]
    install = ["-m", "pip", "install", *quiet, str(wheel)]
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


USE = """
import rsmcm, rsmcm.apps
from rsmcm.models import PixelLabels
print(rsmcm.__version__, rsmcm.models.__name__)
"""


@pytest.mark.slow
def test_nothing_beside_a_script_is_taken_for_the_package(environment: Path, tmp_path: Path) -> None:
    (tmp_path / "rsmcm").mkdir()  # of results, perhaps
    for name in ("models.py", "inference.py", "chains.py", "apps.py", "rsmcm/models.py"):
        (tmp_path / name).write_text("raise SystemExit('the wrong one')")
    (tmp_path / "use.py").write_text(USE)

    def output(*arguments: str) -> str:
        done = subprocess.run(
            [*arguments], check=True, env=_clean(), cwd=tmp_path, timeout=MOST_SECONDS, stdout=subprocess.PIPE
        )
        return done.stdout.decode().strip()

    python = _program(environment, "python")
    version = output(_program(environment, "rsmcm"), "--version")
    assert output(python, "-m", "rsmcm", "--version") == version
    assert output(python, "use.py") == f"{version} rsmcm.models"


NOBODY = ("--reuid=65534", "--regid=65534", "--clear-groups")
READS_ALL = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
"""Nobody, who may read where the tests are, and write nothing."""


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("setpriv") is None or os.geteuid() != 0, reason="only root can be somebody else"
)
def test_another_user_without_a_home_tracks_with_a_read_only_installation(
    environment: Path, tmp_path: Path
) -> None:
    write_scene(sleeping_man(6, size=(64, 48), enter=0), tmp_path / "scene")
    out = Path(tempfile.mkdtemp())  # unlike pytest's folders in one that everybody may enter
    out.chmod(0o777)
    for cache in environment.glob("[Ll]ib/**/site-packages/rsmcm/**/__pycache__"):
        shutil.rmtree(cache)

    def said(*variables: str) -> str:
        run = ["background", str(tmp_path / "scene" / "input"), "--out", str(out / "found")]
        command = [
            *("setpriv", *NOBODY, *READS_ALL, "env", "-i", *variables),
            *(_program(environment, "python"), "-m", "rsmcm", *run, "--overwrite"),
        ]
        return subprocess.run(
            command, check=True, cwd=tmp_path, timeout=MOST_SECONDS, capture_output=True, text=True
        ).stderr

    kept = f"NUMBA_CACHE_DIR={out / 'cache'}"
    assert said().count("compiled code cannot be kept") == 1
    assert "which is done once" in said(kept)
    assert said(kept) == ""
    shutil.rmtree(out)


def test_the_image_of_a_container_is_warmed_by_commands_that_there_are() -> None:
    lines = re.findall(r"&& rsmcm (.*?)(?: \\)?$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert {line.split()[0] for line in lines} == {"demo", "structure", "face", "body"}
    for line in lines:
        app.parse_args(line.split(), exit_on_error=False, print_error=False)


def test_help_of_make_tells_every_target() -> None:
    text = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):", text, re.MULTILINE)) - {"help"}
    assert targets == set(re.findall(r'@echo "make ([\w-]+) ', text))
    assert targets | {"help"} == set(re.findall(r"^\.PHONY: ((?:[\w-]+ ?)+)$", text, re.MULTILINE)[0].split())
