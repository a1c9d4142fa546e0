"""The tests with the lowest versions of what the package needs, the tested ones and the newest.

`nox` runs the quick tests with each; what stands behind `--` goes to pytest in place of all tests.
"""

import os

import nox

nox.options.default_venv_backend = "uv"
nox.options.download_python = "never"
nox.options.error_on_missing_interpreters = False  # nox lists the sessions that it left out

FIRST_MET = (
    "apps/background", "apps/io", "apps/test_command_line.py", "inference/core", "system/test_pages.py",
)  # fmt: skip
"""Tests of what meets other libraries first: files, saved states, engines, the command line."""


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


def install(session: nox.Session, *versions: str) -> None:
    """Install the package and its test tools in the given way."""
    session.install(*versions, "--editable", ".[test]")


def run_tests(session: nox.Session, *tests: str) -> None:
    """Run the quick tests, or those of the given files."""
    # Compiled loops are kept apart: each version of numba overwrites what another one has left.
    session.env["NUMBA_CACHE_DIR"] = os.fspath(session.cache_dir / session.name)
    session.run("python", "-m", "pytest", "-n", "2", "-m", "not slow", *tests)
