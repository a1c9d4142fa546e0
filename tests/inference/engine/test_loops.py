"""Belief propagation on graphs with loops, against plain loopy belief propagation and enumeration."""

from collections.abc import Mapping
from typing import Any

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference import MultiChain, RecursiveBP, RunState
from rsmcm.models import (
    BoxMessage,
    CategoricalMessage,
    Frame,
    GaussianMessage,
    Layer,
    LayerStack,
    LogOdds,
    PixelMessage,
)

from ...support.discrete import CavityChain, enumerate_slice, image, random_model

Table = NDArray[np.float64]
Step = tuple[str, str]


def random_links(random: np.random.Generator, n_loops: int) -> list[Step]:
    """A random connected graph of two to four chains and features with so many links more than a tree."""
    while True:
        n_chains, n_features = random.integers(2, 5, size=2)
        pairs = [(f"c{i}", f"f{j}") for i in range(n_chains) for j in range(n_features)]
        count = n_chains + n_features - 1 + n_loops
        if count <= len(pairs):
            links = [pairs[k] for k in random.choice(len(pairs), count, replace=False)]
            graph = nx.Graph(links)
            if len(graph) == n_chains + n_features and nx.is_connected(graph):
                return links


def factor_of(model: MultiChain, chain: str, prediction: Table) -> Table:
    """Sum over the chain's states: a table with an axis for each of its features."""
    tables = [model.chains[chain].emission[name] for name in model.features_of[chain]]
    total = 0.0
    for state, weight in enumerate(prediction):
        part = np.array(weight)
        for table in tables:
            part = np.multiply.outer(part, table[state])
        total = total + part
    return np.asarray(total)


class PlainBP:
    """Loopy belief propagation on factors over features, all messages at once, damped by powers."""

    def __init__(self, model: MultiChain, predictions: Mapping[str, Table], frame: Frame, seen: bool) -> None:
        self.features = model.features
        self.scopes = model.features_of
        self.factors = {name: factor_of(model, name, predictions[name]) for name in model.chains}
        self.evidence = {
            name: np.exp(node.log_likelihood(frame)) if seen else np.ones(node.size)
            for name, node in self.features.items()
        }
        self.messages = {
            (chain, feature): np.ones(self.features[feature].size) / self.features[feature].size
            for chain in model.chains
            for feature in self.scopes[chain]
        }

    def settle(self, damping: float = 0.3, most: int = 3000, tolerance: float = 1e-14) -> bool:
        for _ in range(most):
            fresh = {}
            for (chain, feature), old in self.messages.items():
                axis = self.scopes[chain].index(feature)
                joint = self.weighted(chain, without=feature)
                new = joint.sum(axis=tuple(k for k in range(joint.ndim) if k != axis))
                new = (new / new.sum()) ** (1 - damping) * old**damping
                fresh[chain, feature] = new / new.sum()
            change = max(np.abs(fresh[step] - self.messages[step]).max() for step in fresh)
            self.messages = fresh
            if change < tolerance:
                return True
        return False

    def towards(self, feature: str, chain: str = "") -> Table:
        """What reaches a feature, but for one chain."""
        others = [m for (c, f), m in self.messages.items() if f == feature and c != chain]
        return np.prod([self.evidence[feature], *others], axis=0)

    def weighted(self, chain: str, without: str = "") -> Table:
        joint = self.factors[chain]
        for axis, name in enumerate(self.scopes[chain]):
            if name != without:
                shape = [1] * joint.ndim
                shape[axis] = -1
                joint = joint * self.towards(name, chain).reshape(shape)
        return joint

    def belief(self, feature: str) -> Table:
        weights = self.towards(feature)
        return weights / weights.sum()

    def log_sum(self) -> float:
        """Minus Bethe's free energy of the beliefs: mean log factors plus entropies."""

        def mean_log(belief: Table, weight: Table) -> float:
            return float((belief * (np.log(weight) - np.log(belief))).sum())

        total = 0.0
        for chain in self.factors:
            joint = self.weighted(chain)
            total += mean_log(joint / joint.sum(), self.factors[chain])
        for feature, evidence in self.evidence.items():
            belief = self.belief(feature)
            count = sum(f == feature for _, f in self.messages)
            total += float((belief * np.log(evidence)).sum())
            total += (1 - count) * float(-(belief * np.log(belief)).sum())
        return total

    @classmethod
    def settled(
        cls, model: MultiChain, predictions: Mapping[str, Table], frame: Frame, seen: bool = True
    ) -> "PlainBP | None":
        plain = cls(model, predictions, frame, seen)
        return plain if plain.settle() else None


def posterior(plain: PlainBP, model: MultiChain, chain: str, prediction: Table) -> Table:
    weights = prediction
    for name in model.features_of[chain]:
        weights = weights * (model.chains[chain].emission[name] @ plain.towards(name, chain))
    return weights / weights.sum()


def random_slice(seed: int, n_loops: int, cavity: str = "") -> tuple[MultiChain, dict[str, Table], Frame]:
    """A model, every other one with tables that are nearly certain, its predictions and a frame."""
    random = np.random.default_rng(seed)
    links = random_links(random, n_loops)
    kinds = dict.fromkeys(cavity.split(), CavityChain)
    model = random_model(random, links, kinds, power=1 + 3 * (seed % 2))
    predictions = {name: chain.initial_probabilities for name, chain in model.chains.items()}
    return model, predictions, Frame(image(*random.integers(0, 5, 4)), 0.0, 1)


@pytest.mark.parametrize("cavity", ["", "c0 c2"])
def test_sixty_graphs_with_loops_are_those_of_plain_belief_propagation(cavity: str) -> None:
    errors = []
    for seed in range(60):
        model, predictions, frame = random_slice(seed, 1 + seed % 3, cavity)
        belief = RecursiveBP(model, most_sweeps=300, tolerance=1e-12).step(RunState(), frame)
        plain, unseen = (PlainBP.settled(model, predictions, frame, seen) for seen in (True, False))
        assert model.has_loops
        assert belief.converged == (plain is not None)
        if plain is None or unseen is None:
            continue
        chains, features, _ = enumerate_slice(model, predictions, frame)
        for name in features:
            np.testing.assert_allclose(belief[name].probabilities(), plain.belief(name), rtol=0, atol=1e-9)
            errors.append(np.abs(belief[name].probabilities() - features[name]).mean())
        for name in chains:
            expected = posterior(plain, model, name, predictions[name])
            np.testing.assert_allclose(belief[name].probabilities, expected, rtol=0, atol=1e-9)
            errors.append(np.abs(belief[name].probabilities - chains[name]).mean())
        bethe = plain.log_sum() - unseen.log_sum()
        assert belief.log_evidence == pytest.approx(bethe, rel=0, abs=1e-9)
    print(f"mean absolute error of {len(errors)} marginals: {np.mean(errors):.4f}")
    assert np.mean(errors) < 0.02  # .006 to .009 with other seeds


def test_sixty_forests_are_exact() -> None:
    for seed in range(60):
        model, predictions, frame = random_slice(seed, 0)
        belief = RecursiveBP(model).step(RunState(), frame)
        chains, features, log_evidence = enumerate_slice(model, predictions, frame)
        assert (model.has_loops, belief.converged, belief.sweeps) == (False, True, 1)
        for name in chains:
            np.testing.assert_allclose(belief[name].probabilities, chains[name], rtol=0, atol=1e-12)
        for name in features:
            np.testing.assert_allclose(belief[name].probabilities(), features[name], rtol=0, atol=1e-12)
        assert belief.log_evidence == pytest.approx(log_evidence, rel=0, abs=1e-12)


def test_damping_leads_to_the_same_beliefs() -> None:
    for seed in range(10):
        model, _, frame = random_slice(seed, 2)
        plain, damped = (
            RecursiveBP(model, damping, 300, 1e-13).step(RunState(), frame) for damping in (0.0, 0.5)
        )
        assert damped.sweeps > plain.sweeps
        for name in model.features:
            np.testing.assert_allclose(
                damped[name].probabilities(), plain[name].probabilities(), rtol=0, atol=1e-10
            )


def test_a_belief_tells_whether_its_messages_have_settled() -> None:
    model, _, frame = random_slice(1, 2)
    belief = RecursiveBP(model, most_sweeps=2, tolerance=0).step(RunState(), frame)
    assert (belief.converged, belief.sweeps) == (False, 2)
    assert "not settled after 2 sweeps" in repr(belief)
    assert belief._repr_html_().count("<tr>") == 1 + len(model.chains)
    nothing = RecursiveBP(model).step(RunState(), Frame(None, 0.0, 1))
    assert (nothing.converged, nothing.sweeps) == (True, 1)
    missing = RecursiveBP(model).step(belief.state, Frame(None, 1.0, 2))
    assert missing.log_evidence == 0


def test_messages_without_distance_and_powers_settle_by_their_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    model, _, frame = random_slice(4, 1)
    one = RecursiveBP(model, damping=0.2).step(RunState(), frame)
    for method in ("distance", "__pow__"):
        monkeypatch.delattr(CategoricalMessage, method)
    other = RecursiveBP(model, damping=0.2).step(RunState(), frame)
    assert (other.converged, other.sweeps < one.sweeps) == (True, True)
    for name in model.features:
        np.testing.assert_allclose(other[name].probabilities(), one[name].probabilities(), rtol=0, atol=1e-5)


def gaussian(mean: float, variance: float = 4.0, identity: int = 3) -> GaussianMessage:
    return GaussianMessage.from_moments([identity], [[mean, 0.0]], [variance * np.eye(2)])


def layer(left: int, cover: float = 0.6) -> PixelMessage:
    mask = np.full((4, 5), cover, np.float32)
    return PixelMessage(layers=LayerStack([Layer(-1, left, mask, appearance=None)]))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (CategoricalMessage([0.0, 0.0]), CategoricalMessage([np.log(9), 0.0]), 0.4),
        (CategoricalMessage([5.0, 7.0]), CategoricalMessage([0.0, 2.0]), 0.0),
        (gaussian(100.0), gaussian(104.0), 4 * 0.25 / np.sqrt(0.5)),  # slopes +-.5 at 102, over 1/sd
        (gaussian(100.0), gaussian(100.0, 2.0), 1 / 3),
        (gaussian(100.0), gaussian(100.0) * gaussian(50.0, 3.0, 7), 1.0),
        (GaussianMessage.uniform(2), GaussianMessage.uniform(2), 0.0),
        (layer(10), layer(11), 0.6),
        (layer(10), layer(10, 0.5), 0.1),
        (layer(10), PixelMessage(), 0.6),
        (PixelMessage(), PixelMessage(), 0.0),
        (BoxMessage(), BoxMessage(existence=LogOdds(np.array([3]), np.array([np.log(3)]))), 0.25),
        (BoxMessage(), BoxMessage(), 0.0),
    ],
)
def test_distance_of_messages(one: Any, other: Any, expected: float) -> None:
    assert one.distance(other) == pytest.approx(expected, abs=1e-6)
    assert other.distance(one) == pytest.approx(expected, abs=1e-6)
    assert one.distance(one) == 0
