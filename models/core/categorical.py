"""Feature with a few possible values, such as a door or a light."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import Count, Shape, checked, shown
from .frame import Frame
from .short_repr import short_repr


@short_repr
class CategoricalMessage:
    """Log weights `(size,)` of the feature's values; minus infinity for an impossible value.

    Raises
    ------
    ValueError
        if one is NaN or infinite.
    """

    @checked
    def __init__(self, log_weights: Annotated[ArrayLike, Shape(None, finite=False)]) -> None:
        self.log_weights: NDArray[np.float64] = np.asarray(log_weights, np.float64)
        if not (self.log_weights < np.inf).all():
            raise ValueError(
                f"log_weights: got {shown(self.log_weights.tolist())}, expected less than infinity"
            )

    @property
    def log_mass(self) -> float:
        """Log of the sum of the weights."""
        from scipy.special import logsumexp  # slow to import

        return float(logsumexp(self.log_weights))

    def probabilities(self) -> NDArray[np.float64]:
        """Return weights `(size,)` that sum to 1; a `ValueError` if every value is impossible."""
        log_mass = self.log_mass
        if log_mass == -np.inf:
            raise ValueError("message: got weight 0 for every value, expected one that is possible")
        return np.exp(self.log_weights - log_mass)

    def __mul__(self, other: "CategoricalMessage") -> "CategoricalMessage":
        return CategoricalMessage(self.log_weights + other.log_weights)

    def __pow__(self, exponent: float) -> "CategoricalMessage":
        return CategoricalMessage(self.log_weights * exponent)

    def normalised(self) -> "CategoricalMessage":
        """Return the message with weights that sum to 1, or itself if all values are impossible."""
        log_mass = self.log_mass
        return self if log_mass == -np.inf else CategoricalMessage(self.log_weights - log_mass)

    def distance(self, other: "CategoricalMessage") -> float:
        """Return the greatest difference of normalised weights."""
        one, two = (np.exp(each.normalised().log_weights) for each in (self, other))
        return float(np.abs(one - two).max())


@checked
@short_repr
@dataclass(frozen=True)
class Categorical:
    """Feature node with a few values.

    Parameters
    ----------
    name
        of the node.
    size
        number of values.
    log_likelihood
        log p(I | F = each value), `(size,)`, of a frame with an image. `None` if images contain no
        information about the feature.
    """

    name: str
    size: Count
    log_likelihood: Callable[[Frame], ArrayLike] | None = None

    searches = False

    def uniform(self) -> CategoricalMessage:
        """Return the constant 1."""
        return CategoricalMessage(np.zeros(self.size))

    def evidence(self, frame: Frame, prior: CategoricalMessage) -> CategoricalMessage:
        """Return the likelihood of the frame; a `ValueError` if it has another number of values."""
        if self.log_likelihood is None:
            return self.uniform()
        message = CategoricalMessage(self.log_likelihood(frame))
        if message.log_weights.shape != (self.size,):
            raise ValueError(
                f"log_likelihood of {self.name!r}: got {message.log_weights.shape} at frame {frame.number}, "
                f"expected ({self.size},)"
            )
        return message
