"""The tests with the lowest versions of what the package needs, the tested ones and the newest, and as other
processors run them.

`nox` runs the quick tests with each version, `nox --session processor` the numerical ones as each processor;
what stands behind `--` goes to pytest in place of these tests.
"""

import os
import sys

import nox

nox.options.default_venv_backend = "uv"
nox.options.download_python = "never"
nox.options.error_on_missing_interpreters = False  # nox lists the sessions that it left out

FIRST_MET = (
    "apps/background", "apps/io", "apps/test_command_line.py", "inference/engine", "system/test_pages.py",
)  # fmt: skip
"""Tests of what meets other libraries first: files, saved states, engines, the command line."""

NUMERICAL = ("tests/models", "tests/inference", "tests/chains")

NO_AVX512 = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "OPENCV_CPU_DISABLE": "AVX512-SKX",
    "OPENCV_IPP": "avx2",
}
NO_AVX2 = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3",
    "OPENCV_IPP": "sse42",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
}
PROCESSORS = {
    "nehalem": {**NO_AVX2, "OPENBLAS_CORETYPE": "Nehalem", "NUMBA_CPU_NAME": "generic"},
    "sandybridge": {**NO_AVX2, "OPENBLAS_CORETYPE": "Sandybridge", "NUMBA_CPU_NAME": "sandybridge"},
    "haswell": {**NO_AVX512, "OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "haswell"},
    "zen": {**NO_AVX512, "OPENBLAS_CORETYPE": "Zen", "NUMBA_CPU_NAME": "znver3"},
}
"""What has OpenBLAS, numpy, OpenCV, the C library and numba take the code that they have for a processor.

Each rounds in its own way. A processor can play those that have less than itself; to be told not to use what
it lacks changes nothing.
"""


@nox.session(python="3.11")
def lowest(session: nox.Session) -> None:
    """The lowest versions that pyproject.toml allows, on the oldest Python."""
    install(session, "--resolution", "lowest-direct")
    run_tests(session, *session.posargs)


@nox.session(python="3.11")
def tested(session: nox.Session) -> None:
    """The versions of constraints.txt."""
    install(session, "--constraint", "constraints.txt")
    run_tests(session, *session.posargs)


@nox.session(python=["3.12", "3.13"])
def newest(session: nox.Session) -> None:
    """The newest version of everything."""
    install(session, "--upgrade")
    run_tests(session, *session.posargs)


@nox.session(python="3.13", default=False)
def newest_first_met(session: nox.Session) -> None:
    """The demo, and a part of the tests, with the newest version of everything: a few minutes."""
    install(session, "--upgrade")
    run_tests(session, *(f"tests/{path}" for path in FIRST_MET))
    session.run("rsmcm", "demo", "--out", f"{session.create_tmp()}/demo")


@nox.session(python=False, default=False)
@nox.parametrize("name", list(PROCESSORS), ids=list(PROCESSORS))
def processor(session: nox.Session, name: str) -> None:
    """The numerical tests as another processor rounds, with the packages that are there."""
    # numba alone would take what this processor has beyond the one that is named
    session.env.update(PROCESSORS[name], NUMBA_CPU_FEATURES="")
    run_tests(session, *(session.posargs or NUMERICAL))


def install(session: nox.Session, *versions: str) -> None:
    """Install the package and its test tools in the given way."""
    session.install(*versions, "--editable", ".[test]")


def run_tests(session: nox.Session, *tests: str) -> None:
    """Run the quick tests, or those of the given files."""
    # Compiled loops are kept apart: each version of numba overwrites what another one has left.
    session.env["NUMBA_CACHE_DIR"] = os.fspath(session.cache_dir / session.name)
    python = "python" if session.python else sys.executable
    session.run(python, "-m", "pytest", "-n", "2", "-m", "not slow", *tests)
