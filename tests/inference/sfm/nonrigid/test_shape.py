"""What is told of a learned shape."""

import numpy as np
import pytest
from rsmcm.inference.sfm.nonrigid.shape import triangles_in_front


def test_points_on_a_line_have_no_triangles() -> None:
    line = np.column_stack([np.arange(8.0), 2 * np.arange(8.0), np.zeros(8)])
    with pytest.raises(ValueError, match="points on a line"):
        triangles_in_front(line)
