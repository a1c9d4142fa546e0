"""Belief propagation beside the sum over all states."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....inference import Incoming, MultiChain, Port, RecursiveBP, RunState
from ....models import Categorical, Frame
from ....models.core.categorical import CategoricalMessage

Probabilities = NDArray[np.float64]


@dataclass(frozen=True)
class _Toy:
    """A hidden state with a few values and a table p(F | X) for each feature."""

    name: str
    prior: Probabilities
    transition: Probabilities
    tables: Mapping[str, Probabilities]

    ports = (Port(Categorical, many=True),)

    def initial(self, frame: Frame) -> Probabilities:
        return self.prior

    def predict(self, state: Probabilities, dt: float) -> Probabilities:
        moved: Probabilities = state @ self.transition
        return moved

    def message(self, state: Probabilities, feature: Categorical, incoming: Incoming) -> CategoricalMessage:
        return CategoricalMessage(
            np.log(self._heard(state, incoming, feature.name) @ self.tables[feature.name])
        )

    def update(self, state: Probabilities, incoming: Incoming) -> Probabilities:
        weights = self._heard(state, incoming)
        weights /= weights.sum()
        return weights

    def _heard(self, state: Probabilities, incoming: Incoming, without: str = "") -> Probabilities:
        for name, message in incoming.by_name(Categorical).items():
            if name != without:
                state = state * (self.tables[name] @ np.exp(message.log_weights))
        return state


def enumeration_error(n_frames: int = 10) -> float:
    """Greatest difference of chains' posteriors from the sum over all joint states, for three chains.

    The chains a, b, c meet on the features f (a, b) and g (b, c); all have three values.
    """
    random = np.random.default_rng(0)

    def table() -> Probabilities:
        values: Probabilities = random.random((3, 3)) + 0.05
        values /= values.sum(axis=1, keepdims=True)
        return values

    links = {"a": ("f",), "b": ("f", "g"), "c": ("g",)}
    chains = {
        name: _Toy(name, table()[0], table(), {feature: table() for feature in features})
        for name, features in links.items()
    }
    emissions = {name: table() for name in ("f", "g")}

    def likelihood(name: str, frame: Frame) -> Probabilities:
        assert frame.image is not None
        return emissions[name][:, frame.image[0, "fg".index(name)]]

    def node(name: str) -> Categorical:
        return Categorical(name, 3, lambda frame: np.log(likelihood(name, frame)))

    features = {name: node(name) for name in emissions}
    model = MultiChain()
    for name, connected in links.items():
        for feature in connected:
            model.connect(chains[name], features[feature])
    engine, state, error = RecursiveBP(model), RunState(), 0.0
    predictions = {name: chain.prior for name, chain in chains.items()}
    for number in range(1, n_frames + 1):
        frame = Frame(random.integers(0, 3, (1, 2)).astype(np.uint8), number / 25, number)
        if number > 1:
            predictions = {name: chain.predict(state.states[name], 1 / 25) for name, chain in chains.items()}
        joint = np.einsum(
            "a,b,c,af,bf,bg,cg,f,g->abcfg",
            *(predictions[name] for name in "abc"),
            *(chains[name].tables[feature] for name, feature in ("af", "bf", "bg", "cg")),
            likelihood("f", frame), likelihood("g", frame),
        )  # fmt: skip
        state = engine.step(state, frame).state
        for axis, name in enumerate("abc"):
            others = tuple(k for k in range(joint.ndim) if k != axis)
            exact = joint.sum(axis=others) / joint.sum()
            error = max(error, float(np.abs(exact - state.states[name]).max()))
    return error
