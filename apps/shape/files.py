"""What a run of the shape application leaves for other programs."""

from pathlib import Path

import numpy as np

from ...models.files import write_atomically
from .result import LearnedShape

SHAPES, MODEL = "shapes.npz", "model.npz"


def write_shapes(path: Path, found: LearnedShape) -> None:
    """Write `shapes.npz`, whole or not at all.

    Point j of frame t is seen at x and y of `shapes[t, j]` = `scales[t] * rotations[t] @ (bases[0, j] + sum_k
    weights[t, k] * bases[k + 1, j])`, with `translations[t]` added to x and y, and finer modes, `details`
    with `detail_weights`, added like the others. `covariance` is that of `shapes` in px^2. What is not known
    of a frame is NaN.
    """
    learned = found.learned
    with write_atomically(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            shapes=found.shapes,
            covariance=found.covariances,
            observed=found.observed,
            rotations=learned.rotations,
            scales=learned.scales,
            translations=learned.translations,
            weights=learned.weights,
            bases=learned.bases,
            details=learned.details,
            detail_weights=learned.detail_weights,
            frame=np.array(found.numbers, np.int64),
            time=found.times,
        )
