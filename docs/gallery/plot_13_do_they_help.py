"""
Do two chains help each other?
==============================

Two models of the same quantity help if their errors differ enough. With the same errors, their product is
only overconfident. The limit can be computed (§3.3 of the RSMCM paper): the gain of the product over the
better chain, in nats, follows from the mean squares :math:`A` and :math:`B` of both errors, their mean
product :math:`K`, and the noise of the observations.

All of these are measured in a recorded run: predictions, each made without the observation, and the
observations. ``compare_predictions`` evaluates them; ``rsmcm validity`` does so for a run of the command.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.io import frames_of_tracks
from rsmcm.apps.scenes import cylinder
from rsmcm.chains import PointTracker
from rsmcm.inference import (
    MultiChain,
    PredictionErrors,
    RecordedPredictions,
    RecursiveBP,
    compare_predictions,
)
from rsmcm.models import Frame, PointTracks

# %%
# Four trackers of the points of a rotating cylinder. Two of them receive all frames, and differ in their
# acceleration noise. The other two are equal, but one receives the odd frames and one the even ones.

turning = cylinder(n_frames=160, p_loose=0, p_drift=0, noise=0.1, degrees_per_frame=1)
points = PointTracks(noise=0.1)  # radii of the cylinder


def predictions(acceleration, numbers):
    tracker, means = PointTracker(acceleration=acceleration), np.full(turning.observed.shape, np.nan)
    given = frames_of_tracks(turning.observed)
    frames = [each if each.number in numbers else Frame(None, each.time, each.number) for each in given]
    for index, belief in enumerate(RecursiveBP(MultiChain().connect(tracker, points)).run(frames)):
        identities, means[index, identities], _ = belief.message(tracker, points).positions.moments
    return means[20:]


every, odd, even = range(1, 161), range(1, 161, 2), [1, *range(2, 161, 2)]  # all begin with the first frame
pairs = {
    "the same frames": (predictions(0.5, every), predictions(1.0, every)),
    "different frames": (predictions(0.5, odd), predictions(0.5, even)),
}

# %%
# Two trackers of the same observations do not help each other: their errors are common. Two with
# different observations do. Lines: the theory for errors of these sizes, at any correlation. Dots:
# measured, with 95 % intervals. Try trackers that also receive half of each other's frames.

noise, at = 0.1**2 * np.eye(2), np.linspace(-0.3, 0.99, 50)[:, None, None]  # at: correlations
figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
for name, (one, two) in pairs.items():
    known = ~np.isnan(one + two).any(axis=2)
    recorded = RecordedPredictions(one[known], two[known], turning.observed[20:][known], noise)
    found = compare_predictions(recorded, groups=np.nonzero(known)[1])  # errors of a point are related
    print(f"{name}: {found.verdict}; errors correlate {found.correlation:.2f}, gain {found.gain:.2f} nats")
    both = found.rms_first.estimate * found.rms_second.estimate * np.eye(2)
    theory = PredictionErrors(found.errors.first, found.errors.second, at * both, 0 * noise, noise)
    (curve,) = axis.plot(at.ravel(), np.minimum(*theory.gains), label=f"trackers of {name}")
    interval = [[found.gain.estimate - found.gain.low], [found.gain.high - found.gain.estimate]]
    axis.errorbar(found.correlation.estimate, found.gain.estimate, interval, fmt="o", color=curve.get_color())
axis.axhline(0, color="grey", linewidth=0.8)
axis.set(xlabel="correlation of the errors", ylabel="gain over the better one, nats")
axis.legend()
