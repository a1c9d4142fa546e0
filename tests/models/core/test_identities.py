"""Tables by identity against dictionaries."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.core.identities import Turnover, common, find, places_of, union

SETS = st.sets(st.integers(-20, 20), max_size=12)
Numbers = NDArray[np.int64]


def table(numbers: set[int]) -> Numbers:
    return np.array(sorted(numbers), np.int64)


@given(SETS, st.lists(st.integers(-25, 25), max_size=9))
@settings(max_examples=20)
def test_rows_are_those_of_a_dictionary(numbers: set[int], wanted: list[int]) -> None:
    row = {number: k for k, number in enumerate(sorted(numbers))}
    place, is_there = find(table(numbers), wanted)
    assert is_there.tolist() == [each in row for each in wanted]
    assert place[is_there].tolist() == [row[each] for each in wanted if each in row]
    if all(each in row for each in wanted):
        assert places_of(table(numbers), wanted).tolist() == [row[each] for each in wanted]
    else:
        missing = next(each for each in wanted if each not in row)
        with pytest.raises(KeyError, match=f"{missing}: not in the table of {len(numbers)}"):
            places_of(table(numbers), wanted)


@given(SETS, SETS)
@settings(max_examples=20)
def test_unions_and_intersections_name_their_rows(one: set[int], other: set[int]) -> None:
    both, here, there = union(table(one), table(other))
    assert both.tolist() == sorted(one | other)
    assert (both[here].tolist(), both[there].tolist()) == (sorted(one), sorted(other))
    both, here, there = common(table(one), table(other))
    assert both.tolist() == sorted(one & other)
    np.testing.assert_array_equal(table(one)[here], both)
    np.testing.assert_array_equal(table(other)[there], both)


@given(SETS, SETS, SETS)
@settings(max_examples=20)
def test_a_turnover_drops_adds_and_keeps_order(before: set[int], ended: set[int], new: set[int]) -> None:
    identities = table(before)
    kept = ~np.isin(identities, table(ended))
    begun = np.array(list(new - (before - ended)), np.int64)
    turnover = Turnover.between(identities, kept, begun)
    after = sorted((before - ended) | new)
    assert turnover.identities.tolist() == after
    rows = turnover.rows(np.stack([identities, 10 * identities], axis=1), np.stack([begun, -begun], axis=1))
    assert rows.tolist() == [[k, -k if k in begun else 10 * k] for k in after]
    assert turnover.rows(identities.astype(float), 0.5).tolist() == [0.5 if k in begun else k for k in after]
    if before - ended:
        with pytest.raises(ValueError, match="twice"):
            Turnover.between(identities, kept, [min(before - ended)])
