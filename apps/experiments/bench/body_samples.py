"""Speed of tracking bodies by samples: a filter's step beside that of `particles`.

Set `OPENBLAS_NUM_THREADS=1` (or that of your BLAS) for the peers too. `particles` asks for numpy 1 and runs
with numpy 2 all the same: `pip install --no-deps particles joblib cloudpickle scikit-learn threadpoolctl
narwhals`. Without it, what is measured beside it is left out.
"""

import importlib.util
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....chains.body.condensation import Condensation
from ....inference.engine.protocols import Incoming
from ....models.body.part_message import PartMessage
from ....models.body.parts import BodyParts
from ....models.body.upper_body import PARTS
from ....models.core.frame import Frame
from ....models.core.gaussian_mixtures import GaussianMixtures
from ...evaluation.text_tables import in_columns
from ..expectations import HEADER, Expectation
from .timing import in_turns, over_rounds

Numbers = NDArray[np.float64]

SAMPLES, DIMENSION = 1000, 13
STEP, NOISE = 0.1, 0.3  # standard deviations of a walk and of its measurements
N_FRAMES = 400  # more than there are steps in the measurement


def bootstrap_times() -> list[Expectation]:
    """A step of CONDENSATION over vectors with a Gaussian walk and likelihood, beside a bootstrap filter."""
    random = np.random.default_rng(0)
    measured = STEP * random.normal(size=(N_FRAMES, DIMENSION)).cumsum(axis=0)
    methods = {"ours": _condensation(measured)}
    if importlib.util.find_spec("particles") is not None:
        methods["particles"] = _bootstrap(measured)
    return over_rounds(_of_steps, in_turns(methods, rounds=15, turn=20))


def _of_steps(seconds: Mapping[str, float]) -> list[Expectation]:
    what = f"CONDENSATION's step, {SAMPLES} x {DIMENSION}"
    expectations = [Expectation(f"{what}, ms", 1e3 * seconds["ours"])]
    if "particles" in seconds:
        expectations.append(
            Expectation(
                f"particles' bootstrap filter over {what}", seconds["particles"] / seconds["ours"], ">=", 2
            )
        )
    return expectations


# --- the same walk for both ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Vectors:
    """Samples `(n, 13)` in the place of poses."""

    values: Numbers

    def __len__(self) -> int:
        return len(self.values)

    def take(self, chosen: Any) -> "_Vectors":
        return _Vectors(self.values.take(chosen, axis=0))


class _Anything:
    """A body without limits."""

    def allowed(self, vectors: _Vectors) -> NDArray[np.bool_]:
        return np.ones(len(vectors), np.bool_)


class _Walk:
    """A random walk."""

    def draw(self, vectors: _Vectors, dt: float, random: np.random.Generator) -> _Vectors:
        steps = random.standard_normal(vectors.values.shape)
        steps *= STEP
        steps += vectors.values
        return _Vectors(steps)

    def log_posture(self, vectors: _Vectors, dt: float) -> float:
        return 0.0


def _likelihood(measured: Numbers) -> Callable[[_Vectors], Numbers]:
    def of(vectors: _Vectors) -> Numbers:
        off = vectors.values - measured
        logs: Numbers = np.einsum("nd,nd->n", off, off)
        logs *= -0.5 / NOISE**2
        return logs

    return of


def _condensation(measured: Numbers) -> Callable[[], object]:
    """One step further at each call."""
    stand_ins: Any = (_Anything(), _Vectors(np.zeros((1, DIMENSION))), _Walk(), _likelihood)
    body, start, dynamics, likelihood = stand_ins
    chain = Condensation(body, SAMPLES, start, 0, dynamics, likelihood)
    state = chain.initial(Frame(np.zeros((2, 2), np.uint8), 0.0, 1))
    frames = iter(measured)
    nothing, node = GaussianMixtures.uniform(len(PARTS)), BodyParts(1.0)

    def step() -> object:
        nonlocal state
        now: Any = next(frames)
        state = chain.update(chain.predict(state, 1.0), Incoming({node: PartMessage(nothing, now)}))
        return state

    return step


def _bootstrap(measured: Numbers) -> Callable[[], object]:
    """The same with `particles`, which resamples at every step too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its age
        import particles
        from particles.distributions import MvNormal
        from particles.state_space_models import Bootstrap, StateSpaceModel

    unit = np.eye(DIMENSION)

    class Walk(StateSpaceModel):  # type: ignore[misc]
        def PX0(self) -> Any:  # noqa: N802
            return MvNormal(loc=np.zeros(DIMENSION), cov=unit)

        def PX(self, t: int, xp: Numbers) -> Any:  # noqa: N802
            return MvNormal(loc=xp, scale=STEP, cov=unit)

        def PY(self, t: int, xp: Numbers, x: Numbers) -> Any:  # noqa: N802
            return MvNormal(loc=x, scale=NOISE, cov=unit)

    model = Bootstrap(ssm=Walk(), data=list(measured))
    run = particles.SMC(fk=model, N=SAMPLES, resampling="systematic", ESSrmin=1.0)
    return lambda: next(run)


if __name__ == "__main__":
    print(in_columns(HEADER, [expectation.cells for expectation in bootstrap_times()]))
