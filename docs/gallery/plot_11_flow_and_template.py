"""
Optic flow and template matching, and what lies between
=======================================================

What does a face look like in the next frame? **Optic flow** says: as in this one. It follows everything and drifts,
since each small error becomes part of what it looks for. **Template matching** says: as in the first one. It never
drifts, and is lost when the looks change. Both are G-flow at its ends: texture is a Kalman filter for every texel, and
its gain says how much of a new picture is believed: 1 for flow, 0 for a template.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import face
from rsmcm.chains import GFlow
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

# %%
# Two films, in which the texture of a face stays as it is, and in which blotches come and go.

films = {"constant texture": face(100, seed=2), "changing texture": face(100, seed=2, change=20.0)}
gains = (0.0, 0.02, 0.1, 0.3, 0.6, 1.0)
figure, (axis, over_time) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
for name, film in films.items():
    errors = {}
    for gain in gains:
        tracker = GFlow.template(film.model, film.poses[0], gain=gain)
        beliefs = RecursiveBP(MultiChain().connect(tracker, PixelLabels())).run(film)
        found = np.array([tracker.vertices(belief[tracker])[0][:, :2] for belief in beliefs])
        errors[gain] = np.linalg.norm(found - film.vertices, axis=2).mean(axis=1)
    print(name, {gain: float(error.mean().round(2)) for gain, error in errors.items()})
    axis.semilogy(gains, [error.mean() for error in errors.values()], "o-", label=name)
