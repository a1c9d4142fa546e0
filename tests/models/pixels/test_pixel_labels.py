"""Messages about pixels: their algebra, and the two chains that meet on them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.pixels.background_prediction import BackgroundPrediction, colour, fixed_point
from rsmcm.chains.pixels.gaussians import Gaussians
from rsmcm.chains.pixels.light import LightField
from rsmcm.chains.pixels.second_colours import KNOWN, REVEALED, SecondColours, update_behind
from rsmcm.chains.pixels.shade import shade_in
from rsmcm.chains.pixels.sway import Sway
from rsmcm.models import PixelLabels
from rsmcm.models.pixels.layers import Layer, LayerStack
from rsmcm.models.pixels.pixel_labels import PixelMessage
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

SIZE = (30, 40)
HEIGHT, WIDTH = SIZE


def image_of(seed=0, channels=3):
    shape = SIZE if channels == 1 else (*SIZE, channels)
    return np.random.default_rng(seed).integers(60, 120, shape).astype(np.uint8)


def background(channels=3, **changes):
    n_pixels = HEIGHT * WIDTH
    values = {
        "size": SIZE,
        "pixels": fixed_point(
            colour.to_planes(image_of(1, channels)),
            np.full(n_pixels, 10, np.float32),
            np.full(n_pixels, 100, np.float32),
        ),
        "frames": 3,
        "light": LightField(np.ones((3, 4), np.float32), SIZE),
        "prior": 0.8,
        "drift": 1.0,
        "noise_share": 0.0,
        "first_variance": 20.0,
        "unknown_variance": 0.0,
        "pooling": 0.0,
        "second": SecondColours(np.zeros(n_pixels * channels, np.uint8), np.zeros(n_pixels, np.uint16)),
        "tolerance": 50.0,
        "sway": Sway(np.zeros((3, 4), np.float32), 3),
        "shade": shade_in(np.zeros((3, 3, 4), np.float32), SIZE),
        "mirroring": np.zeros(4, bool),
        "in_turn": np.ones((4, 2), np.uint8),
    }
    return BackgroundPrediction(**{**values, **changes})


def layer(top, left, height, width, seed=0, channels=3, **changes):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(0, 0.97, (height, width)).astype(np.float32)
    appearance = colour.to_planes(rng.integers(60, 120, (height, width, 3)).astype(np.uint8))
    return Layer(top, left, mask, appearance.reshape(3, height, width)[:channels], **changes)


def weights(layers, image):
    """w1 and w0 of every pixel of one chain's layers, in plain float64."""
    clear, explained = np.ones(SIZE), np.ones(SIZE)
    for one in layers:
        height, width = one.mask.shape
        for row in range(max(0, -one.top), min(height, HEIGHT - one.top)):
            for column in range(max(0, -one.left), min(width, WIDTH - one.left)):
                y, x = one.top + row, one.left + column
                covers = float(one.mask[row, column])
                ratio = 1.0
                if one.appearance is not None and image is not None:
                    channels = len(one.appearance)
                    seen = colour.FROM_BGR @ image[y, x] if channels == 3 else [image[y, x]]
                    density = multivariate_normal.pdf(
                        seen, one.appearance[:, row, column], one.colour_variance * np.eye(channels)
                    )
                    density *= colour.VOLUME[channels] * 256.0**channels
                    ratio = (1 - one.outliers) * density + one.outliers
                if one.ghost:
                    explained[y, x] *= 1 - 0.998 * covers * clear[y, x]
                else:
                    explained[y, x] += one.strength * clear[y, x] * covers * ratio
                    clear[y, x] *= 1 - covers
    return clear, explained


def spread_out(parts):
    clear, explained, times = np.ones(SIZE), np.ones(SIZE), np.zeros(SIZE, int)
    for part in parts:
        clear[part.window], explained[part.window] = part.clear, part.explained
        times[part.window] += 1
        np.testing.assert_allclose(part.shift, np.log(part.clear.astype(float) / part.explained), atol=2e-4)
    assert times.max() <= 1
    return clear, explained


SCENES = {
    "one": [layer(5, 6, 10, 8)],
    "two that overlap": [layer(5, 6, 10, 8), layer(8, 9, 12, 11, 1)],
    "apart": [layer(0, 0, 5, 5), layer(20, 30, 8, 8, 1)],
    "over every edge": [layer(-4, -3, 9, 9), layer(25, 35, 12, 14, 1), layer(-5, 36, 50, 9, 2)],
    "outside": [layer(-20, 3, 9, 9), layer(4, 41, 9, 9), layer(3, 3, 4, 4)],
    "in the crook of two": [layer(0, 0, 30, 4), layer(26, 2, 4, 30, 1), layer(5, 12, 6, 6, 2)],
    "a ghost in front": [layer(5, 5, 10, 10, ghost=True), layer(8, 8, 10, 10, 1)],
    "a ghost behind": [layer(5, 5, 10, 10), layer(8, 8, 10, 10, 1, ghost=True)],
    "any colour": [Layer(3, 3, np.full((6, 6), 0.7, np.float32), None)],
}


@pytest.mark.parametrize("name", [*SCENES, "grey", "unseen"])
def test_layers_are_composed_front_to_back(name):
    layers = SCENES.get(name, SCENES["two that overlap"])
    image = None if name == "unseen" else image_of()
    if name == "grey":
        image, layers = image_of(3, 1), [layer(4, 4, 9, 9, channels=1), layer(8, 2, 9, 9, 1, channels=1)]
    got = spread_out(LayerStack(layers).composed(image, SIZE))
    for ours, expected in zip(got, weights(layers, image), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=2e-3)


def messages():
    return {
        "background": PixelMessage(background=background()),
        "image": PixelMessage(image=image_of()),
        "one": PixelMessage(layers=LayerStack([layer(5, 6, 10, 8), layer(7, 8, 9, 9, 1)])),
        "other": PixelMessage(layers=LayerStack([layer(9, 9, 12, 11, 2), layer(-3, 20, 9, 9, 3)])),
        "third": PixelMessage(layers=LayerStack([layer(8, 7, 6, 20, 4, ghost=True)])),
        "uniform": PixelLabels().uniform(),
    }


@settings(max_examples=20, deadline=None)
@given(st.permutations(list(messages())), st.integers(1, 5))
def test_products_commute_and_associate(order, middle):
    made = messages()

    def product(names):
        total = made[names[0]]
        for name in names[1:]:
            total = total * made[name]
        return total

    straight = product(list(made))
    grouped = product(order[:middle]) * product(order[middle:])
    np.testing.assert_allclose(grouped.background_probability(), straight.background_probability(), atol=1e-4)
    assert (grouped.foreground() != straight.foreground()).mean() < 1e-3  # ties may round either way
    assert grouped.log_mass == pytest.approx(straight.log_mass, rel=1e-6)


def test_only_one_background_and_one_image():
    with pytest.raises(ValueError, match="two background predictions"):
        PixelMessage(background()) * PixelMessage(background())
    with pytest.raises(ValueError, match="two images"):
        PixelMessage(image=image_of()) * PixelMessage(image=image_of())
    with pytest.raises(ValueError, match="size is not known"):
        PixelMessage().foreground()


@pytest.mark.parametrize(
    ("name", "channels"), [("two that overlap", 3), ("over every edge", 1), ("a ghost in front", 3)]
)
def test_log_mass_is_the_sum_over_labels(name, channels):
    layers = [
        Layer(one.top, one.left, one.mask, one.appearance[:channels], ghost=one.ghost) for one in SCENES[name]
    ]
    image, scene = image_of(0, channels), background(channels)
    clear, explained = weights(layers, image)
    seen, covariance = colour.to_planes(image).astype(float), 111.0 * np.eye(channels)
    away = (seen - scene.colours.grey_levels().reshape(channels, -1)).T
    density = colour.VOLUME[channels] * multivariate_normal.pdf(away, np.zeros(channels), covariance)
    labels = 0.8 * density * clear.reshape(-1) + 0.2 / 256**channels * explained.reshape(-1)
    message = PixelMessage(scene, LayerStack(layers), image)
    assert message.log_mass == pytest.approx(np.log(labels).sum(), abs=1e-3 * labels.size)


@pytest.mark.parametrize(("name", "pooling"), [("over every edge", 0.3), ("a ghost behind", 0.0)])
def test_labels_and_probabilities_agree(name, pooling):
    scene, image = background(pooling=pooling), image_of()
    message = PixelMessage(scene, LayerStack(SCENES[name]), image)
    clear, explained = weights(SCENES[name], image)
    odds = scene.compare(image).smoothed.reshape(SIZE) / 20 + np.log(clear) - np.log(explained)
    probability = message.background_probability()
    np.testing.assert_allclose(probability, 1 / (1 + np.exp(-odds)), atol=1e-3)
    sure = np.abs(probability - 0.5) > 1e-4
    np.testing.assert_array_equal((message.foreground() == 255)[sure], (probability < 0.5)[sure])
    assert set(np.unique(message.foreground())) <= {0, 255}
    assert probability.dtype == np.float32
    assert message.foreground().dtype == np.uint8


def test_without_an_image_the_predictions_speak():
    layers = SCENES["two that overlap"]
    message = PixelMessage(background(), LayerStack(layers))
    clear, explained = weights(layers, None)
    expected = 0.8 * clear / (0.8 * clear + 0.2 * explained)
    np.testing.assert_allclose(message.background_probability(), expected, atol=0.01)  # stored odds
    assert message.subtraction is None
    expected = np.log(0.8 * clear + 0.2 * explained).sum()
    assert message.log_mass == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("with_background", "strength"), [(True, 1.0), (True, 30.0), (False, 1.0)])
def test_densities_of_a_pixel_sum_to_one_over_all_images(with_background, strength):
    def one(value):
        return np.full(1, value, np.float32)

    scene = background(
        1, size=(1, 1), pixels=fixed_point(one(130)[None], one(10), one(100)),
        second=SecondColours(np.zeros(1, np.uint8), np.zeros(1, np.uint16)),
        light=LightField(np.ones((2, 2), np.float32), (1, 1)),
    )  # fmt: skip
    layers = LayerStack([Layer(0, 0, one(0.7)[None], np.full((1, 1, 1), 90, np.float32), strength=strength)])
    message = PixelMessage(scene if with_background else None, layers)
    densities = [
        (message * PixelMessage(image=np.full((1, 1), value, np.uint8))).log_density(np.ones((1, 1), bool))
        for value in range(256)
    ]
    assert logsumexp(densities) == pytest.approx(0.0, abs=0.01)
    if with_background:
        masses = [PixelMessage(scene, layers, np.full((1, 1), k, np.uint8)).log_mass for k in range(256)]
        assert logsumexp(masses) == pytest.approx(message.log_mass, abs=0.01)
    assert np.argmax(densities) == 90 if strength > 1 or not with_background else 130


def test_densities_of_parts_of_a_picture_add_up_to_the_evidence():
    image = image_of()
    message = PixelMessage(background(), LayerStack(SCENES["two that overlap"]))
    seen = message * PixelMessage(image=image)
    part = np.random.default_rng(0).random(SIZE) < 0.3
    whole = seen.log_mass - message.log_mass
    assert seen.log_density(part) + seen.log_density(~part) == pytest.approx(whole, rel=1e-5)
    with pytest.raises(ValueError, match="no image"):
        message.log_density(part)


@pytest.mark.parametrize("region", [(0, 0, *SIZE), (-3, -2, 8, 9), (25, 33, 20, 20), (-9, 3, 4, 4)])
def test_odds_in_a_region_are_those_of_the_picture(region):
    message = PixelMessage(background(), LayerStack(SCENES["two that overlap"]), image_of())
    picture = np.zeros((120, 120), np.float32)
    inside = slice(40, 40 + SIZE[0]), slice(40, 40 + SIZE[1])
    top, left, height, width = region
    there = slice(40 + top, 40 + top + height), slice(40 + left, 40 + left + width)
    for ask in (message.log_odds, message.log_likelihood_ratio):
        picture[inside] = ask()
        assert ask(region).dtype == np.float32
        np.testing.assert_array_equal(ask(region), picture[there])
    without = PixelMessage(background(), image=image_of())
    ratio, odds = message.log_likelihood_ratio(), without.log_odds()
    np.testing.assert_allclose(ratio + np.log(0.8 / 0.2), odds, atol=1e-5)
    assert PixelMessage().log_likelihood_ratio(region).shape == (height, width)
    assert (PixelMessage(image=image_of()).background_probability() == 0.5).all()


@pytest.mark.parametrize("unknown", [0.0, 5000.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_background_behind_layers_is_updated_with_what_they_say(channels, unknown):
    rng = np.random.default_rng(7)
    scene, image = background(channels, noise_share=0.05, unknown_variance=unknown), image_of(0, channels)
    if unknown:
        scene.pixels.variance[rng.random(1200) < 0.3] = 60 * 256 + (3000 - 60) * 8
    shift = rng.normal(0, 3, (11, 21)).astype(np.float32)
    pooled = rng.integers(-127, 128, HEIGHT * WIDTH).astype(np.int8)
    before = [rng.integers(0, 30000, array.shape).astype(array.dtype) for array in scene.pixels]
    after, covered = [array.copy() for array in before], np.zeros(1200, np.uint8)
    blocks = LightField(rng.uniform(0.8, 1.2, (3, 4)).astype(np.float32), SIZE)
    rows, position = blocks.along_rows
    second = SecondColours(np.zeros(image.size, np.uint8), np.full(1200, 5, np.uint16))
    # a second region, in which nobody says anything, and which nothing else is in
    apart = (20, 2, 3, 4)
    update_behind(
        np.array([(6, 9, 11, 21), apart]), np.append(shift.reshape(-1), np.zeros(12, np.float32)),
        image.reshape(-1), pooled, scene.pixels, blocks.along_rows, scene.model, scene.rounding,
        colour.to_pixels(channels), Gaussians(*after), second, covered,
    )  # fmt: skip
    box = (slice(6, 17), slice(9, 30))
    above = position.astype(int)
    share = (position - above)[:, None]
    light = (rows[above] * (1 - share) + rows[above + 1] * share).astype(float)
    told, light = shift.astype(float), light[box]
    odds = pooled.reshape(SIZE)[box] / 20 + told
    weight = 1 / (1 + np.exp(-odds))
    mean = scene.colours.grey_levels()[:, *box].astype(float)
    difference = colour.to_planes(image).reshape(-1, *SIZE)[:, *box] - light * mean
    square = (difference**2).mean(axis=0)
    variance = np.where(scene.pixels.variance > 60 * 256, 3000, 10).reshape(SIZE)[box].astype(float)
    wandered, wide = variance + 1, variance > 60
    total = light**2 * wandered + 100
    gain = light * wandered / total
    learned = np.where(wide & (weight < 0.5), 0, weight)
    objects = (told < -3) & (square * channels < 9 * total)
    revealed = (told > 3) & (square * channels > 9 * total)
    assert revealed.any() or channels == 1
    new_mean = mean + np.where(revealed, 1 / light, learned * gain) * difference
    new_variance = (1 - learned * gain * light) * wandered + learned * (1 - learned) * gain**2 * square
    new_variance = np.clip(new_variance, 0.5, np.maximum(variance, 60))
    new_variance = np.where(objects & (unknown > 0), np.maximum(new_variance, unknown), new_variance)
    assert (objects & (new_variance > 4000)).any() == (unknown > 0)
    new_variance = np.where(revealed, 20, new_variance)
    new_noise = np.where(revealed | wide, 100, np.clip(100 + 0.05 * weight * (square - total), 20, 400))
    steps = after[1].astype(float)
    found = after[0] / 32, np.where(steps <= 15360, steps / 256, 60 + (steps - 15360) / 8), after[2] / 128
    coarse = np.where(new_variance > 60, 1 / 8, 1 / 256)
    for got, expected, step in zip(
        found, (new_mean, new_variance, new_noise), (1 / 32, coarse, 1 / 128), strict=True
    ):
        got = got.reshape(-1, *SIZE)[:, *box]
        assert (np.abs(got - expected) <= 1e-3 * np.abs(expected) + 2e-3 + step).all()
    outside = np.ones(SIZE, bool)
    outside[box] = outside[20:23, 2:6] = False
    for got, old in zip(after, before, strict=True):
        got, old = got.reshape(-1, *SIZE), old.reshape(-1, *SIZE)
        np.testing.assert_array_equal(got[:, outside], old[:, outside])
        assert (got[:, 20:23, 2:6] != old[:, 20:23, 2:6]).mean() > 0.5
    seen = np.full(SIZE, 5)
    seen[box][revealed] = KNOWN
    np.testing.assert_array_equal(second.seen.reshape(SIZE), seen)
    colours = colour.to_image((light * mean).reshape(channels, -1), (11, 21)).reshape(11, 21, channels)
    kept = second.colours.reshape(*SIZE, channels)[box]
    assert np.abs(kept[revealed].astype(int) - colours[revealed]).max(initial=0) <= 1
    assert not kept[~revealed].any()
    expected = np.zeros(SIZE, np.uint8)
    expected[box] = np.where(told < -0.5, 255, np.where(revealed, REVEALED, 0))
    np.testing.assert_array_equal(covered.reshape(SIZE), expected)
