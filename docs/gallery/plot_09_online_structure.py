"""
Structure, frame by frame
=========================

``RecursiveStructure`` estimates the shape of a rigid object and the motion of the camera frame by frame,
in constant time per frame. At first its message is uniform; once the motion has determined the shape, it
predicts every point, also hidden ones.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import cylinder
from rsmcm.chains import PointTracker, RecursiveStructure
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PointTracks, frames_of_tracks

# %%
# A rotating cylinder. Its points are sometimes hidden for about ten frames, and keep their identities. Two
# models predict the hidden points in each frame: a tracker alone, with constant velocities, and the same
# tracker with the shape.

turning = cylinder(n_frames=120, p_loose=0.05, p_drift=0.0, p_regain=0.1, seed=3)
points = PointTracks(noise=0.01)  # radii of the cylinder, as all lengths here
alone = MultiChain().connect(PointTracker(), points)
models = {"tracker alone": alone, "tracker and structure": alone.copy().connect(RecursiveStructure(), points)}
errors = {name: [] for name in models}
for name, model in models.items():
    for index, belief in enumerate(RecursiveBP(model).run(frames_of_tracks(turning.observed))):
        identities, means, _ = belief[points].positions.moments
        hidden = ~turning.visible[index, identities]
        off = np.linalg.norm(means - turning.positions[index, identities], axis=1)[hidden]
        errors[name].append(np.median(off) if len(off) else np.nan)
    print(f"{name}: median error of hidden points {np.nanmedian(errors[name]):.4f} radii")

# %%
# Left: until the motion has shown a shape, both are the same. Right: the last frame with the points that
# are visible (dots), the hidden ones as the second model predicts them (circles), and the truth
# (crosses). Try points that come back later (``p_regain=0.02``).

figure, (axis, shown) = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=(2, 1), layout="constrained")
for name, error in errors.items():
    axis.semilogy(range(1, 121), error, label=name)
axis.set(xlabel="frame", ylabel="median error of hidden points, radii")
axis.legend()
shown.plot(*turning.observed[-1].T, ".")
shown.plot(*means[hidden].T, "o", fillstyle="none")
shown.plot(*turning.positions[-1, identities[hidden]].T, "kx")
shown.set(xlabel="u, radii", ylabel="v, radii", aspect="equal")
