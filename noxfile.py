"""The quick tests with other versions of the dependencies, on other processors and with other seeds.

`nox` runs them with the lowest, the tested and the newest versions, `nox --session processor` the numerical
ones as four other processors compute, `nox --session seeds` all of them with another shift of all seeds each
time. Arguments behind `--` go to pytest in place of these tests.
"""

import os
import sys
import time

import nox

nox.options.default_venv_backend = "uv"
nox.options.download_python = "never"
nox.options.error_on_missing_interpreters = False  # nox lists the sessions that it left out

DEPENDENT = (
    "apps/background", "apps/io", "apps/test_command_line.py", "inference/engine", "system/test_pages.py",
)  # fmt: skip
"""Tests of the parts that depend on other libraries most: files, saved states, engines, the command line."""

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
"""Environment in which OpenBLAS, numpy, OpenCV, the C library and numba choose their code for a processor.

Each rounds in its own way. A processor can only play older ones, with fewer instructions than its own.
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
def newest_dependent(session: nox.Session) -> None:
    """The demo, and a part of the tests, with the newest version of everything: a few minutes."""
    install(session, "--upgrade")
    run_tests(session, *(f"tests/{path}" for path in DEPENDENT))
    session.run("rsmcm", "demo", "--out", f"{session.create_tmp()}/demo")


@nox.session(python=False, default=False)
@nox.parametrize("name", list(PROCESSORS), ids=list(PROCESSORS))
def processor(session: nox.Session, name: str) -> None:
    """The numerical tests as another processor computes, with the installed packages."""
    # without this, numba also uses what this processor has beyond the named one
    session.env.update(PROCESSORS[name], NUMBA_CPU_FEATURES="")
    run_tests(session, *(session.posargs or NUMERICAL))


@nox.session(python=False, default=False)
def seeds(session: nox.Session) -> None:
    """The quick tests with every seed shifted, by `SEED_SHIFT` or a number that is another one each time."""
    shift = os.environ.get("SEED_SHIFT") or str(int(time.time()) % 1_000_000)
    session.log(f"SEED_SHIFT={shift} repeats this run")
    session.env["SEED_SHIFT"] = shift
    run_tests(session, f"--hypothesis-seed={shift}", *session.posargs)


def install(session: nox.Session, *versions: str) -> None:
    """Install the package and its test tools in the given way."""
    session.install(*versions, "--editable", ".[test]")


def run_tests(session: nox.Session, *tests: str) -> None:
    """Run the quick tests, or those of the given files."""
    # each version of numba would overwrite the compiled loops of another one
    session.env["NUMBA_CACHE_DIR"] = os.fspath(session.cache_dir / session.name)
    python = "python" if session.python else sys.executable
    session.run(python, "-m", "pytest", "-n", "2", "-m", "not slow", *tests)
