"""Fixed-lag smoothing of poses, against the Kalman smoother and by its properties."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.apps.scenes import signer
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.fixed_lag import FixedLag, WaitingFrames, thin
from rsmcm.chains.body.samples import BodySamples
from rsmcm.inference.engine import checkpoint
from rsmcm.models.body.parts import BodyParts
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import Frame

BODY = UpperBody.from_head(90.0)
DT = 0.04
SIZE = (360, 640)


def random_walk(n_frames, n, random, noise=4.0):
    """Weighted poses of a bootstrap filter of x alone, and the filter's and smoother's exact moments.

    Places are seen with `noise` px; necks and arms never move.
    """
    dynamics = replace(BodyDynamics(BODY), jumps=0.0, exchanges=0.0)
    step = dynamics.place * BODY.head_height * np.sqrt(DT)
    truth = 300 + np.cumsum(step * random.standard_normal(n_frames))
    seen = truth + noise * random.standard_normal(n_frames)
    pose = dynamics.draw_anywhere(400, SIZE, random)
    hands = BODY.joints(pose)[:, [4, 7]]
    pose = pose.take([np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1).argmax()])  # not to be exchanged
    clouds, means, variances = [], [], []
    mean, variance = 300.0, step**2
    xs = 300 + step * random.standard_normal(n)
    for measured in seen:
        log_weights = -0.5 * ((xs - measured) / noise) ** 2
        poses = pose.take(np.zeros(n, np.int64))
        roots = np.stack([xs, np.full(n, 100.0)], axis=1)
        poses = replace(poses, roots=roots, torsos=np.zeros((n, 3)), necks=np.zeros((n, 3)))
        cloud = BodySamples.even(poses, SIZE, random).reweighed(log_weights)
        clouds.append(cloud)
        gain = variance / (variance + noise**2)
        mean, variance = mean + gain * (measured - mean), (1 - gain) * variance
        means.append(mean)
        variances.append(variance)
        variance += step**2
        xs = cloud.resample(n, random).roots[:, 0] + step * random.standard_normal(n)
    smooth = [(means[-1], variances[-1])]
    for mean, variance in zip(means[-2::-1], variances[-2::-1], strict=True):
        gain = variance / (variance + step**2)
        later, spread = smooth[-1]
        smooth.append((mean + gain * (later - mean), variance + gain**2 * (spread - variance - step**2)))
    return dynamics, clouds, np.array(smooth[::-1])


def run(hindsight, clouds, after=None):
    answers = []
    for index, cloud in enumerate(clouds):
        if index == after:
            return answers
        answers += hindsight.add(Frame(None, index * DT, index + 1), cloud)
    return [*answers, *hindsight.flush()]


def test_of_a_random_walk_it_is_the_kalman_smoother():
    random = np.random.default_rng(3)
    squares, ratios = [], []
    for seed in range(12):
        dynamics, clouds, smooth = random_walk(10, 4000, random)
        answers = run(FixedLag(dynamics, 20, trajectories=400, seed=seed), clouds)
        xs = np.array([answer.samples.poses.roots[:, 0] for answer in answers])
        squares.append((xs.mean(axis=1) - smooth[:, 0]) ** 2 / smooth[:, 1])
        ratios.append(xs.var(axis=1) / smooth[:, 1])
    # 400 trajectories and 400 poses a frame: a mean is known to a tenth of the spread at most
    assert np.mean(squares) < 0.1**2
    assert np.mean(ratios) == pytest.approx(1, abs=0.05)


def test_every_frame_is_answered_once_and_in_order():
    dynamics, clouds, _ = random_walk(11, 50, np.random.default_rng(1))
    for lag in (0, 1, 5, 30):
        hindsight = FixedLag(dynamics, lag)
        late, answers = [], []
        for index, cloud in enumerate(clouds):
            new = hindsight.add(Frame(None, index * DT, index + 1), cloud)
            late += [index + 1 - answer.number for answer in new]
            answers += new
        answers += hindsight.flush()
        assert [answer.number for answer in answers] == list(range(1, 12))
        assert all(lag <= each <= lag + 5 for each in late)
        assert not hindsight.waiting.frames


def test_what_is_improbable_survives_the_thinning():
    random = np.random.default_rng(1)
    poses = BodyDynamics(BODY).draw_anywhere(1000, SIZE, random)
    log_weights = np.where(np.arange(1000) < 200, np.log(0.01 / 200), np.log(0.99 / 800))
    few = thin(BodySamples(poses, log_weights, SIZE, random), 400, random)
    unlikely = np.isclose(few.poses.roots[:, None], poses.roots[None, :200]).all(axis=2).any(axis=1)
    assert len(few.poses) <= 400
    assert np.count_nonzero(unlikely) >= 10
    assert few.weights[unlikely].sum() == pytest.approx(0.01, rel=0.2)
    assert few.weights.sum() == pytest.approx(1)


def test_a_run_over_pictures_that_is_taken_up_again_gives_the_same(tmp_path):
    scene = signer(10, 4, size=(320, 180))
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    dynamics = BodyDynamics(scene.body)
    random = np.random.default_rng(1)
    shown = [
        (
            frame,
            BodySamples.even(dynamics.draw(scene.poses.take(np.full(80, index)), DT, random), SIZE, random),
            parts.evidence(frame, parts.uniform()).image,
        )
        for index, frame in enumerate(scene)
    ]
    whole, first, second = (FixedLag(dynamics, 2) for _ in range(3))
    answers = [answer for each in shown for answer in whole.add(*each)] + whole.flush()
    again = [answer for each in shown[:9] for answer in first.add(*each)]
    assert len(again) == 6
    checkpoint.save(tmp_path / "state.npz", {"waiting": first.waiting}, {"waiting": WaitingFrames})
    second.waiting = checkpoint.load(tmp_path / "state.npz", {"waiting": WaitingFrames})["waiting"]
    again += second.add(*shown[9]) + second.flush()
    for one, other in zip(answers, again, strict=True):
        np.testing.assert_array_equal(one.samples.poses.arms, other.samples.poses.arms)
        assert one.evidence == other.evidence
    # most arms are not the filter's own: they were moved
    pairs = zip(answers[1:5], shown[1:5], strict=True)
    own = [np.isin(answer.samples.poses.arms, each[1].poses.arms).mean() for answer, each in pairs]
    assert max(own) < 0.5
