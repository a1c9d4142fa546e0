"""Outlines of projected meshes, scans across them, and Gaussian terms of points of the surface."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.path import Path
from numpy.typing import NDArray
from rsmcm.chains.face.background import BackgroundContrast
from rsmcm.chains.face.experts import find_modes
from rsmcm.chains.face.pose_terms import PointTerms, PoseDynamics, PosePrior, Silhouette
from rsmcm.chains.face.texture_likelihood import Level, TexturedObject, TextureLikelihood
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel, Poses
from rsmcm.models.face.surface import Box, MeshEdges, SurfaceTexels, covered, outline
from rsmcm.models.numerics.rotations import exponential
from scipy.spatial import ConvexHull

from ...support.surfaces import bumpy, poses_near

Array = NDArray[np.float64]

SIZE = (120, 160)
WHOLE = Box(0, 0, *SIZE)


def ellipsoid(n_points: int = 300) -> MorphableModel:
    """A closed convex mesh, longer than wide, that can be told from its turned self."""
    number = np.arange(n_points)
    height = 1 - 2 * (number + 0.5) / n_points
    angle = np.pi * (3 - np.sqrt(5)) * number
    around = np.sqrt(1 - height**2)
    points = np.stack([around * np.cos(angle), 1.4 * height, 0.8 * around * np.sin(angle)], axis=1)
    triangles = ConvexHull(points).simplices.astype(np.int64)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (normals * corners.mean(axis=1)).sum(axis=1) < 0
    triangles[inwards] = triangles[inwards][:, [0, 2, 1]]
    return MorphableModel(points[None], triangles)


def centred(angles: Array, size: float = 22.0) -> Poses:
    n = len(angles)
    return Poses(exponential(angles), np.tile([80.3, 60.6], (n, 1)), np.full((n, 1), size))


def test_covered_pixels_are_those_whose_centres_are_in_a_triangle() -> None:
    model = bumpy(3, 1)
    positions = model.project(poses_near(3, 3, 5, turn=0.6))
    box = Box(20, 31, 70, 100)
    inside = covered(positions, model.triangles, box)
    rows, columns = np.mgrid[20:90, 31:131]
    centres = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    for found, places in zip(inside, positions, strict=True):
        within = np.zeros(len(centres), np.bool_)
        for corners in places[model.triangles]:
            within |= Path(corners).contains_points(centres)
        assert (found.reshape(-1) != within).sum() <= 2  # centres that lie on an edge but for rounding


def test_the_outline_of_a_convex_body_is_its_hull() -> None:
    model = ellipsoid()
    poses = centred(np.random.default_rng(0).uniform(-1, 1, (4, 3)))
    positions = model.project(poses)
    edges = MeshEdges.of(model.triangles)
    found = outline(positions, edges, covered(positions, model.triangles, WHOLE), WHOLE)
    for number, places in enumerate(positions):
        hull = ConvexHull(places)
        used = found.lengths[number] > 0
        points = (places[found.vertices[number]] * found.weights[number][..., None]).sum(axis=1)[used]
        normals = found.normals[number][used]
        distances = points @ hull.equations[:, :2].T + hull.equations[:, 2]
        nearest = distances.argmax(axis=1)
        assert np.abs(distances.max(axis=1)).max() < 1e-4
        np.testing.assert_allclose(normals, hull.equations[nearest, :2], atol=1e-3)
        # short edges at a slant to the pixels may fail the test of what is beside them
        assert found.lengths[number].sum() == pytest.approx(hull.area, rel=0.05)


def test_an_edge_before_another_part_of_the_object_is_not_on_the_outline() -> None:
    model = face_model(shields=True)
    pose = Poses(
        exponential(np.array([[0, 0.3, 0]])), np.array([[80.0, 60.0]]), np.eye(1, model.n_bases) * 22
    )
    positions = model.project(pose)
    inside = covered(positions, model.triangles, WHOLE)
    found = outline(positions, MeshEdges.of(model.triangles), inside, WHOLE)
    points = (positions[0][found.vertices[0]] * found.weights[0][..., None]).sum(axis=1)
    out = np.rint(points + 1.5 * found.normals[0]).astype(int)
    back = np.rint(points - 1.5 * found.normals[0]).astype(int)
    assert not inside[0, out[:, 1], out[:, 0]].any()
    assert inside[0, back[:, 1], back[:, 0]].all()


def contrast_of(border: NDArray[np.float32]) -> BackgroundContrast:
    return BackgroundContrast(
        WHOLE, border, np.ones_like(border), border, np.zeros(SIZE, np.float32), np.zeros(1)
    )


def known_outside(inside: NDArray[np.uint8], contrast: float = 3.0) -> BackgroundContrast:
    """Background seen around an object, whose own pixels it does not explain."""
    return contrast_of(np.where(inside[:1] > 0, -contrast, contrast).astype(np.float32))


@pytest.mark.parametrize("off", [-2.5, 0.0, 1.7])
def test_a_scan_finds_the_edge(off: float) -> None:
    model = ellipsoid()
    truth = centred(np.zeros((1, 3)))
    image = known_outside(covered(model.project(truth), model.triangles, WHOLE))
    moved = Poses(truth.rotations, truth.translations + np.array([off, 0]), truth.morphs)
    terms = Silhouette(model, MeshEdges.of(model.triangles), image, 400).around(moved, 0)
    positions = model.project(moved)
    found = outline(
        positions, MeshEdges.of(model.triangles), covered(positions, model.triangles, WHOLE), WHOLE
    )
    points = (positions[0][found.vertices[0]] * found.weights[0][..., None]).sum(axis=1)
    across = ((terms.targets[0] - points) * found.normals[0]).sum(axis=1)
    sideways = np.abs(found.normals[0, :, 0]) > 0.9
    # whole pixels: half a px at most, and less on average
    error = across[sideways] + off * found.normals[0, sideways, 0]
    assert abs(error.mean()) < 0.25
    assert np.abs(error).max() < 1.25


def test_where_nothing_is_known_a_scan_says_nothing() -> None:
    model = ellipsoid()
    pose = centred(np.zeros((2, 3)))
    silhouette = Silhouette(
        model, MeshEdges.of(model.triangles), contrast_of(np.zeros((1, *SIZE), np.float32)), 400
    )
    energy, gradient, curvature = silhouette.around(pose, 0).equations(pose, np.arange(2))
    assert not energy.any()
    assert not gradient.any()
    assert not curvature.any()


def test_each_expert_may_have_its_own_map() -> None:
    model = ellipsoid()
    truth = centred(np.zeros((2, 3)))
    truth.translations[1] += (2.0, -1.0)
    maps = known_outside(covered(model.project(truth), model.triangles, WHOLE))
    both = np.concatenate(
        [known_outside(covered(model.project(truth[k]), model.triangles, WHOLE)).border for k in range(2)]
    )
    at = truth[np.array([0, 0])]
    terms = Silhouette(model, MeshEdges.of(model.triangles), contrast_of(both), 400).around(at, 0)
    gradient = terms.equations(at, np.arange(2))[1]
    alone = Silhouette(model, MeshEdges.of(model.triangles), maps, 400).around(at, 0)
    np.testing.assert_allclose(gradient[0], alone.equations(at, np.arange(2))[1][0])
    assert gradient[1, 3] < 0 < gradient[1, 4]  # energy falls to the right and up


def some_terms(seed: int, n: int = 2) -> SimpleNamespace:
    random = np.random.default_rng(seed)
    model, n_points = bumpy(3, seed), 7
    poses = poses_near(n, 3, seed)
    numbers = random.integers(0, 20, (n, n_points))
    bases = np.moveaxis(model.bases[:, numbers], 0, 2)
    targets = np.take_along_axis(model.project(poses), numbers[..., None], 1) + random.normal(
        0, 2, (n, n_points, 2)
    )
    root = random.normal(size=(n, n_points, 2, 2))
    full = root @ np.swapaxes(root, 2, 3)
    information = np.stack([full[..., 0, 0], full[..., 0, 1], full[..., 1, 1]], axis=-1)
    terms = PointTerms(np.ascontiguousarray(bases), targets, information)
    return SimpleNamespace(model=model, poses=poses, numbers=numbers, full=full, terms=terms)


def test_point_terms_have_the_right_energy_gradient_and_curvature() -> None:
    case = some_terms(3)
    owner = np.array([1, 0])
    poses = case.poses[owner]
    energy, gradient, curvature = case.terms.equations(poses, owner)
    places, rows = case.model.project(poses), case.model.jacobian(poses)
    for m, d in enumerate(owner):
        error = places[m, case.numbers[d]] - case.terms.targets[d]
        jacobian = rows[m, case.numbers[d]]
        information = case.full[d]
        assert energy[m] == pytest.approx(0.5 * np.einsum("na,nab,nb", error, information, error))
        expected = np.einsum("nap,nab,nb->p", jacobian, information, error)
        np.testing.assert_allclose(gradient[m], expected)
        expected = np.einsum("nap,nab,nbq->pq", jacobian, information, jacobian)
        np.testing.assert_allclose(curvature[m], expected)
    step = 1e-5
    for k in range(poses.dimension):
        change = np.zeros((2, poses.dimension))
        change[:, k] = step
        ahead = case.terms.equations(poses.moved(change), owner)[0]
        behind = case.terms.equations(poses.moved(-change), owner)[0]
        np.testing.assert_allclose((ahead - behind) / (2 * step), gradient[:, k], rtol=1e-5, atol=1e-3)


def peak_search(model: MorphableModel, start: Poses, evidence: Silhouette | PointTerms) -> Poses:
    """Peak without any texture: an even picture."""
    surface = TexturedObject(model, SurfaceTexels.dense(model, 300))
    levels = [Level(np.full((120 // s, 160 // s), 100, np.float32), 1 / s) for s in (1, 2, 4)]
    n_texels = len(surface.texels)
    likelihood = TextureLikelihood(
        surface,
        levels,
        np.full((len(start), 3, n_texels), 100, np.float32),
        np.full((len(start), n_texels), 36, np.float32),
        surface.visible(start),
    )
    prior = PosePrior.after(start, PoseDynamics(), float(start.sizes[0]), 1.0)
    return find_modes(likelihood, prior, start, 400, 2, [evidence]).poses


def test_the_silhouette_alone_finds_place_and_size() -> None:
    model = ellipsoid()
    truth = centred(np.array([[0.0, 0.0, 0.3]]))
    image = known_outside(covered(model.project(truth), model.triangles, WHOLE))
    random = np.random.default_rng(1)
    n = 5
    start = Poses(
        np.repeat(truth.rotations, n, 0),
        truth.translations + random.uniform(-7, 7, (n, 2)),
        truth.morphs * random.uniform(0.95, 1.05, (n, 1)),
    )
    found = peak_search(model, start, Silhouette(model, MeshEdges.of(model.triangles), image, 400))
    # pixels are whole, and the prior holds a little
    assert np.abs(found.translations - truth.translations).max() < 0.5
    assert np.abs(found.sizes / truth.sizes - 1).max() < 0.02
