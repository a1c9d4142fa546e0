"""Where lost parts may be, and that nothing is known less than that."""

import numpy as np
from rsmcm.chains import FleshTracker
from rsmcm.chains.body.flesh_state import HANDS, FleshTracks, within_reach
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import Frame

BODY = UpperBody.from_head(90.0)


def nothing_known() -> FleshTracks:
    return FleshTracker(BODY).initial(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, 1))


def test_what_is_known_less_than_that_it_is_in_reach_is_lost_there() -> None:
    """A hand whose Gaussian is wider than the reach of its arm; the others stay as they are."""
    tracks = nothing_known()
    lost = FleshTracker(BODY)._anywhere(tracks)
    tracks.means[0, :, :2] = [[300.0, 90.0], [380.0, 200.0], [900.0, -50.0]]
    for part, spread in enumerate((5.0, 12.0, 2000.0)):
        tracks.covariances[0, part] = spread**2 * np.eye(4)
    found = within_reach(tracks, lost)
    for part, expected in enumerate((tracks, tracks, lost)):
        np.testing.assert_array_equal(found.means[0, part], expected.means[0, part])
        np.testing.assert_array_equal(found.covariances[0, part], expected.covariances[0, part])


def test_hands_of_a_head_in_the_middle_of_the_picture_are_below_it() -> None:
    """With the person's own left hand on the right, and a head that is anywhere."""
    tracks = nothing_known()
    head, left, right = tracks.positions
    np.testing.assert_allclose(head, (320.0, 180.0))
    np.testing.assert_allclose(left - right, (BODY.shoulder_width, 0.0))
    assert (left + right)[0] == 2 * head[0]
    assert left[1] > head[1]
    np.testing.assert_allclose(tracks.position_covariances[0], np.diag([640.0**2, 360.0**2]) / 12)
    reach = BODY.upper_arm + BODY.forearm
    for hand in HANDS:
        expected = tracks.position_covariances[0] + 0.25 * reach**2 * np.eye(2)
        np.testing.assert_allclose(tracks.position_covariances[hand], expected)


def test_trust_fades_with_the_seconds_since_a_part_was_seen() -> None:
    tracks = nothing_known()
    assert not tracks.trust.any()
    tracks.since[0] = (0.0, tracks.patience, 2 * tracks.patience)
    np.testing.assert_allclose(tracks.trust, np.exp([[0.0, -1.0, -2.0]]))
