"""The picture of the empty scene against plain float64 formulas, quadrature and Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.chains.pixels import gaussians as kernels
from rsmcm.chains.pixels import second_colours as seconds
from rsmcm.chains.pixels.background_prediction import BackgroundPrediction, fixed_point, stored_planes
from rsmcm.chains.pixels.light import LightField
from rsmcm.chains.pixels.shade import shade_in
from rsmcm.chains.pixels.sway import Sway
from rsmcm.models.numerics.threads import set_threads, thread_count
from rsmcm.models.pixels import colour
from rsmcm.models.pixels.background import foreground_spans
from scipy.integrate import quad
from scipy.stats import norm

from ...support.light import light_of

STEP = 1 / kernels.ODDS_STEPS
QUANTISATION = STEP + 2e-3  # a stored step, and float32 with approximate exp and log


@pytest.fixture(autouse=True)
def _threads():
    before = thread_count()
    yield
    set_threads(before)


def scene(channels, seed=0, size=(23, 37), prior=0.9, **changes):
    """A prediction and an image that agrees with it in most places."""
    rng = np.random.default_rng(seed)
    height, width = size
    n_pixels = height * width
    shape = size if channels == 1 else (*size, 3)
    remembered = rng.integers(30, 220, shape).astype(np.uint8)
    values = {
        "size": size,
        "pixels": fixed_point(
            colour.to_planes(remembered) + rng.normal(0, 2, (channels, n_pixels)).astype(np.float32),
            rng.uniform(0.5, 60, n_pixels).astype(np.float32),
            rng.uniform(20, 400, n_pixels).astype(np.float32),
        ),
        "frames": 7,
        "light": LightField(rng.uniform(0.8, 1.2, (3, 4)).astype(np.float32), size),
        "prior": prior,
        "drift": 1.5,
        "noise_share": 0.03,
        "first_variance": 20.0,
        "unknown_variance": 0.0,
        "pooling": 0.3,
        "second": seconds.SecondColours(
            np.zeros(n_pixels * channels, np.uint8), np.zeros(n_pixels, np.uint16)
        ),
        "tolerance": 100.0,
        "sway": Sway(np.zeros((3, 4), np.float32), 3),
        "shade": shade_in(np.zeros((3, 3, 4), np.float32), size),
        "mirroring": np.zeros(4, bool),
        "in_turn": np.ones((3, 2), np.uint8),
    }
    image = np.clip(remembered + rng.normal(0, 6, shape), 0, 255)
    strange = image[5:15, 10:20]
    strange[:] = rng.integers(0, 256, strange.shape)
    return BackgroundPrediction(**{**values, **changes}), image.astype(np.uint8)


def decoded(pixels):
    """Mean, variance and noise that are stored, as float64: of variances two lines meet at 60."""
    steps = pixels.variance.astype(float)
    variance = np.where(steps <= 60 * 256, steps / 256, 60 + (steps - 60 * 256) / 8)
    return pixels.mean / 32, variance, pixels.noise / 128


def plainly(mean, variance, noise, image, prediction):
    """One update in plain float64: mean, variance, noise, and the log odds, which are cut off at 6 nats."""
    light, channels = light_of(prediction.light), len(mean)
    seen = colour.FROM_BGR @ image.reshape(-1, 3).T if channels == 3 else image.reshape(1, -1).astype(float)
    before = variance + prediction.drift
    total = light**2 * before + noise
    difference = seen - light * mean
    odds = np.log(prediction.prior) - np.log1p(-prediction.prior) + np.log(colour.VOLUME[channels])
    odds = odds + norm.logpdf(difference, 0, np.sqrt(total)).sum(axis=0) + channels * np.log(256)
    weight = 1 / (1 + np.exp(-np.clip(odds, -6, 6)))
    gain, square = light * before / total, (difference**2).mean(axis=0)
    after = (1 - weight * gain * light) * before + weight * (1 - weight) * gain**2 * square
    noisy = noise + prediction.noise_share * weight * (square - total)
    return mean + weight * gain * difference, np.clip(after, 0.5, 60), np.clip(noisy, 20, 400), odds


@pytest.mark.parametrize("channels", [1, 3])
def test_log_odds_and_update(channels):
    prediction, image = scene(channels)
    mean, variance, noise, odds = plainly(*decoded(prediction.pixels), image, prediction)
    stored = prediction.compare(image).log_odds * STEP
    np.testing.assert_allclose(stored, np.clip(odds, -6, 6), atol=QUANTISATION)
    after = decoded(prediction.update(image))
    # rounded up or down: a step at most, and what float32 with approximate exp and log is off by
    np.testing.assert_allclose(after[0], mean, rtol=1e-4, atol=1 / 32 + 5e-3)
    np.testing.assert_allclose(after[1], variance, rtol=1e-3, atol=1 / 256)
    np.testing.assert_allclose(after[2], noise, rtol=1e-3, atol=1 / 128)


@pytest.mark.parametrize(("channels", "drift"), [(3, 0.0), (1, 0.05)])
def test_over_a_long_film_16_bits_say_what_float64_does(channels, drift):
    """The scene drifts, light comes and goes, things pass; without a drift a mean moves by 1/40 of a step."""
    rng, size = np.random.default_rng(11), (24, 32)
    shape = size if channels == 1 else (*size, 3)
    room, grain = rng.uniform(60, 160, shape), rng.uniform(3, 22, (*size, *shape[2:]))
    state = fixed_point(
        colour.to_planes(room.astype(np.uint8)), np.full(768, 20, np.float32), np.full(768, 100, np.float32)
    )
    known, differing, compared = decoded(state), 0, 0
    for frame in range(250):
        light = 1 + 0.3 * np.sin(frame / 40)
        shown = light * (room + 0.02 * frame) + rng.normal(0, 1, shape) * grain
        shown[(frame % 60) // 4 : (frame % 60) // 4 + 8, 8:16] = 20
        image = np.clip(np.rint(shown), 0, 255).astype(np.uint8)
        prediction, _ = scene(
            channels, size=size, pixels=state, frames=frame, drift=drift, noise_share=0.02, pooling=0.0,
            light=LightField(np.full((3, 4), light, np.float32), size),
        )  # fmt: skip
        *known, odds = plainly(*known, image, prediction)
        reading, state = prediction.compare(image), prediction.update(image)
        differing += np.count_nonzero((reading.log_odds < 0) != (odds <= -STEP))  # cut off towards 0
        compared += odds.size
    mean, variance, noise = decoded(state)
    assert (
        differing < 6e-4 * compared
    )  # one in ten thousand, by 0.5 from seed to seed: several frames of a pixel
    away = mean - known[0]
    assert abs(away.mean()) < 0.02  # no rounding one way, and no small step that is lost
    assert away.std() < 0.25 * np.sqrt(known[1]).min()  # of what is not known of it anyway
    assert np.isclose(variance, known[1], rtol=0.05, atol=1 / 256).mean() > 0.99
    assert np.abs(noise / known[2] - 1).mean() < 0.01


def test_each_frame_rounds_otherwise_and_over_time_evenly():
    prediction, _ = scene(1)
    predictions = (replace(prediction, size=(1, 100), frames=frame) for frame in range(512))
    drawn = np.array([each.rounding for each in predictions]) - kernels.ROUNDING
    assert drawn.min() >= 0
    assert drawn.max() < 1
    assert np.abs(drawn.mean(axis=0) - 0.5).max() < 0.01
    shares = np.array([(drawn < bound).mean(axis=0) for bound in (0.1, 0.3, 0.9)])
    assert np.abs(shares - np.array([0.1, 0.3, 0.9])[:, None]).max() < 0.02


@pytest.mark.parametrize("channels", [1, 3])
def test_numbers_are_kept_and_end_at_their_bounds(channels):
    numbers = np.array([0.5, 1.25, 59.75, 60.0, 61.0, 5418.75], np.float32)
    means = np.linspace(-1023, 1023, 6 * channels, dtype=np.float32).reshape(channels, 6)
    mean, variance, noise = decoded(fixed_point(means, numbers, np.full(6, 30.125, np.float32)))
    np.testing.assert_allclose(mean, means, atol=1 / 64)
    np.testing.assert_array_equal(variance, np.where(numbers > 60, np.rint(numbers * 8) / 8, numbers))
    assert (noise == 30.125).all()
    beyond = fixed_point(2000 * np.sign(means), numbers, numbers)
    assert set(np.unique(beyond.mean)) <= {-32768, 0, 32767}
    planes = stored_planes(fixed_point(means, numbers, numbers).mean, (2, 3)).grey_levels()
    np.testing.assert_allclose(planes, means.reshape(channels, 2, 3), atol=1 / 64)


def test_likelihood_is_the_integral_over_labels_and_values():
    prediction, image = scene(1, size=(3, 4))
    means, variances, noises = decoded(prediction.pixels)
    light, before = light_of(prediction.light), variances + prediction.drift
    total = 0.0
    for k, shown in enumerate(image.reshape(-1).astype(float)):
        mean, deviation = light[k] * means[0, k], light[k] * before[k] ** 0.5
        of_background, _ = quad(
            lambda value, m=mean, d=deviation, s=shown, n=noises[k]: (
                norm.pdf(value, m, d) * norm.pdf(s, value, n**0.5)
            ),
            mean - 12 * deviation, mean + 12 * deviation, limit=200,
        )  # fmt: skip
        total += np.log(prediction.prior * of_background + (1 - prediction.prior) / 256)
    assert prediction.log_likelihood(image) == pytest.approx(total, abs=1e-3 * image.size)


@pytest.mark.parametrize("channels", [1, 3])
def test_likelihood_with_what_others_say(channels):
    prediction, image = scene(channels)
    odds = plainly(*decoded(prediction.pixels), image, prediction)[-1]
    shift = np.random.default_rng(5).normal(0, 3, odds.size).astype(np.float32)
    hidden = np.where(np.arange(odds.size) % 7 < 5, np.float32(-80), shift)
    for added in (None, shift, hidden):
        expected = np.logaddexp(0, odds + (0 if added is None else added)).sum()
        expected += odds.size * (np.log1p(-prediction.prior) - channels * np.log(256))
        # float32 sums over rows: 1e-3 nat a pixel
        assert prediction.log_likelihood(image, added) == pytest.approx(expected, abs=1e-3 * odds.size)


def pooled_plainly(log_odds, prior, share):
    said = np.pad(np.clip(log_odds.astype(int) - prior, -80, 80), 2)
    height, width = log_odds.shape
    around = sum(said[dy : dy + height, dx : dx + width] for dy in range(5) for dx in range(5))
    return np.clip(log_odds + np.float32(share) * around, -127, 127)


@pytest.mark.parametrize("size", [(23, 37), (1, 40), (3, 3)])
def test_pooling(size):
    log_odds = np.random.default_rng(6).integers(-120, 121, size).astype(np.int8)
    pooled = np.empty(log_odds.size, np.int8)
    kernels.smooth_log_odds(0, size[0], *size, log_odds.reshape(-1), np.int16(44), np.float32(0.3), pooled)
    np.testing.assert_allclose(pooled.reshape(size), pooled_plainly(log_odds, 44, 0.3), atol=1)


@pytest.mark.parametrize("channels", [1, 3])
def test_bands_and_threads_change_nothing(channels):
    results = []
    for threads in (1, 3, 50):
        set_threads(threads)
        prediction, image = scene(channels)
        reading, after = prediction.compare(image), prediction.update(image)
        results.append((reading.log_odds, reading.smoothed, after.mean, after.variance, after.noise))
    for other in results[1:]:
        assert [a.tobytes() for a in other] == [a.tobytes() for a in results[0]]


@pytest.mark.parametrize("channels", [1, 3])
def test_a_second_colour_that_was_seen_often_is_background(channels):
    prediction, image = scene(channels)
    own = prediction.compare(image).log_odds.copy()
    rng = np.random.default_rng(8)
    candidate = np.clip(image.astype(int) + rng.integers(-6, 7, image.shape), 0, 255).astype(np.uint8)
    seen = rng.integers(0, seconds.SETTLED, own.size).astype(np.uint16)
    recalled, _ = scene(channels, second=seconds.SecondColours(candidate.reshape(-1), seen))
    gap = np.square(colour.to_planes(image).astype(float) - colour.to_planes(candidate)).sum(axis=0)
    known = (own < 0) & (seen >= seconds.SETTLED / 2) & (gap < 100.0)
    assert 5 < known.sum() < (own < 0).sum()
    np.testing.assert_array_equal(recalled.compare(image).log_odds, np.where(known, 20, own))


STEP_OF_TEN = seconds.SETTLED // 10


def second_colours(channels=1, colour_seen=0, steps=0):
    return seconds.SecondColours(
        np.full(9 * channels, colour_seen, np.uint8), np.full(9, steps * STEP_OF_TEN, np.uint16)
    )


def observe(second, covered=0, odds=-40, known=1.0):
    """Nine pixels of one colour, all foreground, for about a tenth of the settling time."""
    channels = second.colours.size // 9
    image = np.full(9 * channels, 90, np.uint8)
    mean = colour.to_planes(np.full((3, 3) if channels == 1 else (3, 3, 3), 200, np.uint8))
    pixels = fixed_point(mean, np.full(9, known, np.float32), np.full(9, 30, np.float32))
    to_planes = colour.from_pixels(channels)
    seconds.learn_second_colours(
        image, np.full(9, odds, np.int8), np.full(9, covered, np.uint8),
        kernels.Light(np.full((3, 3), 2, np.float32), np.zeros(3, np.float32)),
        to_planes, np.linalg.inv(to_planes),
        seconds.Settling(np.float32(100), STEP_OF_TEN, 2 * STEP_OF_TEN, np.float32(20), np.float32(4)),
        pixels, second,
    )  # fmt: skip
    return decoded(pixels)[:2]


def test_a_new_colour_becomes_a_candidate_and_lasts():
    second = second_colours(3)
    observe(second, covered=1)
    observe(second, odds=0)  # neither objects nor background are one
    assert not second.seen.any()
    for times in range(1, 4):
        mean, _ = observe(second)
        assert (second.seen == times * STEP_OF_TEN).all()
        assert (second.colours == 90).all()
        np.testing.assert_allclose(mean[0], 200, atol=1e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_lasting_colour_changes_places_with_the_mean(channels):
    second = second_colours(channels, 92, 10)
    mean, variance = observe(second)
    np.testing.assert_allclose(mean[0], 90 / 2, atol=1e-3)  # under a light of 2
    assert (variance == 20).all()
    assert (second.seen == seconds.KNOWN).all()
    assert (second.colours == 255).all()  # 2 * 200, as it would look today


def test_another_colour_wears_the_candidate_out():
    second = second_colours(1, 30, 7)
    for times in (5, 3, 1):
        observe(second)
        assert (second.seen == times * STEP_OF_TEN).all()
        assert (second.colours == 30).all()
    observe(second)
    assert (second.colours == 90).all()
    mean, _ = observe(second_colours(1, 30, 20))
    np.testing.assert_allclose(mean, 200)  # what is not the candidate never becomes background


def test_a_mean_that_was_hardly_seen_gives_way_soon_and_behind_objects_too():
    second = second_colours(1, 90, 5)  # 2 and 2 * 30 / 15 times are enough
    mean, variance = observe(second, covered=1, known=15.0)
    assert (mean == 45).all()
    assert (variance == 20).all()
    assert (second.colours == 255).all()
    mean, _ = observe(second_colours(1, 90, 4), known=15.0)
    assert (mean == 200).all()


def test_spans_are_where_there_is_foreground():
    rng = np.random.default_rng(10)
    for size in (1, 63, 64, 65, 640, 1003):
        log_odds = np.where(rng.random(size) < 0.01, -1, 5).astype(np.int8)
        spans = np.empty(size // 64 + 1, np.int64)
        found = {int(start) for start in spans[: foreground_spans(log_odds, spans)]}
        wanted = {int(i) // 64 * 64 for i in np.flatnonzero(log_odds < 0)}
        assert wanted <= found <= wanted | {size // 64 * 64}
