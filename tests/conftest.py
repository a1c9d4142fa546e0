"""Fixtures that several test files share."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A busy machine, or the first call of a compiled loop, says nothing about what is tested.
settings.register_profile("any-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real sequences: `RSMCM_DATA`, or `shared/data` beside the checkout; skips where there are none."""
    stated = os.environ.get("RSMCM_DATA")
    folder = Path(stated) if stated else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no data in {folder}: set RSMCM_DATA")
    return folder
