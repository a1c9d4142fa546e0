"""When combining two chains pays: closed forms, against Monte Carlo and brute force, and the estimates."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.evaluation.predictions import (
    FILE,
    MOST_ROWS,
    PairRecord,
    PairRecorder,
    read_predictions,
    write_predictions,
)
from rsmcm.inference.validity import (
    FEWEST_GROUPS,
    Comparison,
    PredictionErrors,
    RecordedPredictions,
    compare_predictions,
    cost,
    product_of,
)
from rsmcm.models.core.gaussian_message import GaussianMessage

from ...conftest import Command

Numbers = NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)
MOMENT = np.array([[1.0, 0.2], [0.2, 1.5]])


def random_errors(d: int, random: np.random.Generator, cases: tuple[int, ...] = ()) -> PredictionErrors:
    """Errors of chains of very different quality, noises of very different size."""

    def covariance(size: int, spread: float) -> Numbers:
        root = random.normal(size=(*cases, size, size + 1)) * np.exp(
            spread * random.normal(size=(*cases, size, 1))
        )
        return root @ np.swapaxes(root, -1, -2) / size

    joint = covariance(2 * d, 0.7)
    return PredictionErrors(
        joint[..., :d, :d], joint[..., d:, d:], joint[..., :d, d:], covariance(d, 1.0), covariance(d, 1.0)
    )


def scalars(first: float, second: float, cross: float, process: float, noise: float) -> PredictionErrors:
    return PredictionErrors(*(np.full((1, 1), value) for value in (first, second, cross, process, noise)))


class Costs(NamedTuple):
    """Costs of either chain and of their product, nats, each `(...)`."""

    first: Numbers
    second: Numbers
    product: Numbers

    @property
    def gain(self) -> Numbers:
        return np.minimum(self.first, self.second) - self.product


def costs_of(errors: PredictionErrors, noises: tuple[Numbers, Numbers] | None = None) -> Costs:
    """C(q_1), C(q_2), C(q*) of eq. (16) with these stated noises, or Lemma 1's."""
    first, second = errors.optimal_noises if noises is None else noises
    noise, of_first, of_second = product_of(first, second)
    crossed = of_first @ errors.cross @ np.swapaxes(of_second, -1, -2)
    error = of_first @ errors.first @ np.swapaxes(of_first, -1, -2) + crossed
    error = error + of_second @ errors.second @ np.swapaxes(of_second, -1, -2) + np.swapaxes(crossed, -1, -2)
    stated = ((first, errors.first), (second, errors.second), (noise, error))
    return Costs(*(cost(each, wrong, errors.process, errors.observation) for each, wrong in stated))


# --- theory -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("optimal", [True, False])
def test_costs_are_the_mean_divergence_of_posteriors(optimal: bool) -> None:
    """Eq. (16) as it stands: sample errors, features and observations. Within four standard errors."""
    d, random = 2, np.random.default_rng(20 + optimal)
    errors = random_errors(d, random)
    noises = errors.optimal_noises
    if not optimal:
        noises = 0.3 * errors.first + 1.7 * errors.process, 2 * errors.second + 0.2 * errors.process
    count = 40_000
    joint = np.block([[errors.first, errors.cross], [errors.cross.T, errors.second]])
    off = random.multivariate_normal(np.zeros(2 * d), joint, count)
    features = random.multivariate_normal(np.zeros(d), errors.process, count)
    observed = features + random.multivariate_normal(np.zeros(d), errors.observation, count)

    def posterior(means: Numbers, covariance: Numbers) -> tuple[Numbers, Numbers]:
        information, seen = np.linalg.inv(covariance), np.linalg.inv(errors.observation)
        result = np.linalg.inv(information + seen)
        return (means @ information + observed @ seen) @ result, result

    one, two = map(np.linalg.inv, noises)
    both = np.linalg.inv(one + two)
    right, right_covariance = posterior(np.zeros((count, d)), errors.process)
    costs = costs_of(errors, None if optimal else noises)
    for exact, means, covariance in (
        (costs.first, off[:, :d], noises[0]),
        (costs.second, off[:, d:], noises[1]),
        (costs.product, (off[:, :d] @ one + off[:, d:] @ two) @ both, both),
    ):
        mean, spread = posterior(means, covariance)
        information = np.linalg.inv(spread)
        fixed = np.linalg.slogdet(spread)[1] - np.linalg.slogdet(right_covariance)[1] - d
        fixed += np.trace(information @ right_covariance)
        divergences = 0.5 * (fixed + np.einsum("ni,ij,nj->n", mean - right, information, mean - right))
        assert abs(divergences.mean() - exact) < 4 * divergences.std() / np.sqrt(count)


@given(SEEDS)
@settings(max_examples=20)
def test_lemma_1_no_noise_is_better_than_the_optimal_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    errors, other = random_errors(2, random), random_errors(2, random).process
    best = cost(errors.optimal_noises[0], errors.first, errors.process, errors.observation)
    worse = cost(other, errors.first, errors.process, errors.observation)
    assert worse >= best - 1e-9 * (1 + abs(best))


def test_theorem_2_is_sufficient_but_not_necessary() -> None:
    """No counterexample among 40,000 cases; benefit without its condition is common."""
    errors = random_errors(2, np.random.default_rng(6), (40_000,))
    helps = np.minimum(*errors.gains) > 0
    assert errors.theorem_holds.sum() > 200
    assert helps[errors.theorem_holds].all()
    assert (helps & ~errors.theorem_holds).sum() > 2000


@given(SEEDS, st.integers(1, 3))
@settings(max_examples=20)
def test_identical_chains_never_help_and_independent_ones_always_do(seed: int, d: int) -> None:
    """Independent of the feature's own noise, that is: K = 0."""
    errors = random_errors(d, np.random.default_rng(seed))
    alike = replace(errors, second=errors.first, cross=errors.first)
    assert max(alike.gains) < 0
    assert not alike.theorem_holds
    independent = replace(errors, cross=-errors.process)
    assert min(independent.gains) > 0
    assert independent.critical_factor == np.inf
    without_process = replace(errors, cross=np.zeros((d, d)), process=np.zeros((d, d)))
    assert without_process.theorem_holds
    assert min(without_process.gains) > 0


@given(SEEDS, st.integers(1, 3))
@settings(max_examples=20)
def test_invariances(seed: int, d: int) -> None:
    """Chains exchanged, coordinates changed linearly, and, of gains, noise of the process taken for error."""
    random = np.random.default_rng(seed)
    errors = random_errors(d, random)
    costs, swapped = costs_of(errors), costs_of(errors.swapped)
    near = {"rel": 1e-6, "abs": 1e-6}
    assert errors.gains == pytest.approx((costs.first - costs.product, costs.second - costs.product), **near)
    assert swapped.first == pytest.approx(costs.second, **near)
    assert swapped.second == pytest.approx(costs.first, **near)
    assert swapped.product == pytest.approx(costs.product, **near)

    change, _ = np.linalg.qr(random.normal(size=(d, d)))
    change = change * np.exp(random.normal(size=d))
    parts = (errors.first, errors.second, errors.cross, errors.process, errors.observation)
    other = PredictionErrors(*(change @ part @ change.T for part in parts))
    assert costs_of(other).product == pytest.approx(costs.product, **near)
    assert other.gains == pytest.approx(errors.gains, **near)
    assert other.correlation == pytest.approx(errors.correlation, **near)
    assert other.theorem_holds == errors.theorem_holds

    moved = PredictionErrors(
        errors.first + errors.process,
        errors.second + errors.process,
        errors.cross + errors.process,
        0 * errors.process,
        errors.observation,
    )
    assert moved.gains == pytest.approx(errors.gains, **near)
    assert moved.critical_factor == pytest.approx(errors.critical_factor, **near)
    assert moved.correlation == pytest.approx(errors.correlation, **near)


@given(SEEDS)
@settings(max_examples=20)
def test_critical_correlation_is_where_the_gain_ends(seed: int) -> None:
    errors = random_errors(2, np.random.default_rng(seed))
    if np.isfinite(errors.critical_factor):
        both = errors.critical_factor * (errors.cross + errors.process)
        edge = replace(errors, cross=both - errors.process)
        assert min(edge.gains) == pytest.approx(0, abs=1e-8 * (1 + max(abs(g) for g in errors.gains)))


# --- estimates ----------------------------------------------------------------------------------------------


def recorded(
    errors: PredictionErrors,
    random: np.random.Generator,
    n_tracks: int = 50,
    length: int = 20,
    memory: float = 0.7,
) -> tuple[RecordedPredictions, NDArray[np.int64]]:
    """Predictions along tracks, whose errors fade with `memory` from frame to frame, honestly stated."""
    d = errors.first.shape[0]
    joint = np.block([[errors.first, errors.cross], [errors.cross.T, errors.second]])
    root = np.linalg.cholesky(joint + 1e-12 * np.eye(2 * d))
    state = random.normal(size=(n_tracks, 2 * d))
    off = np.empty((n_tracks, length, 2 * d))
    for t in range(length):
        off[:, t] = state @ root.T
        state = memory * state + np.sqrt(1 - memory**2) * random.normal(size=state.shape)
    off = off.reshape(-1, 2 * d)
    feature = 100 * random.normal(size=(len(off), d))
    observed = feature + random.normal(size=feature.shape) @ np.linalg.cholesky(errors.observation).T
    stated = (np.tile(noise, (len(off), 1, 1)) for noise in errors.optimal_noises)
    predictions = RecordedPredictions(
        feature + off[:, :d], feature + off[:, d:], observed, errors.observation, *stated
    )
    return predictions, np.repeat(np.arange(n_tracks), length)


def without_process(
    first: Numbers, second: Numbers, cross: Numbers, noise: float | Numbers
) -> PredictionErrors:
    observation = noise * np.eye(len(first)) if np.isscalar(noise) else np.asarray(noise)
    return PredictionErrors(first, second, cross, np.zeros_like(first), observation)


def test_estimates_are_near_the_truth() -> None:
    """With 4000 independent rows the relative error of a moment is about 2 %; five times that is allowed."""
    cross = np.array([[0.3, 0.0], [0.2, 0.1]])
    errors = without_process(MOMENT, 2 * MOMENT, cross, np.array([[0.5, 0.1], [0.1, 0.3]]))
    predictions, groups = recorded(errors, np.random.default_rng(0), 400, 10, memory=0.0)
    found = compare_predictions(predictions, groups)
    assert found.first.estimate == pytest.approx(MOMENT, abs=0.15)
    assert found.second.estimate == pytest.approx(2 * MOMENT, abs=0.3)
    assert found.cross.estimate == pytest.approx(cross, abs=0.2)
    assert found.correlation.estimate == pytest.approx(float(errors.correlation), abs=0.05)
    assert found.rms_first.estimate == pytest.approx(np.sqrt(1.25), rel=0.05)
    assert found.gain.estimate == pytest.approx(float(min(errors.gains)), abs=0.03)
    assert (found.count, found.groups, found.verdict) == (4000, 400, "helps")
    stated = found.stated
    assert stated is not None
    assert stated.nis_first.estimate == pytest.approx(1, abs=0.1)
    assert stated.nis_second.estimate == pytest.approx(1, abs=0.1)
    assert stated.gain.estimate == pytest.approx(float(min(errors.gains)), abs=0.1)


def test_intervals_hold_the_truth() -> None:
    """60 simulated runs of 50 tracks with errors related over time: 95 % intervals hold true gains and
    correlation in at least 80 % (five standard errors below 0.95 would be 81 %).
    """
    errors = without_process(np.eye(1), 1.5 * np.eye(1), 0.3 * np.sqrt(1.5) * np.eye(1), 0.5)
    truth = (*(float(gain) for gain in errors.gains), float(errors.correlation))
    hits = np.zeros(3)
    for seed in range(60):
        random = np.random.default_rng(seed)
        result = compare_predictions(*recorded(errors, random), random, resamples=200)
        intervals = (result.gain_first, result.gain_second, result.correlation)
        hits += [i.low <= value <= i.high for i, value in zip(intervals, truth, strict=True)]
    assert (hits / 60 >= 0.8).all()


def judged(cross: Numbers | float, n_tracks: int = 200, second: float = 1.0) -> Comparison:
    of_both = cross * np.eye(2) if np.isscalar(cross) else np.asarray(cross)
    errors = without_process(np.eye(2), second * np.eye(2), of_both, 0.5)
    return compare_predictions(*recorded(errors, np.random.default_rng(4), n_tracks))


def test_verdicts_and_their_reasons() -> None:
    helping, alike, few = judged(0.1), judged(0.999), judged(0.1, FEWEST_GROUPS - 1)
    assert helping.verdict == "helps"
    assert helping.theorem_holds
    assert "combining helps below 0.5" in helping.reason
    assert alike.verdict == "does not help"
    assert alike.stated is not None
    assert alike.stated.score_gain.high < 0
    assert alike.stated.gain.high < 0
    assert alike.stated.nis_product.low > 1.2, "the product is surer than it should be"
    assert "not sure" in {judged(correlation).verdict for correlation in (0.55, 0.6)}
    assert few.verdict == "not sure"
    assert f"only from {FEWEST_GROUPS - 1} independent groups" in few.reason
    opposed = judged(-0.5)
    assert opposed.verdict == "helps"
    assert "combining helps at any correlation" in opposed.reason


def test_wrong_arrays() -> None:
    ones, noise = np.ones((3, 2)), np.eye(2)
    with pytest.raises(ValueError, match=r"observed: got \(3,\), expected \(n, d\)"):
        RecordedPredictions(ones, ones, np.ones(3), noise)
    with pytest.raises(ValueError, match=r"first: got \(2, 2\), expected \(3, 2\)"):
        RecordedPredictions(np.ones((2, 2)), ones, ones, noise)
    with pytest.raises(ValueError, match=r"second: got \[1.0, nan\] in row 1"):
        RecordedPredictions(ones, np.array([[1, 1], [1, np.nan], [1, 1]]), ones, noise)
    with pytest.raises(ValueError, match="noise: got one that is not positive definite"):
        RecordedPredictions(ones, ones, ones, np.diag([1.0, -1]))
    with pytest.raises(ValueError, match="noise: got one that is not symmetric"):
        RecordedPredictions(ones, ones, ones, np.array([[1.0, 0.5], [0, 1]]))
    with pytest.raises(ValueError, match="got one of them"):
        RecordedPredictions(ones, ones, ones, noise, np.tile(noise, (3, 1, 1)))
    predictions = RecordedPredictions(ones, ones, ones, noise)
    with pytest.raises(ValueError, match=r"groups: got \(2,\) for 3 predictions"):
        compare_predictions(predictions, [1, 2])
    with pytest.raises(ValueError, match="groups: got 1 of 3 rows, expected two or more"):
        compare_predictions(predictions, [7, 7, 7])


# --- files and command --------------------------------------------------------------------------------------


def pair(seed: int = 0, n_tracks: int = 60, correlation: float = 0.1, names: str = "ab") -> PairRecord:
    errors = without_process(np.eye(2), np.eye(2), correlation * np.eye(2), 0.25)
    predictions, tracks = recorded(errors, np.random.default_rng(seed), n_tracks)
    frames = np.tile(np.arange(1, 21), n_tracks)
    return PairRecord(*(f"chain-{name}" for name in names), "points", "px", predictions, tracks, frames)


def test_files_hold_what_was_recorded(tmp_path: Path) -> None:
    bare = pair(1, names="bc")
    bare = replace(bare, predictions=replace(bare.predictions, first_covariance=None, second_covariance=None))
    write_predictions(tmp_path, [pair(), bare])
    assert [path.name for path in tmp_path.iterdir()] == [FILE]
    first, second = read_predictions(tmp_path)
    assert isinstance(first, PairRecord)
    assert isinstance(second, PairRecord)
    assert (first.first, first.second, first.feature, first.unit) == ("chain-a", "chain-b", "points", "px")
    assert second.predictions.first_covariance is None
    for written, read in ((pair(), first), (bare, second)):
        np.testing.assert_array_equal(read.tracks, written.tracks)
        np.testing.assert_array_equal(read.frames, written.frames)
        np.testing.assert_array_equal(read.predictions.observed, written.predictions.observed)
        np.testing.assert_array_equal(read.predictions.noise, written.predictions.noise)


def test_an_overstated_noise_of_the_observed_gives_no_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    honest = pair()
    overstated = replace(honest, predictions=replace(honest.predictions, noise=10 * honest.predictions.noise))
    for record, verdict in ((honest, "helps"), (overstated, "not sure")):
        write_predictions(tmp_path, [record])
        Command("validity")(tmp_path)
        said = capsys.readouterr().out
        assert f"chain-a + chain-b on points: {verdict}." in said
        assert ("the noise is overstated" in said) == (verdict == "not sure")


def test_long_records_are_thinned_evenly(tmp_path: Path) -> None:
    count = 3 * MOST_ROWS + 17
    numbers = np.arange(count)
    values = numbers[:, None].astype(float)
    record = PairRecord(
        "a", "b", "f", "px", RecordedPredictions(values, values, values, np.eye(1)), numbers, numbers
    )
    write_predictions(tmp_path, [record])
    (thin,) = read_predictions(tmp_path)
    assert isinstance(thin, PairRecord)
    assert len(thin.tracks) == len(thin.predictions) == MOST_ROWS
    assert (thin.tracks[0], thin.tracks[-1]) == (0, count - 1)
    assert set(np.diff(thin.tracks)) == {3, 4}
    np.testing.assert_array_equal(thin.predictions.first[:, 0], thin.tracks)


def test_recorder_keeps_points_that_all_speak_of() -> None:
    def message(identities: list[int], shift: float) -> GaussianMessage:
        count = len(identities)
        means = np.array(identities, np.float64)[:, None] + np.array([shift, 0])
        return GaussianMessage.from_moments(identities, means, np.tile(np.eye(2), (count, 1, 1)))

    recorder = PairRecorder("tracker", "structure", "points")
    assert recorder.record() is None
    recorder.add(1, message([1, 2, 5], 0.1), GaussianMessage.uniform(2), message([1, 2], 0.0))
    assert recorder.record() is None
    recorder.add(2, message([1, 2, 5], 0.1), message([2, 5, 7], 0.2), message([1, 2, 5, 7], 0.0))
    record = recorder.record()
    assert record is not None
    np.testing.assert_array_equal(record.tracks, [2, 5])
    np.testing.assert_array_equal(record.frames, [2, 2])
    np.testing.assert_allclose(record.predictions.first, [[2.1, 2], [5.1, 5]])
    np.testing.assert_allclose(record.predictions.second, [[2.2, 2], [5.2, 5]])

    many = list(range(1000))
    for number in range(3, 403):
        recorder.add(number, message(many, 0.1), message(many, 0.2), message(many, 0.0))
    record = recorder.record()
    assert record is not None
    assert len(record.tracks) <= 2 * MOST_ROWS
    assert record.frames[-1] > 390


def test_command_prints_verdicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_predictions(tmp_path, [pair(), pair(2, correlation=0.99, names="bc")])
    assert Command("validity")(tmp_path) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["chains", "feature", "predictions"]
    assert lines[2].startswith("chain-a + chain-b")
    assert lines[2].endswith("helps")
    assert lines[3].endswith("does not help")
    assert "chain-a + chain-b on points: helps. Errors of " in out
    assert "Theorem 2 is met" in out
    assert "chain-a has calibrated covariances" in out
    assert "predicts the observations better" in out
    assert "predicts the observations worse" in out


def test_command_on_wrong_folders(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    complaint = partial(Command("validity").complaint, capfd)

    assert "nowhere: no such folder" in complaint(tmp_path / "nowhere")
    assert "holds no predictions.npz; it is written by: rsmcm structure" in complaint(tmp_path)
    path = tmp_path / FILE
    path.write_bytes(b"PK nonsense")
    assert "predictions.npz: got neither .npy nor .npz" in complaint(tmp_path)
    assert "expected the folder of a finished run" in complaint(path)
    np.savez(path, about=np.array('{"format": "other 3", "pairs": []}'))
    assert "got format 'other 3', expected 'rsmcm predictions 1'" in complaint(tmp_path)
    write_predictions(tmp_path, [pair()])
    with np.load(path) as members:
        arrays = {name: members[name] for name in members.files}
    np.savez(path, **{**arrays, "0/tracks": arrays["0/tracks"][:-1]})
    assert "pair 0: got (1199,) tracks" in complaint(tmp_path)
    for name, factor, words in (
        ("first", 1e200, "pair 0, first: got float64, expected numbers up to 1e+14"),
        ("noise", 1e-310, "pair 0, noise: got less than 1e-14"),
    ):
        np.savez(path, **{**arrays, f"0/{name}": arrays[f"0/{name}"] * factor})
        assert words in complaint(tmp_path)
    np.savez(path, **{**arrays, "0/first": arrays["0/first"] * np.nan})
    assert "first: got [nan, nan] in row 0" in complaint(tmp_path)
    np.savez(path, **{name: array for name, array in arrays.items() if name != "0/observed"})
    assert "0/observed" in complaint(tmp_path)
    write_predictions(tmp_path, [pair().rows(np.array([0]))])
    assert "predictions of one track in one frame" in complaint(tmp_path)
