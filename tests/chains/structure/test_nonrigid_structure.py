"""The chain of a deforming shape: what it takes from a feature node, and what it says there."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io.point_files import frames_of_tracks
from rsmcm.chains import NonrigidStructure
from rsmcm.inference import CoordinateAscent, MultiChain, Solution
from rsmcm.models.points.point_tracks import PointTracks

from ...support.deforming import N_BASES, N_POINTS, NOISE, deforming

Numbers = NDArray[np.float64]

POINTS = PointTracks(noise=NOISE)
HIDDEN = slice(20, 30)


def behind_something() -> tuple[Numbers, Numbers]:
    """Tracks of which a third of the points is hidden for ten frames, and the true shapes."""
    tracks, shapes = deforming()
    tracks[HIDDEN, :7] = np.nan
    return tracks, shapes


def torn(tracks: Numbers) -> Numbers:
    """The same, with new tracks for the points that come back."""
    after = np.full((len(tracks), 7, 2), np.nan)
    after[HIDDEN.stop :] = tracks[HIDDEN.stop :, :7]
    before = tracks.copy()
    before[HIDDEN.stop :, :7] = np.nan
    return np.concatenate([before, after], axis=1)


def solved(chain: NonrigidStructure, tracks: Numbers) -> Solution:
    return CoordinateAscent(MultiChain().connect(chain, POINTS)).run(frames_of_tracks(tracks))


@pytest.fixture(scope="module")
def united() -> Solution:
    return solved(NonrigidStructure(N_BASES), torn(behind_something()[0]))


def test_tracks_of_one_point_are_named_as_one(united: Solution) -> None:
    """A pair is refused with a probability of 5 %: more than two of seven with one of 0.4 %."""
    point = united["structure"].point_of_track
    np.testing.assert_array_equal(point[:N_POINTS], range(N_POINTS))
    again = point[N_POINTS:]
    alone = again >= N_POINTS
    assert alone.sum() <= 2
    np.testing.assert_array_equal(again[~alone], np.flatnonzero(~alone))
    first = np.where(alone, np.arange(N_POINTS, N_POINTS + 7), np.arange(7))
    message = united.messages("structure", POINTS)[0]
    np.testing.assert_array_equal(message.same_as, [*range(N_POINTS), *first])


def test_hidden_points_are_where_they_are_said_to_be(united: Solution) -> None:
    truth = behind_something()[1][..., :2]
    squares, errors = [], []
    for time in range(HIDDEN.start, HIDDEN.stop):
        identities, means, covariances = united.messages("structure", POINTS)[time].positions.moments
        off = means[identities < 7] - truth[time, :7]
        errors.append(np.linalg.norm(off, axis=1))
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances[identities < 7]), off) / 2)
    # the last place that was seen is several px off after a few frames
    stale = np.linalg.norm(truth[HIDDEN, :7] - truth[HIDDEN.start - 1, :7], axis=2).mean()
    assert np.mean(errors) < 0.2 * stale
    # 70 places of which those of a frame, and of a point, err together: a factor of two is luck
    assert 0.5 < np.mean(squares) < 2


def test_frames_that_show_nothing_are_passed_over() -> None:
    tracks, _ = deforming(n_frames=20)
    tracks[5] = np.nan
    tracks[3:, 2] = np.nan
    tracks[1, 2] = np.nan  # a point that is seen twice only
    solution = solved(NonrigidStructure(N_BASES), tracks)
    messages = solution.messages("structure", POINTS)
    assert len(messages[5].positions.identities) == 0
    assert 2 not in messages[4].positions.identities
    assert len(messages[4].positions.identities) == N_POINTS - 1


def test_too_little_to_go_by() -> None:
    tracks, _ = deforming(n_frames=20)
    with pytest.raises(ValueError, match="got 2 frames that show 4 points or more, expected 3"):
        solved(NonrigidStructure(N_BASES), tracks[:2])
