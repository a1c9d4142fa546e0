import cv2
import numpy as np
from rsmcm.apps.scenes import turntable

from ...support.scenes import transferred


def test_pictures_agree_with_the_geometry():
    film = turntable(2, (288, 360), seed=3)
    rows, columns = np.nonzero(np.isfinite(film.depth[0]))
    places = np.stack([columns, rows], axis=1).astype(np.float64)
    there = transferred(film, places, 0, 1)
    middle = np.linalg.norm(places - [179.5, 143.5], axis=1) < 50  # nothing hides itself here
    seen = cv2.remap(film.images[1], *there.T.astype(np.float32)[:, None], cv2.INTER_LINEAR)[0]
    assert np.corrcoef(seen[middle], film.images[0, rows, columns][middle])[0, 1] > 0.9
    step = np.linalg.norm(there - places, axis=1)[middle]
    assert 10 < np.median(step) < 20  # as a radius of 86 px turns by 10 degrees
    back = transferred(film, there[middle], 1, 0)
    assert np.median(np.linalg.norm(back - places[middle], axis=1)) < 0.2


def test_a_whole_turn_ends_where_it_began():
    film = turntable(4, (72, 90), degrees_per_frame=120.0)
    np.testing.assert_allclose(film.depth[3], film.depth[0], atol=1e-3)
    assert np.abs(film.images[3].astype(int) - film.images[0]).mean() < 2  # the camera's noise
    assert np.abs(film.images[1].astype(int) - film.images[0])[np.isfinite(film.depth[0])].mean() > 5


def test_black_is_nowhere():
    film = turntable(2, (72, 90))
    assert not np.isfinite(transferred(film, np.array([[0.0, 0.0]]), 0, 1)).any()
