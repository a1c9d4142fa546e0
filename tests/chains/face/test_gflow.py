"""G-flow as a chain in the engine: tracks, detects that it is lost, recovers, is saved and resumed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import FaceScene, face
from rsmcm.chains.face.gflow import CONTRAST, GFlow, GFlowState
from rsmcm.chains.face.recovery import TRIAL
from rsmcm.chains.face.texture_likelihood import image_pyramid, local_variance
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.engine.checkpoint import load, save
from rsmcm.models import PixelLabels
from rsmcm.models.face.morphable_model import Poses, SurfacePoints

Image = NDArray[np.uint8]

N_FRAMES = 14


@pytest.fixture(scope="module")
def scene() -> FaceScene:
    return face(N_FRAMES, seed=3)


@pytest.fixture(scope="module")
def images(scene: FaceScene) -> list[Image]:
    return [scene.image(number) for number in range(N_FRAMES)]


def chain_for(scene: FaceScene, **settings: object) -> GFlow:
    return GFlow(scene.model, scene.poses[0], **{"experts": 4, "texels": 500, **settings})  # type: ignore[arg-type]


def states(chain: GFlow, images: list[Image | None] | list[Image]) -> list[GFlowState]:
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    return [belief[chain.name] for belief in engine.run(images, dt=1 / 25)]


def error(chain: GFlow, scene: FaceScene, state: GFlowState, number: int, shift: float = 0.0) -> float:
    seen = scene.model.project(chain.mean_pose(state))[0] - [shift, 0.0]
    return float(np.linalg.norm(seen - scene.vertices[number], axis=1).mean())


@pytest.fixture(scope="module")
def run(scene: FaceScene, images: list[Image]) -> list[GFlowState]:
    return states(chain_for(scene), images)


@pytest.mark.parametrize(
    "settings", [{}, {"surface": "patches"}, {"gain": "learned"}, {"experts": 1, "covariance_scale": 0.0}]
)
def test_tracks_a_face(
    scene: FaceScene, images: list[Image], run: list[GFlowState], settings: dict[str, object]
) -> None:
    chain = chain_for(scene, **settings)
    last = states(chain, images)[-1] if settings else run[-1]
    motion = np.linalg.norm(scene.vertices[0] - scene.vertices[-1], axis=1).mean()
    assert not last.lost
    assert error(chain, scene, last, N_FRAMES - 1) < min(2.0, 0.4 * motion)
    assert last.weights.sum() == pytest.approx(1)
    assert np.isfinite(last.log_evidence)


def noise_like(image: Image, n: int) -> list[Image]:
    return list(np.random.default_rng(0).integers(0, 255, (n, *image.shape)).astype(np.uint8))


@pytest.mark.parametrize(("cut", "shift"), [("noise", 50), ("black", 0)])
def test_is_lost_and_finds_the_face_again(
    scene: FaceScene, images: list[Image], cut: str, shift: int
) -> None:
    chain = chain_for(scene, experts=8)
    between = noise_like(images[0], 5) if cut == "noise" else [np.zeros_like(images[0])] * 5
    after = states(chain, [*images[:8], *between, *(np.roll(image, shift, axis=1) for image in images[8:])])
    assert not any(state.lost for state in after[:10])
    assert all(state.lost for state in after[10:13])
    last = after[-1]
    assert (last.lost, last.relocations) == (False, 1)
    assert error(chain, scene, last, N_FRAMES - 1, shift) < 2.5


def test_a_flat_wall_is_not_the_face(scene: FaceScene, images: list[Image]) -> None:
    """With 2.2 times the contrast a face differs from its texture by more than a wall without any."""
    chain = chain_for(scene)
    weak = (128 + 0.45 * (images[0].astype(float) - 128)).astype(np.uint8)
    state, wall = states(chain, [weak])[-1], images[0].copy()
    wall[:, : wall.shape[1] // 4] = 128
    pyramid = image_pyramid(wall, state.size, n_levels=3, local_mean=True)
    place, middle = scene.poses[0], chain.object.positions(scene.poses[0])[0].mean(axis=0)
    flat = replace(place, translations=place.translations + np.array([wall.shape[1] / 8 - middle[0], 0.0]))
    both, level = Poses.concatenated([place, flat]), pyramid[-1]
    likelihood = chain._likelihood(state, pyramid, chain._visible_texels(state.poses))
    squares = likelihood.sums(both, np.zeros(2, np.int64), level=2)[:, 0]
    assert squares[0] > squares[1]
    here, there = likelihood.misfit(both, 2, local_variance(level.image, state.size * level.scale) + CONTRAST)
    assert here < 0.5 * there


def test_who_hides_the_face_is_not_tracked(scene: FaceScene, images: list[Image]) -> None:
    """Somebody else is detected in its place for a second."""
    other, numbers = face(25, seed=8), list(range(25))
    hidden = [other.image(number) for number in numbers]
    chain = chain_for(scene, experts=8, finder=KnownFinder(other, other.poses, hidden, numbers))
    after = states(chain, [*images[:8], *hidden, *images[8:]])
    assert all(state.lost for state in after[10:33])
    assert sum(state.trust.trial > 0 for state in after) > 10
    assert all(error(chain, scene, state, 7) < 2.5 for state in after[10:33]), "it is where it was seen last"
    assert not after[-1].lost
    assert error(chain, scene, after[-1], N_FRAMES - 1) < 2.5


class KnownFinder:
    """Detects the face in some pictures, at its true pose there."""

    def __init__(self, scene: FaceScene, poses: Poses, images: list[Image], numbers: list[int]) -> None:
        self.scene, self.poses, self.images, self.numbers = scene, poses, images, numbers

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        known = [k for k, each in zip(self.numbers, self.images, strict=True) if each is image]
        return self.poses[np.array(known[:1], np.int64)]

    def confirms(self, image: Image, pose: Poses) -> bool:
        true = self.find(image, pose, 0)
        if not len(true):
            return False
        off = self.scene.model.project(true) - self.scene.model.project(pose)
        return bool(np.linalg.norm(off.mean(axis=1)) < 0.3 * pose.sizes[0])


def test_another_face_is_tracked_after_a_trial_if_it_is_detected(
    scene: FaceScene, images: list[Image]
) -> None:
    other, numbers = face(N_FRAMES, seed=8), list(range(11))
    new = [np.roll(other.image(number), 40, axis=1) for number in numbers]
    order = [*numbers, *numbers[-2:0:-1]] * 4
    poses = replace(other.poses, translations=other.poses.translations + np.array([40.0, 0.0]))
    film = [*images[:8], *noise_like(new[0], 5), *(new[number] for number in order)]
    assert all(state.lost for state in states(chain_for(scene), film)[10:])
    after = states(chain_for(scene, finder=KnownFinder(other, poses, new, numbers)), film)
    assert all(state.lost for state in after[10 : 13 + round(25 * TRIAL)]), (
        "who hides the face for a second is not tracked"
    )
    last = after[-1]
    assert (last.lost, last.relocations) == (False, 1)
    off = other.model.project(last.poses.mean(last.weights))[0] - other.model.project(poses)[order[-1]]
    assert np.linalg.norm(off.mean(axis=0)) < 0.3 * poses.sizes[0]  # else the finder would not confirm it


def test_a_single_false_detection_is_rejected(scene: FaceScene, images: list[Image], tmp_path: Path) -> None:
    """The trial fails, is saved with the state, and the old texture is found again."""
    empty = noise_like(images[0], 7)
    finder = KnownFinder(scene, scene.poses, [empty[4]], [3])
    after = states(chain_for(scene, finder=finder), [*images[:8], *empty, *images[8:13]])
    during = after[12]
    assert during.trust.trial > 0
    save(tmp_path / "state.npz", {"face": during}, {"face": GFlowState})
    loaded = load(tmp_path / "state.npz", {"face": GFlowState})["face"]
    assert loaded.trust == during.trust
    np.testing.assert_array_equal(loaded.memories[0].texture.mean, during.memories[0].texture.mean)
    assert after[13].trust.trial == 0
    assert all(state.lost for state in after[10:15])
    assert not after[-1].lost
    assert error(chain_for(scene), scene, after[-1], 12) < 2.5


def test_a_new_texture_is_learned_if_a_detector_confirms_the_face(
    scene: FaceScene, images: list[Image]
) -> None:
    """The picture turns into its negative: lost without a detector."""
    negative, numbers = [255 - image for image in images[6:]], list(range(6, N_FRAMES))
    film = [*images[:6], *[*negative, *negative[::-1]] * 6]
    assert states(chain_for(scene), film)[-1].lost
    finder = KnownFinder(scene, scene.poses, negative, numbers)
    last = states(chain_for(scene, finder=finder), film)[-1]
    assert not last.lost
    assert last.fit > last.trust.least_fit


def test_vertices_have_the_moments_of_the_mixture(scene: FaceScene, run: list[GFlowState]) -> None:
    chain, state, n = chain_for(scene), run[-3], 4000
    mean, covariance = chain.vertices(state)
    positions = scene.model.positions(state.poses)
    np.testing.assert_allclose(mean, np.average(positions, axis=0, weights=state.weights), atol=1e-9)
    random = np.random.default_rng(0)
    expert = random.choice(len(state.weights), n, p=state.weights)
    lower = np.linalg.cholesky(state.covariance)[expert]
    poses = state.poses[expert].moved((lower @ random.standard_normal((n, lower.shape[1], 1)))[..., 0])
    drawn = scene.model.positions(poses)
    np.testing.assert_allclose(
        covariance, np.stack([np.cov(v.T) for v in drawn.swapaxes(0, 1)]), atol=0.15 * covariance.max()
    )
    corners = SurfacePoints.of_vertices(np.arange(5))
    np.testing.assert_allclose(
        chain.points(state, corners), scene.model.project(chain.mean_pose(state))[0, :5], atol=1e-9
    )


def test_starts_where_a_function_finds_the_face(scene: FaceScene, images: list[Image]) -> None:
    chain = GFlow(scene.model, lambda frame: scene.poses[0], experts=2, texels=500)
    assert error(chain, scene, states(chain, images[:3])[-1], 2) < 2
