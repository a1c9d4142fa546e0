"""
A chain of your own
===================

A door that opens is foreground at first, and after some seconds it *is* the background; when it closes,
the closed door is foreground. A second chain with two states, closed and open, solves this. Its message
to the pixels is "with this probability the pixel is covered, in any colour".
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.chains import AdaptiveBackground, DiscreteChain
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import Layer, LayerStack, PixelLabels, PixelMessage
from scipy.linalg import expm

region = (40, 70, 28, 16)  # top, left, height, width, px
rates = np.array([[-1, 1], [1, -1]]) / 20  # per second: it opens and closes about once in 20 s


def message_of(probabilities, pixels):
    mask = np.full(region[2:], probabilities[1], np.float32)
    return PixelMessage(layers=LayerStack([Layer(*region[:2], mask, appearance=None)]))


def log_likelihood(message, pixels):
    nats = message.log_likelihood_ratio(region).mean()  # per pixel, for the closed door
    return [3 * nats, 0]  # neighbours are correlated: all pixels count as three


door = DiscreteChain(
    lambda dt: expm(dt * rates),
    message_of,
    log_likelihood,
    features=PixelLabels,
    initial_probabilities=[1, 0],
    name="door",
)

# %%
# ``message`` is the product of the image and of all *other* chains, without the chain's own message.
# Now a street with a door that is open, and shows a dark hall, from 10 s to 50 s.

random = np.random.default_rng(0)
street = random.integers(90, 130, (120, 160)).astype(float)
street[40:68, 70:86] = 170


def image(time):
    picture = street + random.normal(0, 2, street.shape)
    if 10 <= time < 50:
        picture[40:68, 70:86] = 40 + random.normal(0, 2, (28, 16))
    return picture.clip(0, 255).astype(np.uint8)


# %%
# Connecting it is one line.

pixels, times = PixelLabels(), np.arange(0, 60, 0.2)
alone = MultiChain().connect(AdaptiveBackground(follow_light=False), pixels)
both = alone.copy().connect(door, pixels)
runs = [list(RecursiveBP(model).run(map(image, times), dt=0.2)) for model in (alone, both)]
pictures = [beliefs[245]["background"].picture() for beliefs in runs]
for name, picture in zip(("alone", "with the door"), pictures, strict=True):
    error = np.abs(picture - street)[40:68, 70:86].mean()
    print(f"background {name}: after 49 s its picture of the door is off by {error:.0f} grey levels")

# %%
# Left and middle: the background image after 49 s. Right: the belief of the new chain.
# Connect it with ``feedback=False``: its posterior is the same, but its messages reach no other chain.

figure, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
for axis, picture, title in zip(axes, pictures, ("background alone", "with the door's chain"), strict=False):
    axis.imshow(picture, cmap="gray", vmin=0, vmax=255)
    axis.set(title=title, xticks=[], yticks=[])
axes[2].plot(times, [belief["door"].probabilities[1] for belief in runs[1]])
axes[2].set(title="P(door is open)", xlabel="s")
