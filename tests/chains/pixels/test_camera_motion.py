"""The camera's chain: exact where it is Gaussian, and against known shakes."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.apps.scenes import ShakenFilm, shaken, sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker, CameraMotion, MixtureBackground
from rsmcm.inference import Belief, Incoming, MultiChain, RecursiveBP
from rsmcm.models import Frame, PixelLabels, ScenePixels
from rsmcm.models.camera.moving_camera import UNKNOWNS, AffineMap, View
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.pixels.pixel_labels import PixelMessage
from scipy.stats import multivariate_normal

CAMERA = CameraMotion()
PIXELS = ScenePixels()


def film(n_frames: int = 60, amount: float = 3.0, seed: int = 0) -> ShakenFilm:
    scene = sleeping_man(n_frames, size=(224, 168), enter=5, car_leaves=n_frames, noise=0.0, seed=seed)
    return shaken(scene, amount, seed, noise=4.0)


def model(*, following: bool) -> MultiChain:
    pixels = ScenePixels() if following else PixelLabels()
    made = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    return made.connect(CAMERA, pixels) if following else made  # type: ignore[arg-type]


def follow(frames: ShakenFilm) -> list[Belief]:
    return list(RecursiveBP(model(following=True)).run(frames))


@pytest.fixture(scope="module")
def shaking() -> tuple[ShakenFilm, list[Belief]]:
    frames = film()
    return frames, follow(frames)


def errors(frames: ShakenFilm, beliefs: list[Belief]) -> np.ndarray:
    """px, root mean square over the picture."""
    found = [belief["pixels"].view.map.parameters for belief in beliefs]
    pairs = zip(found, frames.views, strict=True)
    return np.array([AffineMap(one - view.parameters, view.size).displacement for one, view in pairs])


def test_the_map_from_the_first_frame_is_as_unsure_as_both_of_its_parts() -> None:
    """Against drawn maps: after a pan, an error of the turn acts far away, and a zoom magnifies."""
    random = np.random.default_rng(0)
    state = CAMERA.predict(CAMERA.initial(film(1)[0]), 0.3)
    size = state.picture.shape[:2]
    moved = np.array([30.0, 8.0, 3.0, -20.0, 4.0, 10.0])
    where = replace(state.where, mean=np.concatenate([moved, np.zeros(12)])[None])
    root = np.tril(random.normal(0, 1.0, (UNKNOWNS, UNKNOWNS)))
    state = replace(state, where=where, first=5 * moved, first_covariance=root @ root.T)
    maps = random.multivariate_normal(state.mean, state.covariance, 4000)
    firsts = random.multivariate_normal(state.first, state.first_covariance, 4000)
    drawn = [
        AffineMap(one, size).after(AffineMap(two, size)).parameters
        for one, two in zip(maps, firsts, strict=True)
    ]
    stated = state.view_of_first.covariance
    ratio = np.linalg.eigvals(np.linalg.solve(stated, np.cov(np.array(drawn).T))).real
    np.testing.assert_allclose(ratio, 1, atol=0.25)  # of 4000: .05 each, and products of errors


def test_it_knows_where_a_shaking_camera_looks(shaking: tuple[ShakenFilm, list[Belief]]) -> None:
    assert np.median(errors(*shaking)) < 0.07
    assert errors(*shaking).max() < 0.25


def test_a_view_alone_tells_the_size_of_the_picture() -> None:
    message = PixelMessage(view=CAMERA.initial(film(1)[0]).view)
    assert message.size == film(1)[0].image.shape[:2]


def test_what_it_predicts_is_a_density_of_a_place_that_grows_vague_at_its_own_pace() -> None:
    state = CAMERA.initial(film(1)[0])
    for seconds in (0.04, 0.5, 100.0):
        later = CAMERA.predict(state, seconds)
        assert CAMERA.message(later, PIXELS, Incoming({})).log_mass == pytest.approx(0.0, abs=1e-9)
    # the way of a velocity with correlation time T, the shake now, and that of the first frame
    radius = np.hypot(136, 192) / 2
    way = 2 * CAMERA.turn_time * (seconds - CAMERA.turn_time) * CAMERA.speed**2
    widest = radius * np.sqrt(way + 2 * CAMERA.shake**2)
    np.testing.assert_allclose(np.sqrt(np.diag(later.covariance)), widest, rtol=1e-4)


def test_update_is_that_of_a_kalman_filter() -> None:
    random = np.random.default_rng(0)
    frame = film(1)[0]
    assert frame.image is not None
    state = CAMERA.predict(CAMERA.initial(frame), 0.1)
    spread = random.normal(size=(UNKNOWNS, UNKNOWNS))
    noise = 0.1 * spread @ spread.T + 0.01 * np.eye(UNKNOWNS)
    seen = random.normal(size=UNKNOWNS)
    information = np.linalg.inv(noise)
    scale = np.array([-0.5 * seen @ information @ seen])
    where = GaussianMessage(np.zeros(1, np.int64), information[None], (information @ seen)[None], scale)
    likelihood = PixelMessage(image=frame.image, view=View(frame.image.shape[:2], where))
    after = CAMERA.update(state, Incoming({PIXELS: PixelMessage()}, {PIXELS: likelihood}))
    gain = state.covariance @ np.linalg.inv(state.covariance + noise)
    np.testing.assert_allclose(after.mean, state.mean + gain @ (seen - state.mean), rtol=1e-8)
    np.testing.assert_allclose(after.covariance, (np.eye(UNKNOWNS) - gain) @ state.covariance, rtol=1e-6)
    # what the Gaussians weigh: the density of the map that was found, times the likelihood's own integral
    weight = (CAMERA.message(state, PIXELS, Incoming({})) * likelihood).log_mass
    found = multivariate_normal(state.mean, state.covariance + noise).logpdf(seen)
    own = 0.5 * np.linalg.slogdet(2 * np.pi * noise)[1]
    assert weight == pytest.approx(found + own)


def test_who_stands_in_the_scene_is_not_learned() -> None:
    image = np.random.default_rng(0).integers(80, 120, (60, 80, 3)).astype(np.uint8)
    state = CAMERA.predict(CAMERA.initial(Frame(image, 0.0, 1)), 5.0)
    background = AdaptiveBackground()
    known = background.initial(Frame(image, 0.0, 1))
    covered = image.copy()
    covered[20:40, 30:50] = 250
    seen = {PIXELS: PixelMessage(image=covered)}
    told = background.message(known, PIXELS, Incoming({PIXELS: PixelMessage()}, seen))
    after = CAMERA.update(state, Incoming({PIXELS: told}, seen))
    np.testing.assert_array_equal(after.picture[22:38, 32:48], image[22:38, 32:48])


def test_what_the_frame_does_not_show_counts_as_pixels_of_any_colour() -> None:
    image = np.random.default_rng(1).integers(80, 120, (40, 60, 3)).astype(np.uint8)
    background = AdaptiveBackground(follow_light=False)
    told = background.message(background.initial(Frame(image, 0.0, 1)), PIXELS, Incoming({}))
    narrow = 1e-6 * np.eye(UNKNOWNS)
    for shift, n_hidden in ((0.0, 0), (15.0, 15 * 40), (1000.0, 60 * 40)):
        view = View.predicted(np.array([shift, 0, 0, 0, 0, 0]), narrow, image.astype(np.float32))
        message = told * PixelMessage(image=image, view=view)
        shown = told.background.log_likelihood(image[:, :60])  # type: ignore[union-attr]
        if n_hidden == 0:
            assert message.log_mass == pytest.approx(shown)
            continue
        other = image.copy()
        other[view.hidden] = 255
        assert (told * PixelMessage(image=other, view=view)).log_mass == pytest.approx(message.log_mass)
        assert int(view.hidden.sum()) == n_hidden
        if n_hidden == 2400:
            assert message.log_mass == pytest.approx(-2400 * 3 * np.log(256), rel=1e-5)


@pytest.mark.parametrize("background", [AdaptiveBackground(), MixtureBackground()])
def test_in_the_next_scene_the_background_is_moved_and_begins_anew_where_it_was_not_seen(background) -> None:
    random = np.random.default_rng(2)
    image, frame = (random.integers(80, 120, (40, 60, 3)).astype(np.uint8) for _ in range(2))
    known = np.ones((40, 60), np.bool_)
    known[:, 40:] = False
    state, fresh = (background.initial(Frame(each, 0.0, 1)) for each in (image, frame))
    shift = AffineMap(np.array([-8.0, 0, 0, 4.0, 0, 0]), (40, 60))
    picture = state.seen_by(shift, known, fresh).picture()
    np.testing.assert_allclose(picture[4:, :32], image[:36, 8:40], atol=1)
    np.testing.assert_allclose(picture[:4], frame[:4], atol=1)
    np.testing.assert_allclose(picture[:, 32:], frame[:, 32:], atol=1)


def test_a_new_scene_begins_where_the_camera_has_gone_and_its_velocity_goes_on() -> None:
    random = np.random.default_rng(5)
    wide = random.integers(40, 220, (30, 100)).astype(np.float32)
    wide = np.kron(wide, np.ones((6, 6), np.float32)).astype(np.uint8)
    images = [wide[:, 5 * k : 5 * k + 240] for k in range(40)]
    beliefs = list(RecursiveBP(model(following=True)).run(images))
    begun = [k for k, belief in enumerate(beliefs) if belief["pixels"].view.begins is not None]
    assert begun[0] in (3, 4)  # beyond a tenth of 150 px, which the third shift just is
    for k in (begun[0], begun[-1], 39):
        state = beliefs[k]["camera"]
        np.testing.assert_allclose(state.view_of_first.map.parameters[[0, 3]], [-5 * k, 0], atol=0.5)
        np.testing.assert_allclose(state.where.mean[0, 6], -125.0, rtol=0.25)  # px/s, at 25 frames/s


@pytest.mark.parametrize("background", [AdaptiveBackground(), MixtureBackground()])
def test_a_scene_that_is_found_no_more_is_given_up_for_what_the_camera_shows(background) -> None:
    random = np.random.default_rng(7)
    here, there = np.kron(random.integers(40, 220, (2, 20, 30)), np.ones((6, 6))).astype(np.uint8)
    pixels = ScenePixels()
    made = MultiChain().connect(background, pixels).connect(CAMERA, pixels)
    beliefs = list(RecursiveBP(made).run([here] * 5 + [there] * 35))
    begun = [k for k, belief in enumerate(beliefs) if belief["pixels"].view.begins is not None]
    assert begun[0] in (29, 30)  # 5 frames, and a second without being found
    assert beliefs[20]["camera"].covariance[0, 0] > 100 * beliefs[4]["camera"].covariance[0, 0]
    np.testing.assert_allclose(beliefs[39]["background"].picture(), there, atol=1)
    assert (beliefs[39]["pixels"].foreground() == 0).all()
