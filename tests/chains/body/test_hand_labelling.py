"""Names of the hands over a film: against enumeration, and of a generated signer."""

from itertools import groupby, product

import numpy as np
import pytest
from rsmcm.apps.scenes import signer
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.hand_labelling import (
    APART,
    CORRELATION_TIME,
    MISTAKEN,
    MOST,
    SURE,
    TOGETHER,
    ExchangeEvidence,
    Labelling,
    exchange_evidence,
    label_hands,
)
from rsmcm.chains.body.likelihood import BodyLikelihood
from rsmcm.chains.body.samples import BodySamples
from rsmcm.inference.engine import checkpoint
from rsmcm.models.body.parts import BodyParts


@pytest.mark.parametrize("seed", range(4))
def test_labels_are_those_of_all_sequences(seed):
    random = np.random.default_rng(seed)
    n = 7
    times = np.cumsum(random.choice([0.04, 0.4, 3.0], n))
    log_odds, confusable = 3 * random.standard_normal(n), random.random(n)
    found = label_hands(np.arange(1, n + 1), times, log_odds, confusable)
    steps = np.diff(times)
    weights = np.minimum(np.concatenate([[CORRELATION_TIME], steps]) / CORRELATION_TIME, 1)
    sequences = np.array(list(product([0, 1], repeat=n)))
    scores = sequences @ (weights * log_odds) + sequences[:, 0] * np.log(MISTAKEN / (1 - MISTAKEN))
    for index in range(1, n):
        rate = APART + TOGETHER * confusable[index - 1 : index + 1].max()
        change = 0.5 * (1 - np.exp(-2 * rate * steps[index - 1]))
        switches = sequences[:, index] != sequences[:, index - 1]
        scores = scores + np.where(switches, np.log(change), np.log(1 - change))
    shares = np.exp(scores - scores.max())
    np.testing.assert_allclose(found.probabilities, shares @ sequences / shares.sum(), atol=1e-12)
    best = sequences[scores.argmax()] == 1
    stretches = [list(group) for _, group in groupby(range(n), key=lambda index: bool(best[index]))]
    for stretch in stretches:
        sure = best[stretch[0]] and (found.probabilities[stretch] > SURE).any()
        assert (found.exchanged[stretch] == sure).all()


def test_nothing_is_exchanged_before_it_is_sure():
    times, apart = 0.04 * np.arange(100), np.zeros(100)
    for level, exchanged in ((0.5, False), (MOST, True)):
        log_odds = np.where(np.arange(100) < 50, -MOST, level)
        found = label_hands(np.arange(100), times, log_odds, apart)
        assert not found.exchanged[:50].any()
        assert (found.exchanged[50:] == exchanged).all()
        assert (found.shares[60:] > 0.9).all() if exchanged else (found.shares[60:] < 0.5).all()


def test_frames_of_one_look_say_one_thing():
    apart, log_odds = np.zeros(40), np.full(40, 1.0)
    slow, fast = (label_hands(np.arange(40), dt * np.arange(40), log_odds, apart) for dt in (1e-3, 1e-4))
    assert abs(slow.filtered_log_odds[-1] - slow.filtered_log_odds[0]) < 40 * 1e-3 / CORRELATION_TIME
    assert abs(fast.filtered_log_odds[-1] - fast.filtered_log_odds[0]) < 40 * 1e-4 / CORRELATION_TIME


def test_of_no_frame_nothing_is_said():
    found = Labelling().result()
    assert len(found.numbers) == len(found.probabilities) == len(found.exchanged) == 0


def test_labels_go_on_from_what_is_known():
    random = np.random.default_rng(9)
    times, log_odds, confusable = np.arange(9) * 0.1, 3 * random.standard_normal(9), random.random(9)
    whole = label_hands(np.arange(9), times, log_odds, confusable)
    rest = label_hands(
        np.arange(4, 9), times[4:], log_odds[4:], confusable[4:], first_log_odds=whole.filtered_log_odds[4]
    )
    np.testing.assert_allclose(rest.probabilities, whole.probabilities[4:], atol=1e-12)
    np.testing.assert_allclose(rest.filtered_log_odds, whole.filtered_log_odds[4:], atol=1e-12)


def test_exchanged_poses_say_the_same_with_the_opposite_sign():
    scene = signer(40, seed=7)
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    dynamics, likelihood = BodyDynamics(scene.body), BodyLikelihood(scene.body)
    random = np.random.default_rng(1)
    there, back = [], []
    for index, frame in list(enumerate(scene))[::2]:
        log_likelihood = likelihood(parts.evidence(frame, parts.uniform()).image)
        poses = dynamics.draw(scene.poses.take(np.full(60, index)), 0.002, random)
        evidence, exchanged = exchange_evidence(
            dynamics, BodySamples.even(poses, (360, 640), random), log_likelihood, random
        )
        if len(exchanged):
            samples = BodySamples.even(exchanged, (360, 640), random)
            there.append(evidence.log_odds)
            back.append(exchange_evidence(dynamics, samples, log_likelihood, random)[0].log_odds)
    sums = np.add(there, back)
    assert len(sums) >= 10
    assert np.mean(there) < -1
    assert np.mean(back) > 1
    assert abs(sums.mean()) < 4 * sums.std() / np.sqrt(len(sums)) + 0.1


def test_where_hands_have_the_wrong_names_a_film_says_so(tmp_path):
    scene = signer(50, seed=7)
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    dynamics, likelihood = BodyDynamics(scene.body), BodyLikelihood(scene.body)
    random = np.random.default_rng(1)
    labelling = Labelling()
    for index, frame in enumerate(scene):
        image = parts.evidence(frame, parts.uniform()).image
        poses = dynamics.draw(scene.poses.take(np.full(60, index)), 0.002, random)
        samples = BodySamples.even(poses, (360, 640), random)
        evidence, exchanged = exchange_evidence(dynamics, samples, likelihood(image), random)
        if index >= 25 and len(exchanged):
            samples = BodySamples.even(exchanged, (360, 640), random)
            evidence, back = exchange_evidence(dynamics, samples, likelihood(image), random)
            hands = scene.body.parts(poses)[:, 1:].mean(axis=0)
            near = scene.body.head_height / 3  # those are kept that fit the image
            np.testing.assert_allclose(scene.body.parts(back)[:, 1:].mean(axis=0), hands, atol=near)
        labelling.add(frame.number, frame.time, evidence)
    checkpoint.save(tmp_path / "labelling.npz", {"of": labelling}, {"of": Labelling})
    labels = checkpoint.load(tmp_path / "labelling.npz", {"of": Labelling})["of"].result()
    np.testing.assert_array_equal(labels.numbers, np.arange(1, 51))
    assert (labels.probabilities[:10] < 0.1).all()
    assert (labels.probabilities[30:] > 0.9).all()
    assert not labels.exchanged[:10].any()
    assert labels.exchanged[30:].all()


def test_hands_that_are_far_apart_are_not_confused():
    scene = signer(1, seed=101)
    dynamics = BodyDynamics(scene.body)
    random = np.random.default_rng(1)
    poses = dynamics.draw_anywhere(400, (360, 640), random)
    hands = scene.body.parts(poses)[:, 1:]
    far = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1).argmax()
    apart = BodySamples.even(poses.take(np.full(50, far)), (360, 640), random)
    assert exchange_evidence(dynamics, apart, None, random)[0] == ExchangeEvidence(0.0, 0.0)
