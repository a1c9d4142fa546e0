"""Noises of a texel, and the gain and temperature of its Kalman filter in the steady state, both ways."""

from dataclasses import dataclass
from typing import Self

import numpy as np

USUAL_RATE = 25.0
"""Frames a second at which gains and temperatures are those of the steady state."""


@dataclass(frozen=True)
class TexelNoise:
    """Noises of the texture (G-flow paper eq. 1, 4).

    Parameters
    ----------
    rendering
        sigma_w^2, squared grey levels: of a texel as the picture shows it.
    process
        Psi_v, squared grey levels per second: by which a texel changes.
    """

    rendering: float
    process: float

    def __post_init__(self) -> None:
        if not (self.rendering >= 0 and self.process >= 0 and self.rendering + self.process > 0):
            raise ValueError(
                f"texel noise: got rendering {self.rendering}, process {self.process}, expected 0 or more "
                "and one of them above"
            )

    @classmethod
    def of_steady_state(cls, gain: float, temperature: float) -> Self:
        """The noises for which gain and temperature settle at the given values, eq. (33) solved for them.

        sigma_w^2 = (1 - K) tau, and Psi = K^2 tau from one frame to the next of `USUAL_RATE`.

        Raises
        ------
        ValueError
            if the gain is not from 0 to 1 or the temperature not above 0.
        """
        if not (0 <= gain <= 1 and temperature > 0):
            raise ValueError(
                f"texel noise: got gain {gain}, temperature {temperature}, expected a gain from 0 to 1 and a "
                "temperature above 0"
            )
        return cls((1 - gain) * temperature, gain**2 * temperature * USUAL_RATE)

    @property
    def steady_variance(self) -> float:
        """V_inf, squared grey levels, eq. (34): of predictions from frame to frame of `USUAL_RATE`."""
        change = self.process / USUAL_RATE
        return 0.5 * (change + float(np.sqrt(change**2 + 4 * self.rendering * change)))

    @property
    def steady_gain(self) -> float:
        """K_inf, from 0 to 1: of pictures of `USUAL_RATE`."""
        return self.steady_variance / self.temperature

    @property
    def temperature(self) -> float:
        """tau_inf = V_inf + sigma_w^2, squared grey levels (§4.1)."""
        return self.steady_variance + self.rendering
