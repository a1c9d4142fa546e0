"""Identities that become one, and what is known of points by identity."""

import networkx as nx
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.points.point_tracker import (
    PointTable,
    find_coincident_tracks,
    find_duplicates,
    merge_duplicates,
    merge_groups,
)
from rsmcm.chains.points.trajectory import Appearances, PointTrajectory
from rsmcm.inference.kalman import PointStates
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.points.point_tracks import PointMessage

PIXELS = np.random.default_rng(0).uniform(0, 255, (6, 5, 5)).astype(np.float32)

pairs = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=12)


def at(identities: list[int], positions: list[list[float]], same_as: list[int] | None = None) -> PointMessage:
    covariances = np.tile(np.eye(2), (len(identities), 1, 1))
    message = GaussianMessage.from_moments(identities, np.array(positions, float).reshape(-1, 2), covariances)
    return PointMessage(message, same_as=None if same_as is None else np.array(same_as))


def trajectory(first: NDArray[np.float32], last: NDArray[np.float32]) -> PointTrajectory:
    n = len(first)
    nothing = np.zeros((1, n), np.bool_)
    flat, square = np.zeros((1, n, 2)), np.zeros((1, n, 2, 2))
    appearances = Appearances(np.arange(n), first, last)
    return PointTrajectory(
        np.arange(n), flat, square, nothing, nothing, square, flat, appearances, np.array([[5, 3]]), 0.0
    )


@given(pairs, pairs)
def test_groups_are_those_of_a_graph_and_named_by_their_smallest(
    one: list[tuple[int, int]], other: list[tuple[int, int]]
) -> None:
    graph = nx.Graph()
    graph.add_nodes_from(range(10))
    graph.add_edges_from([*one, *other])
    expected = {
        node: min(part) for part in nx.connected_components(graph) for node in part if node != min(part)
    }
    assert merge_groups(merge_groups({}, one), other) == expected


def test_what_is_said_of_one_point_counts_once() -> None:
    message = at([1, 4, 6], [[0, 0], [5, 5], [9, 9]])
    same = merge_duplicates(message, {6: 4, 1: 0}).positions
    np.testing.assert_array_equal(same.identities, [0, 4])
    np.testing.assert_allclose(same.moments[1], [[0, 0], [5, 5]])
    assert merge_duplicates(message, {}) is message


def test_points_that_others_take_for_one_have_to_look_alike() -> None:
    first = PIXELS.copy()
    last = PIXELS[::-1].copy()
    first[2] = 0.5 * last[0] + 30  # found again as it was lost, in another light
    others = [at([0, 1, 2, 4], [[0, 0]] * 4, [0, 0, 0, 4]), at([0], [[0, 0]])]
    assert find_duplicates(trajectory(first, last), others) == {2: 0, 5: 3}  # what was one before stays so


def test_one_spot_again_and_again_is_one_point() -> None:
    near, far = at([3, 7, 8], [[10, 10], [11, 10], [30, 30]]), at([3, 7, 8], [[10, 10], [20, 10], [30, 30]])
    assert find_coincident_tracks([near] * 5 + [far] * 3, 1.5) == [(3, 7)]
    assert find_coincident_tracks([near] * 4 + [far] * 3, 1.5) == []


def known(identities: list[int], alive: list[bool], unseen: list[float]) -> PointTable:
    n = len(identities)
    states = PointStates.at_rest(np.arange(2.0 * n).reshape(n, 2), 1.0, 1.0)
    return PointTable(
        np.array(identities), states.mean, states.covariance, np.array(alive), np.array(unseen), PIXELS[:n],
        PIXELS[:n],
    )  # fmt: skip


def test_points_are_joined_in_order() -> None:
    both = known([2, 9], [True, False], [0.0, 1.0]).merged(known([1, 5], [True, True], [0.0, 0.2]))
    np.testing.assert_array_equal(both.identities, [1, 2, 5, 9])
    np.testing.assert_array_equal(both.alive, [True, True, True, False])
    np.testing.assert_array_equal(both.states.mean[:, 0], [0, 0, 2, 2])
    np.testing.assert_array_equal(both.patches, PIXELS[[0, 0, 1, 1]])


def test_of_the_lost_the_last_are_remembered() -> None:
    points = known([1, 2, 3, 4, 5], [True, False, False, False, True], [9.0, 1.0, 3.0, 1.0, 0.0])
    np.testing.assert_array_equal(points.without_oldest(1).identities, [1, 4, 5])
    np.testing.assert_array_equal(points.without_oldest(2).identities, [1, 2, 4, 5])
    assert points.without_oldest(3) is points
