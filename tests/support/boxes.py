"""True boxes by hand."""

import numpy as np
from rsmcm.apps.io.ground_truth import BoxTruth


def truth_of(rows: list[list[float]]) -> BoxTruth:
    """Rows of frame, identity, x, y, width, height, kind."""
    table = np.array(rows, float).reshape(-1, 7)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    whole = table.astype(np.int64)
    return BoxTruth(whole[:, 0], whole[:, 1], table[:, 2:6], whole[:, 6])
