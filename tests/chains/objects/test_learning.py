"""What a frame teaches of a blob, against plain numpy in float64."""

import numpy as np
import pytest
from rsmcm.chains.objects import blob_scene as kernels
from rsmcm.chains.objects.blob_records import UNKNOWN_COLOUR, Patch

from ...support.blob_patches import F4, density_of, sprite, textured


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
        Patch(planes, odds, free), others, sprite(mask, appearance), F4(10), F4(0.2), F4(0.3),
        F4(0.45), new_mask, new_appearance, np.empty(mask.size, F4),
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
    expected = np.where(after < 0.1, UNKNOWN_COLOUR, appearance + rate * (planes - appearance))
    np.testing.assert_allclose(new_appearance[:, sure], expected[:, sure], atol=1e-2)
    assert 0 < learned.mean() < 1
