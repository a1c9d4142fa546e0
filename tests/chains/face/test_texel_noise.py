"""Noises, gain and temperature of a texel: both ways, and against the filter that they describe."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.chains.face.texture_filter import USUAL_RATE, TexelNoise

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
