"""
Points that are found again
===========================

Points of a rotating cylinder are lost and found again, and a tracker gives each one a new identity when
it comes back. A second chain models all of them as one rigid shape. Its messages contain which tracks show
the same point, and the position of each point, visible or hidden.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import cylinder
from rsmcm.chains import FactorStructure
from rsmcm.inference import CoordinateAscent, MultiChain
from rsmcm.models import PointTracks, frames_of_tracks, noise_of_tracks

# %%
# 40 points in 60 frames. In every frame a visible point is lost with probability 0.1, and a lost one is
# found again with probability 0.5. Lengths are in radii of the cylinder; noise is 0.01.

turning = cylinder(p_loose=0.1, p_drift=0.0, p_regain=0.5, seed=0)
tracks = turning.tracks()  # (60, n_tracks, 2), NaN where a track is not seen
frames = frames_of_tracks(tracks)
points = PointTracks(noise=noise_of_tracks(frames))
solution = CoordinateAscent(MultiChain().connect(FactorStructure(), points)).run(frames)
structure = solution["structure"]
print(f"{tracks.shape[1]} tracks, joined to {len(structure.factorisation.shape)} points")

# %%
# The chain predicts the point of a track in every frame, visible or hidden. (A few short tracks cannot be
# assigned, and get no prediction.)

predictions = [message.positions for message in solution.messages("structure", points)]
predicted, assigned = np.array([each.moments[1] for each in predictions]), predictions[0].identities
error = np.linalg.norm(predicted - turning.positions[:, turning.point_of_track[assigned]], axis=2)
seen = ~np.isnan(tracks[:, assigned, 0])
hidden = ~turning.visible[:, turning.point_of_track[assigned]]
print(f"median error, in radii: visible {np.median(error[seen]):.4f}, hidden {np.median(error[hidden]):.4f}")

# %%
# Left: tracks of three points, each in its own colour, and the positions predicted by the chain (grey).
# Right: frame 31, with the visible points (dots) and all points of the shape (circles). Try
# ``p_loose=0.3``.

figure, (axis, shown) = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=(2, 1), layout="constrained")
for point in np.unique(structure.point_of_track[assigned])[:3]:
    same = np.flatnonzero(structure.point_of_track[assigned] == point)
    axis.plot(range(1, 61), predicted[:, same[0], 0], color="lightgrey", linewidth=5)
    axis.plot(range(1, 61), tracks[:, assigned[same], 0], ".-")
axis.set(xlabel="frame", ylabel="u, radii")
shown.plot(*predicted[30].T, "o", fillstyle="none")
shown.plot(*tracks[30].T, ".")
shown.set(xlabel="u, radii", ylabel="v, radii", aspect="equal")
