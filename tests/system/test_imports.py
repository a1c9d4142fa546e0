"""What an import costs: packages load only what is asked for."""

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
    "statement",
    [
        "import rsmcm.inference",
        "import rsmcm.models, rsmcm.chains",
        "from rsmcm.inference import RecursiveBP",
    ],
)
def test_an_import_brings_nothing_heavy(statement: str) -> None:
    assert not loaded(statement) & HEAVY


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import rsmcm.apps.command_line", {*HEAVY, "numpy", "networkx", "joblib"}),
        (
            "import rsmcm.apps.background.application",
            {"scipy.special", "scipy.optimize", "matplotlib", "joblib"},
        ),
        ("import rsmcm.apps.face.application, rsmcm.apps.body.application", {"matplotlib", "joblib"}),
        ("import rsmcm.apps.structure.application", {"matplotlib", "joblib"}),
    ],
)
def test_an_application_brings_nothing_that_it_does_not_begin_with(statement: str, heavy: set[str]) -> None:
    assert not loaded(statement) & heavy


def test_a_chain_brings_nothing_of_other_domains() -> None:
    names = loaded("from rsmcm.chains import AdaptiveBackground")
    assert not [name for name in names if name.startswith("rsmcm") and {"body", "face"} & {*name.split(".")}]


@pytest.mark.parametrize(
    "package", ["models", "inference", "chains", "apps.io", "apps.evaluation", "apps.scenes"]
)
def test_all_names_of_a_package_are_there(package: str) -> None:
    script = f"from rsmcm.{package} import *; import rsmcm.{package} as package; print(*package.__all__)"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert len(done.stdout.split()) >= 9
