"""What is reported of blobs."""

import numpy as np
import pytest
from rsmcm.inference.objects.blobs import Track, middle_covariance
from rsmcm.models.camera.affine_map import AffineMap


def test_a_track_is_seen_by_a_camera_that_has_moved_as_its_middle_is() -> None:
    view = AffineMap(np.array([4.0, 3.0, -6.0, -2.0, 5.0, 2.0]), (120, 160))
    covariance = ((4.0, 1.0), (1.0, 9.0))
    track = Track(3, (40.0, 30.0, 10.0, 20.0), 0.75, (8.0, -6.0), True, covariance)
    seen = track.seen_by(view)

    def middle(moved: float) -> np.ndarray:
        x, y, width, height = view.box((40 + 8 * moved, 30 - 6 * moved, 10.0, 20.0))
        return np.array([x + width / 2, y + height / 2])

    assert (seen.identity, seen.confidence, seen.seen) == (3, 0.75, True)
    assert seen.box == pytest.approx(view.box(track.box))
    np.testing.assert_allclose(seen.velocity, middle(1.0) - middle(0.0), atol=1e-9)
    drawn = np.random.default_rng(0).multivariate_normal((0, 0), covariance, 100_000)
    places = view.points(drawn)
    np.testing.assert_allclose(seen.position_covariance, np.cov(places.T), atol=0.12)


def test_a_middle_is_half_a_height_above_the_foot() -> None:
    variance = np.array([4.0, 9.0, 1.0, 16.0])
    boxes = np.random.default_rng(0).normal(0, np.sqrt(variance), (200_000, 4))
    middles = boxes[:, :2] - [0, 0.5] * boxes[:, 3:]
    np.testing.assert_allclose(middle_covariance(variance), np.cov(middles.T), atol=0.1)
