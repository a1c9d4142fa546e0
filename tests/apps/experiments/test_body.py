"""Body trackers compared: measures and expectations on made-up trials, counts of samples, short scenes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.body.measures import HANDS, PLACES, BodyTrial, coverage, mis_tracks, pooled, recoveries
from rsmcm.apps.experiments import body, run_experiment
from rsmcm.apps.experiments.body import BodyTracker, SignerFilm, in_turns
from rsmcm.chains.body.articulated_pose import ArticulatedPose
from rsmcm.inference import MultiChain, RecursiveBP

N_FRAMES = 30
LATER = body.LATER.format(body.RSMCM.name)
RSMCM = BodyTracker("RSMCM", "rsmcm", 100)


def heads_of(text: str) -> NDArray[np.float64]:
    """Errors in head heights: `.` good, `-` neither good nor bad, `x` bad; the first frame is given."""
    return np.array([{".": 0.1, "-": 0.4, "x": 0.8}[each] for each in "." + text])


def hidden_in(n_frames: int, *frames: int) -> NDArray[np.bool_]:
    return np.isin(np.arange(n_frames), frames)


def trial(left: NDArray[np.float64], others: float = 0.0, seconds: float = 0.05) -> BodyTrial:
    """A trial whose left hand has these errors, px, and hands and elbows beside it another one."""
    n = len(left)
    errors = np.full((n, 4), others)
    errors[:, 1] = left
    return BodyTrial(
        errors,
        errors + 1,
        np.ones((n, 2)),
        np.full(n, 300.0),
        np.full(n, seconds),
        np.zeros((n, 2), np.bool_),
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
    heads = heads_of(text)
    tracks = mis_tracks(1, heads, hidden_in(len(heads), *hidden))
    assert [(each.hand, each.start, each.seen, each.end, each.recovered) for each in tracks] == [
        (1, *each) for each in expected
    ]


def test_measures_over_frames_and_scenes() -> None:
    """The first frame is left out: its pose is given."""
    one = trial(50 * heads_of("..xx"))
    one.errors[0] = 1000.0
    assert one.hands == pytest.approx(50 * (0.1 + 0.1 + 0.8 + 0.8) / 4 / 2)
    assert one.error == pytest.approx(one.hands / 2)
    assert one.off == 0.5
    assert pooled([one, one], "errors").shape == (8, 4)
    trials = [trial(50 * heads_of(text)) for text in ("xx...", "." + "x" * 20 + ".", "...xx")]
    assert recoveries(trials) == (1, 2)
    assert coverage(trials) == 1.0
    assert coverage([replace(trials[0], nees=np.full((6, 2), 5.0)), trials[0]]) == 0.5


def made_up(rsmcm: float, later: float, sampler: float, clouds: tuple[float, ...]) -> body.TrialsByTracker:
    def even(error: float, seconds: float = 0.05) -> list[BodyTrial]:
        return [trial(np.full(N_FRAMES, error), error, seconds)] * 2

    nees = np.where(np.arange(N_FRAMES) < 3, 9.0, 1.0)[:, None] * np.ones(2)  # 90 % of them in the region
    found = {
        body.RSMCM.name: even(rsmcm),
        LATER: [replace(one, nees=nees) for one in even(later, 0.06)],
        body.SAMPLER: even(sampler),
        body.LATER.format(body.CLOUDS[0]): even(2 * later),
        body.FLESH.name: even(np.nan, 0.02),
    }
    for name, times, error in zip(body.CLOUDS, body.MULTIPLES, clouds, strict=True):
        found[name] = even(error, 0.05 * times)
    return found


def test_expectations() -> None:
    good = body.expectations_of(made_up(8, 6, 20, (24, 12)))
    assert {each.verdict for each in good} == {"pass", ""}
    assert [each.measured for each in good[:5]] == pytest.approx([0.4, 1 / 3, 0.25, 0.5, body.MULTIPLES[-1]])
    assert "more than" in good[4].what
    poor = body.expectations_of(made_up(8, 8, 10, (9, 9)))
    assert [each.verdict for each in poor[:5]] == ["missed", "missed", "missed", "", "missed"]
    assert {each.verdict for each in poor[5:]} == {"pass"}
    assert poor[4].measured == pytest.approx(1.0)
    assert "more than" not in poor[4].what


def test_mis_tracks_and_exchanges_count_for_the_later_answers() -> None:
    found = made_up(8, 6, 20, (24, 12))
    errors = np.full((N_FRAMES, 4), 8.0)
    errors[2:5, 1] = 60.0  # three frames
    errors[10:25, 3] = 60.0  # fifteen, in which the hand is seen
    exchanged = hidden_in(N_FRAMES, *range(10, 22)).astype(np.float64)
    found[LATER] = [replace(found[LATER][0], errors=errors, exchanged=exchanged), found[LATER][0]]
    recovered, *_, off, scenes = body.expectations_of(found)[5:]
    assert (recovered.measured, scenes.measured) == (0.5, 1)
    assert "2 mis-tracks" in recovered.what
    assert off.measured == pytest.approx(18 / 29 / 2)
    assert [each.verdict for each in (recovered, off, scenes)] == ["missed"] * 3


def test_the_time_to_come_near_lies_between_those_that_were_measured() -> None:
    assert body.time_to_come_near((1, 4), (1.5, 1.0)) == pytest.approx(2.0)
    assert body.time_to_come_near((1, 2, 4), (1.5, 1.25, 1.0)) == pytest.approx(2.0)
    assert body.time_to_come_near((1, 4), (1.0, 0.9)) == 1
    assert body.time_to_come_near((1, 4), (3.0, 2.0)) == 4


def test_samples_of_a_time_lie_on_a_line() -> None:
    few, many = counts = (2000, 10_000)
    for seconds, expected in ((0.03, few), (0.07, many), (0.05, 6000), (0.035, 3000), (0.19, 34_000)):
        assert body.samples_in(seconds, counts, (0.030, 0.070)) == expected
    assert body.samples_in(0.001, counts, (0.030, 0.070)) == body.FEWEST_SAMPLES


@pytest.mark.slow
def test_short_scenes_in_earnest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(body, "SEEDS", range(2))
    monkeypatch.setattr(body, "SCENE", {"n_frames": 18})
    monkeypatch.setattr(body, "TIMED_FRAMES", 18)
    monkeypatch.setattr(body, "SHOWN", (4, 9))
    run_experiment("body", tmp_path / "out")
    tables = json.loads((tmp_path / "out" / "results.json").read_text())["tables"]
    errors = {name: (samples, error) for name, samples, error, *_ in tables[0]["rows"]}
    counts = [errors[name][0] for name in body.CLOUDS]
    assert counts == sorted(counts)
    assert 0 < errors[body.RSMCM.name][1] < 300
    assert "a hand off" in capsys.readouterr().out


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
