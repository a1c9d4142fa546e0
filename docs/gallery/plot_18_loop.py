"""
A chain that closes a loop
==========================

A sliding door opens for people in front of it. Its chain shares the pixels, which it covers when it is open,
and the boxes of the objects, which show who stands there. The blob tracker shares both as well, so that
chains and features form a loop: pixels, blobs, objects, door, pixels. The engine then sends the messages of
the loop repeatedly until they settle.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.chains import AdaptiveBackground, BlobTracker, DiscreteChain, GroundPlane
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import Layer, LayerStack, ObjectBoxes, PixelLabels, PixelMessage

REGION = (40, 70, 28, 16)  # top, left, height, width, px


def message_of(probabilities, feature):
    if isinstance(feature, ObjectBoxes):
        return feature.uniform()  # it predicts no people
    mask = np.full(REGION[2:], probabilities[1], np.float32)
    return PixelMessage(layers=LayerStack([Layer(*REGION[:2], mask, appearance=None)]))


def log_likelihood(message, feature):
    if isinstance(feature, PixelLabels):
        return [3 * message.log_likelihood_ratio(REGION).mean(), 0]
    _, boxes, _ = message.objects.moments  # of each object: x and y of its foot, width, height
    return [0, 4 * (np.abs(boxes[:, :2] - (78, 74)).max(axis=1) < 15).any()]


transition = [[0.997, 0.003], [0.02, 0.98]]  # closed to open, open to closed, in 0.2 s
door = DiscreteChain(transition, message_of, log_likelihood, features=(PixelLabels, ObjectBoxes), name="door")

# %%
# A person comes from the left, waits in front of the door, and goes on.

random = np.random.default_rng(0)
street, coat = random.integers(90, 130, (120, 160)).astype(float), random.integers(20, 60, (30, 12))
street[40:68, 70:86] = 170


def image(time):
    picture = street + random.normal(0, 2, street.shape)
    if 9 <= time < 16:  # it is open, and shows a dark hall
        picture[40:68, 70:86] = 40 + random.normal(0, 2, (28, 16))
    left = int(10 + 8 * min(time, 8) + 8 * max(time - 16, 0))
    picture[46:76, left : left + 12] = coat
    return picture.clip(0, 255).astype(np.uint8)


# %%
# The standard model and the door. ``belief.converged`` tells whether the messages of a frame have settled.

pixels, objects, blobs, times = PixelLabels(), ObjectBoxes(), BlobTracker(), np.arange(0, 22, 0.2)
model = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels).connect(blobs, objects)
model.connect(GroundPlane(), objects).connect(door, pixels).connect(door, objects)
beliefs = list(RecursiveBP(model).run(map(image, times), dt=0.2))
settled, sweeps = (np.array([getattr(each, name) for each in beliefs]) for name in ("converged", "sweeps"))
print(f"loops: {model.has_loops}; settled in {settled.mean():.0%} of the frames, after {sweeps.max()} sweeps")

# %%
# The door is expected to be open as soon as a person stands in front of it, before the pixels show it.

is_open = np.array([belief["door"].probabilities[1] for belief in beliefs])
plt.plot(times, is_open)
plt.axvspan(9, 16, color="0.9")
plt.gca().set(title="P(door is open); grey: it is", xlabel="s")
