"""Ground plane as a chain: objects stand on one plane, so they look the taller the lower they stand.

Of objects j with feet (x_j, y_j), heights h_j and widths w_j, s_j being the plane's own height there:

    p(feet_t | feet_t-1): constant velocity but for white acceleration; a, b and all c_j stay
    p(h_j | y_j) = N(h_j; a + b (y_j - middle) + c_j s_j, (spread s_j)^2)
    p(w_j | h_j) = N(w_j; r_j h_j, v_j s_j^2)
    mu_{ground -> boxes}(b_j) = N(x_j) N(y_j) p(h_j | y_j) p(w_j | h_j)

The RSMCM paper names a level above its object trackers, a model of how objects share a scene, whose
predictions of their positions guide the trackers (end of §3); it gives no equations. What is here is ours:
the scene's perspective is learned from the objects that walk through it, each object walks without jumps, and
both together predict every object's box. What they predict comes from the past alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference.engine.protocols import Incoming, Port
from ...inference.kalman import kinematic
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BOX, HEIGHT, WIDTH, BoxMessage, Newcomers
from ...models.objects.object_boxes import ObjectBoxes
from .kernels.ground_plane import GroundModel, Objects, Observed, box_densities, observe

Numbers = NDArray[np.float64]

FIRST_TRUST, MOST_TRUST = 1.4, 4.0
"""Log odds that an object stands on the plane: before its first observation, and as sure as one can get."""

MOST_ASPECTS = 50.0
"""Observations that are remembered of everybody's width over height."""


@short_repr
@dataclass(frozen=True, eq=False)
class GroundState:
    """Perspective of the scene and the objects in it.

    With its foot in row y, object k is scene[0] + scene[1] (y - middle) + scene[2 + k] heights[k] high: what
    the plane makes of everybody, and how much taller or shorter this one is.

    Parameters
    ----------
    size
        `(height, width)` px of the picture; `middle` is its middle row.
    variation
        standard deviation of heights over what the plane predicts, as a share of that.
    scene
        `(2 + n_objects,)`: px height with the foot in the middle row, px it grows with each row, and each
        object's share.
    scene_covariance
        `(2 + n_objects, 2 + n_objects)`.
    everybody
        `(3,)`: weight, mean and variance of the width over height of all who were seen.
    identities
        `(n_objects,)` int64, increasing.
    feet
        `(n_objects, 2, 2)`: along x and y, position px and velocity px/s.
    feet_covariance
        `(n_objects, 2, 2, 2)`: along x and y, of position and velocity.
    heights
        `(n_objects,)` px, the scale on which an object moves and varies.
    aspects, aspect_variances
        `(n_objects,)` width over height.
    trust
        `(n_objects,)` log odds that the object stands on the plane.
    unseen
        `(n_objects,)` s since it was last heard of.
    """

    size: tuple[int, int]
    variation: float
    scene: Numbers
    scene_covariance: Numbers
    everybody: Numbers
    identities: NDArray[np.int64]
    feet: Numbers
    feet_covariance: Numbers
    heights: Numbers
    aspects: Numbers
    aspect_variances: Numbers
    trust: Numbers
    unseen: Numbers

    @property
    def middle(self) -> float:
        """px, middle row of the picture."""
        return 0.5 * self.size[0]

    def newcomers(self) -> Newcomers:
        """Box of somebody new; as long as nobody was seen, heights deviate by about the picture's."""
        _, aspect, variance = self.everybody.tolist()
        return Newcomers(
            self.size, self.scene[:2], self.scene_covariance[:2, :2], self.variation, aspect, variance
        )

    def expected_height(self, foot_y: ArrayLike) -> tuple[Numbers, Numbers]:
        """Mean and standard deviation px of the height of somebody new, with feet in these rows."""
        return self.newcomers().height(foot_y)

    @property
    def objects(self) -> Objects:
        """What loops know of the objects."""
        return Objects(
            self.feet,
            self.feet_covariance,
            self.heights,
            self.aspects,
            self.aspect_variances,
            self.trust,
            self.unseen,
        )

    def boxes(self, spread: float, foot_spread: float) -> GaussianMessage:
        """Density N(x) N(y) N(height; plane's at y) N(width; aspect * height) of every object's box.

        Of the perspective, which all objects share, each gets its own marginal, with the slope at its mean.

        Parameters
        ----------
        spread
            standard deviation of one person's height about their own mean, as a share.
        foot_spread
            heights: standard deviation of the bottom edge's middle about the point on the ground.
        """
        count = len(self.identities)
        message = GaussianMessage(
            self.identities, np.empty((count, BOX, BOX)), np.empty((count, BOX)), np.empty(count)
        )
        box_densities(
            self.middle, spread, foot_spread, self.scene, self.scene_covariance, self.objects,
            message.information, message.vector, message.log_scale,
        )  # fmt: skip
        return message


@short_repr
@dataclass(frozen=True)
class GroundPlane:
    """Scene-level chain over the boxes of objects.

    Heights are a linear regression on the foot's row that all objects share, with a share of each object's
    own (a Kalman filter without dynamics: cameras stay, people keep their size); feet have first-order
    dynamics. Both take observations for a mixture of good ones and outliers (half hidden, or no person).

    Parameters
    ----------
    stature
        standard deviation of people's sizes, as a share.
    spread
        standard deviation of one person's height about their own mean (gait, ragged outlines), as a share.
    foot_spread
        heights: standard deviation of the bottom edge's middle about the point on the ground below a person.
    acceleration
        heights/s^2, standard deviation of what moves a foot out of its straight way; it lasts half a second.
    first_speed
        heights/s, standard deviation of the velocity of somebody new.
    outliers
        share of observations that do not show an object from head to foot.
    observation_time
        s after which an observation of the same object is worth a whole new one: outlines err for a while.
    patience
        s after which an object that is not heard of is forgotten.
    """

    stature: float = 0.1
    spread: float = 0.05
    foot_spread: float = 0.03
    acceleration: float = 0.5
    first_speed: float = 1.0
    outliers: float = 0.1
    observation_time: float = 1.0
    patience: float = 3.0
    name: str = "ground"

    ports = (Port(ObjectBoxes),)

    def __post_init__(self) -> None:
        for name in (
            "stature",
            "spread",
            "foot_spread",
            "acceleration",
            "first_speed",
            "observation_time",
            "patience",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")
        if not 0 < self.outliers < 1:
            raise ValueError(f"outliers: got {self.outliers}, expected a share between 0 and 1")

    def initial(self, frame: Frame) -> GroundState:
        """Nobody there, and any perspective: people are taller lower down, if it has to be guessed."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        height, width = frame.image.shape[:2]
        none = np.zeros(0)
        return GroundState(
            size=(height, width),
            variation=float(np.hypot(self.stature, self.spread)),
            scene=np.array([0.25 * height, 0.3]),
            scene_covariance=np.diag([(0.5 * height) ** 2, 0.5**2]),
            everybody=np.array([1.0, 0.5, 0.3**2]),
            identities=np.zeros(0, np.int64),
            feet=np.zeros((0, 2, 2)),
            feet_covariance=np.zeros((0, 2, 2, 2)),
            heights=none,
            aspects=none,
            aspect_variances=none,
            trust=none,
            unseen=none,
        )

    def predict(self, state: GroundState, dt: float) -> GroundState:
        """Feet walk on, but for a random force; perspective and sizes stay."""
        force = 0.5 * (self.acceleration * state.heights[:, None]) ** 2  # px^2/s^3: it lasts half a second
        feet, covariance = kinematic(2, dt).moved(state.feet, state.feet_covariance, force)
        return replace(state, feet=feet, feet_covariance=covariance, unseen=state.unseen + dt)

    def message(self, state: GroundState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage:
        """Every known object's box, and that of somebody new (mu_{ground -> objects})."""
        newcomers = state.newcomers()
        if not len(state.identities):
            return BoxMessage(newcomers=newcomers)
        return BoxMessage(state.boxes(self.spread, self.foot_spread), newcomers=newcomers)

    def update(self, state: GroundState, incoming: Incoming) -> GroundState:
        """Perspective and objects given what others say of the boxes."""
        message = incoming[ObjectBoxes]
        identities, boxes, covariances = message.objects.moments
        state = self._joined(state, identities, boxes)
        if not len(identities):
            return state
        places = np.searchsorted(state.identities, identities)
        existence = message.existence.of(identities) if len(message.existence) else None
        certainty = np.ones(len(identities)) if existence is None else 1 / (1 + np.exp(-existence))
        scene, scene_covariance = state.scene.copy(), state.scene_covariance.copy()
        objects = Objects(*(array.copy() for array in state.objects))
        rows, columns = map(float, state.size)
        model = GroundModel(
            rows, columns, self.spread, self.foot_spread, self.outliers, self.observation_time, MOST_TRUST
        )
        shown = observe(
            Observed(places, boxes, covariances, certainty), model, state.everybody[1], scene,
            scene_covariance, objects,
        )  # fmt: skip
        return replace(
            state,
            scene=scene,
            scene_covariance=0.5 * (scene_covariance + scene_covariance.T),
            everybody=_with(state.everybody, *shown),
            **objects._asdict(),
        )

    def _joined(self, state: GroundState, identities: NDArray[np.int64], boxes: Numbers) -> GroundState:
        """The state without who was not heard of for long, and with who is new.

        Somebody new starts where they are first observed with next to no information, so that the
        observation counts once.
        """
        place = np.searchsorted(state.identities, identities)
        known = np.zeros(len(identities), np.bool_)
        inside = place < len(state.identities)
        known[inside] = state.identities[place[inside]] == identities[inside]
        stays, new = state.unseen <= self.patience, ~known
        stays[place[known]] = True
        if stays.all() and not new.any():
            return state
        heights, n_new, n_stay = boxes[new, HEIGHT], int(new.sum()), int(stays.sum())
        heights = np.maximum(heights, 1.0)
        numbers = np.concatenate([state.identities[stays], identities[new]])
        order = np.argsort(numbers)
        feet = np.zeros((n_new, 2, 2))
        feet[:, :, 0] = boxes[new, :WIDTH]
        feet_covariance = np.zeros((n_new, 2, 2, 2))
        feet_covariance[:, :, 0, 0] = (10 * heights[:, None]) ** 2
        feet_covariance[:, :, 1, 1] = (self.first_speed * heights[:, None]) ** 2
        among = np.concatenate([[True, True], stays])
        scene = np.concatenate([state.scene[among], np.zeros(n_new)])
        covariance = np.zeros((2 + n_stay + n_new, 2 + n_stay + n_new))
        covariance[: 2 + n_stay, : 2 + n_stay] = state.scene_covariance[np.ix_(among, among)]
        covariance[range(2 + n_stay, len(scene)), range(2 + n_stay, len(scene))] = self.stature**2
        kept = np.concatenate([[0, 1], 2 + order])

        def sorted_with(old: Numbers, added: Numbers) -> Numbers:
            together: Numbers = np.concatenate([old[stays], added])[order]
            return together

        return replace(
            state,
            scene=scene[kept],
            scene_covariance=covariance[np.ix_(kept, kept)],
            identities=numbers[order],
            feet=sorted_with(state.feet, feet),
            feet_covariance=sorted_with(state.feet_covariance, feet_covariance),
            heights=sorted_with(state.heights, heights),
            aspects=sorted_with(state.aspects, boxes[new, WIDTH] / heights),
            aspect_variances=sorted_with(state.aspect_variances, np.full(n_new, 0.1**2)),
            trust=sorted_with(state.trust, np.full(n_new, FIRST_TRUST)),
            unseen=sorted_with(state.unseen, np.full(n_new, self.observation_time)),
        )


def _with(moments: Numbers, added: float, off: float, squares: float) -> Numbers:
    """Weight, mean and variance of what was observed, with more; the last `MOST_ASPECTS` count.

    `off` and `squares` are weighted sums of the differences from the mean and of their squares.
    """
    weight, mean, variance = moments.tolist()
    share = added / (weight + added)
    shift = share * off / max(added, 1e-9)
    variance = (1 - share) * variance + share * squares / max(added, 1e-9) - shift**2
    return np.array([min(weight + added, MOST_ASPECTS), mean + shift, variance])
