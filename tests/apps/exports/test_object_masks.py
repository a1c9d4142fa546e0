"""Masks of objects, and COCO's compressed run lengths against COCO's own code."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pycocotools import mask as coco
from rsmcm.apps.exports.object_masks import compressed, object_masks


@given(arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20)))
def test_run_lengths_are_those_of_coco(mask: np.ndarray) -> None:
    expected = coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()
    assert compressed(mask) == expected


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 1.0])
def test_long_runs_too(share: float) -> None:
    mask = np.random.default_rng(0).random((700, 900)) < share
    expected = coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()
    assert compressed(mask) == expected


edge = st.floats(-30, 60)


@given(st.lists(st.tuples(edge, edge, st.floats(0, 40), st.floats(0, 40)), max_size=3))
def test_a_pixel_is_in_a_box_if_its_middle_is(boxes: list[tuple[float, ...]]) -> None:
    foreground = np.where(np.random.default_rng(1).random((18, 24)) < 0.6, 255, 0).astype(np.uint8)
    masks = object_masks(foreground, np.reshape(boxes, (-1, 4)))
    assert masks.shape == (len(boxes), 18, 24)
    rows, columns = np.indices(foreground.shape) + 0.5
    for mask, (x, y, width, height) in zip(masks, boxes, strict=True):
        inside = (x <= columns) & (columns < x + width) & (y <= rows) & (rows < y + height)
        np.testing.assert_array_equal(mask, inside & (foreground > 0))
