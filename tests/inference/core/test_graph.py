"""The graph of chains and features: what may be connected, and the order of messages."""

from itertools import pairwise
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.inference import MultiChain
from rsmcm.inference.core.graph import IMAGE

from ...support.discrete import CavityChain, random_model

PAIR = [("a", "f"), ("b", "f")]
LOOP = [("a", "f"), ("b", "f"), ("b", "g"), ("a", "g")]


def random() -> np.random.Generator:
    return np.random.default_rng(0)


def test_connections_are_edges_of_a_networkx_graph() -> None:
    model = random_model(random(), PAIR)
    assert set(map(frozenset, model.graph.edges)) == {frozenset(edge) for edge in [*PAIR, (IMAGE, "f")]}
    assert list(model.chains) == ["a", "b"]
    assert list(model.features) == ["f"]
    model.check()


def test_a_pair_is_connected_once() -> None:
    model = random_model(random(), PAIR)
    with pytest.raises(ValueError, match="'a' and 'f' are connected already"):
        model.connect(model.chains["a"], model.features["f"])


@pytest.mark.parametrize("name", ["a", "f"])
def test_a_name_is_used_once(name: str) -> None:
    model = random_model(random(), PAIR)
    other = random_model(random(), [(name, "h")])
    with pytest.raises(ValueError, match=f"'{name}' is taken"):
        model.connect(other.chains[name], model.features["f"])


def test_the_name_of_the_image_is_reserved() -> None:
    with pytest.raises(ValueError, match="'image' is taken"):
        random_model(random(), [(IMAGE, "f")])


def test_the_two_ends_have_different_names() -> None:
    first, second = random_model(random(), [("a", "f")]), random_model(random(), [("f", "g")])
    model = MultiChain()
    with pytest.raises(ValueError, match="'f' is taken"):
        model.connect(second.chains["f"], first.features["f"])
    assert list(model.graph) == [IMAGE]


def test_other_objects_are_refused() -> None:
    model = random_model(random(), PAIR)
    lacks = (
        r"a Chain \(it lacks name, .*, update\) or a BatchChain \(it lacks name, ports, smooth, messages\)$"
    )
    with pytest.raises(TypeError, match=f"^chain: got int, expected {lacks}"):
        model.connect(3, model.features["f"])  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"feature: got str, expected a FeatureNode \(it lacks name, "):
        model.connect(model.chains["a"], "f")  # type: ignore[arg-type]
    feature = SimpleNamespace(name="g", searches=False, evidence=None)
    with pytest.raises(TypeError, match=r"feature: got SimpleNamespace, .* \(it lacks uniform\)$"):
        model.connect(model.chains["a"], feature)  # type: ignore[arg-type]


def test_a_loop_is_named_with_its_remedy() -> None:
    model = random_model(random(), [("c", "g"), *LOOP])
    with pytest.raises(ValueError, match="merge the feature nodes") as error:
        model.check()
    names = str(error.value).split("loop ")[1].split(",")[0].split(" - ")
    assert names[0] == names[-1]
    assert len(names) == 5
    assert set(names) == {"a", "b", "f", "g"}
    assert all(model.graph.has_edge(*pair) for pair in pairwise(names))


def test_a_cut_edge_opens_a_loop_unless_information_still_circulates() -> None:
    whole = random_model(random(), LOOP)

    def cut(*edges: tuple[str, str]) -> MultiChain:
        model = MultiChain()
        for chain, feature in LOOP:
            model.connect(
                whole.chains[chain], whole.features[feature], feedback=(chain, feature) not in edges
            )
        return model

    cut(("a", "f"), ("b", "f")).check()
    with pytest.raises(ValueError, match="loop"):
        cut(("a", "f")).check()


def test_the_image_speaks_after_quick_chains_and_before_those_that_use_their_cavity() -> None:
    model = random_model(
        random(),
        [("slow", "f"), ("quick", "f"), ("later", "f")],
        dict.fromkeys(["slow", "later"], CavityChain),
    )
    assert model.schedule() == [("quick", "f"), (IMAGE, "f"), ("later", "f"), ("slow", "f")]


@given(st.integers(1, 8), st.integers(1, 8), st.data())
def test_every_forest_has_a_schedule_and_every_loop_is_found(
    n_chains: int, n_features: int, data: st.DataObject
) -> None:
    pairs = [(f"c{i}", f"f{j}") for i in range(n_chains) for j in range(n_features)]
    links = data.draw(st.lists(st.sampled_from(pairs), min_size=1, max_size=12, unique=True))
    cavity = data.draw(st.sets(st.sampled_from(sorted({chain for chain, _ in links}))))
    model = random_model(random(), links, dict.fromkeys(cavity, CavityChain))
    if not nx.is_forest(nx.Graph(links)):
        with pytest.raises(ValueError, match="loop"):
            model.schedule()
        return
    schedule = model.schedule()
    assert sorted(schedule) == sorted([*links, *((IMAGE, feature) for feature in model.features)])
    position = {step: number for number, step in enumerate(schedule)}
    for chain, feature in links:
        for other in set(model.features_of(chain)) - {feature}:
            for sender in {IMAGE, *model.senders(other)} - {chain}:
                assert position[sender, other] < position[chain, feature]
