"""Texels lie on the surface, evenly, and any first part of a group does, too."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.models.face.surface import SurfaceTexels

from ...support.surfaces import bumpy, row_of_texel


@given(st.integers(1, 3000))
def test_a_dense_mesh_shares_texels_out_by_area(n_texels: int) -> None:
    model = bumpy()
    texels = SurfaceTexels.dense(model, n_texels)
    corners = model.bases[0][model.triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert len(texels) == n_texels == texels.first[-1] == len(texels.group_of_texel)
    assert (np.diff(texels.counts) <= 0).all()
    assert texels.counts.min() > 0
    number = {tuple(corners): k for k, corners in enumerate(model.triangles.tolist())}
    counts = np.zeros(len(area))
    counts[[number[tuple(corners)] for corners in texels.groups.tolist()]] = texels.counts
    assert (np.abs(counts - area / area.sum() * n_texels) < 1 + 1e-6).all()
    assert (texels.weights >= 0).all()
    np.testing.assert_allclose(texels.weights.sum(axis=1), 1, atol=1e-6)
    assert not texels.offsets.any()
    assert not texels.areas.any()


def test_rows_hold_the_kth_texel_of_every_group_that_has_so_many() -> None:
    texels = SurfaceTexels.dense(bumpy(), 700)
    for row, (begin, end) in enumerate(zip(texels.first[:-1], texels.first[1:], strict=True)):
        np.testing.assert_array_equal(texels.group_of_texel[begin:end], np.flatnonzero(texels.counts > row))
        assert (row_of_texel(texels)[begin:end] == row).all()
        assert (texels.weights[begin:end] == texels.weights[begin]).all()
        assert (texels.offsets[begin:end] == texels.offsets[begin]).all()


def test_texels_fill_triangles_evenly() -> None:
    texels = SurfaceTexels.dense(bumpy(), 24 * 400)
    inside = texels.weights[texels.group_of_texel == 0]
    assert len(inside) > 100
    # moments of the uniform density over a triangle: means 1/3, second moments 1/6 and 1/12
    np.testing.assert_allclose(inside.mean(axis=0), 1 / 3, atol=0.01)
    np.testing.assert_allclose(
        inside.T @ inside / len(inside), np.full((3, 3), 1 / 12) + np.eye(3) / 12, atol=0.01
    )
    # so is its first quarter, which a coarse level uses
    part = inside[: len(inside) // 4]
    np.testing.assert_allclose(part.mean(axis=0), 1 / 3, atol=0.04)
    np.testing.assert_allclose(part.T @ part / len(part), np.full((3, 3), 1 / 12) + np.eye(3) / 12, atol=0.03)


@given(st.floats(1, 12))
def test_patches_are_discs_with_a_texel_a_pixel(radius: float) -> None:
    model = bumpy()
    texels = SurfaceTexels.patches(model, radius)
    wanted = {(x, y) for x in range(-13, 14) for y in range(-13, 14) if x * x + y * y <= radius**2}
    for vertex in range(model.n_vertices):
        own = texels.group_of_texel == vertex
        assert {tuple(offset) for offset in texels.offsets[own].astype(int).tolist()} == wanted
        assert (texels.groups[vertex] == vertex).all()
        np.testing.assert_array_equal(texels.weights[own], np.tile([1, 0, 0], (len(wanted), 1)))
    np.testing.assert_array_equal(texels.areas, 1)


def test_impossible_surfaces_are_refused() -> None:
    with pytest.raises(ValueError, match="dense texels: got 10 on 0 triangles"):
        SurfaceTexels.dense(bumpy(closed=False), 10)
    with pytest.raises(ValueError, match="dense texels: got 0 on 24 triangles"):
        SurfaceTexels.dense(bumpy(), 0)
    with pytest.raises(ValueError, match=r"radius: got 0\.5 px, expected 1 or more"):
        SurfaceTexels.patches(bumpy(), 0.5)
