"""Incoming messages by kind and node, and what is worked out once in a time slice."""

import numpy as np
import pytest
from rsmcm.inference import Incoming
from rsmcm.models import ObjectBoxes, PixelLabels
from rsmcm.models.core.categorical import Categorical, CategoricalMessage
from rsmcm.models.pixels.pixel_labels import PixelMessage

PIXELS = PixelLabels()
MESSAGE = PixelMessage()


def test_messages_are_found_by_kind_and_by_node() -> None:
    incoming = Incoming({PIXELS: MESSAGE})
    assert incoming[PixelLabels] is incoming[PIXELS] is incoming.get(PixelLabels) is MESSAGE
    assert incoming.get(ObjectBoxes) is None
    assert list(incoming) == [PIXELS]
    assert incoming.node(PixelLabels) is PIXELS
    with pytest.raises(KeyError, match="ObjectBoxes: got 0 such nodes among pixels, expected one"):
        incoming[ObjectBoxes]


def test_nodes_of_one_kind_are_told_by_name() -> None:
    nodes = [Categorical(name, 2) for name in "fg"]
    incoming = Incoming({node: node.uniform() for node in nodes})
    assert incoming[nodes[0]] is not incoming[nodes[1]]
    assert incoming.by_name(Categorical) == {node.name: incoming[node] for node in nodes}
    with pytest.raises(KeyError, match="Categorical: got 2 such nodes among f, g, expected one"):
        incoming[Categorical]


def test_a_message_is_what_the_image_says_times_what_the_others_say() -> None:
    node = Categorical("f", 2)
    image, others = CategoricalMessage([0.0, 1.0]), CategoricalMessage([2.0, 3.0])
    incoming = Incoming({node: others}, evidence={node: image})
    assert incoming.evidence(node) is incoming.evidence(Categorical) is image
    assert incoming.others(Categorical) is others
    np.testing.assert_array_equal(incoming[Categorical].log_weights, [2.0, 4.0])
    np.testing.assert_array_equal(Incoming({node: others}).evidence(node).log_weights, 0)


class Counting:
    def __init__(self) -> None:
        self.calls = 0

    def doubled(self, values: list[int]) -> list[int]:
        self.calls += 1
        return values * 2


def test_the_same_function_of_the_same_objects_is_worked_out_once() -> None:
    incoming, one, other, values = Incoming({}), Counting(), Counting(), [1]
    first = incoming.once(one.doubled, values)
    assert incoming.once(one.doubled, values) is first
    assert one.calls == 1
    assert incoming.once(one.doubled, [1]) is not first  # equal is not the same
    assert incoming.once(other.doubled, values) is not first
    assert (one.calls, other.calls) == (2, 1)
    assert Incoming({}).once(one.doubled, values) is not first  # nor is another time slice
