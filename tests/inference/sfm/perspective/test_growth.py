"""Structures that grow from two views: films for which there is no affine start."""

import numpy as np
import pytest
from rsmcm.inference.sfm.perspective.structure import grown
from rsmcm.models.numerics.rotations import logarithm

from ....support.perspective_films import PerspectiveFilm, table_top, turning


def about_principal(film: PerspectiveFilm) -> np.ndarray:
    return film.tracks - film.cameras.principal


def test_grows_to_the_whole_film() -> None:
    """A table top does (24 of 24 seeds), of turning things with gaps half (11 of 24); what grows is right."""
    table = table_top(0, outliers=0.05)
    whole = []
    for film in (table, *(turning(k, outliers=0.05, missing=0.5) for k in range(3))):
        found = grown(about_principal(film), 1.2 * film.cameras.focal, focal_known=False)
        if found is None or not found[2].all():
            continue
        cameras = found[0]
        assert cameras.focal == pytest.approx(film.cameras.focal, rel=0.1)
        between = [
            each.rotations[1:] @ each.rotations[:-1].transpose(0, 2, 1) for each in (cameras, film.cameras)
        ]
        turns, wanted = (np.degrees(np.linalg.norm(logarithm(each), axis=1)) for each in between)
        assert np.median(np.abs(turns - wanted)) < 0.4
        whole.append(film)
    assert any(film is table for film in whole)


def test_without_parallax_nothing_grows() -> None:
    """A camera that only turns: rays to a point are parallel."""
    film = table_top(3, noise=0.05)
    rng = np.random.default_rng(0)
    away = rng.uniform([-400, -300, 900], [400, 300, 1000], (60, 3))
    places = np.stack(
        [film.cameras.focal * (seen := away @ turn.T)[:, :2] / seen[:, 2:] for turn in _pans(12)]
    )
    assert grown(places + rng.normal(0, 0.01, places.shape), 320.0, focal_known=True) is None


def test_with_too_few_points_nothing_grows() -> None:
    film = table_top(0)
    assert grown(about_principal(film)[:, :6], film.cameras.focal, focal_known=True) is None


def _pans(n: int) -> np.ndarray:
    angles = np.radians(2.0) * np.arange(n)
    turns = np.tile(np.eye(3), (n, 1, 1))
    turns[:, 0, 0] = turns[:, 2, 2] = np.cos(angles)
    turns[:, 0, 2], turns[:, 2, 0] = np.sin(angles), -np.sin(angles)
    return turns
