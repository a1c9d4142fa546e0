"""Fixtures that several test files share, and commands as a user runs them."""

import json
import math
import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from rsmcm.apps.command_line import main
from rsmcm.apps.runs import progress

from .support import seed_shift
from .support.browser import Browser, browsing

seed_shift.install()

# A busy machine, or the first call of a compiled loop, may take long.
for profile, examples in (("quick", 20), ("long", 100)):
    settings.register_profile(
        profile, deadline=None, suppress_health_check=[HealthCheck.too_slow], max_examples=examples
    )
settings.load_profile("quick")


@pytest.fixture(scope="session", autouse=True)
def no_lines_of_progress() -> Iterator[None]:
    """However slow a busy machine is, a command of this process says nothing between its own lines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "SPARSE_SECONDS", math.inf)
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real sequences: `RSMCM_DATA`, or `shared/data` beside the checkout; skips where there are none."""
    stated = os.environ.get("RSMCM_DATA")
    folder = Path(stated) if stated else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no data in {folder}: set RSMCM_DATA")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium, in which pages are opened; skips where there is none."""
    with browsing() as opened:
        yield opened


@dataclass(frozen=True)
class Command:
    """A command of `rsmcm`, as a user runs it.

    Parameters
    ----------
    name
        that stands before all arguments.
    """

    name: str

    def __call__(self, *arguments: object) -> int:
        """Run it, for its exit code."""
        with pytest.raises(SystemExit) as ended:
            main([self.name, *(str(argument) for argument in arguments)])
        return int(ended.value.code or 0)

    def complaint(self, capfd: pytest.CaptureFixture[str], *arguments: object) -> str:
        """The one line that a wrong command leads to."""
        capfd.readouterr()
        code = self(*arguments)
        out, err = capfd.readouterr()
        assert (code, out) == (2, "")
        err = without_compiling(err)
        _assert_one_line(err)
        return err

    def on_a_full_disk(self, out: Path, most: int, *arguments: object) -> None:
        """One line names what cannot be written, and what is left is whole.

        A limit of the size of files stands for the disk, `most` bytes.
        """
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "rsmcm.apps.command_line",
                self.name,
                *map(str, arguments),
                "--out",
                str(out),
                "--quiet",
            ],
            capture_output=True,
            text=True,
            timeout=120,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
            # Python would leave files of compiled modules that are cut off at the limit
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        )
        assert done.returncode == 2
        _assert_one_line(done.stderr)
        assert str(out) in done.stderr
        for path in out.rglob("*"):
            assert "unfinished" not in path.name
            assert "partial" not in path.name
            if path.suffix == ".npz":
                with np.load(path) as content:
                    assert all(content[name] is not None for name in content.files)


def without_compiling(err: str) -> str:
    """Standard error without the line that says that a first run compiles."""
    return "".join(
        line for line in err.splitlines(keepends=True) if ": compiling for this machine, " not in line
    )


def _assert_one_line(err: str) -> None:
    assert err.startswith("rsmcm: ")
    assert err.count("\n") == 1, err


def summary_of(out: Path) -> dict[str, Any]:
    """What a run says of itself."""
    content: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return content


def names(folder: Path) -> set[str]:
    """Of all files but the lock, which stays."""
    return {path.name for path in folder.iterdir()} - {".lock"}


def with_peak(*arguments: object) -> tuple[subprocess.CompletedProcess[str], int]:
    """A finished command, and the bytes that it has had in memory at most; where that is not known, a skip.

    What the system counts for a child includes the process that it was forked from, so it is asked itself.
    """
    if not Path("/proc/self/status").exists():
        pytest.skip("the peak of another process is not known here")
    script = (
        "import sys\n"
        "from rsmcm.apps.command_line import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "finally:\n"
        "    print(open('/proc/self/status').read())\n"
    )
    command = [sys.executable, "-c", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000)
    (kilobytes,) = re.findall(r"VmHWM:\s*(\d+) kB", done.stdout)
    return done, 1024 * int(kilobytes)


def modified(folder: Path) -> dict[Path, int]:
    """When all that is in a folder was written, but for the lock."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.name != ".lock"}
