"""Which versions of what a result depends on."""

import importlib.metadata
import platform

import cv2


def versions() -> dict[str, str]:
    """Version by name; they are written to a run's summary."""
    found = {"python": platform.python_version()}
    for name in ("rsmcm", "numpy", "scipy", "numba", "av"):
        found[name] = importlib.metadata.version(name)
    found["opencv"] = cv2.__version__
    return found
