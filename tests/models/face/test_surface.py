"""Texels on the surface, and their visibility against closed forms and lines of sight."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.surface import SurfaceTexels, visible
from rsmcm.models.numerics.rotations import exponential

from ...support.surfaces import bumpy


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


Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


class Mesh(NamedTuple):
    vertices: Array
    triangles: Numbers


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts[:-1], strict=True)]),
    )


def wall(width: float, height: float, z: float, n: int = 8) -> Mesh:
    """A rectangle about the origin that faces the viewer."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, n), np.linspace(-height / 2, height / 2, n))
    corner = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    halves = [[corner, corner + n, corner + 1], [corner + 1, corner + n, corner + n + 1]]
    triangles = np.concatenate([np.stack(half, axis=1) for half in halves])
    return Mesh(np.stack([x.ravel(), y.ravel(), np.full(n * n, z)], axis=1), triangles)


def sphere(n: int = 24) -> Mesh:
    """Of radius 1, closed."""
    down, round_ = np.meshgrid(
        np.linspace(0, np.pi, n), 2 * np.pi * np.arange(2 * n) / (2 * n), indexing="ij"
    )
    vertices = np.stack([np.sin(down) * np.cos(round_), np.cos(down), np.sin(down) * np.sin(round_)], axis=2)
    row, column = np.meshgrid(np.arange(n - 1), np.arange(2 * n), indexing="ij")
    a, b = row * 2 * n + column, row * 2 * n + (column + 1) % (2 * n)
    triangles = np.concatenate([np.stack([a, b, a + 2 * n], -1), np.stack([b, b + 2 * n, a + 2 * n], -1)])
    triangles = triangles.reshape(-1, 3)
    vertices = vertices.reshape(-1, 3)
    normals = normals_of(Mesh(vertices, triangles))
    middles = vertices[triangles].mean(axis=1)
    triangles = np.where(((normals * middles).sum(axis=1) > 0)[:, None], triangles, triangles[:, ::-1])
    return Mesh(vertices, triangles[np.linalg.norm(normals, axis=1) > 1e-9])


def normals_of(mesh: Mesh) -> Array:
    """Cross products of edges."""
    corners = mesh.vertices[mesh.triangles]
    normals: Array = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def cosines(mesh: Mesh) -> Array:
    """Of the angle between each triangle's normal and the direction to the viewer."""
    normals = normals_of(mesh)
    return -normals[:, 2] / np.linalg.norm(normals, axis=1)


def points(vertices: Numbers, weights: Array) -> SurfaceTexels:
    """A texel for each of the weighted means of three vertices."""
    n = len(vertices)
    return SurfaceTexels(
        vertices.astype(np.int32),
        np.array([0, n], np.int32),
        weights.astype(np.float32),
        np.zeros((n, 2), np.float32),
        np.zeros(n, np.float32),
    )


def scattered(mesh: Mesh, n: int, seed: int) -> tuple[Numbers, Array]:
    """Triangle numbers and weights of points all over a mesh."""
    random = np.random.default_rng(seed)
    return random.integers(len(mesh.triangles), size=n), random.dirichlet(np.ones(3), n)


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(3, 400), st.floats(0.05, 0.6))
def test_of_a_sphere_that_is_seen_which_faces_the_viewer(seed: int, radius: float, facing: float) -> None:
    random = np.random.default_rng(seed)
    unit = sphere()
    turned = unit.vertices @ exponential(random.normal(size=(1, 3)))[0].T
    mesh = Mesh(radius * turned + [300 * random.normal(), 300 * random.normal(), 50], unit.triangles)
    chosen, weights = scattered(mesh, 2000, seed)
    seen = visible(mesh.vertices[None], mesh.triangles, points(mesh.triangles[chosen], weights), facing)[0]
    cosine = cosines(mesh)[chosen]
    clear = np.abs(cosine - facing) > 1e-9
    np.testing.assert_array_equal(seen[clear], (cosine > facing)[clear])


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.2, 0.3, 0.1), (-0.3, -0.2, 0.5)])
def test_a_wall_hides_what_is_behind_it_seen_along_the_line_of_sight(turn: tuple[float, ...]) -> None:
    near, far = wall(60, 40, -50), wall(200, 160, 30, 16)
    both = joined(near, far)
    vertices = both.vertices @ exponential(np.array([turn]))[0].T
    mesh = Mesh(vertices, both.triangles)
    chosen, weights = scattered(mesh, 4000, 1)
    seen = visible(vertices[None], mesh.triangles, points(mesh.triangles[chosen], weights))[0]
    places = np.einsum("na,nac->nc", weights, vertices[mesh.triangles[chosen]])
    behind = chosen >= len(near.triangles)
    # where the near wall's plane is met along the line of sight, in the wall's own axes
    rotation = exponential(np.array([turn]))[0]
    across = places[:, :2] - vertices[: len(near.vertices), :2].mean(axis=0)
    own = np.linalg.solve(rotation[:2, :2], across.T).T
    margin = np.abs(own) - [30, 20]
    covered, clear = margin.max(axis=1) < 0, np.abs(margin.max(axis=1)) > 3
    np.testing.assert_array_equal(seen[clear], ~(covered & behind)[clear])
    assert (covered & behind & clear).sum() > 50
    assert seen[~behind].all()
