"""Imports load only what is used."""

import subprocess
import sys

import pytest

HEAVY = {"numba", "cv2", "scipy", "matplotlib", "av"}


def loaded(statement: str) -> set[str]:
    """Names of all modules that a fresh interpreter has after the statement."""
    script = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import rsmcm.models, rsmcm.chains; from rsmcm.inference import RecursiveBP", HEAVY),
        ("import rsmcm; assert rsmcm.__version__", {*HEAVY, "numpy", "rsmcm.models"}),
        ("import rsmcm.apps, rsmcm.apps.command_line", {*HEAVY, "numpy", "networkx", "joblib"}),
        (
            "import rsmcm.apps.background.application",
            {"scipy.special", "scipy.optimize", "matplotlib", "joblib"},
        ),
    ],
)
def test_an_import_loads_only_what_is_used(statement: str, heavy: set[str]) -> None:
    assert not loaded(statement) & heavy


def test_a_chain_loads_no_other_domain() -> None:
    names = loaded("from rsmcm.chains import AdaptiveBackground")
    assert not [name for name in names if name.startswith("rsmcm") and {"body", "face"} & {*name.split(".")}]


def test_all_names_of_the_packages_are_there() -> None:
    packages = ("models", "inference", "chains", "apps", "apps.io", "apps.evaluation", "apps.scenes")
    loaded("; ".join(f"from rsmcm.{package} import *" for package in packages))
