"""Random models of discrete chains, exact in every message, and the sum over all states as an oracle."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from rsmcm.chains import DiscreteChain
from rsmcm.inference import Cavity, MultiChain, Port
from rsmcm.models.core.categorical import Categorical
from rsmcm.models.core.frame import Frame

Table = NDArray[np.float64]


class CavityChain(DiscreteChain):
    """Listens before it speaks, as projected mixtures do; what it says is the same."""

    ports = (Port(Categorical, Cavity.OTHERS, many=True),)


def random_table(random: np.random.Generator, *shape: int, power: float = 1.0) -> Table:
    """Rows of random probabilities; the larger `power`, the nearer to certain."""
    table = random.random(shape) ** power + 0.01
    return table / table.sum(axis=-1, keepdims=True)


def image(*values: int) -> NDArray[np.uint8]:
    return np.array([values], np.uint8)


def random_model(
    random: np.random.Generator,
    links: Sequence[tuple[str, str]],
    kinds: Mapping[str, type] | None = None,
    power: float = 1.0,
) -> MultiChain:
    """Random chains and features of sizes 2 to 4; pixel k of a frame is what feature k shows (0 to 4)."""
    chain_names = sorted({chain for chain, _ in links})
    feature_names = sorted({feature for _, feature in links})
    features = {}
    for position, name in enumerate(feature_names):
        size = int(random.integers(2, 5))
        emission = random_table(random, size, 5, power=power)

        def log_likelihood(frame: Frame, emission: Table = emission, position: int = position) -> Table:
            assert frame.image is not None
            return np.log(emission[:, frame.image[0, position]])

        features[name] = Categorical(name, size, log_likelihood)
    chains = {}
    for name in chain_names:
        n_states = int(random.integers(2, 5))
        tables = {
            f: random_table(random, n_states, features[f].size, power=power) for c, f in links if c == name
        }
        kind = (kinds or {}).get(name, DiscreteChain)
        prior, transition = random_table(random, n_states), random_table(random, n_states, n_states)
        chains[name] = kind(transition, initial_probabilities=prior, emission=tables, many=True, name=name)
    model = MultiChain()
    for chain, feature in links:
        model.connect(chains[chain], features[feature])
    return model


def enumerate_slice(
    model: MultiChain, predictions: Mapping[str, Table], frame: Frame
) -> tuple[dict[str, Table], dict[str, Table], float]:
    """Sum over all joint values: the chains' posteriors, the features' beliefs, log p(frame | past)."""
    chains, features = model.chains, model.features
    names = [*chains, *features]
    sizes = [len(predictions[name]) for name in chains] + [feature.size for feature in features.values()]
    likelihoods = {
        name: np.ones(feature.size) if frame.image is None else np.exp(feature.log_likelihood(frame))
        for name, feature in features.items()
    }
    marginals = {name: np.zeros(size) for name, size in zip(names, sizes, strict=True)}
    before, total = 0.0, 0.0
    for values in product(*map(range, sizes)):
        at = dict(zip(names, values, strict=True))
        weight = 1.0
        for name, chain in chains.items():
            weight *= predictions[name][at[name]]
            for feature in model.features_of[name]:
                weight *= chain.emission[feature][at[name], at[feature]]
        before += weight
        for name, likelihood in likelihoods.items():
            weight *= likelihood[at[name]]
        total += weight
        for name in names:
            marginals[name][at[name]] += weight
    posterior = {name: marginals[name] / total for name in names}
    return (
        {c: posterior[c] for c in chains},
        {f: posterior[f] for f in features},
        float(np.log(total / before)),
    )
