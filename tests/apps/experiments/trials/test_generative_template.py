"""Batch EM of one template: its bound rises, it mends a drifting track, and sees what is in front."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.trials.generative_template import (
    LEAST_NOISE,
    OUTLIER_LIMITS,
    ClipTemplate,
    GenerativeTemplate,
)
from rsmcm.apps.scenes import face
from rsmcm.chains.face.image_pyramid import image_pyramid
from rsmcm.chains.face.pose_dynamics import PoseDynamics, PosePrior
from rsmcm.chains.face.texture_likelihood import TexturedObject
from rsmcm.models.face.pose import RIGID, Poses
from rsmcm.models.face.surface_texels import SurfaceTexels

from ....support.surfaces import bilinear, bumpy, poses_near, smooth_picture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]


class Clip:
    """A talking face in even light, as the template model has it, and a track that drifts off it."""

    def __init__(self, n_frames: int = 24, seed: int = 3) -> None:
        scene = face(n_frames, seed, (160, 120), light=0.0)
        random = np.random.default_rng(seed)
        self.model, self.truth, self.vertices = scene.model, scene.poses, scene.vertices
        self.pictures: list[Picture] = list(scene.images())
        self.surface = TexturedObject(self.model, SurfaceTexels.dense(self.model, 800))
        size = float(self.truth.sizes[0])
        drift = PoseDynamics(rotation=0.25, translation=0.35, morphs=0.4)
        steps = np.sqrt(drift.transition(size, self.truth.dimension, 0.004)[1]) * random.normal(
            size=(n_frames, self.truth.dimension)
        )
        steps[0] = 0
        self.track = self.truth.moved(np.cumsum(steps, axis=0))

    def error(self, poses: Poses) -> Array:
        off = self.model.project(poses) - self.vertices
        return np.asarray(np.linalg.norm(off, axis=2).mean(axis=1))


@pytest.fixture(scope="module")
def clip() -> Clip:
    return Clip()


@pytest.fixture(scope="module")
def fitted(clip: Clip) -> ClipTemplate:
    return GenerativeTemplate(clip.surface, rounds=7).fit(clip.pictures, clip.track)


def test_a_track_that_drifts_is_mended(clip: Clip, fitted: ClipTemplate) -> None:
    before, after = clip.error(clip.track), clip.error(fitted.poses)
    assert after.mean() < 0.5 * before.mean()
    assert after.mean() < 0.5
    assert after.max() < 1.5
    np.testing.assert_array_equal(fitted.poses.translations[0], clip.track.translations[0])


def test_every_round_raises_the_bound(fitted: ClipTemplate) -> None:
    assert len(fitted.bounds) == 7
    # what is visible changes with the pose, so that rounds are of slightly different texels
    assert (np.diff(fitted.bounds) > -1e-3 * np.abs(fitted.bounds[-1])).all()
    assert fitted.bounds[-1] > fitted.bounds[1] > fitted.bounds[0]


def test_what_it_learned_is_of_this_clip(clip: Clip, fitted: ClipTemplate) -> None:
    n_levels, n_texels = fitted.template.shape
    assert (n_levels, n_texels) == (3, len(clip.surface.texels))
    levels = image_pyramid(clip.pictures[5], float(clip.truth.sizes[0]), n_levels=3, local_mean=True)
    pose = clip.truth[5]
    looks, seen = clip.surface.observe(levels, pose, clip.surface.visible(pose))
    off = (looks[0] - fitted.template)[:, seen[0]]
    assert np.sqrt((off**2).mean(axis=1)).max() < 0.3 * looks[0][:, seen[0]].std()
    assert np.median(off[0] ** 2 / fitted.noise[seen[0]]) < 2
    assert fitted.noise.min() >= LEAST_NOISE


def test_covariance_is_that_of_the_coefficients_alone(clip: Clip, fitted: ClipTemplate) -> None:
    for covariance in fitted.morph_covariance:
        assert (np.linalg.eigvalsh(covariance) > 0).all()
    twice = GenerativeTemplate(clip.surface, rounds=1, effective_pixels=1e7).fit(
        clip.pictures[:2], clip.truth[:2]
    )
    more = GenerativeTemplate(clip.surface, rounds=1, effective_pixels=2e7).fit(
        clip.pictures[:2], clip.truth[:2]
    )
    # where the picture decides, twice as many pixels halve it
    np.testing.assert_allclose(more.morph_covariance[0] * 2, twice.morph_covariance[0], rtol=0.01)


def test_one_picture_again_and_again_is_its_own_template() -> None:
    model = bumpy(3)
    surface = TexturedObject(model, SurfaceTexels.patches(model, 3))
    picture = np.rint(smooth_picture(2)).astype(np.uint8)
    pose = poses_near(1, 3, 2)
    tracker = GenerativeTemplate(surface, rounds=2, levels=1, local_mean=False)
    found = tracker.fit([picture] * 3, pose[[0, 0, 0]])
    (level,) = image_pyramid(picture, float(pose.sizes[0]), n_levels=1, local_mean=False)
    visible = surface.visible(pose)[0]
    group = surface.texels.group_of_texel
    places = model.project(pose)[0][surface.texels.groups[group, 0]] + surface.texels.offsets
    values, _ = bilinear(level.image, places)
    np.testing.assert_allclose(found.template[0, visible], values[visible], atol=0.1)
    np.testing.assert_allclose(model.project(found.poses[2]), model.project(pose), atol=0.1)
    assert found.outliers == OUTLIER_LIMITS[0]
    # all that is left is how unsure the shape is, which the posterior knows
    assert np.median(found.noise[visible]) < 3 * LEAST_NOISE


def test_the_gaussian_of_the_coefficients_is_laplaces() -> None:
    model = bumpy(3)
    surface = TexturedObject(model, SurfaceTexels.patches(model, 3))
    picture, pose = np.rint(smooth_picture(2)).astype(np.uint8), poses_near(1, 3, 2)
    tracker = GenerativeTemplate(surface, rounds=1, levels=1, local_mean=False)
    found = tracker.fit([picture], pose)
    (level,) = image_pyramid(picture, float(pose.sizes[0]), n_levels=1, local_mean=False)
    visible, group = surface.visible(pose)[0], surface.texels.group_of_texel
    vertex = surface.texels.groups[group, 0]
    values, slopes = bilinear(level.image, model.project(pose)[0][vertex] + surface.texels.offsets)
    rows = np.einsum("na,nad->nd", slopes, model.jacobian(pose)[0][vertex])[visible, RIGID:]
    # residuals are zero, the noise 400 and the prior share of outliers 0.05
    odds = 0.95 / (0.05 / 256 * np.sqrt(2 * np.pi * 400))
    weight = 400 / visible.sum() / 400 * odds / (1 + odds)
    prior = PosePrior.after(pose, PoseDynamics(), float(pose.sizes[0]), 100.0).precision[RIGID:]
    wanted = np.linalg.inv(weight * rows.T @ rows + np.diag(prior))
    assert np.ptp(values[visible]) > 50
    np.testing.assert_allclose(found.morph_covariance[0], wanted, rtol=1e-3)


def test_what_passes_in_front_of_the_face_is_left_out(clip: Clip) -> None:
    hidden, covered = [picture.copy() for picture in clip.pictures], np.zeros(len(clip.pictures))
    for number in range(6, 20):
        middle = clip.truth.translations[number].astype(int)
        left = middle[0] - 40 + 5 * (number - 6)
        window = np.s_[middle[1] - 30 : middle[1] + 30, max(left, 0) : left + 14]
        hidden[number][window] = np.random.default_rng(number).integers(0, 256, hidden[number][window].shape)
        inside = clip.vertices[number, :, 0] - left
        covered[number] = ((inside > 0) & (inside < 14)).mean()
    found = GenerativeTemplate(clip.surface, rounds=7).fit(hidden, clip.track)
    before, after = clip.error(clip.track), clip.error(found.poses)
    assert after.mean() < 0.6 * before.mean()
    assert found.outliers > 0.015
    free, over = found.occlusion[covered == 0], found.occlusion[covered > 0.15]
    assert len(over) >= 4
    assert over.min() > free.max()
    assert np.corrcoef(covered, found.occlusion)[0, 1] > 0.9


@pytest.mark.parametrize(("n_pictures", "n_poses"), [(0, 0), (3, 2)])
def test_a_pose_is_needed_for_every_picture(clip: Clip, n_pictures: int, n_poses: int) -> None:
    message = f"start: got {n_poses} poses for {n_pictures} pictures, expected one for each"
    with pytest.raises(ValueError, match=message):
        GenerativeTemplate(clip.surface).fit(clip.pictures[:n_pictures], clip.track[:n_poses])
