"""Log evidence of poses is log p(image | past): beside a bootstrap filter, and between runs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.body import SignerFilm
from rsmcm.chains import ArticulatedPose, Condensation
from rsmcm.chains.body.dynamics import Ancestors, BodyDynamics
from rsmcm.chains.body.samples import BodySamples
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.engine.recursive_bp import RunState
from rsmcm.models.body.upper_body import BodyPoses

pytestmark = pytest.mark.slow

N_SEEDS = 6


@pytest.fixture(scope="module")
def film() -> SignerFilm:
    return SignerFilm.of(n_frames=5, seed=103)


def evidence(chain: ArticulatedPose | Condensation, film: SignerFilm, known: BodyPoses) -> float:
    """Nats of all frames after the first, whose pose is known."""
    engine = RecursiveBP(MultiChain().connect(chain, film.parts))
    state = engine.step(RunState(), film.frames[0]).state
    samples = state.states[chain.name]
    assert isinstance(samples, BodySamples)
    given = known.take(np.zeros(len(samples.poses), np.int64))
    samples = BodySamples.even(given, samples.size, samples.random)
    state = replace(state, states={**state.states, chain.name: samples})
    total = 0.0
    for frame in film.frames[1:]:
        belief = engine.step(state, frame)
        state, total = belief.state, total + belief[chain].log_evidence
    return total


def over_seeds(
    kind: type[ArticulatedPose] | type[Condensation], samples: int, film: SignerFilm
) -> tuple[float, float]:
    """Mean over seeds of the random numbers and its standard error, from the true pose, without exchanges."""
    body = film.scene.body
    dynamics = BodyDynamics(body, exchanges=0.0)
    found: NDArray[np.float64] = np.array(
        [
            evidence(kind(body, samples, seed=seed, dynamics=dynamics), film, film.scene.poses)
            for seed in range(N_SEEDS)
        ]
    )
    return float(found.mean()), float(found.std(ddof=1) / np.sqrt(N_SEEDS))


@pytest.fixture(scope="module")
def brute(film: SignerFilm) -> tuple[float, float]:
    return over_seeds(Condensation, 20_000, film)


def test_more_samples_of_a_bootstrap_filter_say_the_same(
    film: SignerFilm, brute: tuple[float, float]
) -> None:
    few, error = over_seeds(Condensation, 5000, film)
    assert abs(few - brute[0]) < 4 * np.hypot(error, brute[1])


def test_it_is_that_of_a_bootstrap_filter_of_many_samples(
    film: SignerFilm, brute: tuple[float, float]
) -> None:
    """To one nat over four frames, each of which gives about 24, and four standard errors of both."""
    ours, error = over_seeds(ArticulatedPose, 1000, film)
    assert abs(ours - brute[0]) < 1 + 4 * np.hypot(error, brute[1])


@pytest.mark.parametrize(("kind", "samples"), [(ArticulatedPose, 500), (Condensation, 5000)])
def test_exchanged_hands_explain_less(kind: type[ArticulatedPose] | type[Condensation], samples: int) -> None:
    """On average over films; each run starts from its pose, and no hand jumps."""
    gains = []
    for seed in range(101, 109):
        film = SignerFilm.of(n_frames=5, seed=seed)
        body = film.scene.body
        truth = Ancestors(film.scene.poses.take(np.zeros(200, np.int64)), np.full(200, 1 / 200), 0.04)
        pairs = BodyDynamics(body).with_exchanged(truth, np.random.default_rng(0)).poses
        chain = kind(body, samples, dynamics=BodyDynamics(body, exchanges=0.0, jumps=0.0))
        if len(pairs) > 200:  # else hands do not reach each other's positions
            right, exchanged = film.scene.poses.take([0]), pairs.take([200])
            gains.append(evidence(chain, film, right) - evidence(chain, film, exchanged))
    assert len(gains) >= 4
    assert np.mean(gains) > 2 * np.std(gains, ddof=1) / np.sqrt(len(gains))
