"""What summary and page need of a run, gathered frame by frame, and how that is saved with the run."""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .frame_lists import listed


@dataclass(eq=False, kw_only=True)
class FrameRecord:
    """Columns that grow with the frames. Every further field is a column.

    Parameters
    ----------
    numbers, times
        of the frames, 1-based and seconds.
    seconds
        that the tracker took.
    missing
        numbers of the frames without an image.
    """

    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    seconds: "array[float]" = field(default_factory=lambda: array("d"))
    missing: list[int] = field(default_factory=list)

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        if not self.missing:
            return []
        return [f"Missing, unreadable or blank, and only predicted: {listed(self.missing)}."]

    @classmethod
    def kinds(cls) -> dict[str, Any]:
        """What `saved` gives, for `rsmcm.inference.engine.checkpoint`."""
        return {each.name: NDArray[Any] for each in fields(cls)}

    def saved(self) -> dict[str, Any]:
        """Everything, as arrays."""
        return {name: np.array(getattr(self, name)) for name in self.kinds()}

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> Self:
        """The record of which `saved` was kept."""
        record = cls()
        for name, values in saved.items():
            getattr(record, name).extend(values.tolist() if values.ndim == 1 else values)
        return record
