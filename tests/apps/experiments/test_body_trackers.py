"""Trials of body trackers: measures on made-up errors, and short films in earnest."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.body.measures import (
    HANDS,
    PLACES,
    BodyTrial,
    coverage,
    mis_tracks,
    pooled,
    recoveries,
)
from rsmcm.apps.experiments.bench import people as bench
from rsmcm.apps.experiments.body import BodyTracker, SignerFilm, in_turns
from rsmcm.chains.body.articulated_pose import ArticulatedPose
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models.numerics.threads import set_threads, thread_count

RSMCM = BodyTracker("RSMCM", "rsmcm", 100)


def errors_of(text: str) -> NDArray[np.float64]:
    """Errors in head heights: `.` good, `-` neither good nor bad, `x` bad; the first frame is given."""
    return np.array([{".": 0.1, "-": 0.4, "x": 0.8}[each] for each in "." + text])


def hidden_in(n_frames: int, *frames: int) -> NDArray[np.bool_]:
    hidden = np.zeros(n_frames, np.bool_)
    hidden[list(frames)] = True
    return hidden


def trial(text: str, *hidden: int) -> BodyTrial:
    """A trial whose left hand errs like this; everything else is right."""
    heads = errors_of(text)
    n = len(heads)
    errors = np.zeros((n, 4))
    errors[:, 1] = 50 * heads
    seconds = np.full(n, 0.02)
    return BodyTrial(
        errors,
        2 * errors,
        np.full((n, 2), 3.0),
        np.full(n, 70.0),
        seconds,
        np.stack([hidden_in(n, *hidden), hidden_in(n)], axis=1),
        np.zeros(n),
        50.0,
    )


@pytest.mark.parametrize(
    ("text", "hidden", "expected"),
    [
        ("..x..x-x..", (), []),  # one bad frame is none
        ("..xx-x--..", (3, 4), [(3, 5, 9, True)]),  # until the error is small; it is seen from frame 5 on
        ("xx.xxx", (), [(1, 1, 3, True), (4, 4, None, None)]),  # nothing is known of the last frames
        ("." + "x" * 14 + "...", (), [(2, 2, 16, False)]),  # 14 frames, all seen
        ("." + "x" * 14 + "...", (2, 3, 4, 5), [(2, 6, 16, True)]),  # 10 frames after it was seen
        ("." + "x" * 12, (), [(2, 2, None, False)]),
    ],
)
def test_mis_tracks(text: str, hidden: tuple[int, ...], expected: list[tuple[Any, ...]]) -> None:
    heads = errors_of(text)
    tracks = mis_tracks(1, heads, hidden_in(len(heads), *hidden))
    assert [(each.start, each.seen, each.end, each.recovered) for each in tracks] == expected
    assert all(each.hand == 1 for each in tracks)


def test_measures_leave_the_first_frame_out() -> None:
    one = trial("..xx")
    one.errors[0] = 1000.0
    assert one.hands == pytest.approx(50 * (0.1 + 0.1 + 0.8 + 0.8) / 4 / 2)
    assert one.error == pytest.approx(one.hands / 2)
    assert one.off == 0.5
    assert pooled([one, one], "errors").shape == (8, 4)


def test_recoveries_and_coverage_over_scenes() -> None:
    trials = [trial("xx..."), trial("." + "x" * 20 + "."), trial("...xx")]
    assert recoveries(trials) == (1, 2)
    assert coverage(trials) == 1.0
    assert coverage([replace(trials[0], nees=np.full((6, 2), 5.0)), trials[0]]) == 0.5


@pytest.fixture(scope="module")
def film() -> SignerFilm:
    return SignerFilm.of(n_frames=5, seed=2)


def test_all_trackers_start_at_the_truth(film: SignerFilm) -> None:
    trackers = [
        RSMCM,
        BodyTracker("sampler", "sampler", 100),
        BodyTracker("cloud", "condensation", 200),
        BodyTracker("flesh", "flesh", 0),
    ]
    trials = in_turns(film, trackers, shown=[0, 3])
    for tracker, one in zip(trackers, trials, strict=True):
        assert one.errors.shape == one.errors_3d.shape == (5, 4)
        assert (one.seconds > 0).all()
        assert one.hidden.shape == (5, 2)
        assert np.isfinite(one.errors[:, HANDS]).all()
        if tracker.system == "flesh":
            assert np.isnan(one.error)
            assert not one.shown
        else:
            np.testing.assert_allclose(one.errors_3d[0], 0, atol=1e-6)
            assert (one.errors_3d >= one.errors - 1e-9).all()
            assert one.shown.keys() == {0, 3}
            assert one.shown[3].samples.shape == (40, 8, 3)
            shown = np.linalg.norm((one.shown[3].joints - film.scene.joints[3])[PLACES, :2], axis=1)
            np.testing.assert_allclose(one.errors[3], shown)


def test_the_sampler_is_what_it_is_without_the_flesh_tracker(film: SignerFilm) -> None:
    body, parts = film.scene.body, film.parts
    model, name = BodyTracker("sampler", "sampler", 100).connected(film)
    alone = MultiChain().connect(ArticulatedPose(body, 100, seed=film.scene.seed), parts)
    for one, other in zip(
        RecursiveBP(model).run(film.frames), RecursiveBP(alone).run(film.frames), strict=True
    ):
        np.testing.assert_array_equal(one[name].log_weights, other[name].log_weights)


def test_the_benchmark_of_bodies_times_one_thread_beside_two(
    film: SignerFilm, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = bench.BodyFilm("generated", film.frames, film.scene.body, film.parts)
    for name, value in {"SAMPLES": 50, "WARM_UP": 1, "TURN": 2}.items():
        monkeypatch.setattr(bench, name, value)
    monkeypatch.setattr(bench.BodyFilm, "load", lambda: one)
    before, opencv = thread_count(), cv2.getNumThreads()
    try:
        rates = bench.bodies().expectations
    finally:
        set_threads(before)
        cv2.setNumThreads(opencv)
    assert len(rates) == 3
    assert all(rate.measured > 0 and rate.seeds == 2 for rate in rates)
    assert [rate.ratio for rate in rates] == [False, False, True]


def test_answers_with_hindsight_are_measured_beside_the_filters(film: SignerFilm) -> None:
    (one,) = in_turns(film, [replace(RSMCM, lag=2)], shown=[3])
    (usual,) = in_turns(film, [RSMCM])
    assert usual.later is None
    assert one.later is not None
    np.testing.assert_array_equal(one.errors, usual.errors)
    assert one.later.errors.shape == (5, 4)
    assert (one.later.errors[1:] != one.errors[1:]).any()
    assert one.later.shown.keys() == {3}
    assert (one.later.seconds > one.seconds).all()
    np.testing.assert_array_equal(one.later.hidden, one.hidden)
