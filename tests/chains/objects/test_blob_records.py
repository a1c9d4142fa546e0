"""Loops over masks and pixels of blobs, against plain numpy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rsmcm.chains.objects import blob_records as kernels
from rsmcm.chains.objects.blob_records import fade_beyond, measured
from rsmcm.chains.objects.blobs import take_crumbs
from rsmcm.chains.pixels.background_prediction import colour

F4 = np.float32

masks = arrays.arrays(
    F4,
    st.tuples(st.integers(1, 14), st.integers(1, 18)),
    # far from the thresholds, so that no rounding decides
    elements=st.sampled_from([0.0, 0.1, 0.3, 0.4, 0.5, 0.9]),
    fill=st.just(F4(0)),
)


def span(hit):
    """First and end of what is true; all and 0 where nothing is."""
    places = np.flatnonzero(hit)
    return (int(places[0]), int(places[-1]) + 1) if places.size else (len(hit), 0)


@settings(max_examples=20, deadline=None)
@given(masks)
def test_boxes_and_mass(mask):
    shape = measured(mask)
    likely, faint = mask > 0.45, mask > 0.25
    assert (shape["top"], shape["bottom"]) == span(likely.sum(axis=1) > 1)
    assert (shape["left"], shape["right"]) == span(likely.sum(axis=0) > 1)
    assert (shape["faint_top"], shape["faint_bottom"]) == span(faint.any(axis=1))
    assert (shape["faint_left"], shape["faint_right"]) == span(faint.any(axis=0))
    np.testing.assert_allclose(shape["mass"], mask.sum(dtype=float), rtol=1e-5, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(masks)
def test_the_waist_is_the_narrowest_place_between_upright_parts(mask):
    heights = np.pad(mask.sum(axis=0, dtype=float), 1, mode="edge")
    smooth = (heights[:-2] + heights[1:-1] + heights[2:]) / 3
    beside = np.minimum(np.maximum.accumulate(smooth), np.maximum.accumulate(smooth[::-1])[::-1])
    depth = np.ones(len(smooth))
    upright = beside > 0.25 * len(mask) + 1e-4
    depth[upright] = smooth[upright] / beside[upright]
    shape = measured(mask)
    if np.abs(beside - 0.25 * len(mask)).min() > 1e-4:
        np.testing.assert_allclose(shape["waist_depth"], depth.min(), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(
            depth[shape["waist"]], depth.min() if shape["waist"] else depth[0], atol=1e-4
        )


@settings(max_examples=20, deadline=None)
@given(masks, st.floats(0, 20), st.floats(0, 20))
def test_fade_beyond(mask, height, width):
    def median(masses):
        return int(np.flatnonzero(np.cumsum(masses) >= 0.5 * masses.sum())[0])

    mask = np.round(mask * 16) / F4(16)  # sums are exact, so that no rounding moves a median
    rows, columns = np.indices(mask.shape)
    far = np.abs(rows - median(mask.sum(axis=1))) > 0.5 * height + 2
    far |= np.abs(columns - median(mask.sum(axis=0))) > 0.5 * width + 2
    faded = mask.copy()
    fade_beyond(faded, height, width, F4(0.5), np.empty(99, F4))
    np.testing.assert_array_equal(faded, np.where(far, 0.5 * mask, mask))


def test_crumbs_are_spots_of_less_than_a_tenth_of_the_largest():
    mask = np.full((24, 31), 0.2, F4)
    mask[3:11, 4:9] = mask[15, 3:7] = 0.8
    expected = mask.copy()
    mask[20, 20], mask[21, 21], mask[20, 22] = 0.9, 0.9, 0.4  # three that touch at corners
    expected[20, 20] = expected[21, 21] = expected[20, 22] = 0
    whole = mask.copy()
    labels, (crumb,) = take_crumbs(mask)
    np.testing.assert_array_equal(mask, expected)
    np.testing.assert_array_equal(np.where(labels == crumb, whole, 0), whole - expected)
    assert len(take_crumbs(mask)[1]) == len(take_crumbs(np.zeros((5, 7), F4))[1]) == 0


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from([1, 3]),
    st.integers(-12, 25),
    st.integers(-20, 40),
    st.integers(1, 14),
    st.integers(1, 20),
)
def test_gather_cuts_a_box_out_of_the_picture(channels, top, left, rows, columns):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (17, 29, channels)).astype(np.uint8)
    log_odds = rng.integers(-127, 128, (17, 29)).astype(np.int8)
    planes, odds, free = (
        np.full(shape, 9, F4) for shape in ((channels, rows, columns), *[(rows, columns)] * 2)
    )
    kernels.gather(image, log_odds, top, left, kernels.Patch(planes, odds, free))
    wide = colour.to_planes(image if channels == 3 else image[:, :, 0]).reshape(channels, 17, 29)
    wide, in_nats = np.pad(wide, ((0, 0), (50, 50), (50, 50))), np.pad(log_odds / 20.0, 50)
    box = (slice(50 + top, 50 + top + rows), slice(50 + left, 50 + left + columns))
    np.testing.assert_allclose(planes, wide[:, *box], atol=1e-3)
    np.testing.assert_allclose(odds, in_nats[box], atol=1e-6)
    np.testing.assert_array_equal(free, np.pad(np.ones((17, 29)), 50)[box])


@settings(max_examples=20, deadline=None)
@given(st.integers(-15, 15), st.integers(-15, 15))
def test_cover_takes_away_what_a_mask_covers(top, left):
    rng = np.random.default_rng(1)
    mask, free = rng.random((7, 9)).astype(F4), rng.random((11, 8)).astype(F4)
    wide = np.ones((60, 60))
    wide[20 + top : 27 + top, 20 + left : 29 + left] = 1 - mask
    expected = free * wide[20:31, 20:28]
    kernels.cover(free, top, left, mask)
    np.testing.assert_allclose(free, expected, rtol=1e-6)
