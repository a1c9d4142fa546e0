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
    exchange_evidence,
    label_hands,
)
from rsmcm.chains.body.likelihood import BodyLikelihood
from rsmcm.chains.body.samples import BodySamples
from rsmcm.models.body.parts import BodyParts

SIZE = (180, 320)


@pytest.mark.parametrize("seed", range(3))
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


def test_labels_go_on_from_what_is_known():
    random = np.random.default_rng(9)
    times, log_odds, confusable = np.arange(9) * 0.1, 3 * random.standard_normal(9), random.random(9)
    whole = label_hands(np.arange(9), times, log_odds, confusable)
    rest = label_hands(
        np.arange(4, 9), times[4:], log_odds[4:], confusable[4:], first_log_odds=whole.filtered_log_odds[4]
    )
    np.testing.assert_allclose(rest.probabilities, whole.probabilities[4:], atol=1e-12)
    np.testing.assert_allclose(rest.filtered_log_odds, whole.filtered_log_odds[4:], atol=1e-12)


def film_of(n_frames, seed):
    """Frames, the dynamics of the person, poses about the truth and the likelihood of each frame."""
    scene = signer(n_frames, seed, 0.0, 0.3, (320, 180))
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    dynamics, likelihood = BodyDynamics(scene.body), BodyLikelihood(scene.body)
    random = np.random.default_rng(seed)
    for index, frame in enumerate(scene):
        image = parts.evidence(frame, parts.uniform()).image
        poses = dynamics.draw(scene.poses.take(np.full(60, index)), 0.002, random)
        yield frame, dynamics, BodySamples.even(poses, SIZE, random), likelihood(image), random


def exchanged_twice(dynamics, samples, log_likelihood, random):
    """Evidence for the labels, and for the exchanged ones; the latter's poses. `None` if impossible."""
    evidence, exchanged = exchange_evidence(dynamics, samples, log_likelihood, random)
    if not len(exchanged):
        return None
    samples = BodySamples.even(exchanged, SIZE, random)
    return evidence, *exchange_evidence(dynamics, samples, log_likelihood, random)


def test_exchanged_poses_have_the_opposite_evidence():
    """On average over three films; bounded, so that a mean over frames has an error bar."""
    there, back = [], []
    for seed in range(3):
        for frame, *known in film_of(13, seed):
            if frame.number % 4 == 1 and (both := exchanged_twice(*known)):
                there.append(both[0].log_odds)
                back.append(both[1].log_odds)
    assert len(there) >= 6
    assert np.abs([there, back]).max() <= MOST
    assert np.mean(there) < 0 < np.mean(back)
    sums = np.add(there, back)
    assert abs(sums.mean()) < 5 * sums.std() / np.sqrt(len(sums)) + 0.3


def test_hands_that_are_far_apart_are_not_confused():
    scene = signer(1, seed=101)
    dynamics = BodyDynamics(scene.body)
    random = np.random.default_rng(1)
    poses = dynamics.draw_anywhere(400, SIZE, random)
    hands = scene.body.parts(poses)[:, 1:]
    far = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1).argmax()
    apart = BodySamples.even(poses.take(np.full(50, far)), SIZE, random)
    assert exchange_evidence(dynamics, apart, None, random)[0] == ExchangeEvidence(0.0, 0.0)
