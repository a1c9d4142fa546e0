"""Packages that only some of the exports need."""

from importlib import import_module
from typing import Any


def needed(package: str) -> Any:
    """Import a package that the extra of its name brings.

    Raises
    ------
    ImportError
        that says what to install.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise ImportError(f"this needs {package}: pip install 'rsmcm[{package}]'", name=package) from error
