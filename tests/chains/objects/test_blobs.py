"""What is reported of blobs."""

import numpy as np
import pytest
from rsmcm.chains.objects.blobs import Blob, Blobs, BlobState, Track
from rsmcm.chains.objects.left_behind import LeftBehind
from rsmcm.models.camera.moving_camera import View

NOTHING_LEFT = LeftBehind.nothing(np.zeros((120, 160), np.uint8))


def test_a_track_is_seen_by_a_camera_that_has_moved_as_its_middle_is() -> None:
    parameters, errors = np.array([4.0, 3.0, -6.0, -2.0, 5.0, 2.0]), np.array([0.5, 1.0, 0.0, 2.0, 0.0, 1.0])
    view = View.predicted(parameters, np.diag(errors**2 + 1e-9), np.zeros((120, 160), np.float32))
    covariance = ((4.0, 1.0), (1.0, 9.0))
    track = Track(3, (40.0, 30.0, 10.0, 20.0), 0.75, (8.0, -6.0), True, covariance)
    seen = track.seen_by(view)

    def middle(moved: float) -> np.ndarray:
        box = np.array([[45 + 8 * moved, 50 - 6 * moved, 10.0, 20.0]])
        ((x, y, _, height),) = view.map.boxes(box)
        return np.array([x, y - height / 2])

    assert (seen.identity, seen.confidence, seen.seen) == (3, 0.75, True)
    x, y, width, height = seen.box
    np.testing.assert_allclose([x + width / 2, y + height / 2], middle(0.0))
    np.testing.assert_allclose([width, height], view.map.scale * [10.0, 20.0])
    np.testing.assert_allclose(seen.velocity, middle(1.0) - middle(0.0), atol=1e-9)
    random = np.random.default_rng(0)
    drawn = random.multivariate_normal((0, 0), covariance, 100_000)
    places = view.map.points(drawn)
    foot_from_middle = np.array([45 - 79.5, 50 - 59.5]) / 100  # half a diagonal is 100 px
    unsure = errors**2 @ np.array(
        [[1, 0], [foot_from_middle[0] ** 2, 0], [0, 0], [0, 1], [0, 0], [0, foot_from_middle[1] ** 2]]
    )
    np.testing.assert_allclose(seen.position_covariance, np.cov(places.T) + np.diag(unsure), atol=0.12)


def known(**changes: object) -> Blob:
    """Somebody who is well known, and shown by the last frame."""
    mask = np.full((30, 20), 0.9, np.float32)
    blob = Blob.newborn(1, np.array([50.0, 40.0]), mask, np.zeros((1, 30, 20), np.float32), 1.0, 100.0)
    return blob.changed(covariance=np.array([[4.0, 1.0], [1.0, 9.0]]), seen=2.0, existence=9.0, **changes)


@pytest.mark.parametrize(
    ("unseen", "unfound", "elapsed", "seen"),
    [
        (0.0, None, 0.0, True),  # the image shows it
        (0.2, None, 0.0, False),  # it is hidden
        (0.0, None, 0.04, False),  # there is no image
        (0.2, 0.0, 0.0, True),  # the detector alone finds it
        (0.0, 0.0, 0.04, True),  # and does without an image
        (0.2, 0.1, 0.0, False),  # it has found it before
    ],
)
def test_who_is_seen_and_who_is_only_predicted(
    unseen: float, unfound: float | None, elapsed: float, seen: bool
) -> None:
    blob = known(unseen=unseen)
    if unfound is not None:
        blob = blob.changed(detected=1, box_mean=(10, 30, 20, 30), box_variance=(1, 2, 3, 8), unfound=unfound)
    state = BlobState(Blobs.of((blob,), 1), 1, (120, 160), elapsed, 0.35, NOTHING_LEFT, unfound is not None)
    (track,) = state.tracks()
    assert track.seen == seen
    assert track.position_covariance == (
        ((4.0, 0.0), (0.0, 4.0)) if unfound is None else ((5.0, 0.0), (0.0, 8.0))
    )


def test_in_the_next_scene_tracks_are_where_the_camera_saw_them() -> None:
    parameters = np.array([6.0, 12.0, -3.0, -4.0, 3.0, 12.0])  # with a zoom by an eighth
    view = View.predicted(parameters, 0.25 * np.eye(6), np.zeros((120, 160), np.float32))
    box = {"detected": 1, "box_mean": (12.0, 27.0, 14.0, 24.0), "box_variance": (4.0, 4.0, 2.0, 3.0)}
    blobs = Blobs.of([known(velocity=(3.0, -8.0), **box), known(identity=2, whole=2)], 1)

    def tracks(those: Blobs) -> list[Track]:
        return BlobState(those, 2, (120, 160), 0.0, 0.3, NOTHING_LEFT, detecting=False).tracks()

    seen = [track.seen_by(view) for track in tracks(blobs)]
    moved = blobs.seen_by(view)
    for one, other in zip(tracks(moved), seen, strict=True):
        np.testing.assert_allclose(one.velocity, other.velocity, atol=1e-9)
        # boxes of masks are whole pixels, of which resampling moves one
        np.testing.assert_allclose(one.box, other.box, atol=1e-9 if one.identity == 1 else 1.0)
    # a place has one variance along both axes, and the height of a box counts a quarter
    np.testing.assert_allclose(
        tracks(moved)[0].position_covariance, seen[0].position_covariance, rtol=0.1, atol=0.2
    )
    assert [blob.mask.shape for blob in moved] == [(34, 22), (34, 22)]
    assert moved[0].mask.mean() == pytest.approx(blobs[0].mask.mean(), rel=0.02)


def test_a_part_that_comes_apart_is_as_real_as_the_whole_but_where_that_appeared() -> None:
    whole = known(past_views=-20.0, view=-30.0, still=1.0, origin=(300.0, 50.0, 20.0, 30.0))
    mask = np.zeros((30, 20), np.float32)
    mask[22:28, 4:12] = 0.8
    part = whole.part(7, mask)
    assert (part.identity, part.whole, part.seen, part.still, part.view) == (7, 7, 0, 0, 0)
    assert part.box == tuple(part.origin) == (44, 72, 8, 6)
    np.testing.assert_array_equal(part.size, [6, 8])
    np.testing.assert_array_equal(part.appearance, whole.appearance)
    assert part.past_views == -20
    # all views together are worth no more: it stays real, however like a ghost it looks from now on
    (evidence,) = Blobs.of([part.changed(view=60.0)], 1).ghost_evidence
    assert evidence == 0
    assert whole.changed(origin=(50.0, 75.0, 20.0, 30.0)).part(7, mask).past_views == 0
