"""Messages about pixels: their algebra, and the two chains that meet on them."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.chains.objects.blobs import Blobs
from rsmcm.chains.pixels.background_prediction import BackgroundPrediction, colour, fixed_point
from rsmcm.chains.pixels.gaussians import Gaussians
from rsmcm.chains.pixels.light import LightField
from rsmcm.chains.pixels.second_colours import KNOWN, REVEALED, SecondColours, update_behind
from rsmcm.chains.pixels.sway import Sway
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.numerics.threads import set_threads, thread_count
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


def spread_out(regions):
    clear, explained, times = np.ones(SIZE), np.ones(SIZE), np.zeros(SIZE, int)
    for region in regions:
        clear[region.window], explained[region.window] = region.clear, region.explained
        times[region.window] += 1
        np.testing.assert_allclose(
            region.shift, np.log(region.clear.astype(float) / region.explained), atol=2e-4
        )
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


@pytest.mark.parametrize("layers", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("seen", [True, False])
def test_layers_are_composed_front_to_back(layers, seen):
    image = image_of() if seen else None
    got = spread_out(LayerStack(layers).regions(image, SIZE))
    for ours, expected in zip(got, weights(layers, image), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=2e-3)


def test_a_grey_layer():
    image = image_of(3, 1)
    layers = [layer(4, 4, 9, 9, channels=1), layer(8, 2, 9, 9, 1, channels=1)]
    got = spread_out(LayerStack(layers).regions(image, SIZE))
    for ours, expected in zip(got, weights(layers, image), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=2e-3)


def test_regions_are_worked_out_once():
    stack, image = LayerStack([layer(5, 6, 10, 8)]), image_of()
    assert stack.regions(image, SIZE) is stack.regions(image, SIZE)
    assert stack.regions(None, SIZE)[0].box == stack.regions(image, SIZE)[0].box
    assert stack.regions(None, (12, 12))[0].box != stack.regions(image, SIZE)[0].box


def messages():
    return {
        "background": PixelMessage(background=background()),
        "image": PixelMessage(image=image_of()),
        "one": PixelMessage(layers=LayerStack([layer(5, 6, 10, 8), layer(7, 8, 9, 9, 1)])),
        "other": PixelMessage(layers=LayerStack([layer(9, 9, 12, 11, 2), layer(-3, 20, 9, 9, 3)])),
        "third": PixelMessage(layers=LayerStack([layer(8, 7, 6, 20, 4, ghost=True)])),
        "uniform": PixelLabels().uniform(),
    }


@settings(max_examples=40, deadline=None)
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


def test_uniform_changes_nothing():
    uniform = PixelLabels().uniform()
    message = PixelMessage(background(), LayerStack([layer(3, 3, 9, 9)]), image_of())
    for product in (uniform * message, message * uniform):
        np.testing.assert_array_equal(product.background_probability(), message.background_probability())
        np.testing.assert_array_equal(product.foreground(), message.foreground())
        assert product.log_mass == message.log_mass


def test_only_one_background_and_one_image():
    with pytest.raises(ValueError, match="two background predictions"):
        PixelMessage(background()) * PixelMessage(background())
    with pytest.raises(ValueError, match="two images"):
        PixelMessage(image=image_of()) * PixelMessage(image=image_of())


def test_a_message_without_a_picture_has_no_size():
    with pytest.raises(ValueError, match="size is not known"):
        PixelMessage().foreground()


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", ["one", "two that overlap", "over every edge", "a ghost in front"])
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


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("pooling", [0.0, 0.3])
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


@pytest.mark.parametrize("strength", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("ghost", [False, True])
def test_over_all_images_densities_sum_to_the_mass_without_one(strength, ghost):
    def one(value):
        return np.full(1, value, np.float32)

    scene = background(
        1, size=(1, 1), pixels=fixed_point(one(130)[None], one(10), one(100)),
        second=SecondColours(np.zeros(1, np.uint8), np.zeros(1, np.uint16)),
        light=LightField(np.ones((2, 2), np.float32), (1, 1)),
    )  # fmt: skip
    mask, appearance = one(0.7)[None], np.full((1, 1, 1), 90, np.float32)
    layers = LayerStack([Layer(0, 0, mask, None if ghost else appearance, strength=strength, ghost=ghost)])
    densities = [
        PixelMessage(scene, layers, np.full((1, 1), value, np.uint8)).log_mass for value in range(256)
    ]
    assert logsumexp(densities) == pytest.approx(PixelMessage(scene, layers).log_mass, abs=0.01)


@pytest.mark.parametrize("with_background", [True, False])
@pytest.mark.parametrize("strength", [1.0, 30.0])
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
    assert np.argmax(densities) == 90 if strength > 1 or not with_background else 130


@pytest.mark.parametrize("channels", [1, 3])
def test_densities_of_parts_of_a_picture_add_up_to_the_evidence(channels):
    image = image_of(0, channels)
    layers = [
        Layer(one.top, one.left, one.mask, one.appearance[:channels]) for one in SCENES["two that overlap"]
    ]
    message = PixelMessage(background(channels), LayerStack(layers))
    seen = message * PixelMessage(image=image)
    part = np.random.default_rng(0).random(SIZE) < 0.3
    whole = seen.log_mass - message.log_mass
    assert seen.log_density(part) + seen.log_density(~part) == pytest.approx(whole, rel=1e-5)
    with pytest.raises(ValueError, match="no image"):
        message.log_density(part)


BOXES = [(0, 0, *SIZE), (4, 7, 9, 11), (-3, -2, 8, 9), (25, 33, 20, 20), (50, 50, 3, 4), (-9, 3, 4, 4)]


@pytest.mark.parametrize("box", BOXES)
def test_odds_in_a_box_are_those_of_the_picture(box):
    message = PixelMessage(background(), LayerStack(SCENES["two that overlap"]), image_of())
    picture = np.zeros((120, 120), np.float32)
    inside = slice(40, 40 + SIZE[0]), slice(40, 40 + SIZE[1])
    top, left, height, width = box
    there = slice(40 + top, 40 + top + height), slice(40 + left, 40 + left + width)
    for ask in (message.log_odds, message.log_likelihood_ratio):
        picture[inside] = ask()
        assert ask(box).dtype == np.float32
        np.testing.assert_array_equal(ask(box), picture[there])


def test_odds_are_in_nats():
    image = image_of()
    message = PixelMessage(background(), LayerStack(SCENES["two that overlap"]), image)
    np.testing.assert_allclose(
        message.background_probability(), 1 / (1 + np.exp(-message.log_odds())), rtol=1e-5
    )
    prior = np.log(0.8 / 0.2)
    without_layers = PixelMessage(background(), image=image)
    np.testing.assert_allclose(message.log_likelihood_ratio() + prior, without_layers.log_odds(), atol=1e-5)
    assert not PixelMessage(image=image).log_likelihood_ratio().any()
    assert PixelMessage().log_likelihood_ratio((3, 4, 5, 6)).shape == (5, 6)


@pytest.mark.parametrize("value", [np.nan, -0.1, 1.1, 255.0, -np.inf])
def test_a_mask_that_is_no_probability_is_refused(value):
    mask = np.full((4, 5), 0.5, np.float32)
    mask[2, 3] = value
    with pytest.raises(ValueError, match=r"layer: got a mask from .* expected probabilities from 0 to 1"):
        Layer(0, 0, mask, None)


def test_an_appearance_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"layer: got shapes \(4, 5\) and \(3, 5, 4\), expected a mask of"):
        Layer(0, 0, np.zeros((4, 5), np.float32), np.zeros((3, 5, 4), np.float32))


def test_layers_come_in_a_stack() -> None:
    layer = Layer(0, 0, np.ones((2, 2), np.float32), None)
    with pytest.raises(TypeError, match=r"layers: got Layer\(.*, expected a list of Layer"):
        LayerStack(layer)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"pixel message: got list for layers, expected LayerStack"):
        PixelMessage(layers=[layer])  # type: ignore[arg-type]


def test_without_a_background_labels_are_even():
    message = PixelMessage(image=image_of())
    assert (message.background_probability() == 0.5).all()
    assert not message.foreground().any()


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


# the chains


def clip(n_frames=20, channels=3, size=(96, 128)):
    """A textured square walks over a textured floor."""
    rng = np.random.default_rng(11)
    floor = np.kron(rng.integers(80, 160, (size[0] // 8, size[1] // 8, channels)), np.ones((8, 8, 1)))
    thing = rng.integers(0, 2, (30, 14, channels)) * 180 + 30
    for k in range(n_frames):
        image = floor + rng.normal(0, 2, floor.shape)
        if k > 2:
            image[40:70, 4 * k : 4 * k + 14] = thing
        image = np.clip(image, 0, 255).astype(np.uint8)
        yield image[:, :, 0] if channels == 1 else image


def engine(feedback=True, blobs=True):
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels)
    if blobs:
        model.connect(BlobTracker(), pixels, feedback=feedback)
    return RecursiveBP(model)


def arrays_of(state):
    """All arrays of a chain's state, those of its blobs too."""
    found = []
    for value in vars(state).values():
        if isinstance(value, np.ndarray):
            found.append(value)
        elif isinstance(value, Blobs):
            found += [value.words, value.masks, value.colours]
    return found


@pytest.fixture(autouse=True)
def _threads():
    before = thread_count()
    yield
    set_threads(before)


@pytest.mark.parametrize("channels", [1, 3])
def test_feed_forward_equals_the_background_alone(channels):
    both = engine(feedback=False).run(clip(channels=channels))
    alone = engine(blobs=False).run(clip(channels=channels))
    born = 0
    for one, other in zip(both, alone, strict=True):
        for a, b in zip(arrays_of(one["background"]), arrays_of(other["background"]), strict=True):
            assert a.tobytes() == b.tobytes()
        np.testing.assert_array_equal(one["pixels"].foreground(), other["pixels"].foreground())
        born = max(born, len(one["blobs"].blobs))
    assert born > 0


@pytest.mark.parametrize("channels", [1, 3])
def test_an_object_is_tracked_and_labelled(channels):
    *_, belief = engine().run(clip(channels=channels))
    (track,) = belief["blobs"].tracks()
    assert track.box == pytest.approx((76, 40, 14, 30), abs=4)
    mask = belief["pixels"].foreground()
    inside = mask[42:68, 78:88]
    assert (inside == 255).mean() > 0.9
    mask[36:74, 70:96] = 0
    assert (mask == 255).mean() < 0.01
    assert np.isfinite(belief.log_evidence)


def test_threads_change_nothing():
    results = []
    for threads in (1, 2):
        set_threads(threads)
        *_, belief = engine().run(clip())
        arrays = [array for name in ("background", "blobs") for array in arrays_of(belief[name])]
        results.append([belief["pixels"].foreground().tobytes(), *(array.tobytes() for array in arrays)])
    assert results[0] == results[1]


def test_states_that_are_kept_never_change():
    kept = []
    for belief in engine().run(clip()):
        arrays = [array for name in ("background", "blobs") for array in arrays_of(belief[name])]
        arrays += [belief["pixels"].foreground(), belief["pixels"].background_probability()]
        kept.append((belief, arrays, [array.copy() for array in arrays]))
    for belief, arrays, copies in kept:
        for array, copy in zip(arrays, copies, strict=True):
            np.testing.assert_array_equal(array, copy)
        np.testing.assert_array_equal(belief["pixels"].foreground(), copies[-2])


@pytest.mark.parametrize("channels", [1, 3])
def test_a_saved_run_goes_on_as_if_it_had_not_stopped(tmp_path, channels):
    frames = list(clip(channels=channels))
    straight = list(engine().run(frames))[-1]
    *_, half = engine().run(frames[:9])
    engine().save(tmp_path / "state.npz", half.state)
    state, _ = engine().load(tmp_path / "state.npz")
    *_, resumed = engine().run(frames[9:], state=state)
    for name in ("background", "blobs"):
        for a, b in zip(arrays_of(straight[name]), arrays_of(resumed[name]), strict=True):
            assert a.tobytes() == b.tobytes()
    assert straight["blobs"].tracks() == resumed["blobs"].tracks()
    np.testing.assert_array_equal(straight["pixels"].foreground(), resumed["pixels"].foreground())


def test_missing_frames():
    frames = list(clip())
    frames[8] = frames[9] = None
    beliefs = list(engine().run(frames))
    for missing in (beliefs[8], beliefs[9]):
        assert missing["pixels"].background_probability().shape == (96, 128)
        assert missing["pixels"].foreground().dtype == np.uint8
        np.testing.assert_array_equal(missing["background"].mean, beliefs[7]["background"].mean)
    assert beliefs[9]["background"].elapsed == pytest.approx(2 / 25)
    (track,) = beliefs[-1]["blobs"].tracks()
    assert track.box == pytest.approx((76, 40, 14, 30), abs=4)


def test_evidence_is_the_image():
    frame = Frame(image_of(), 0.0, 1)
    labels = PixelLabels()
    assert labels.evidence(frame, labels.uniform()).image is frame.image


def test_a_message_without_layers_remembers_no_image():
    image = np.zeros((4, 5), np.uint8)
    before = sys.getrefcount(image)
    message = PixelMessage(image=image)
    message.foreground()
    del message
    assert sys.getrefcount(image) == before
