"""Registration of blobs, against plain numpy in float64, and on several threads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.scenes.crowd import crowd
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.chains.objects import registration as kernels
from rsmcm.chains.objects.blob_records import RECORD, Patch
from rsmcm.chains.objects.registration import assign_shards, patch_bounds
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels
from rsmcm.models.numerics.threads import set_threads, thread_count

from ...support.blob_patches import F4, density_of, sprite, textured


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
    patch = Patch(planes, np.zeros(shape, F4), np.ones(shape, F4))
    return patch, rng.uniform(0.5, 2, shape).astype(F4), sprite(mask, appearance)


def prepared(reach, step, patch, rivals, blob):
    """The same with room around the patch, as for whole vectors and rows that are multiplied."""
    scratch = np.full(100_000, np.nan, F4)
    packed, rest = kernels.packed(blob, (0, 0, *blob.mask.shape), step, scratch)
    rows, columns = 2 * reach + step * packed.mask.shape[0], 2 * reach + packed.mask.shape[1]
    room = (0, max(rows - rivals.shape[0], 0)), (0, columns - rivals.shape[1])
    wide = Patch(np.pad(patch.planes, ((0, 0), *room)), *(np.pad(each, room) for each in patch[1:]))
    whole = bool(np.isin(patch.free, (0, 1)).all())
    return wide, np.pad(rivals * patch.free if whole else rivals, room), whole, packed, rest


def searched(reach, expected, step, patch, rivals, blob):
    return kernels.search(reach, expected, F4(0.15), step, *prepared(reach, step, patch, rivals, blob))


CASES = pytest.mark.parametrize(
    ("channels", "size", "step", "open_"),
    [(1, (40, 21), 1, 0.5), (3, (40, 21), 1, 0.0), (3, (30, 32), 3, 0.5), (3, (21, 50), 3, 0.0)],
)


@CASES
@pytest.mark.parametrize("place", [(10, 7), (10, 8), (3, 14)])
def test_agreement_is_the_stated_sum(channels, size, step, open_, place):
    """Where colours fit, nearly, and not at all, which is where outliers count."""
    patch, rivals, blob = registration(channels, 2, -1, size=size)
    patch.free[:, :9] = open_
    box = tuple(slice(at, at + side, by) for at, side, by in zip(place, size, (step, 1), strict=True))
    density = density_of(patch.planes[:, *box], blob.appearance[:, ::step])
    factors = 1 + blob.mask[::step].astype(float) * (density * rivals[box] - 1)
    expected = step * (patch.free[box] * np.log(factors)).sum()
    wide, others, whole, packed, _ = prepared(8, step, patch, rivals, blob)
    start = place[0] * others.shape[1] + place[1]
    found = kernels.agreement(start, step, 1, wide, others, whole, packed)
    # logarithms and exponentials are right to 2e-5 each
    assert found == pytest.approx(expected, rel=1e-4, abs=4e-5 * step * factors.size)


@CASES
def test_search_maximises_the_stated_sum(channels, size, step, open_):
    """Its variances and sub-pixel place are those of the scores in plain float64."""
    patch, rivals, blob = registration(channels, 2, -1, size=size)
    (planes, _, free), (mask, appearance, *_) = patch, blob
    free[:, :9] = open_
    y, x, variance_y, variance_x = searched(8, kernels.Expected(0.0, 0.0, 1e-6), step, patch, rivals, blob)

    def score(down, right):
        box = (slice(8 + down, 8 + down + size[0], step), slice(8 + right, 8 + right + size[1]))
        density = density_of(planes[:, *box], appearance[:, ::step])
        terms = free[box] * np.log1p(mask[::step].astype(float) * (density * rivals[box] - 1))
        return 0.15 * step * terms.sum()

    assert (y, x) == pytest.approx((2, -1), abs=1)
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
    y, x, variance_y, variance_x = searched(8, kernels.Expected(0.0, 0.0, 1.0), 1, patch, rivals, blob)
    assert (y, x) == (0, 0)
    assert (variance_y, variance_x) == (25, 25)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 90), st.integers(1, 90), st.integers(0, 40), st.integers(0, 40), st.floats(0.1, 200))
def test_no_patch_reaches_beyond_its_bounds(rows, columns, top, left, variance):
    blob = np.zeros(1, RECORD)
    blob["rows"], blob["columns"], blob["position"] = rows, columns, (30, 50)
    blob["covariance"] = variance * np.eye(2)
    first_row, first_column, height, width = kernels.patch_bounds(blob[0])
    reach = 30 - first_row
    assert first_column == 50 - reach
    part = (min(top, rows - 1), min(left, columns - 1), rows, columns)
    step = max(1, rows * columns // kernels.FINEST_ROWS)
    whole = sprite(np.zeros((rows, columns), F4), np.zeros((1, rows, columns), F4))
    packed = kernels.packed(whole, part, step, np.empty(100_000, F4))[0].mask.shape
    assert part[0] + 2 * reach + step * packed[0] <= height
    assert part[1] + 2 * reach + packed[1] <= width
    assert height * width * 4 <= kernels.scratch_for_search(blob, 0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 4))
def test_blobs_that_may_meet_are_in_one_shard(seed: int, n_blobs: int, count: int) -> None:
    random = np.random.default_rng(seed)
    table = np.zeros(n_blobs, RECORD)
    table["position"] = random.integers(0, 400, (n_blobs, 2))
    table["rows"], table["columns"] = random.integers(10, 50, (2, n_blobs))
    shards = np.zeros(n_blobs, np.int64)
    assign_shards(table, count, shards)
    assert shards.min() >= 0
    assert shards.max() < count
    for behind in range(n_blobs):
        top, left, rows, columns = patch_bounds(table[behind])
        for front in range(behind):
            # its smallest reach is 2 px, and it covers pixels of its own box alone
            first = table["position"][front] - 2
            room = [table["rows"][front] + 4, table["columns"][front] + 4]
            overlap = np.minimum(first + room, [top + rows, left + columns]) - np.maximum(first, [top, left])
            if (overlap > 0).all():
                assert shards[behind] == shards[front]


def states_of(frames: list[NDArray[np.uint8]]) -> list[bytes]:
    """All that is known of blobs after each frame."""
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    states = [belief["blobs"].blobs for belief in RecursiveBP(model).run(frames)]
    assert len(states[-1]) > 5
    return [blobs.words.tobytes() + blobs.masks.tobytes() for blobs in states]


def test_any_number_of_threads_gives_the_same_bytes() -> None:
    frames = list(crowd(10, 25, (300, 400)))
    before = thread_count()
    try:
        results = []
        for threads in (1, 2, 3):
            set_threads(threads)
            results.append(states_of(frames))
        assert results[0] == results[1] == results[2]
    finally:
        set_threads(before)
