"""Loops over patches against plain numpy in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.models.background.gaussian import colour
from rsmcm.models.background.kernels.layers import Sprite
from rsmcm.models.objects.kernels import blobs as kernels

F4 = np.float32


def textured(rng, channels, height, width):
    """Smooth random planes, so that small shifts look alike."""
    coarse = rng.uniform(30, 220, (channels, height // 4 + 2, width // 4 + 2))
    rows, columns = np.arange(height) / 4, np.arange(width) / 4
    across = np.array([[np.interp(columns, np.arange(len(row)), row) for row in plane] for plane in coarse])
    out = [[np.interp(rows, np.arange(len(line)), line) for line in plane.T] for plane in across]
    return np.array(out).transpose(0, 2, 1).astype(F4)


def density_of(planes, appearance):
    distance = np.square(planes.astype(float) - appearance).sum(axis=0)
    return 0.9 * np.exp(4.0 - 0.5 / 300 * distance) + 0.1


@settings(max_examples=60, deadline=None)
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


@settings(max_examples=60, deadline=None)
@given(st.integers(-15, 15), st.integers(-15, 15))
def test_cover_takes_away_what_a_mask_covers(top, left):
    rng = np.random.default_rng(1)
    mask, free = rng.random((7, 9)).astype(F4), rng.random((11, 8)).astype(F4)
    wide = np.ones((60, 60))
    wide[20 + top : 27 + top, 20 + left : 29 + left] = 1 - mask
    expected = free * wide[20:31, 20:28]
    kernels.cover(free, top, left, mask)
    np.testing.assert_allclose(free, expected, rtol=1e-6)


def registration(channels, down, right, reach=8, size=(40, 21)):
    """A patch in which a blob has moved by `(down, right)`."""
    rng = np.random.default_rng(2)
    rows, columns = size
    planes = textured(rng, channels, rows + 2 * reach, columns + 2 * reach)
    window = (slice(reach + down, reach + down + rows), slice(reach + right, reach + right + columns))
    appearance = planes[:, *window] + rng.normal(0, 3, (channels, rows, columns)).astype(F4)
    mask = np.zeros(size, F4)
    mask[4:-4, 4:-4] = 0.9
    shape = planes.shape[1:]
    patch = kernels.Patch(planes, np.zeros(shape, F4), np.ones(shape, F4))
    return patch, rng.uniform(0.5, 2, shape).astype(F4), sprite(mask, appearance)


def sprite(mask, appearance):
    return Sprite(mask, appearance, F4(0.5 / 300), F4(4.0), F4(0.1))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-5, 6), (7, 7)])
def test_search_finds_a_shifted_blob(channels, shift):
    found = kernels.search(8, kernels.Expected(0.0, 0.0, 0.001), F4(0.15), 1, *registration(channels, *shift))
    assert found[:2] == pytest.approx(shift, abs=0.5)
    assert 0.1 <= found[2] <= 25
    assert 0.1 <= found[3] <= 25


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(40, 21), (30, 32), (21, 50)])
@pytest.mark.parametrize("step", [1, 3])
def test_search_maximises_the_stated_sum(channels, size, step):
    """Its variances and sub-pixel place are those of the scores in plain float64."""
    patch, rivals, blob = registration(channels, 2, -1, size=size)
    (planes, _, free), (mask, appearance, *_) = patch, blob
    free[:, :9] = 0.5
    y, x, variance_y, variance_x = kernels.search(
        8, kernels.Expected(0.0, 0.0, 1e-6), F4(0.15), step, patch, rivals, blob
    )

    def score(down, right):
        box = (slice(8 + down, 8 + down + size[0], step), slice(8 + right, 8 + right + size[1]))
        density = density_of(planes[:, *box], appearance[:, ::step])
        terms = free[box] * np.log1p(mask[::step].astype(float) * (density * rivals[box] - 1))
        return 0.15 * step * terms.sum()

    # sub-pixel places may round to a neighbour of the best whole one
    near = [(round(y) + i, round(x) + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    middle = max(near, key=lambda place: score(*place))
    here = score(*middle)
    for axis, place, variance in ((0, y, variance_y), (1, x, variance_x)):
        aside = np.eye(2, dtype=int)[axis]
        before, after = score(*(middle - aside)), score(*(middle + aside))
        curvature = 2 * here - before - after
        assert here >= max(before, after) - 0.05
        assert variance == pytest.approx(np.clip(1 / curvature, 0.1, 25), rel=0.05)
        peak = np.clip(0.5 * (after - before) / curvature, -0.5, 0.5)
        assert place - middle[axis] == pytest.approx(peak, abs=0.05)


def test_search_stays_at_the_prior_where_pixels_say_nothing():
    patch, rivals, blob = registration(3, 0, 0)
    patch.free[:] = 0
    y, x, variance_y, variance_x = kernels.search(
        8, kernels.Expected(0.0, 0.0, 1.0), F4(0.15), 1, patch, rivals, blob
    )
    assert (y, x) == (0, 0)
    assert (variance_y, variance_x) == (25, 25)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("columns", [5, 16, 33])
def test_learn(channels, columns):
    rng = np.random.default_rng(4)
    shape = (12, columns)
    planes, appearance = (textured(rng, channels, *shape) for _ in range(2))
    appearance = (planes + 0.1 * (appearance - planes)).astype(F4)
    odds, free = rng.normal(0, 3, shape).astype(F4), rng.integers(0, 2, shape).astype(F4)
    others, mask = rng.uniform(1, 40, shape).astype(F4), rng.uniform(0, 0.95, shape).astype(F4)
    new_mask, new_appearance = np.empty_like(mask), np.empty_like(appearance)
    total, visible, seen, variance = kernels.learn(
        kernels.Patch(planes, odds, free), others, sprite(mask, appearance), F4(10), F4(0.2), F4(0.3),
        F4(0.45), new_mask, new_appearance,
    )  # fmt: skip
    share = np.minimum((10 * free * mask * density_of(planes, appearance) + 1) / others, 1)
    target = share / (1 + np.exp(odds))
    assert total == pytest.approx(mask.sum(), rel=1e-4)
    assert visible == pytest.approx((free * mask).sum(), rel=1e-4)
    assert seen == pytest.approx((free * mask * target).sum(), rel=1e-3)
    learned = free * target > 0.5
    squares = np.square(planes.astype(float) - appearance).mean(axis=0)
    assert variance == pytest.approx(squares[learned & (mask > 0.5)].mean(), rel=1e-3)
    doubt = (mask > 0.35) & (density_of(planes, appearance) > 1)
    wanted = np.where(doubt, np.maximum(target, 0.45), target)
    after = np.clip(mask + 0.2 * free * (wanted - mask), 0, 0.97)
    np.testing.assert_allclose(new_mask, after, atol=1e-3)
    rate = np.where(learned, np.where(mask < 0.2, 1.0, 0.3), 0.0)
    sure = (np.abs(free * target - 0.5) > 1e-3) & (np.abs(after - 0.1) > 1e-3)
    expected = np.where(after < 0.1, kernels.UNKNOWN_COLOUR, appearance + rate * (planes - appearance))
    np.testing.assert_allclose(new_appearance[:, sure], expected[:, sure], atol=1e-2)
    assert 0 < learned.mean() < 1


@pytest.mark.parametrize(("width", "reach"), [(6, 1), (6, 2), (2, 2), (1, 3)])
def test_contrasts_across_an_outline_and_beside_it(width, reach):
    mask, out = np.zeros((30, 40), F4), np.empty((2, 4 * 1200), F4)
    mask[12:20, 17 : 17 + width] = 1
    planes = np.full((2, 30, 40), 50, F4)
    planes[:, mask > 0] = [[150], [90]]
    free = np.ones((30, 40), F4)
    count = kernels.outline_contrasts(planes, free, mask, reach, out)
    assert count == 2 * (8 + width)
    np.testing.assert_allclose(out[0, :count], np.hypot(100, 40))
    np.testing.assert_array_equal(out[1, :count], 0)
    planes[:] = 3 * np.arange(40)
    assert kernels.outline_contrasts(planes, free, mask, reach, out) == count
    slopes = np.unique(out[1, :count])
    np.testing.assert_allclose(slopes, [0, 6 * reach * np.sqrt(2)], rtol=1e-6)
    free[:, :17] = 0  # what covers the left side hides its outline, and places above and below next to it
    assert kernels.outline_contrasts(planes, free, mask, reach, out) == count - 8
    assert kernels.outline_contrasts(planes, 0 * free, mask, reach, out) == 0


@pytest.mark.parametrize("size", [(40, 60), (7, 5), (33, 65)])
@pytest.mark.parametrize("scale", [1, 4])
def test_count_foreground(size, scale):
    log_odds = np.random.default_rng(5).integers(-20, 127, size).astype(np.int8)
    counts = np.full((-(-size[0] // scale), -(-size[1] // scale)), 7, np.int32)
    kernels.count_foreground(log_odds.reshape(-1), size[1], scale, counts)
    wide = np.zeros((counts.shape[0] * scale, counts.shape[1] * scale), bool)
    wide[: size[0], : size[1]] = log_odds < 0
    expected = wide.reshape(counts.shape[0], scale, counts.shape[1], scale).sum(axis=(1, 3))
    np.testing.assert_array_equal(counts, expected)
