"""Smooth functions: random ones of places and of time, and steps."""

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Pixels = NDArray[np.float32]


def mottle(shape: tuple[int, int], coarsest: float, finest: float, generator: np.random.Generator) -> Pixels:
    """Return noise of unit variance with as much in every octave, from spots of `coarsest` px to `finest`."""
    down, across = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    # spots as large as 0.4 wavelengths
    cycles = np.hypot(down[:, None], across[None, :]) / 0.4
    amplitude = np.exp(-0.5 * (cycles * finest) ** 2) / (cycles**2 + coarsest**-2) ** 0.5
    amplitude[0, 0] = 0
    field = np.fft.irfft2(np.fft.rfft2(generator.standard_normal(shape)) * amplitude, shape)
    unit: Pixels = np.asarray(field / field.std(), np.float32)
    return unit


def wander(times: Numbers, periods: tuple[float, float], generator: np.random.Generator) -> Numbers:
    """Return a smooth random function of unit variance at `times` (s): sines of periods (s) in a range."""
    n_sines = 8
    lengths = np.exp(generator.uniform(np.log(periods[0]), np.log(periods[1]), n_sines))
    phases = generator.uniform(0, 2 * np.pi, n_sines)
    sines = np.sin(2 * np.pi * times[:, None] / lengths + phases)
    wandered: Numbers = sines.sum(axis=1) * np.sqrt(2 / n_sines)
    return wandered


def inside(distance: Numbers, soft: float = 0.012) -> Numbers:
    """Return 1 where `distance` from an outline is positive, 0 outside, smooth over `soft`."""
    share: Numbers = 0.5 * (1 + np.tanh(distance / soft))
    return share
