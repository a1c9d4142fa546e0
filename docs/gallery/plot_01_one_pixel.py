"""
One pixel, two chains, by hand
==============================

The whole method on one pixel, small enough to check by hand. A floor is dark. In the second frame the
pixel turns bright, and stays so: has a person in a bright shirt stopped in front of the floor, or has the
floor changed?

The feature :math:`F` that two chains share has three values: the pixel shows the dark floor, the bright
floor, or a person. Each chain has a state :math:`X` with two values, and three tables: ``first`` is
:math:`p(X)` in the first frame, ``follows`` is :math:`p(X_t \\mid X_{t-1})` with a row for each previous
state, and ``shows`` is :math:`p(F \\mid X)` with a row for each state.

.. math::

   \\mu_{X \\to F}(F) = \\sum_X p(X)\\, p(F \\mid X), \\qquad
   p(X \\mid I) \\propto p(X) \\sum_F p(F \\mid X)\\, \\mu_{F \\to X}(F)
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.inference import MultiChain, Port, RecursiveBP
from rsmcm.models import Categorical, CategoricalMessage


class TwoStates:
    ports = (Port(Categorical),)

    def __init__(self, name, first, follows, shows):
        self.name, self.first, self.follows, self.shows = name, *map(np.array, (first, follows, shows))

    def initial(self, frame):
        return self.first

    def predict(self, state, dt):
        return state @ np.linalg.matrix_power(self.follows, round(dt))

    def message(self, state, feature, incoming):
        return CategoricalMessage(np.log(state @ self.shows))

    def update(self, state, incoming):
        weights = state * (self.shows @ incoming[Categorical].probabilities())
        return weights / weights.sum()


# %%
# The tables
# ----------
# The floor is dark or bright. It hardly ever changes, and is visible in 8 of 10 frames. The person is
# absent or present, mostly stays, and hides the floor. ``image`` is the likelihood of a grey level, dark
# (row 0) or bright (row 1), for each value of :math:`F`. There is one frame per second.

floor = TwoStates("floor", [0.99, 0.01], [[0.999, 0.001], [0.001, 0.999]], [[0.8, 0, 0.2], [0, 0.8, 0.2]])
person = TwoStates("person", [0.9, 0.1], [[0.8, 0.2], [0.005, 0.995]], [[0.5, 0.5, 0], [0.002, 0.002, 0.996]])
image = np.array([[0.95, 0.05, 0.5], [0.05, 0.95, 0.5]])
pixel = Categorical("pixel", 3, lambda frame: np.log(image[frame.image[0, 0]]))
images = [np.full((1, 1), number > 0, np.uint8) for number in range(20)]
together = MultiChain().connect(floor, pixel).connect(person, pixel)
apart = MultiChain().connect(floor, pixel).connect(person, pixel, feedback=False)
runs = [list(RecursiveBP(model).run(images, dt=1.0)) for model in (together, apart)]

# %%
# Frame 2 by hand
# ---------------
# The posterior of a chain after frame 1, times ``follows``, is its prediction, ``x`` and ``y``. The
# prediction times ``shows`` is its message to :math:`F`. The belief of :math:`F` is the product of both
# messages and of the image's likelihood, divided by its sum.

first, second, *_ = runs[0]
x, y = (first[chain] @ chain.follows for chain in (floor, person))
for chain, p in ((floor, x), (person, y)):
    print(f"{chain.name}: {first[chain].round(3)} -> {p.round(4)} -> {(p @ chain.shows).round(4)}")
product = (x @ floor.shows) * (y @ person.shows) * image[1]
print("times image", product.round(4), "divided by the sum", (product / product.sum()).round(4))

# %%
# For comparison, the sum over all :math:`2 \cdot 2 \cdot 3` cases, without messages. The three columns are
# the beliefs of the pixel, the floor and the person.

cases = np.einsum("x,y,xf,yf,f->xyf", x, y, floor.shows, person.shows, image[1]) / product.sum()
print("all cases ", *(cases.sum(others).round(4) for others in ((0, 1), (1, 2), (0, 2))))
print("the engine", second[pixel].probabilities().round(4), second[floor].round(4), second[person].round(4))

# %%
# Twenty frames
# -------------
# Feed-forward, without messages from the person, the floor absorbs the shirt within seconds, and the
# person is lost. With feedback both chains agree on a person, and the floor behind stays dark. This
# depends on the probability that a person stays: with 0.02, 0.98 in the last row of ``follows``, the
# floor changes in the end.

figure, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True, layout="constrained")
for axis, beliefs, title in zip(axes, runs, ("with feedback", "feed-forward"), strict=True):
    axis.plot(range(1, 21), [[belief[floor][1], belief[person][1]] for belief in beliefs], "o-")
    axis.set(title=title, xlabel="frame", ylabel="probability", ylim=(-0.02, 1.02))
axes[0].legend(["floor is bright", "person is present"])
