"""The chain of shape and motion: what it takes from a feature node, and what it says there."""

import numpy as np
import pytest
from rsmcm.apps.io.point_files import frames_of_tracks
from rsmcm.apps.scenes import cylinder
from rsmcm.chains import FactorStructure
from rsmcm.chains.structure.factor_structure import StructureTrajectory
from rsmcm.inference import CoordinateAscent, MultiChain, Solution
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise_robustly, predicted
from rsmcm.models import Frame
from rsmcm.models.points.point_tracks import PointTracks

SCENE = cylinder(n_points=20, n_frames=30, p_loose=0.06, p_drift=0.0, seed=4)
POINTS = PointTracks(noise=0.01)


def solved(chain: FactorStructure, frames: list[Frame]) -> Solution:
    return CoordinateAscent(MultiChain().connect(chain, POINTS)).run(frames)


def test_without_association_it_is_factor_analysis_of_the_tracks() -> None:
    tracks = SCENE.tracks()
    solution = solved(FactorStructure(associate=False), frames_of_tracks(tracks))
    found: StructureTrajectory = solution["structure"]
    weights = np.where(np.isnan(tracks[..., 0]), 0.0, 1e4)
    robust = factorise_robustly(tracks, weights, coherence=True)
    expected = robust.factorisation.of_points(robust.consistent)
    # coordinates that came as messages differ by rounding, on which EM may end a round sooner
    np.testing.assert_allclose(found.factorisation.cameras, expected.cameras, atol=5e-3)
    numbers = np.where(robust.consistent, np.cumsum(robust.consistent) - 1, -1)
    np.testing.assert_array_equal(found.point_of_track, numbers)
    assert (found.trusted == (weights > 0)).mean() > 0.99
    assert found.noise == pytest.approx(0.01**2, rel=0.5)


@pytest.mark.parametrize("associate", [False, True])
def test_wrong_places_are_no_part_of_the_shape(associate: bool) -> None:
    """Every 12th track jumps to another place halfway: it is refused, or its place, and nothing else is."""
    tracks = SCENE.tracks()
    seen = ~np.isnan(tracks[..., 0])
    wrong = np.flatnonzero(seen.sum(axis=0) >= 2)[::12]
    for track in wrong:
        frames = np.flatnonzero(seen[:, track])
        tracks[frames[len(frames) // 2 :], track] += (0.4, -0.5)
    found: StructureTrajectory = solved(FactorStructure(associate=associate), frames_of_tracks(tracks))[
        "structure"
    ]
    right = np.ones(tracks.shape[1], bool)
    right[wrong] = False
    assert (found.point_of_track[right] >= 0).mean() >= 0.95
    assert (found.trusted | ~seen)[:, wrong].all(axis=0).mean() <= 0.2
    assert found.noise == pytest.approx(0.01**2, rel=0.3)
    known = right & (found.point_of_track >= 0)
    places, _ = predicted(found.factorisation)
    off = (places[:, found.point_of_track[known]] - SCENE.positions[:, SCENE.point_of_track[known]])[
        seen[:, known]
    ]
    assert np.sqrt(np.square(off).sum(axis=1).mean()) < 0.015


def test_messages_predict_points_where_they_were_not_seen() -> None:
    frames = frames_of_tracks(SCENE.tracks())
    solution = solved(FactorStructure(), frames)
    found: StructureTrajectory = solution["structure"]
    errors = []
    for time, message in enumerate(solution.messages("structure", POINTS)):
        identities, means, covariances = message.positions.moments
        truth = SCENE.positions[time, SCENE.point_of_track[identities]]
        given = frames[time].points
        assert given is not None
        hidden = ~np.isin(identities, given.identities)
        off = (means - truth)[hidden]
        errors.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances[hidden]), off))
    # squared errors in units of what is stated, which also allows for features scattering about the shape
    assert np.mean(np.concatenate(errors)) < 3
    assert (found.point_of_track >= 0).mean() > 0.9


def test_tracks_of_one_point_are_named_as_one() -> None:
    solution = solved(FactorStructure(), frames_of_tracks(SCENE.tracks()))
    found: StructureTrajectory = solution["structure"]
    message = solution.messages("structure", POINTS)[0]
    known = found.point_of_track >= 0
    np.testing.assert_array_equal(message.positions.identities, found.identities[known])
    assert message.same_as is not None
    for point in range(found.point_of_track.max() + 1):
        members = found.identities[found.point_of_track == point]
        named = message.same_as[np.isin(message.positions.identities, members)]
        np.testing.assert_array_equal(named, np.full(len(members), members.min()))


def test_missing_frames_have_cameras_too() -> None:
    frames = frames_of_tracks(SCENE.observed)
    frames[10] = Frame(None, frames[10].time, frames[10].number)
    solution = solved(FactorStructure(associate=False), frames)
    _, means, _ = solution.messages("structure", POINTS)[10].positions.moments
    error = np.sqrt(np.square(means - SCENE.positions[10]).sum(axis=1).mean())
    assert error < 0.02


def test_too_little_to_go_by() -> None:
    tracks = SCENE.observed
    with pytest.raises(ValueError, match="got 2 frames and 20 points, expected 3 frames and 4 points"):
        solved(FactorStructure(), frames_of_tracks(tracks[:2]))
    with pytest.raises(ValueError, match="3 points, expected"):
        solved(FactorStructure(), frames_of_tracks(tracks[:, :3]))
