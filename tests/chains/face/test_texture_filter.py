"""Filter of texels against filterpy's; steady states; gains that are learned against the best ones."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.face.texture_filter import USUAL_RATE, LearnedGain, TexelNoise, Texture
from rsmcm.chains.face.texture_likelihood import UNKNOWN_VARIANCE

variances = st.floats(1e-6, 1e6)
gains = st.floats(0, 1)


def steady_gain(noise: TexelNoise) -> float:
    return noise.steady_variance / noise.temperature


@given(gains, variances)
def test_wanted_gain_and_temperature_come_out(gain: float, temperature: float) -> None:
    noise = TexelNoise.of_steady_state(gain, temperature)
    assert steady_gain(noise) == pytest.approx(gain, rel=1e-7, abs=1e-9)
    assert noise.temperature == pytest.approx(temperature, rel=1e-9)


@given(variances, st.floats(1e-3, 1e3))
def test_the_filter_settles_there(rendering: float, ratio: float) -> None:
    noise = TexelNoise(rendering, ratio * rendering * USUAL_RATE)
    change = ratio * rendering  # from frame to frame
    variance = 10 * (rendering + change)
    for _ in range(3000):
        variance = variance * rendering / (variance + rendering) + change
    assert noise.steady_variance == pytest.approx(variance, rel=1e-6)
    assert steady_gain(noise) == pytest.approx(variance / (variance + rendering), rel=1e-6)


@pytest.mark.parametrize(("gain", "temperature"), [(-0.1, 1.0), (1.1, 1.0), (0.5, 0.0), (np.nan, 1.0)])
def test_impossible_steady_states_are_refused(gain: float, temperature: float) -> None:
    with pytest.raises(ValueError, match="texel noise: got gain"):
        TexelNoise.of_steady_state(gain, temperature)


@pytest.mark.parametrize(("rendering", "process"), [(-1.0, 1.0), (1.0, -1.0), (0.0, 0.0), (np.nan, 1.0)])
def test_impossible_noises_are_refused(rendering: float, process: float) -> None:
    with pytest.raises(ValueError, match="texel noise: got rendering"):
        TexelNoise(rendering, process)


Array = NDArray[np.float64]

DT = 1 / USUAL_RATE


def known(mean: Array, variance: Array) -> Texture:
    return Texture(mean.astype(np.float32), variance.astype(np.float32))


@given(st.integers(0, 10**6), st.floats(0.01, 0.95), st.floats(4, 300))
def test_every_texel_is_filtered_as_filterpy_does(seed: int, gain: float, temperature: float) -> None:
    random = np.random.default_rng(seed)
    noise = TexelNoise.of_steady_state(gain, temperature)
    assume(900 + noise.process < UNKNOWN_VARIANCE / 2)  # or a texel that is hidden for long is unknown
    looks = random.uniform(0, 255, (25, 2, 3, 4)).astype(np.float32)
    seen = random.random((25, 2, 4)) < 0.6
    texture = known(random.uniform(0, 255, (2, 3, 4)), random.uniform(0, 900, (2, 4)))
    start = texture
    for look, visible in zip(looks, seen, strict=True):
        texture = texture.updated(look, visible, noise, DT).predicted(noise, DT)
    for expert, texel in np.ndindex(2, 4):
        one = KalmanFilter(dim_x=1, dim_z=1)
        one.x[:], one.P[:] = start.mean[expert, 0, texel], start.variance[expert, texel]
        one.F[:], one.H[:], one.Q[:], one.R[:] = 1, 1, noise.process * DT, noise.rendering
        for look, visible in zip(looks, seen, strict=True):
            one.update(look[expert, 0, texel] if visible[expert, texel] else None)
            one.predict()
        assert texture.mean[expert, 0, texel] == pytest.approx(one.x[0, 0], rel=1e-4, abs=1e-3)
        assert texture.variance[expert, texel] == pytest.approx(one.P[0, 0], rel=1e-4)
        last = np.flatnonzero(seen[:, expert, texel])
        if len(last):  # coarse levels hold the last look
            np.testing.assert_array_equal(texture.mean[expert, 1:, texel], looks[last[-1], expert, 1:, texel])


@pytest.mark.parametrize("gain", [0.0, 0.05, 1.0])
def test_a_first_look_is_the_texture(gain: float) -> None:
    noise = TexelNoise.of_steady_state(gain, 36.0)
    looks = np.random.default_rng(0).uniform(0, 255, (400, 1, 2, 5)).astype(np.float32)
    seen = np.array([[True, True, False, False, True]])
    texture = Texture.unknown(1, 2, 5, learn=False).updated(looks[0], seen, noise, 0.0)
    np.testing.assert_allclose(texture.mean[0][:, seen[0]], looks[0, 0][:, seen[0]], rtol=1e-6)
    np.testing.assert_allclose(texture.variance[seen], noise.rendering if gain else 0, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(texture.variance[~seen], UNKNOWN_VARIANCE)
    for look in looks[1:]:
        texture = texture.predicted(noise, DT).updated(look, np.ones_like(seen), noise, DT)
    texture = texture.predicted(noise, DT)
    if gain in (0.0, 1.0):  # a template, and optic flow
        late = looks[-1 if gain else 0, 0, 0]
        np.testing.assert_allclose(texture.mean[0, 0, seen[0]], late[seen[0]], atol=1e-4)
    np.testing.assert_allclose(texture.variance, noise.steady_variance, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(texture.temperature(noise), 36.0, rtol=1e-5)


def test_children_have_their_parents_textures() -> None:
    random = np.random.default_rng(1)
    texture = known(random.normal(size=(3, 2, 4)), random.uniform(size=(3, 4)))
    texture = Texture(texture.mean, texture.variance, LearnedGain.first(3, 4))
    child = texture.of(np.array([2, 2, 0]))
    np.testing.assert_array_equal(child.mean, texture.mean[[2, 2, 0]])
    np.testing.assert_array_equal(child.variance, texture.variance[[2, 2, 0]])
    assert child.learned is not None
    assert child.learned.gain.shape == (3, 4)
