"""The graph of chains and features: what may be connected, and the order of messages."""

from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.chains import AdaptiveBackground, BlobTracker, MixtureBackground, PointTracker
from rsmcm.inference import MultiChain, Port, RecursiveBP
from rsmcm.inference.engine.graph import IMAGE
from rsmcm.models import ObjectBoxes, PixelLabels, PointTracks

from ...support.discrete import CavityChain, random_model

PAIR = [("a", "f"), ("b", "f")]
LOOP = [("a", "f"), ("b", "f"), ("b", "g"), ("a", "g")]


def random() -> np.random.Generator:
    return np.random.default_rng(0)


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


def test_a_feature_of_another_kind_is_refused() -> None:
    expected = (
        r"got 'points' \(PointTracks\) for 'blobs', expected .* BlobTracker meets: PixelLabels or ObjectBoxes"
    )
    with pytest.raises(TypeError, match=expected):
        MultiChain().connect(BlobTracker(), PointTracks())  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="PointTracker meets: PointTracks"):
        MultiChain().connect(PointTracker(), PixelLabels())  # type: ignore[arg-type]


@pytest.mark.parametrize("ports", [Port(PixelLabels), (PixelLabels,), [Port(PixelLabels)]])
def test_ports_are_a_tuple_of_ports(monkeypatch: pytest.MonkeyPatch, ports: object) -> None:
    monkeypatch.setattr(BlobTracker, "ports", ports)
    with pytest.raises(TypeError, match=r"ports of 'blobs': got .*, expected a tuple of Port"):
        MultiChain().connect(BlobTracker(), PixelLabels())


def test_a_chain_meets_one_feature_of_a_kind_unless_it_says_otherwise() -> None:
    tracker = BlobTracker()
    model = MultiChain().connect(tracker, PixelLabels())
    with pytest.raises(
        ValueError, match="got 'other' for 'blobs', which meets 'pixels' already, expected one"
    ):
        model.connect(tracker, PixelLabels(name="other"))
    assert list(model.features) == ["pixels"]
    random_model(random(), [("a", "f"), ("a", "g")])


def test_one_chain_says_what_only_one_can() -> None:
    pixels, points = PixelLabels(), PointTracks()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(PointTracker(), points)
    second = "got 'mixture' for the background of 'pixels', which 'background' sends already"
    with pytest.raises(ValueError, match=second):
        model.connect(MixtureBackground(name="mixture"), pixels)
    with pytest.raises(ValueError, match="for the appearance of 'points', which 'tracker' sends already"):
        model.connect(PointTracker(name="second"), points)
    model.connect(MixtureBackground(name="mixture"), pixels, feedback=False)  # it only reads


def test_a_chain_gets_what_it_cannot_do_without() -> None:
    model = MultiChain().connect(BlobTracker(), ObjectBoxes())
    expected = "'blobs' is connected to objects, expected a PixelLabels too, which it needs"
    with pytest.raises(ValueError, match=expected):
        RecursiveBP(model)


@given(st.permutations([("a", "f"), ("b", "f"), ("b", "g"), ("c", "g"), ("c", "h")]))
def test_a_model_looks_the_same_however_it_was_connected(links: list[tuple[str, str]]) -> None:
    whole = random_model(random(), sorted(links), {"a": CavityChain})
    model = MultiChain()
    for chain, feature in links:
        model.connect(whole.chains[chain], whole.features[feature], feedback=chain != "c")
    assert list(model.chains) == ["b", "c", "a"]
    assert list(model.features) == ["f", "g", "h"]
    assert model.senders["f"] == ("b", "a")
    assert model.senders["g"] == ("b",)
    assert model.components() == [["f", "g"]]


def test_a_cut_edge_opens_a_loop_unless_information_still_circulates() -> None:
    whole = random_model(random(), LOOP)

    def cut(*edges: tuple[str, str]) -> MultiChain:
        model = MultiChain()
        for chain, feature in LOOP:
            model.connect(
                whole.chains[chain], whole.features[feature], feedback=(chain, feature) not in edges
            )
        return model

    assert cut().has_loops
    assert cut(("a", "f")).has_loops
    assert not cut(("a", "f"), ("b", "f")).has_loops


def test_the_image_speaks_after_quick_chains_and_before_those_that_use_their_cavity() -> None:
    model = random_model(
        random(),
        [("slow", "f"), ("quick", "f"), ("later", "f")],
        dict.fromkeys(["slow", "later"], CavityChain),
    )
    assert model.schedule() == [(("quick", "f"),), ((IMAGE, "f"),), (("later", "f"),), (("slow", "f"),)]


@given(st.integers(1, 8), st.integers(1, 8), st.data())
def test_messages_follow_from_those_before_them_or_of_their_loop(
    n_chains: int, n_features: int, data: st.DataObject
) -> None:
    pairs = [(f"c{i}", f"f{j}") for i in range(n_chains) for j in range(n_features)]
    links = data.draw(st.lists(st.sampled_from(pairs), min_size=1, max_size=12, unique=True))
    cavity = data.draw(st.sets(st.sampled_from(sorted({chain for chain, _ in links}))))
    model = random_model(random(), links, dict.fromkeys(cavity, CavityChain))
    schedule = model.schedule()
    position = {step: number for number, group in enumerate(schedule) for step in group}
    assert sorted(step for group in schedule for step in group) == sorted(
        [*links, *((IMAGE, feature) for feature in model.features)]
    )
    assert model.has_loops == (not nx.is_forest(nx.Graph(links))) == any(len(group) > 1 for group in schedule)
    for chain, feature in links:
        for other in set(model.features_of[chain]) - {feature}:
            for sender in {IMAGE, *model.senders[other]} - {chain}:
                first, then = position[sender, other], position[chain, feature]
                assert first < then or (first == then and len(schedule[first]) > 1)


@pytest.mark.parametrize("suffix", [".svg", ".png"])
def test_a_graph_is_drawn(tmp_path: Path, suffix: str) -> None:
    model = random_model(random(), PAIR)
    model.draw(tmp_path / f"graph{suffix}")
    assert (tmp_path / f"graph{suffix}").read_bytes().startswith(b"<?xml" if suffix == ".svg" else b"\x89PNG")
    assert ElementTree.fromstring(model._repr_svg_()).tag.endswith("svg")
    with pytest.raises(ValueError, match=r"graph.txt.*\.svg or \.png"):
        model.draw(tmp_path / "graph.txt")
