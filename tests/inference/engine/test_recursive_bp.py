"""Recursive belief propagation against the sum over all states of small graphs."""

import gc
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.chains import DiscreteChain
from rsmcm.inference import Belief, Cavity, Incoming, MultiChain, Port, RecursiveBP, RunState
from rsmcm.models import (
    BodyParts,
    GaussianMessage,
    GaussianMixtures,
    Layer,
    LayerStack,
    PartMessage,
    PixelLabels,
    PixelMessage,
    PointMessage,
    PointTracks,
)
from rsmcm.models.core.categorical import Categorical, CategoricalMessage
from rsmcm.models.core.frame import Frame
from scipy.special import logsumexp

from ...support.discrete import CavityChain, enumerate_slice, image, random_model

GRAPHS = {
    "one chain": [("a", "f")],
    "two chains": [("a", "f"), ("b", "f")],
    "two features": [("a", "f"), ("a", "g"), ("b", "g")],
    "three chains": [("a", "f"), ("b", "f"), ("b", "g"), ("c", "g")],
    "three at one": [("a", "f"), ("b", "f"), ("c", "f"), ("c", "g")],
    "two components": [("a", "f"), ("b", "g"), ("c", "g")],
}
FRAMES = [image(0, 3), image(4, 1), None, image(2, 2), image(0, 0)]
EXACT = 1e-12  # a few hundred roundings of numbers between 0 and 1


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def log_evidences(beliefs: Sequence[Belief]) -> list[float]:
    return [belief.log_evidence for belief in beliefs]


@pytest.mark.parametrize("cavity", ["", "a", "b", "abc"])
@pytest.mark.parametrize("links", GRAPHS.values(), ids=GRAPHS)
def test_every_frame_equals_enumeration(links: list[tuple[str, str]], cavity: str) -> None:
    for seed in range(3):
        model = random_model(rng(seed), links, dict.fromkeys(cavity, CavityChain))
        predictions = {name: chain.initial_probabilities for name, chain in model.chains.items()}
        for belief in RecursiveBP(model).run(FRAMES):
            posteriors, features, log_evidence = enumerate_slice(model, predictions, belief.frame)
            for name, expected in posteriors.items():
                np.testing.assert_allclose(belief[name].probabilities, expected, rtol=0, atol=EXACT)
            for name, expected in features.items():
                np.testing.assert_allclose(belief[name].probabilities(), expected, rtol=0, atol=EXACT)
            assert belief.log_evidence == pytest.approx(log_evidence, rel=0, abs=EXACT)
            predictions = {n: belief[n].probabilities @ c.transition for n, c in model.chains.items()}


@st.composite
def trees(draw: st.DrawFn) -> list[tuple[str, str]]:
    """Links of random trees of chains a, b, ... and features f, g, ..., in any order."""
    chains, features = ["a"], ["f"]
    links = [("a", "f")]
    for _ in range(draw(st.integers(0, 4))):
        if draw(st.booleans()):
            chains.append("abcdef"[len(chains)])
            links.append((chains[-1], draw(st.sampled_from(features))))
        else:
            features.append("fghijk"[len(features)])
            links.append((draw(st.sampled_from(chains)), features[-1]))
    return list(draw(st.permutations(links)))


@given(trees(), st.sets(st.sampled_from("abcdef")))
def test_order_of_connection_changes_no_byte(links: list[tuple[str, str]], cavity: set[str]) -> None:
    whole = random_model(rng(), sorted(links), dict.fromkeys(cavity, CavityChain))
    frames = [None if picture is None else image(*range(5), 0) for picture in FRAMES]

    def run(order: Sequence[tuple[str, str]]) -> list[Belief]:
        model = MultiChain()
        for chain, feature in order:
            model.connect(whole.chains[chain], whole.features[feature])
        return list(RecursiveBP(model).run(frames))

    for one, other in zip(run(links), run(sorted(links)), strict=True):
        assert list(one.states) == list(other.states)
        for name in one.states:
            np.testing.assert_array_equal(one[name].probabilities, other[name].probabilities)
        for name in whole.features:
            np.testing.assert_array_equal(one[name].log_weights, other[name].log_weights)
        assert one.log_evidence == other.log_evidence


def cut(
    links: Sequence[tuple[str, str]],
    *edges: tuple[str, str],
    seed: int = 0,
    kinds: dict[str, type] | None = None,
) -> MultiChain:
    whole = random_model(rng(seed), links, kinds)
    model = MultiChain()
    for chain, feature in links:
        model.connect(whole.chains[chain], whole.features[feature], feedback=(chain, feature) not in edges)
    return model


def test_feed_forward_equals_the_stand_alone_modules_bit_for_bit() -> None:
    model = cut([("a", "f"), ("b", "f")], ("b", "f"))
    chains, feature = model.chains, model.features["f"]
    alone = list(RecursiveBP(MultiChain().connect(chains["a"], feature)).run(FRAMES))
    state: Any = None
    for low, both in zip(alone, RecursiveBP(model).run(FRAMES), strict=True):
        np.testing.assert_array_equal(low["a"].probabilities, both["a"].probabilities)
        np.testing.assert_array_equal(low["f"].log_weights, both["f"].log_weights)
        assert low.log_evidence == both.log_evidence
        state = chains["b"].initial(low.frame) if state is None else chains["b"].predict(state, 0.04)
        state = chains["b"].update(state, Incoming({feature: low[feature]}))
        np.testing.assert_array_equal(state.probabilities, both["b"].probabilities)


CUTS: dict[str, tuple[list[tuple[str, str]], list[tuple[str, str]]]] = {
    "no cut": (GRAPHS["two features"], []),
    "one reads": ([("a", "f"), ("b", "f")], [("b", "f")]),
    "a pipeline": (GRAPHS["three chains"], [("b", "f")]),
    "two readers": ([("a", "f"), ("b", "f"), ("c", "f"), ("b", "g"), ("c", "g")], [("b", "f"), ("c", "f")]),
    "three in a row": (
        [("a", "e"), ("b", "e"), ("b", "f"), ("c", "f"), ("c", "g")],
        [("b", "e"), ("c", "f")],
    ),
}


@pytest.mark.parametrize(
    ("links", "edges"),
    [*((links, []) for links in GRAPHS.values()), *CUTS.values()],
    ids=[*GRAPHS, *CUTS],
)
@pytest.mark.parametrize("cavity", ["", "ab"])
def test_evidence_of_all_images_is_one(
    links: list[tuple[str, str]], edges: list[tuple[str, str]], cavity: str
) -> None:
    model = cut(links, *edges, kinds=dict.fromkeys(cavity, CavityChain))
    engine = RecursiveBP(model)
    state = engine.step(RunState(), Frame(image(1, 3, 2), 0.0, 1)).state
    images = product(range(5), repeat=len(model.features))
    evidence = [
        engine.step(state, Frame(image(*values, *(0,) * (3 - len(values))), 0.04, 2)).log_evidence
        for values in images
    ]
    assert logsumexp(evidence) == pytest.approx(0, rel=0, abs=EXACT)


def test_evidence_behind_a_cut_edge_is_counted_once() -> None:
    # b reads f and speaks to g: the second component is p(I_g | I_f), seen through b's posterior given f.
    model = cut([("a", "f"), ("b", "f"), ("b", "g"), ("c", "g")], ("b", "f"))
    chains, features = model.chains, model.features
    frame = Frame(image(3, 1), 0.0, 1)
    belief = RecursiveBP(model).step(RunState(), frame)

    low = RecursiveBP(MultiChain().connect(chains["a"], features["f"])).step(RunState(), frame)
    read = chains["b"].emission["f"] @ np.exp(low["f"].log_weights) * chains["b"].initial_probabilities
    given_f = DiscreteChain(
        np.eye(len(read)), initial_probabilities=read / read.sum(), emission=chains["b"].emission, name="b"
    )
    high = MultiChain().connect(given_f, features["g"]).connect(chains["c"], features["g"])
    expected = low.log_evidence + RecursiveBP(high).step(RunState(), frame).log_evidence
    assert belief.log_evidence == pytest.approx(expected, rel=0, abs=EXACT)


def test_a_feature_that_is_only_read_has_no_evidence() -> None:
    model = cut([("a", "f")], ("a", "f"))
    assert log_evidences(list(RecursiveBP(model).run(FRAMES))) == [0.0] * len(FRAMES)


@pytest.mark.parametrize("cavity", Cavity)
@pytest.mark.parametrize("missing", [False, True])
def test_parts_of_a_message_are_the_image_and_the_other_chains(cavity: Cavity, missing: bool) -> None:
    parts: dict[str, list[tuple[CategoricalMessage, CategoricalMessage, CategoricalMessage]]] = {}

    class Parted(DiscreteChain):
        ports = (Port(Categorical, cavity, many=True),)

        def message(self, state: Any, feature: Categorical, incoming: Incoming) -> CategoricalMessage:
            self.note("message", feature, incoming)
            return super().message(state, feature, incoming)

        def update(self, state: Any, incoming: Incoming) -> Any:
            self.note("update", f, incoming)
            return super().update(state, incoming)

        def note(self, what: str, feature: Categorical, incoming: Incoming) -> None:
            of_feature = incoming.evidence(feature), incoming.others(feature), incoming[feature]
            parts.setdefault(what, []).append(of_feature)

    model = random_model(rng(), [("a", "f"), ("b", "f"), ("c", "f")], {"b": Parted})
    f = model.features["f"]
    frame = Frame(None if missing else image(1), 0.0, 2)
    engine = RecursiveBP(model)
    belief = engine.step(engine.step(RunState(), Frame(image(0), -1.0, 1)).state, frame)
    belief["f"].probabilities()
    evidence = belief.evidence(f).log_weights
    said = [belief.message(name, f).log_weights for name in "ac"]
    for what, wanted in (("message", cavity), ("update", Cavity.OTHERS)):
        seen, others, together = (each.log_weights for each in parts[what][-1])
        np.testing.assert_array_equal(seen, evidence if wanted >= Cavity.IMAGE else 0)
        np.testing.assert_array_equal(others, sum(said) if wanted == Cavity.OTHERS else 0)
        np.testing.assert_allclose(together, seen + others, rtol=0, atol=EXACT)
    same_product = parts["message"][-1][2] is parts["update"][-1][2]
    assert same_product or cavity < Cavity.OTHERS


@dataclass(frozen=True)
class Looking(Categorical):
    """Evidence that notes where it was told to look."""

    asked: list[CategoricalMessage] | None = None

    searches = True

    def evidence(self, frame: Frame, prior: CategoricalMessage) -> CategoricalMessage:
        assert self.asked is not None
        self.asked.append(prior)
        return super().evidence(frame, prior)


def test_evidence_is_asked_once_a_frame_with_what_all_chains_predict() -> None:
    tables = random_model(rng(), [("a", "f"), ("b", "f"), ("c", "f")], {"b": CavityChain})
    node = tables.features["f"]
    looking = Looking("f", node.size, node.log_likelihood, [])
    model = MultiChain()
    for name in "bac":
        model.connect(tables.chains[name], looking)
    list(RecursiveBP(model).run(FRAMES[:3]))
    assert looking.asked is not None
    assert len(looking.asked) == 2  # the third frame is missing
    expected = [
        np.log(tables.chains[name].initial_probabilities @ tables.chains[name].emission["f"])
        for name in "acb"
    ]
    np.testing.assert_allclose(looking.asked[0].log_weights, sum(expected), rtol=0, atol=EXACT)


@pytest.mark.parametrize("message", [None, 3.0])
def test_a_message_that_is_none_of_its_feature_is_refused(message: object) -> None:
    class Mute(DiscreteChain):
        def message(self, state: Any, feature: Categorical, incoming: Incoming) -> Any:
            return message

    model = random_model(rng(), [("a", "f"), ("b", "f")], {"b": Mute})
    expected = f"from 'b' to 'f': got {type(message).__name__}, expected CategoricalMessage"
    with pytest.raises(TypeError, match=expected):
        list(RecursiveBP(model).run(FRAMES))


def nan_mask() -> PixelMessage:
    return PixelMessage(layers=LayerStack([Layer(0, 0, np.full((2, 2), np.nan, np.float32), None)]))


def points_at(mean: float, variance: float) -> PointMessage:
    return PointMessage(GaussianMessage.from_moments([1], [[mean, 0.0]], variance * np.eye(2)[None]))


def parts_at(mean: float, log_weight: float) -> PartMessage:
    means, covariances = np.full((3, 1, 2), mean), np.tile(np.eye(2), (3, 1, 1, 1))
    return PartMessage(GaussianMixtures.of_parts(np.full((3, 1), log_weight), means, covariances))


@pytest.mark.parametrize(
    ("feature", "say", "expected"),
    [
        (PixelLabels(), nan_mask, "to 'pixels': mask: got NaN or infinity, expected finite numbers"),
        (PointTracks(), lambda: points_at(np.nan, 1.0), "to 'points': vector: got NaN or infinity, "),
        (PointTracks(), lambda: points_at(np.inf, 1.0), "to 'points': vector: got NaN or infinity, "),
        (PointTracks(), lambda: points_at(0.0, np.nan), "to 'points': .*: got .*, expected "),
        (BodyParts(40.0), lambda: parts_at(np.nan, 0.0), "to 'parts': part message: got NaN or infinity, "),
        (BodyParts(40.0), lambda: parts_at(9.0, np.nan), "to 'parts': part message: got NaN or infinity, "),
    ],
)  # fmt: skip
def test_numbers_that_are_not_finite_are_refused_with_the_chain_and_the_feature(
    feature: Any, say: Any, expected: str
) -> None:
    class Door(DiscreteChain):
        def message(self, *_: Any) -> Any:
            return say()

    door, reader = (Door(np.eye(1), features=type(feature), name=name) for name in ("door", "reader"))
    model = MultiChain().connect(door, feature).connect(reader, feature, feedback=False)
    with pytest.raises(ValueError, match=f"^message from 'door' {expected}"):
        RecursiveBP(model).step(RunState(), Frame(image(1), 0.0, 1))


def test_evidence_that_is_no_number_is_refused_with_the_chain_and_the_feature() -> None:
    class Door(DiscreteChain):
        def message(self, *_: Any) -> PixelMessage:
            scene: Any = SimpleNamespace(size=(1, 1), prior=0.5, log_likelihood=lambda *_: np.nan)
            return PixelMessage(scene)

        def update(self, state: Any, incoming: Incoming) -> Any:
            return state

    model = MultiChain().connect(Door(np.eye(1), features=PixelLabels, name="door"), PixelLabels())
    with pytest.raises(ValueError, match="log evidence at 'pixels': got NaN from door, expected a number"):
        _ = RecursiveBP(model).step(RunState(), Frame(image(1), 0.0, 1)).log_evidence


def test_a_time_slice_is_gone_when_nobody_needs_it() -> None:
    engine = RecursiveBP(random_model(rng(), GRAPHS["three chains"]))
    frame = Frame(image(1, 2), 0.0, 1)
    belief = engine.step(RunState(), frame)
    message = weakref.ref(belief["f"])
    assert np.isfinite(belief.log_evidence)
    gc.disable()
    del belief
    try:
        assert message() is None
    finally:
        gc.enable()


def test_leading_missing_frames_believe_nothing() -> None:
    model = random_model(rng(), GRAPHS["two chains"])
    late = list(RecursiveBP(model).run([None, None, *FRAMES]))
    for belief in late[:2]:
        assert belief.states == {}
        assert belief.log_evidence == 0
        with pytest.raises(KeyError, match="before the first frame"):
            belief["a"]
    usual = list(RecursiveBP(model).run(FRAMES))
    assert log_evidences(late[2:]) == log_evidences(usual)
    assert [belief.frame.number for belief in late] == list(range(1, 8))


def test_a_run_goes_on_from_any_state_and_leaves_it_as_it_was() -> None:
    model = random_model(rng(), GRAPHS["three chains"])
    engine = RecursiveBP(model)
    whole = list(engine.run(FRAMES))
    for start in range(1, len(FRAMES)):
        rest = list(engine.run(FRAMES[start:], state=whole[start - 1].state))
        assert log_evidences(rest) == log_evidences(whole[start:])
        assert [belief.state.time for belief in rest] == [belief.state.time for belief in whole[start:]]


def test_a_belief_is_asked_by_object_or_name() -> None:
    model = random_model(rng(), GRAPHS["two chains"])
    belief = RecursiveBP(model).step(RunState(), Frame(image(1), 0.0, 1))
    assert belief[model.chains["a"]] is belief["a"] is belief.states["a"]
    assert belief[model.features["f"]] is belief["f"]
    with pytest.raises(KeyError, match="blobs: not part of the model, expected one of a, b, f"):
        belief["blobs"]


def test_what_was_said_in_a_frame_can_be_asked_for() -> None:
    model = cut([("a", "f"), ("b", "f"), ("b", "g")], ("b", "g"))
    f, g = model.features["f"], model.features["g"]
    beliefs = list(RecursiveBP(model).run(FRAMES))
    for belief in beliefs:
        said = belief.message("a", f) * belief.message(model.chains["b"], f) * belief.evidence(f)
        np.testing.assert_allclose(said.probabilities(), belief[f].probabilities(), rtol=0, atol=EXACT)
    np.testing.assert_array_equal(beliefs[2].evidence(f).log_weights, f.uniform().log_weights)
    with pytest.raises(KeyError, match="'b' sends nothing to 'g'"):
        beliefs[0].message("b", g)
    with pytest.raises(KeyError, match="before the first frame"):
        RecursiveBP(model).step(RunState(), Frame(None, 0.0, 1)).message("a", f)


def test_bad_frames_are_refused_with_their_number() -> None:
    engine = RecursiveBP(random_model(rng(), GRAPHS["one chain"]))
    state = engine.step(RunState(), Frame(image(1, 2), 1.0, 7)).state
    with pytest.raises(ValueError, match=r"got \(1, 3\) uint8 at frame 8, expected \(1, 2\) uint8"):
        engine.step(state, Frame(image(1, 2, 3), 2.0, 8))
    with pytest.raises(ValueError, match=r"got \(1, 2, 3\) uint8 at frame 8"):
        engine.step(state, Frame(np.zeros((1, 2, 3), np.uint8), 2.0, 8))
    with pytest.raises(TypeError, match=r"float64 of shape \(1, 2\), .* at frame 8"):
        list(engine.run([np.zeros((1, 2))], state=state))  # type: ignore[list-item]
    for time in (1.0, 0.5):
        with pytest.raises(ValueError, match=r"at frame 8, expected later than 1.0 s at frame 7"):
            engine.step(state, Frame(image(1, 2), time, 8))


def test_states_of_other_chains_are_refused() -> None:
    state = RecursiveBP(random_model(rng(), [("z", "f")])).step(RunState(), Frame(image(1), 0.0, 1)).state
    with pytest.raises(ValueError, match="got chains z, expected a"):
        RecursiveBP(random_model(rng(), [("a", "f")])).step(state, Frame(image(1), 1.0, 2))


def test_impossible_values_and_wrong_likelihoods_are_named() -> None:
    with pytest.raises(ValueError, match="weight 0 for every value"):
        CategoricalMessage([-np.inf, -np.inf]).probabilities()
    with pytest.raises(ValueError, match=r"log_likelihood of 'door': got \(3,\) at frame 1, expected \(2,\)"):
        Categorical("door", 2, lambda frame: np.zeros(3)).evidence(
            Frame(image(1), 0.0, 1), Categorical("door", 2).uniform()
        )


@pytest.mark.parametrize(("method", "steps"), [("update", 1), ("predict", 2)])
def test_a_forgotten_return_is_said_in_words(
    monkeypatch: pytest.MonkeyPatch, method: str, steps: int
) -> None:
    model = random_model(rng(), GRAPHS["one chain"])
    monkeypatch.setattr(DiscreteChain, method, lambda *_: None)
    with pytest.raises(TypeError, match=f"chain 'a': {method} gave None, expected a state"):
        list(RecursiveBP(model).run(FRAMES[:steps]))
