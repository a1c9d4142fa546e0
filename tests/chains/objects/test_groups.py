"""One, two, or a part of one: what the size of anybody at a place says of blobs."""

import math

import numpy as np
import pytest
from rsmcm.chains.objects.blob_records import MARGIN
from rsmcm.chains.objects.blobs import Blob, Blobs, BlobState
from rsmcm.chains.objects.groups import (
    fragment_times,
    group_parts,
    merge_pieces,
    pair_evidence,
    select_whole,
    split_mask,
    thinnest_column,
)
from rsmcm.models.objects.box_message import Newcomers

F4 = np.float32


def people(deviation=2.0, aspect=0.4):
    """Anybody is 40 px high with feet in row 60, and half a px more with every row below."""
    line = np.array([40.0, 0.5])
    return Newcomers((120, 160), line, np.diag([deviation**2, 1e-4]), 0.1, aspect, 0.05**2)


def blob(identity, x, y, width, height, speed=0.0, seen=1.0):
    mask = np.zeros((height + 2 * MARGIN, width + 2 * MARGIN), F4)
    mask[MARGIN:-MARGIN, MARGIN:-MARGIN] = 0.9
    corner, planes = np.array([y - MARGIN, x - MARGIN], float), np.full((3, *mask.shape), 90, F4)
    return Blob.newborn(identity, corner, mask, planes, 2.0, 300.0).changed(
        seen=seen, velocity=np.array([0.0, speed])
    )


class Scene:
    """What `fragment_time` needs of a frame."""

    size = (120, 160)
    elapsed = 0.04

    def __init__(self, newcomers):
        self.newcomers = newcomers


def test_the_ratio_of_two_and_one_is_that_of_their_densities_of_width():
    std = math.hypot(0.05 * 40, 0.1 * 16)
    for width in (22, 26, 30, 35):
        one = math.exp(-0.5 * ((width - 16) / std) ** 2) / (std * math.sqrt(2 * math.pi))
        found = pair_evidence((30, 20, width, 40), people())
        assert found == pytest.approx(math.log((1 / 16) / one))
    for width in (10, 16, 18, 37, 60):
        assert pair_evidence((30, 20, width, 40), people()) < 0


@pytest.mark.parametrize(
    ("box", "newcomers"),
    [
        ((30, 20, 30, 40), None),
        ((30, 20, 30, 40), people(deviation=30)),  # nobody was seen yet
        ((30, 20, 30, 40), people(aspect=1.4)),  # cars
        ((30, 40, 30, 20), people()),  # a cart
        ((30, -10, 50, 70), people()),  # a lorry
    ],
)
def test_what_is_not_as_high_as_anybody_is_left_alone(box, newcomers):
    assert pair_evidence(box, newcomers) == -math.inf


def test_halves_part_a_mask_where_it_is_thinnest():
    group = blob(1, 30, 20, 30, 40)
    mask = group.mask.copy()
    mask[: MARGIN + 10, MARGIN + 16 : MARGIN + 20] = 0
    group = group.changed(mask=mask)
    column = thinnest_column(mask)
    assert MARGIN + 16 <= column < MARGIN + 20
    larger, smaller = split_mask(group, column)
    np.testing.assert_array_equal(larger + smaller, mask)
    assert larger.sum() > smaller.sum() > 0.7 * larger.sum()
    assert not (np.minimum(larger, smaller) > 0).any()


def test_what_is_much_smaller_than_anybody_is_not_reported_until_it_has_long_moved():
    legs, somebody = blob(1, 60, 50, 10, 12), blob(2, 60, 20, 16, 40)

    def fragment_time(one, scene):
        (time,) = fragment_times(Blobs.of([one], 3), scene)
        return time

    assert fragment_time(somebody, Scene(people())) == 0
    assert fragment_time(legs, Scene(None)) == 0
    assert fragment_time(blob(3, 0, 50, 10, 12), Scene(people())) == 0  # may be cut off by the picture's edge
    assert fragment_time(legs.changed(fragment_time=1.0), Scene(people())) == pytest.approx(1.04)

    def reported(time, still):
        known = (legs.changed(fragment_time=time, still=still), somebody)
        return [track.identity for track in BlobState(Blobs.of(known, 3), 2, (120, 160), 0.0, 0.35).tracks()]

    assert reported(0.0, 0.0) == [1, 2]
    assert reported(0.1, 0.0) == reported(3.5, 2.0) == [2]
    assert reported(3.5, 0.0) == [1, 2]


def wholes(*blobs, newcomers=None):
    return group_parts(Blobs.of(blobs, 3), newcomers).table["whole"].tolist()


def test_edges_of_a_thing_that_sets_off_are_one_track_for_a_while():
    parts = [blob(k, 30 + 20 * k, 50, 12, 14, 25, 0.5) for k in (1, 2, 3)]
    assert wholes(*parts) == [1, 1, 1]
    together = group_parts(Blobs.of(parts, 3), None)
    assert len(select_whole(together)) == 0
    assert len(select_whole(Blobs.of(list(together)[:2], 3))) == 2
    (track,) = BlobState(together, 3, (120, 160), 0.0, 0.35).tracks()
    assert track.box == pytest.approx((50, 50, 52, 14))
    assert track.velocity == (25, 0)
    assert wholes(*(part.changed(seen=2.5) for part in together)) == [1, 2, 3]


@pytest.mark.parametrize(
    "other",
    [
        blob(2, 50, 50, 12, 14, 0, 0.5),  # stays
        blob(2, 50, 50, 12, 14, -25, 0.5),  # goes elsewhere
        blob(2, 90, 50, 12, 14, 25, 0.5),  # is far away
        blob(2, 50, 50, 12, 14, 25, 1.5),  # was there before
        blob(2, 46, 40, 12, 30, 25, 0.5).changed(velocity=np.array([25.0, 0.0])),
    ],
)
def test_what_does_not_set_off_in_the_same_way_is_no_part(other):
    assert wholes(blob(1, 30, 50, 12, 14, 25, 0.5), other) == [1, 2]


def test_people_side_by_side_are_no_parts_of_one():
    pair = blob(1, 30, 20, 16, 40, 25, 0.5), blob(2, 50, 20, 16, 40, 25, 0.5)
    assert wholes(*pair) == wholes(*pair, newcomers=people()) == [1, 2]
    # nor are pieces that would be higher together than anybody
    pieces = blob(1, 60, 10, 16, 20, 25, 0.5), blob(2, 60, 50, 16, 29, 25, 0.5)
    assert wholes(*pieces) == [1, 1]
    assert wholes(*pieces, newcomers=people()) == [1, 2]


def test_a_piece_that_touches_right_after_its_birth_is_joined():
    body, head = blob(1, 30, 40, 16, 30, seen=2.0), blob(2, 34, 28, 8, 11, seen=0.0)
    (both,) = merge_pieces(Blobs.of([head, body], 3))
    assert both.identity == 1
    assert both.box == pytest.approx((30, 28, 16, 42))
    assert len(merge_pieces(Blobs.of([body, blob(2, 60, 28, 8, 11, seen=0.0)], 3))) == 2
