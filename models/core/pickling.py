"""What is worked out from an object's parameters is not part of it."""

from dataclasses import fields
from typing import Any


class PickledByFields:
    """A dataclass of which fields alone are pickled, and not what its cached properties keep."""

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
