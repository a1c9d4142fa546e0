"""Pose dynamics against scipy; outlines, scans across them, and Gaussian terms of points."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path
from numpy.typing import NDArray
from rsmcm.chains.face.background import BackgroundContrast
from rsmcm.chains.face.experts import find_modes
from rsmcm.chains.face.pose_terms import PointTerms, PoseDynamics, PosePrior, Silhouette
from rsmcm.chains.face.texture_likelihood import Level, TexturedObject, TextureLikelihood
from rsmcm.models.face.morphable_model import RIGID, MorphableModel, Poses
from rsmcm.models.face.surface import MeshEdges, Region, SurfaceTexels, covered, outline
from rsmcm.models.numerics.rotations import exponential
from scipy.spatial import ConvexHull

from ...support.surfaces import bumpy, poses_near

OBJECT = 24.0


def prior_of(seed: int, elapsed: float = 0.04, n: int = 3, n_bases: int = 3) -> PosePrior:
    return PosePrior.after(poses_near(n, n_bases, seed), PoseDynamics(), OBJECT, elapsed)


def test_a_walk_spreads_with_the_root_of_time_and_with_size() -> None:
    dynamics = PoseDynamics(size_range=1e4, morph_range=1e4)
    memory, walk = dynamics.transition(OBJECT, 8, 0.04)
    np.testing.assert_allclose(memory, 1, atol=1e-6)
    np.testing.assert_allclose(dynamics.transition(OBJECT, 8, 0.16)[1], 4 * walk, rtol=1e-6)
    larger = dynamics.transition(2 * OBJECT, 8, 0.04)[1]
    np.testing.assert_allclose(larger[:3], walk[:3])
    np.testing.assert_allclose(larger[3:], 4 * walk[3:], rtol=1e-6)
    one_second = np.sqrt(dynamics.transition(1.0, 8, 1.0)[1])
    expected = [*[dynamics.rotation] * 3, *[dynamics.translation] * 2, dynamics.size, *[dynamics.morphs] * 2]
    np.testing.assert_allclose(one_second, expected, rtol=1e-6)
    assert (dynamics.transition(OBJECT, 8, 0.0)[1] > 0).all()


@given(st.floats(1e-3, 20), st.floats(1e-3, 20))
def test_two_steps_are_one(first: float, second: float) -> None:
    dynamics, start = PoseDynamics(), poses_near(3, 3, 1)
    halfway = PosePrior.after(start, dynamics, OBJECT, first)
    whole = PosePrior.after(start, dynamics, OBJECT, first + second)
    memory, variance = dynamics.transition(OBJECT, start.dimension, second)
    on = PosePrior.after(halfway.mean, dynamics, OBJECT, second)
    np.testing.assert_allclose(on.mean.morphs, whole.mean.morphs, rtol=1e-9, atol=1e-9)
    kept = np.concatenate([np.ones(RIGID), memory])
    np.testing.assert_allclose(kept**2 * halfway.variance + variance, whole.variance, rtol=1e-9)


def test_in_the_long_run_shapes_are_as_usual() -> None:
    prior = prior_of(0, elapsed=1e4)
    usual, spread = prior.mean.morphs, np.sqrt(prior.variance[RIGID:])
    np.testing.assert_allclose(usual, np.tile([OBJECT, 0, 0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(spread, OBJECT * np.array([0.11, 0.8, 0.8]))


@given(st.integers(0, 10**6))
def test_gradient_and_precision_are_derivatives_of_the_energy(seed: int) -> None:
    prior, owner = prior_of(seed), np.array([2, 0, 1, 1])
    random = np.random.default_rng(seed)
    # a turn only about one axis: there the tangent spaces of both poses are one
    change = np.sqrt(prior.variance) * random.normal(size=(4, 8)) * np.array([0, 1, 0, 1, 1, 1, 1, 1])
    poses = prior.mean[owner].moved(change)
    step = 1e-4 * np.sqrt(prior.variance)
    middle, gradient = prior.energy(poses, owner)
    for j in (1, 3, 4, 5, 6, 7):
        ends = [
            prior.energy(poses.moved(np.tile(sign * step[j] * np.eye(8)[j], (4, 1))), owner)[0]
            for sign in (-1, 1)
        ]
        slope, bend = (ends[1] - ends[0]) / (2 * step[j]), (ends[1] + ends[0] - 2 * middle) / step[j] ** 2
        np.testing.assert_allclose(gradient[:, j], slope, rtol=1e-5, atol=1e-6 / step[j])
        np.testing.assert_allclose(bend, prior.precision[j], rtol=1e-2)


Array = NDArray[np.float64]

SIZE = (120, 160)
WHOLE = Region(0, 0, *SIZE)


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
    region = Region(20, 31, 70, 100)
    inside = covered(positions, model.triangles, region)
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
