"""One, two, or a part of one: what the size of anybody at a place says of blobs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.objects.blob_records import MARGIN
from rsmcm.chains.objects.blobs import Blob, Blobs, BlobState
from rsmcm.chains.objects.ground_plane import GroundPlane
from rsmcm.chains.objects.groups import (
    ALIKE,
    ANY_WAY,
    IN_PARTS,
    OBJECTS,
    fragment_times,
    group_parts,
    merge_pieces,
    pair_evidence,
    part_evidence,
    select_whole,
    split_mask,
    thinnest_column,
)
from rsmcm.chains.objects.left_behind import LeftBehind
from rsmcm.models.core.frame import Frame
from rsmcm.models.objects.box_message import Newcomers
from scipy.stats import norm

F4 = np.float32
NOTHING_LEFT = LeftBehind.nothing(np.zeros((120, 160, 3), np.uint8))


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
    """What is asked of a frame."""

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
        return [
            track.identity
            for track in BlobState(Blobs.of(known, 3), 2, (120, 160), 0.0, 0.35, NOTHING_LEFT).tracks()
        ]

    assert reported(0.0, 0.0) == [1, 2]
    assert reported(0.1, 0.0) == reported(3.5, 2.0) == [2]
    assert reported(3.5, 0.0) == [1, 2]


def anything():
    """Nothing was seen yet: the ground plane's own prior, in a picture of 160 x 120 px."""
    return GroundPlane().initial(Frame(np.zeros((120, 160), np.uint8), 0.0, 1)).newcomers()


def together(*blobs, newcomers):
    return group_parts(Blobs.of(blobs, 3), Scene(newcomers))


def wholes(*blobs, newcomers=None):
    return together(*blobs, newcomers=newcomers or people()).table["whole"].tolist()


def part(identity, y, height, speed=25.0, x=30, width=16, whole=None):
    """A part of somebody who walks, whose velocity is known to 3 px/s."""
    return blob(identity, x, y, width, height, speed).changed(
        covariance=np.diag([1.0, 9.0]), whole=identity if whole is None else whole
    )


JACKET, LEGS = part(1, 20, 21), part(2, 42, 18)


@pytest.mark.parametrize("speed", [25, 22, 0.5])
def test_the_evidence_is_the_ratio_of_the_densities_of_one_object_and_two(speed):
    both = Blobs.of([JACKET, part(2, 42, 18, 25 - speed)], 3)
    evidence = part_evidence(both.boxes, both.table["velocity"] + [0, 100], np.full(2, 9.0), Scene(people()))

    def density(y, height):
        """Of a newcomer's box, 16 px wide: nine in ten fit the plane, one is anywhere."""
        usual = 40 + 0.5 * (y + height - 60)
        std = math.hypot(math.sqrt(4 + 1e-4 * (y + height - 60) ** 2), 0.1 * usual)
        fits = norm.pdf(height, usual, std) * norm.pdf(16, 0.4 * height, 0.05 * height)
        anywhere = 1 / (16 * height * math.log(20) * math.log(40))
        return (0.9 * fits + 0.1 * anywhere) / (120 * 160)

    one = IN_PARTS * density(20, 40) / (16 * 40) ** 2
    two = OBJECTS * density(20, 21) * density(42, 18)
    alike, any_way = (
        norm.pdf(speed, 0, math.sqrt(variance)) / math.sqrt(variance)
        for variance in (18 + (ALIKE * 21) ** 2, 18 + (ALIKE * 21) ** 2 + (ANY_WAY * 21) ** 2)
    )
    assert evidence[0, 1] == evidence[1, 0]
    assert evidence[0, 1] == pytest.approx(math.log(one / two) + math.log(2 * alike / (alike + any_way)))


def test_what_moves_together_is_one_if_that_has_a_usual_size():
    assert wholes(JACKET, LEGS) == wholes(JACKET, LEGS, newcomers=anything()) == [1, 1]
    (track,) = BlobState(
        together(JACKET, LEGS, newcomers=people()), 2, (120, 160), 0.0, 0.35, NOTHING_LEFT
    ).tracks()
    assert track.box == pytest.approx((30, 20, 16, 40))
    assert track.velocity == (25, 0)


def test_edges_of_a_thing_that_sets_off_are_one_where_no_size_is_usual():
    edges = [part(k, 50, 14, x=30 + 20 * k, width=12) for k in (1, 2, 3)]
    found = together(*edges, newcomers=None)
    assert found.table["whole"].tolist() == [1, 1, 1]
    assert len(select_whole(found)) == 0
    assert len(select_whole(found.select([0, 1]))) == 2


@pytest.mark.parametrize(
    "other",
    [
        part(2, 42, 18, speed=0),  # stays
        part(2, 42, 18, speed=-40),  # goes elsewhere
        part(2, 42, 18, x=70),  # is far away
        part(2, 42, 40),  # both would be higher than anybody
        part(2, 20, 40, x=50),  # somebody beside
    ],
)
def test_what_is_no_part_is_by_itself(other):
    first = part(1, 20, 40) if other.box[3] > 30 else JACKET
    assert wholes(first, other) == [1, 2]


def test_objects_keep_their_names_while_parts_join_and_leave():
    head = part(3, 20, 7, x=34, width=8)
    assert wholes(part(1, 28, 13, whole=1), part(2, 42, 18, whole=1), head) == [1, 1, 1]
    # the first part is gone: what is left is who it was; but where the first is alive, another is not it
    assert wholes(part(2, 42, 18, whole=1)) == [1]
    assert wholes(part(1, 20, 40), part(2, 20, 40, x=80, whole=1)) == [1, 2]
    assert wholes(part(5, 20, 40, whole=1), part(6, 20, 38, x=80, whole=1)) == [1, 6]  # the larger one


def test_whom_a_detector_has_found_is_by_itself_and_keeps_a_name_that_nobody_else_has():
    found = [part(k, 20, 40, x=80 * k - 50, whole=1).changed(detected=1) for k in (1, 2)]
    assert wholes(*found) == [1, 2]
    assert wholes(found[1]) == wholes(found[1], part(3, 20, 40, x=30))[:1] == [1]


def test_parts_are_as_high_as_the_object():
    parts = together(part(1, 20, 18), part(2, 42, 18), newcomers=people())
    assert parts.table["whole"].tolist() == [1, 1]
    assert not fragment_times(parts, Scene(people())).any()
    assert fragment_times(parts.select([1]), Scene(people())) > 0


def numbers(*ranges):
    return st.tuples(*(st.integers(low, high) for low, high in ranges))


@settings(max_examples=20, deadline=None)
@given(st.lists(numbers((0, 120), (0, 90), (5, 30), (5, 30), (-40, 40)), min_size=1, max_size=8))
def test_no_two_objects_have_one_name(given_parts):
    parts = [part(k, y, h, v, x, w) for k, (x, y, w, h, v) in enumerate(given_parts, 1)]
    found = together(*parts, newcomers=people())
    names = found.table["whole"]
    for name in set(names.tolist()):  # that of its oldest part
        assert name == found.table["identity"][names == name].min()


def test_a_piece_that_touches_right_after_its_birth_is_joined():
    body, head = blob(1, 30, 40, 16, 30, seen=2.0), blob(2, 34, 28, 8, 11, seen=0.0)
    (both,) = merge_pieces(Blobs.of([head, body], 3))
    assert both.identity == 1
    assert both.box == pytest.approx((30, 28, 16, 42))
    assert len(merge_pieces(Blobs.of([body, blob(2, 60, 28, 8, 11, seen=0.0)], 3))) == 2


@settings(max_examples=30, deadline=None)
@given(st.lists(numbers((0, 60), (0, 60), (5, 25), (5, 25), (0, 1)), min_size=2, max_size=10))
def test_what_is_merged_covers_what_its_pieces_did(given_parts):
    # the picture reaches beyond the patches; what is seen is likeliest, whoever's it is
    def painted(blobs):
        picture = np.zeros((120, 120), F4)
        for each in blobs:
            top, left = np.add(each.corner, 20)
            window = picture[top : top + each.mask.shape[0], left : left + each.mask.shape[1]]
            np.maximum(window, each.mask, out=window)
        return picture

    old = (0.0, 2.0)
    parts = [blob(k, x, y, w, h, seen=old[age]) for k, (x, y, w, h, age) in enumerate(given_parts, 1)]
    for each, strength in zip(parts, np.linspace(0.6, 1, len(parts)), strict=True):
        each.mask[:] *= F4(strength)
    merged = merge_pieces(Blobs.of(parts, 3))
    np.testing.assert_array_equal(painted(merged), painted(parts))
    for each in merged:
        rows, columns = (np.flatnonzero((each.mask > 0.45).any(axis=axis)) for axis in (1, 0))
        top, left = each.position
        assert each.box == (left + columns[0], top + rows[0], np.ptp(columns) + 1, np.ptp(rows) + 1)
        assert tuple(each.size) == (np.ptp(rows) + 1, np.ptp(columns) + 1)
        assert each.seen >= parts[each.identity - 1].seen
