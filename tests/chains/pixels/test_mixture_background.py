"""The mixture background against a textbook version, and beside the chain that it replaces."""

import numpy as np
import pytest
from rsmcm.chains import MixtureBackground
from rsmcm.chains.pixels.background_prediction import colour
from rsmcm.chains.pixels.gaussians import HIGHEST_NOISE, LOWEST_NOISE
from rsmcm.chains.pixels.mixture_background import REACH, Mixture, MixturePrediction
from rsmcm.inference import Incoming, MultiChain, RecursiveBP
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.pixels.background import ODDS_STEPS
from rsmcm.models.pixels.layers import Layer, LayerStack
from rsmcm.models.pixels.pixel_labels import PixelMessage
from scipy.stats import norm

SIZE = (7, 11)


class Textbook:
    """One pixel as in Stauffer and Grimson's paper, but for the rate of mean and variance (a / w)."""

    def __init__(self, chain, value):
        self.chain = chain
        self.components = [(1.0, value, chain.first_variance)]

    def ranked(self):
        return sorted(self.components, key=lambda component: -component[0] / component[2] ** 0.5)

    def log_odds(self, value):
        gathered, density = 0.0, 0.0
        for weight, mean, variance in self.ranked():
            gathered += weight
            density += weight * np.prod(norm.pdf(value, mean, variance**0.5))
            if gathered > self.chain.background_share:
                break
        density *= colour.VOLUME[len(value)] * 256.0 ** len(value) / gathered
        return np.log(self.chain.prior / (1 - self.chain.prior)) + np.log(density + 1e-300)

    def learn(self, value, rate):
        ranked = self.ranked()
        reach = REACH[len(value)]
        match = next((k for k, (_, m, v) in enumerate(ranked) if ((value - m) ** 2).sum() < reach * v), None)
        new = [((1 - rate) * weight, mean, variance) for weight, mean, variance in ranked]
        if match is None:
            new = [*new[: self.chain.components - 1], (rate, value, self.chain.first_variance)]
        else:
            weight, mean, variance = new[match]
            weight += rate
            mean = mean + rate / weight * (value - mean)
            variance += rate / weight * (((value - mean) ** 2).mean() - variance)
            new[match] = weight, mean, min(max(variance, LOWEST_NOISE), HIGHEST_NOISE)
        total = sum(weight for weight, _, _ in new)
        self.components = [(weight / total, mean, variance) for weight, mean, variance in new]


def random_images(channels, count, seed=0):
    """Pixels with a few colours each, in turns, and now and then a colour never seen before."""
    rng = np.random.default_rng(seed)
    shape = SIZE if channels == 1 else (*SIZE, 3)
    looks = rng.integers(20, 230, (4, *shape))
    for _ in range(count):
        which = rng.choice(4, SIZE, p=[0.5, 0.3, 0.15, 0.05])
        which = which if channels == 1 else which[..., None]
        image = np.choose(which, looks) + rng.normal(0, 5, shape)
        strange = rng.random(SIZE) < 0.05
        image[strange] = rng.integers(0, 256, image[strange].shape)
        yield np.clip(image, 0, 255).astype(np.uint8)


def planes_of(image):
    if image.ndim == 2:
        return image.reshape(1, -1).astype(float)
    return colour.FROM_BGR @ image.reshape(-1, 3).T


def run(chain, images, dt=1 / 25):
    """Masks, and the last belief."""
    pixels, masks = PixelLabels(), []
    for belief in RecursiveBP(MultiChain().connect(chain, pixels)).run(images, dt):
        masks.append(belief[pixels].foreground())
    return np.array(masks), belief


@pytest.mark.parametrize(("channels", "components"), [(1, 1), (3, 3), (1, 5)])
def test_it_is_stauffer_and_grimson_s(channels, components):
    chain = MixtureBackground(components=components, rate=0.7, pooling=0.0)
    pixels = PixelLabels()
    dt, textbook = 0.1, None
    for belief in RecursiveBP(MultiChain().connect(chain, pixels)).run(random_images(channels, 30), dt):
        image = belief.frame.image
        planes = planes_of(image).T
        if textbook is None:
            textbook = [Textbook(chain, value) for value in planes]
            continue
        odds = [each.log_odds(value) for each, value in zip(textbook, planes, strict=True)]
        np.testing.assert_allclose(
            belief[pixels].subtraction.log_odds / ODDS_STEPS, np.clip(odds, -6, 6), atol=1.1 / ODDS_STEPS
        )
        for each, value in zip(textbook, planes, strict=True):
            each.learn(value, -np.expm1(-chain.rate * dt))
    mixture = belief["background"].mixture
    np.testing.assert_allclose(mixture.weights.sum(axis=0), 1, rtol=1e-5)
    for pixel, each in enumerate(textbook):
        for k, (weight, mean, variance) in enumerate(each.ranked()):
            assert mixture.weights[k, pixel] == pytest.approx(weight, rel=1e-4, abs=1e-7)
            assert mixture.means[k, :, pixel] == pytest.approx(mean, rel=1e-4, abs=1e-2)
            assert mixture.variances[k, pixel] == pytest.approx(variance, rel=1e-4, abs=1e-2)


def heard(chain, background, image, layers):
    """The chain's state after an image, told of layers."""
    pixels = PixelLabels()
    told, seen = {pixels: PixelMessage(layers=LayerStack(layers))}, {pixels: PixelMessage(image=image)}
    return chain.update(chain.predict(background, 1.0), Incoming(told, seen))


def test_what_others_cover_is_not_learned():
    chain = MixtureBackground()
    before, seen = np.full(SIZE, 60, np.uint8), np.full(SIZE, 160, np.uint8)
    background = chain.initial(Frame(before, 0.0, 1))
    mask = np.zeros(SIZE, np.float32)
    mask[:, 5:] = 0.95
    known = Layer(0, 0, mask, np.full((1, *SIZE), 160, np.float32))
    after = heard(chain, background, seen, [known])
    weights = after.mixture.weights[1].reshape(SIZE)
    assert weights[:, :5] == pytest.approx(-np.expm1(-chain.rate))
    assert not weights[:, 5:].any()
    np.testing.assert_array_equal(after.mixture.means[0].reshape(SIZE)[:, 5:], 60)


def test_where_a_ghost_is_the_picture_is_taken_as_it_is():
    chain = MixtureBackground()
    background = chain.initial(Frame(np.full(SIZE, 60, np.uint8), 0.0, 1))
    mask = np.zeros(SIZE, np.float32)
    mask[:, 5:] = 1
    after = heard(chain, background, np.full(SIZE, 160, np.uint8), [Layer(0, 0, mask, None, ghost=True)])
    picture = after.picture()
    assert (picture[:, 5:] == 160).all()
    assert (picture[:, :5] == 60).all()
    np.testing.assert_allclose(after.mixture.weights.sum(axis=0), 1, rtol=1e-6)


@pytest.mark.parametrize(("channels", "shifted"), [(1, False), (3, True)])
def test_likelihood(channels, shifted):
    rng = np.random.default_rng(2)
    *_, image = random_images(channels, 20)
    n_pixels = SIZE[0] * SIZE[1]
    looks = planes_of(image)
    mixture = Mixture(
        np.repeat([[0.6], [0.3], [0.1]], n_pixels, axis=1).astype(np.float32),
        (looks + rng.normal(0, 8, (3, channels, n_pixels))).astype(np.float32),
        rng.uniform(20, 100, (3, n_pixels)).astype(np.float32),
    )
    prediction = MixturePrediction(SIZE, mixture, prior=0.8, share=0.7, pooling=0.0)
    deviation = mixture.variances[:2, None].astype(float) ** 0.5
    parts = norm.pdf(looks, mixture.means[:2], deviation).prod(axis=1) * colour.VOLUME[channels]
    shift = rng.normal(0, 2, n_pixels).astype(np.float32) if shifted else np.zeros(n_pixels, np.float32)
    density = 0.8 * np.exp(shift) * (2 * parts[0] + parts[1]) / 3 + 0.2 / 256.0**channels
    found = prediction.log_likelihood(image, shift if shifted else None)
    assert found == pytest.approx(np.log(density).sum(), abs=1e-3 * n_pixels)
