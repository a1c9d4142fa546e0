"""G-flow as a chain in the engine: follows, says when it is lost, finds again, can be saved and resumed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import FaceScene, face
from rsmcm.chains.face.gflow import GFlow, GFlowState
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.engine.checkpoint import load, save
from rsmcm.inference.engine.protocols import Incoming
from rsmcm.inference.engine.recursive_bp import RunState
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.face.morphable_model import Poses, SurfacePoints
from rsmcm.models.pixels.pixel_labels import PixelMessage
from rsmcm.models.points.point_tracks import PointTracks

N_FRAMES = 24


@pytest.fixture(scope="module")
def scene() -> FaceScene:
    return face(N_FRAMES, seed=3)


@pytest.fixture(scope="module")
def images(scene: FaceScene) -> list[NDArray[np.uint8] | None]:
    return [scene.image(number) for number in range(N_FRAMES)]


def chain_for(scene: FaceScene, **settings: object) -> GFlow:
    return GFlow(scene.model, scene.poses[0], **{"experts": 6, "texels": 800, **settings})  # type: ignore[arg-type]


def states(chain: GFlow, images: list[NDArray[np.uint8] | None]) -> list[GFlowState]:
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    return [belief[chain.name] for belief in engine.run(images, dt=1 / 25)]


def error(chain: GFlow, scene: FaceScene, state: GFlowState, number: int) -> float:
    seen = scene.model.project(chain.mean_pose(state))[0]
    return float(np.linalg.norm(seen - scene.vertices[number], axis=1).mean())


@pytest.mark.parametrize(
    "settings", [{}, {"surface": "patches"}, {"gain": "learned"}, {"experts": 1, "covariance_scale": 0.0}]
)
def test_follows_a_face(
    scene: FaceScene, images: list[NDArray[np.uint8] | None], settings: dict[str, object]
) -> None:
    chain = chain_for(scene, **settings)
    last = states(chain, images)[-1]
    stayed = np.linalg.norm(scene.vertices[0] - scene.vertices[-1], axis=1).mean()
    assert not last.lost
    assert error(chain, scene, last, N_FRAMES - 1) < min(2.0, 0.4 * stayed)
    assert last.weights.sum() == pytest.approx(1)
    assert np.isfinite(last.log_evidence)


def test_same_seed_same_run(scene: FaceScene, images: list[NDArray[np.uint8] | None]) -> None:
    first, second = (states(chain_for(scene), images[:12])[-1] for _ in range(2))
    other = states(chain_for(scene, seed=1), images[:12])[-1]
    np.testing.assert_array_equal(first.poses.morphs, second.poses.morphs)
    assert (first.poses.morphs != other.poses.morphs).any()


def test_resumes_from_a_file(
    scene: FaceScene, images: list[NDArray[np.uint8] | None], tmp_path: Path
) -> None:
    whole = states(chain_for(scene), images[:14])
    save(tmp_path / "state.npz", {"face": whole[7]}, {"face": GFlowState})
    resumed = load(tmp_path / "state.npz", {"face": GFlowState})["face"]
    chain = chain_for(scene)
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    state = replace(RunState(), states={chain.name: resumed}, time=7 / 25)
    for number in range(8, 14):
        belief = engine.step(state, Frame(images[number], number / 25, number + 1))
        state = belief.state
    np.testing.assert_allclose(belief[chain.name].poses.morphs, whole[13].poses.morphs, atol=1e-9)


def test_missing_frames_are_predicted(scene: FaceScene, images: list[NDArray[np.uint8] | None]) -> None:
    chain = chain_for(scene)
    gap = [*images[:8], None, None, *images[10:16]]
    followed = states(chain, gap)
    assert followed[9].elapsed == pytest.approx(2 / 25)
    np.testing.assert_array_equal(followed[9].poses.morphs, followed[7].poses.morphs)
    assert error(chain, scene, followed[-1], 15) < 2


def test_two_predictions_are_one(scene: FaceScene, images: list[NDArray[np.uint8] | None]) -> None:
    chain = chain_for(scene, tracked=(1, 5, 9))
    pixels, points = PixelLabels(), PointTracks()
    state = states(chain, images[:6])[-1]
    once = chain.predict(state, 0.24)
    twice = chain.predict(chain.predict(state, 0.1), 0.14)
    nothing = Incoming({pixels: pixels.uniform(), points: points.uniform()})
    for one, other in zip(
        chain.message(once, points, nothing).positions.moments,
        chain.message(twice, points, nothing).positions.moments,
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    seen = Incoming({pixels: PixelMessage(image=images[11])})
    one, other = (chain.update(state, seen) for state in (once, twice))
    np.testing.assert_allclose(one.poses.morphs, other.poses.morphs, atol=1e-6)
    np.testing.assert_allclose(one.texture.variance, other.texture.variance, rtol=1e-5)


def test_follows_at_half_the_rate(scene: FaceScene, images: list[NDArray[np.uint8] | None]) -> None:
    chain = chain_for(scene)
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    last = [belief[chain] for belief in engine.run(images[::2], dt=2 / 25)][-1]
    assert error(chain, scene, last, N_FRAMES - 2) < 1.5


def test_says_that_it_is_lost_and_finds_the_face_elsewhere(
    scene: FaceScene, images: list[NDArray[np.uint8] | None]
) -> None:
    chain = chain_for(scene, experts=10)
    height, width = images[0].shape  # type: ignore[union-attr]
    noise = np.random.default_rng(0).integers(0, 255, (6, height, width)).astype(np.uint8)
    shift = 50
    moved = [np.roll(image, shift, axis=1) for image in images[14:] if image is not None]
    cut = states(chain, [*images[:14], *noise, *moved])
    assert not any(state.lost for state in cut[:16])
    assert all(state.lost for state in cut[16:20])
    last = cut[-1]
    assert not last.lost
    assert last.relocations == 1
    seen = scene.model.project(chain.mean_pose(last))[0] - [shift, 0]
    assert np.linalg.norm(seen - scene.vertices[-1], axis=1).mean() < 2.5


class KnownFinder:
    """Knows where the face of a scene is, from the number of the picture; else it has seen nothing."""

    def __init__(self, scene: FaceScene, images: list[NDArray[np.uint8]], numbers: list[int]) -> None:
        self.scene, self.images, self.numbers = scene, images, numbers

    def _pose(self, image: NDArray[np.uint8]) -> Poses:
        known = [k for k, each in zip(self.numbers, self.images, strict=True) if each is image]
        return self.scene.poses[np.array(known[:1], np.int64)]

    def confirms(self, image: NDArray[np.uint8], pose: Poses) -> bool:
        true = self._pose(image)
        if not len(true):
            return False
        off = self.scene.model.project(true) - self.scene.model.project(pose)
        return bool(np.linalg.norm(off.mean(axis=1)) < 0.3 * pose.sizes[0])

    def find(self, image: NDArray[np.uint8], last: Poses, attempt: int) -> Poses:
        return self._pose(image)


def test_a_face_that_looks_like_another_is_found_by_a_detector(
    scene: FaceScene, images: list[NDArray[np.uint8] | None]
) -> None:
    """Nobody is there for some time, then somebody else: believed with a new texture, after a trial."""
    other = face(N_FRAMES, seed=8)
    numbers = list(range(12))
    new = [np.roll(other.image(number), 40, axis=1) for number in numbers]
    room = np.random.default_rng(0).integers(0, 255, (5, *new[0].shape)).astype(np.uint8)
    film = [*images[:10], *room, *new]
    alone = states(chain_for(scene), film)
    assert all(state.lost for state in alone[12:])
    shifted = replace(other.poses, translations=other.poses.translations + np.array([40.0, 0.0]))

    class There(KnownFinder):
        def _pose(self, image: NDArray[np.uint8]) -> Poses:
            known = [k for k, each in zip(self.numbers, self.images, strict=True) if each is image]
            return shifted[np.array(known[:1], np.int64)]

    found = states(chain_for(scene, finder=There(other, new, numbers)), film)
    assert all(state.lost for state in found[12:18]), "it is on trial for some pictures"
    assert not any(state.lost for state in found[21:])
    assert found[-1].relocations == 1
    assert found[-1].previous_texture is None
    seen = other.model.project(found[-1].poses.mean(found[-1].weights))[0]
    assert np.linalg.norm(seen - other.model.project(shifted)[11], axis=1).mean() < 3


def test_a_detector_that_errs_once_is_not_believed(
    scene: FaceScene, images: list[NDArray[np.uint8] | None], tmp_path: Path
) -> None:
    """What it shows is not there in the next picture; the texture that is remembered comes back.

    It is saved with the state.
    """
    first = images[0]
    assert first is not None
    empty = [np.random.default_rng(k).integers(0, 255, first.shape).astype(np.uint8) for k in range(8)]
    finder = KnownFinder(scene, [empty[4]], [3])
    cut = states(chain_for(scene, finder=finder), [*images[:10], *empty, *images[10:16]])
    assert cut[14].trust.trial > 0
    save(tmp_path / "state.npz", {"face": cut[14]}, {"face": GFlowState})
    loaded = load(tmp_path / "state.npz", {"face": GFlowState})["face"]
    assert loaded.trust == cut[14].trust
    assert loaded.previous_texture is not None
    assert cut[14].previous_texture is not None
    np.testing.assert_array_equal(loaded.previous_texture.mean, cut[14].previous_texture.mean)
    assert cut[15].trust.trial == 0
    assert all(state.lost for state in cut[12:18])
    assert not cut[-1].lost
    assert error(chain_for(scene), scene, cut[-1], 15) < 2


def test_a_change_that_a_detector_confirms_is_learned(
    scene: FaceScene, images: list[NDArray[np.uint8] | None]
) -> None:
    """The face turns into its negative where it is: lost for good without a detector, not with one."""
    flipped = [255 - image for image in images[10:22] if image is not None]
    film = [*images[:10], *flipped]
    assert states(chain_for(scene), film)[-1].lost
    finder = KnownFinder(scene, flipped, list(range(10, 22)))
    followed = states(chain_for(scene, finder=finder), film)
    assert not followed[-1].lost
    assert error(chain_for(scene), scene, followed[-1], 21) < 4


@pytest.mark.parametrize("value", [0, 255])
def test_blank_pictures_do_no_harm(
    scene: FaceScene, images: list[NDArray[np.uint8] | None], value: int
) -> None:
    chain = chain_for(scene)
    blank = [np.full_like(images[0], value)] * 5
    after = states(chain, [*images[:10], *blank, *images[10:18]])
    assert all(state.lost for state in after[12:15])
    assert not after[-1].lost
    assert error(chain, scene, after[-1], 17) < 2.5


def test_a_face_that_leaves_the_picture_is_lost(
    scene: FaceScene, images: list[NDArray[np.uint8] | None]
) -> None:
    chain = chain_for(scene)
    image = images[0]
    assert image is not None
    leaving = []
    for step in range(16):
        away = np.full_like(image, 90)
        away[:, 20 * step :] = image[:, : image.shape[1] - 20 * step]
        leaving.append(away)
    assert states(chain, leaving)[-1].lost


def test_experts_agree_with_their_summary(scene: FaceScene, images: list[NDArray[np.uint8] | None]) -> None:
    chain = chain_for(scene)
    state = states(chain, images[:11])[-1]
    mean, covariance = chain.vertices(state)
    positions = scene.model.positions(state.poses)
    np.testing.assert_allclose(mean, np.average(positions, axis=0, weights=state.weights), atol=1e-9)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    drawn = scene.model.positions(draw_poses(state, 4000))
    np.testing.assert_allclose(
        covariance, np.stack([np.cov(v.T) for v in drawn.swapaxes(0, 1)]), atol=0.15 * covariance.max()
    )
    corners = SurfacePoints.of_vertices(np.arange(5))
    np.testing.assert_allclose(
        chain.points(state, corners), scene.model.project(chain.mean_pose(state))[0, :5], atol=1e-9
    )


def draw_poses(state: GFlowState, n: int) -> Poses:
    """Poses from the mixture of what experts believe."""
    random = np.random.default_rng(0)
    expert = random.choice(len(state.weights), n, p=state.weights)
    lower = np.linalg.cholesky(state.covariance)[expert]
    return state.poses[expert].moved((lower @ random.standard_normal((n, lower.shape[1], 1)))[..., 0])


def test_starts_where_a_function_finds_the_face(
    scene: FaceScene, images: list[NDArray[np.uint8] | None]
) -> None:
    chain = GFlow(scene.model, lambda frame: scene.poses[0], experts=2, texels=500)
    assert error(chain, scene, states(chain, images[:5])[-1], 4) < 2


@pytest.mark.parametrize(
    ("setting", "value"),
    [("experts", 0), ("gain", 1.5), ("gain", "much"), ("temperature", 0.0), ("texels", 0), ("radius", 0.0),
     ("effective_pixels", 0.0), ("samples", 0), ("covariance_scale", -1.0),
     ("resample_interval", 0.0), ("levels", 4)],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(scene: FaceScene, setting: str, value: object) -> None:
    with pytest.raises(ValueError, match=setting):
        chain_for(scene, **{setting: value})


def test_starts_of_another_number_are_refused(scene: FaceScene) -> None:
    with pytest.raises(ValueError, match="start"):
        GFlow(scene.model, scene.poses[:3], experts=5)
