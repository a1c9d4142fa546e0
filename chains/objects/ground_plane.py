"""Ground plane as a chain: objects stand on one plane, so they look the taller the lower they stand.

Of objects j with feet (x_j, y_j), heights h_j and widths w_j, s_j being the plane's own height there:

    p(feet_t | feet_t-1): constant velocity but for white acceleration; a, b and all c_j stay
    p(h_j | y_j) = N(h_j; a + b (y_j - middle) + c_j s_j, (height_std s_j)^2)
    p(w_j | h_j) = N(w_j; r_j h_j, v_j s_j^2)
    mu_{ground -> boxes}(b_j) = N(x_j) N(y_j) p(h_j | y_j) p(w_j | h_j)

The RSMCM paper names a level above its object trackers, a model of how objects share a scene, whose
predictions of their positions guide the trackers (end of §3); it gives no equations. The model here is ours:
the scene's perspective is learned from the objects that walk through it, each object walks without jumps, and
both together predict every object's box, from the past alone.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference.engine.protocols import Incoming, Port
from ...inference.kalman import kinematic
from ...models.camera.moving_camera import View
from ...models.core.checks import NEAR, NotNegative, Positive, Shape, Share, SizesOf, checked, made
from ...models.core.frame import Frame
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.identities import Turnover, find, places_of
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BOX, FOOT_X, FOOT_Y, HEIGHT, HEIGHTS, WIDTH, BoxMessage, Newcomers
from ...models.objects.object_boxes import ObjectBoxes

Array = NDArray[np.float64]
OfObjects = Annotated[Array, Shape("n")]

INITIAL_TRUST, MAX_TRUST = 1.4, 4.0
"""Log odds that an object stands on the plane: before its first observation, and as sure as one can get."""

MOST_ASPECTS = 50.0  # observations that the statistics of width over height remember

MIN_ASPECT_STD = 0.05
"""Of a width, in heights: what remains uncertain about it, however alike the observations were."""

HALF_HIDDEN = 0.5
"""Heights: standard deviation of what an observation is off by that does not show an object wholly."""

MIN_WORTH = 1e-9
"""Of an observation without weight: its noise is divided by this, which leaves it out."""


FOOT_HEIGHTS, SLOPES = (
    each.ravel() for each in np.meshgrid(np.geomspace(0.06, 1.5, 24), np.linspace(0, 1.8, 19), indexing="ij")
)
"""Planes that are compared: height with feet in the lowest row, in heights of the picture, and px per row."""

USUAL, USUAL_STD, USUAL_SLOPE = 0.35, 0.8, 0.7
"""Their prior, which is wide: median of that height, deviation of its logarithm, mean slope."""
PRIOR = -0.5 * (np.log(FOOT_HEIGHTS / USUAL) / USUAL_STD) ** 2 - SLOPES / USUAL_SLOPE

PART, OTHER = 0.45, 0.1
"""Shares of what pixels alone show that are parts of objects, and neither parts nor whole; guesses."""

LEAST = 0.02  # of the picture's height: the least height of a plane
CELL = 0.1  # of a height: by how much planes that are compared are apart
UNALIKE = 2.0  # deviations by which a plane may be off from the likeliest ones


@short_repr
@dataclass(frozen=True, eq=False)
class GroundState:
    """Perspective of the scene and the objects in it.

    With its foot in row y, object k is scene[0] + scene[1] (y - middle) + scene[2 + k] heights[k] high: what
    the plane predicts of any object, and how much taller or shorter this one is.
    """

    # px of the picture; `middle` is its middle row
    size: Annotated[tuple[int, int], SizesOf("height", "width")]
    variation: NotNegative  # standard deviation of heights over what the plane predicts, a share of that
    # (2 + n,): px height in the middle row, px it grows with each row, and each object's share
    scene: Annotated[Array, Shape("terms")]
    scene_covariance: Annotated[Array, Shape("terms", "terms")]
    # weight, mean and variance of the width over height of all objects
    all_aspects: Annotated[Array, Shape(3)]
    identities: Annotated[NDArray[np.int64], Shape("n")]  # of the objects, increasing
    feet: Annotated[Array, Shape("n", 2, 2), NEAR]  # along x and y, position px and velocity px/s
    feet_covariance: Annotated[Array, Shape("n", 2, 2, 2)]
    heights: OfObjects  # px, the scale on which an object moves and varies
    aspects: OfObjects  # width over height
    aspect_variances: OfObjects
    trust: OfObjects  # log odds that the object stands on the plane
    unseen: OfObjects  # s since it was last observed
    # log weights of all planes that are compared, by what pixels alone have shown
    planes: Annotated[Array, Shape(*PRIOR.shape)] = field(default_factory=lambda: PRIOR.copy())

    def require_fit(self) -> None:
        """Raise a `ValueError` if an object has no term in the scene, or identities are not in order."""
        if len(self.scene) != 2 + len(self.identities) or (np.diff(self.identities) <= 0).any():
            raise ValueError(
                f"identities: got {len(self.identities)}, expected {len(self.scene) - 2} in order"
            )

    @property
    def middle(self) -> float:
        """px, middle row of the picture."""
        return 0.5 * self.size[0]

    def newcomers(self) -> Newcomers:
        """Return the distribution of a new object's box."""
        _, aspect, variance = self.all_aspects.tolist()
        return made(
            Newcomers,
            self.size,
            self.scene[:2],
            self.scene_covariance[:2, :2],
            self.variation,
            aspect,
            variance,
        )

    def expected_height(self, foot_y: ArrayLike) -> tuple[Array, Array]:
        """Return mean and standard deviation px of a new object's height, with feet in these rows."""
        return self.newcomers().height(foot_y)

    def seen_by(self, view: View) -> Self:
        """Return the state in the px of the frame that a camera shows by `view`."""
        down, linear = float(view.map.scale[1]), view.map.matrix[:, :2]
        feet = linear @ self.feet
        feet[:, :, 0] = view.map.points(self.feet[:, :, 0] - 0.5) + 0.5
        unsure = view.box_variances(np.hstack([self.feet[:, :, 0], np.zeros((len(feet), 2))]))
        spread = self.feet_covariance * (view.map.scale**2)[:, None, None]
        spread[:, :, 0, 0] += unsure[:, :WIDTH]
        # rows of the picture, in its middle column, are moved and scaled, and heights are scaled
        middle = np.array([[0.5 * self.size[1], self.middle, 0.0, 0.0]])
        below = (self.middle - view.map.boxes(middle)[0, FOOT_Y]) / linear[1, 1]
        change = np.eye(len(self.scene))
        change[:2, :2] = down * np.array([[1.0, below], [0.0, 1 / linear[1, 1]]])
        scene, covariance = change @ self.scene, change @ self.scene_covariance @ change.T
        covariance[0, 0] += scene[1] ** 2 * view.box_variances(middle)[0, FOOT_Y]
        return replace(
            self,
            scene=scene,
            scene_covariance=covariance,
            feet=feet,
            feet_covariance=spread,
            heights=down * self.heights,
            planes=PRIOR.copy(),
        )

    def design(self, below: Array, places: NDArray[np.intp], own: Array) -> Array:
        """Return the design `(n, 2 + n_objects)` of heights by `scene`, for feet `below` the middle row.

        An object's own share is of `own` px (see `usual_heights`).
        """
        design = np.zeros((len(below), len(self.scene)))
        design[:, 0], design[:, 1] = 1.0, below
        design[np.arange(len(below)), 2 + places] = own
        return design

    def usual_heights(self, below: Array, heights: Array) -> Array:
        """Return the plane's heights px at these rows; the measured ones as long as it is unknown.

        An object's own share and all noise are scaled with it. The measured height comes in as little as can
        be: shares of hidden people's heights would let the plane sink while the shares grow.
        """
        covariance = self.scene_covariance
        variance = covariance[0, 0] + 2 * below * covariance[0, 1] + below**2 * covariance[1, 1]
        measured = np.maximum(heights, 1.0)
        share = 1 / (1 + variance / (HALF_HIDDEN * measured) ** 2)
        usual = measured + share * (self.scene[0] + self.scene[1] * below - measured)
        return np.asarray(np.maximum(usual, 0.25 * measured))

    def boxes(self, height_std: float, foot_std: float) -> GaussianMessage:
        """Return densities N(x) N(y) N(height; plane's at y) N(width; aspect * height) of all objects' boxes.

        Of the perspective, which all objects share, each gets its own marginal, with the slope at its mean.
        `height_std` and `foot_std` are those of `GroundPlane`.
        """
        count, slope, aspects, square = len(self.identities), self.scene[1], self.aspects, self.heights**2
        x, y = self.feet[:, :, 0].T
        design = self.design(y - self.middle, np.arange(count), self.heights)
        variance = ((design @ self.scene_covariance) * design).sum(axis=1)
        upright = design @ self.scene - slope * y
        feet = 1 / (self.feet_covariance[:, :, 0, 0] + (foot_std**2 * square)[:, None])
        of_width = 1 / ((self.aspect_variances + MIN_ASPECT_STD**2) * square)
        of_height = 1 / (1 + np.exp(-self.trust)) / (variance + height_std**2 * square)
        information, vector = np.zeros((count, BOX, BOX)), np.zeros((count, BOX))
        information[:, FOOT_X, FOOT_X] = feet[:, 0]
        information[:, FOOT_Y, FOOT_Y] = feet[:, 1] + slope**2 * of_height
        information[:, FOOT_Y, HEIGHT] = information[:, HEIGHT, FOOT_Y] = -slope * of_height
        information[:, WIDTH, WIDTH] = of_width
        information[:, WIDTH, HEIGHT] = information[:, HEIGHT, WIDTH] = -aspects * of_width
        information[:, HEIGHT, HEIGHT] = of_height + aspects**2 * of_width
        vector[:, FOOT_X] = feet[:, 0] * x
        vector[:, FOOT_Y] = feet[:, 1] * y - slope * of_height * upright
        vector[:, HEIGHT] = of_height * upright
        peak = np.log(feet).sum(axis=1) + np.log(of_width * of_height) - 4 * np.log(2 * np.pi)
        quadratic = feet[:, 0] * x**2 + feet[:, 1] * y**2 + of_height * upright**2
        return GaussianMessage(self.identities, information, vector, 0.5 * (peak - quadratic))


@checked
@short_repr
@dataclass(frozen=True)
class GroundPlane:
    """Scene-level chain over the boxes of objects.

    Heights are a linear regression on the row of the feet, common to all objects, with an offset per object
    (a Kalman filter without dynamics, in the coordinates of the scene: people keep their size); feet have
    first-order dynamics. Observations are a mixture of inliers and outliers (half hidden, or not a person).
    It is not a `LinearGaussianChain`, since the regression correlates all objects, and height and foot share
    one mixture weight.

    Parameters
    ----------
    stature
        relative standard deviation of the sizes of people.
    height_std
        relative standard deviation of the height of one person (gait, irregular outlines).
    foot_std
        heights: standard deviation of the middle of the bottom edge around the true ground point.
    acceleration
        heights/s^2, standard deviation of the acceleration, with a correlation time of half a second.
    initial_velocity_std
        heights/s, standard deviation of the velocity of a new object.
    outliers
        share of observations that do not show a complete object.
    observation_time
        s after which an observation of the same object is independent: errors of outlines are correlated.
    max_coast_time
        s after which an object without observations ends.
    """

    stature: Positive = 0.1
    height_std: Positive = 0.05
    foot_std: Positive = 0.03
    acceleration: Positive = 0.5
    initial_velocity_std: Positive = 1.0
    outliers: Share = 0.1
    observation_time: Positive = 1.0
    max_coast_time: Positive = 3.0
    name: str = "ground"

    ports = (Port(ObjectBoxes),)

    def initial(self, frame: Frame) -> GroundState:
        """Return a state without objects, with a vague prior of the perspective."""
        height, width = frame.required_image().shape[:2]
        none = np.zeros(0)
        return GroundState(
            size=(height, width),
            variation=float(np.hypot(self.stature, self.height_std)),
            scene=np.array([0.25 * height, 0.3]),
            scene_covariance=np.diag([(0.5 * height) ** 2, 0.5**2]),
            all_aspects=np.array([1.0, 0.5, 0.3**2]),
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
        """Return the state `dt` seconds on: feet move by constant velocity and white acceleration."""
        if not state.identities.size:
            return state
        force = 0.5 * (self.acceleration * state.heights[:, None]) ** 2  # px^2/s^3: it lasts half a second
        feet, covariance = kinematic(2, dt).moved(state.feet, state.feet_covariance, force)
        return replace(state, feet=feet, feet_covariance=covariance, unseen=state.unseen + dt)

    def message(self, state: GroundState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage:
        """Return the densities of all objects' boxes and of a new object's (mu_{ground -> objects})."""
        newcomers = state.newcomers()
        if not len(state.identities):
            return BoxMessage(newcomers=newcomers)
        return BoxMessage(state.boxes(self.height_std, self.foot_std), newcomers=newcomers)

    def update(self, state: GroundState, incoming: Incoming) -> GroundState:
        """Return perspective and objects given the boxes of `incoming`."""
        message = incoming[ObjectBoxes]
        state = self._updated(state, message)
        if message.view is None or message.view.begins is None:
            return state
        return state.seen_by(message.view)

    def _updated(self, state: GroundState, message: BoxMessage) -> GroundState:
        identities, boxes, covariances = message.objects.moments
        state = self._with_births_and_deaths(state, identities, boxes)
        if not len(identities):
            return state
        whole = _are_whole(message.in_frame(boxes), state.size)
        places = places_of(state.identities, identities)
        if not len(message.existence):
            state = self._compared(state, boxes[whole], state.unseen[places][whole])
        exists = 1 / (1 + np.exp(-message.existence.of(identities))) if len(message.existence) else 1.0
        return self._observed(state, places, boxes, covariances, whole, exists)

    def _compared(self, state: GroundState, boxes: Array, unseen: Array) -> GroundState:
        """The state after boxes `(n, 4)` px that may show parts of objects, of any height up to theirs.

        A plane that was learned of parts takes what is whole for an outlier. So all planes are compared, and
        it begins anew where the likeliest ones are others.
        """
        if not len(boxes):
            return state
        rows, feet, height = state.size[0], boxes[:, FOOT_Y], boxes[:, HEIGHT, None]
        usual = np.maximum(FOOT_HEIGHTS * rows - SLOPES * (rows - feet[:, None]), LEAST * rows)
        off = (height - usual) / usual / state.variation
        whole = np.exp(-0.5 * off**2) / (math.sqrt(2 * math.pi) * state.variation * usual)
        density = (1 - PART - OTHER) * whole + PART * (height < usual) / usual
        density += OTHER / (height * HEIGHTS)
        planes = state.planes + np.minimum(unseen / self.observation_time, 1.0) @ np.log(density)
        state = replace(state, planes=planes - planes.max())

        share = np.exp(state.planes) / np.exp(state.planes).sum()
        mean = np.log(usual) @ share
        variance = np.log(usual) ** 2 @ share - mean**2 + CELL**2
        height, deviation = state.expected_height(feet)
        height = np.maximum(height, LEAST * rows)
        apart = (np.log(height) - mean) ** 2 / (variance + (deviation / height) ** 2)
        return state if np.median(apart) < UNALIKE**2 else self._begun_anew(state, share)

    def _begun_anew(self, state: GroundState, share: Array) -> GroundState:
        """The state with a plane by the probabilities `share` of all, on which objects are as if new."""
        rows, count = state.size[0], len(state.scene)
        lines = np.stack([rows * (FOOT_HEIGHTS - 0.5 * SLOPES), SLOPES])
        scene, covariance = np.zeros(count), self.stature**2 * np.eye(count)
        scene[:2] = lines @ share
        lines -= scene[:2, None]
        between = 0.5 * CELL * np.array([rows * (FOOT_HEIGHTS @ share), 1.0])
        covariance[:2, :2] = (share * lines) @ lines.T + np.diag(between**2)
        trust = np.full(len(state.trust), INITIAL_TRUST)
        return replace(state, scene=scene, scene_covariance=covariance, trust=trust)

    def _observed(
        self,
        state: GroundState,
        places: NDArray[np.intp],
        boxes: Array,
        covariances: Array,
        whole: NDArray[np.bool_],
        exists: Array | float,
    ) -> GroundState:
        """The state given boxes `(n, 4)` px of different objects, each weighed by its prediction."""
        below, height, slope = boxes[:, FOOT_Y] - state.middle, boxes[:, HEIGHT], state.scene[1]
        own = state.usual_heights(below, height)
        design = state.design(below, places, own)
        off, known = height - design @ state.scene, design @ state.scene_covariance @ design.T
        # variance of the height less what an error of the foot's row would change it by along the plane
        noise = covariances[:, HEIGHT, HEIGHT] + (self.height_std * own) ** 2
        noise += slope * (slope * covariances[:, FOOT_Y, FOOT_Y] - 2 * covariances[:, FOOT_Y, HEIGHT])
        ratio = _good_over_bad(off**2, known.diagonal() + noise, (HALF_HIDDEN * own) ** 2)
        good = self._probability_of_good(ratio)
        on_plane = exists / (1 + np.exp(-state.trust[places]))
        worth = np.clip(state.unseen[places] / self.observation_time, 1e-6 / self.observation_time, 1.0)
        weight = whole * on_plane * good * worth

        gain = np.linalg.solve(
            known + np.diag(noise / np.maximum(weight, MIN_WORTH)), design @ state.scene_covariance
        )
        scene_covariance = state.scene_covariance - state.scene_covariance @ design.T @ gain
        surprise = np.log((1 - self.outliers) * ratio + self.outliers)
        trust = np.clip(state.trust[places] + whole * worth * surprise, -MAX_TRUST, MAX_TRUST)
        aspect = boxes[:, WIDTH] / np.maximum(height, 1.0)
        rate, change = 0.3 * whole * good * worth, aspect - state.aspects[places]
        variance = (1 - rate) * (state.aspect_variances[places] + rate * change**2)
        feet, feet_covariance = self._updated_feet(
            state, places, boxes, covariances, own, whole * (1 - on_plane * (1 - good)), worth
        )
        apart = aspect - state.all_aspects[1]
        moments = weight.sum(), (weight * apart).sum(), (weight * apart**2).sum()
        return replace(
            state,
            scene=state.scene + off @ gain,
            scene_covariance=0.5 * (scene_covariance + scene_covariance.T),
            all_aspects=_pooled(state.all_aspects, *moments),
            feet=_put(state.feet, places, feet),
            feet_covariance=_put(state.feet_covariance, places, feet_covariance),
            heights=_put(state.heights, places, own),
            aspects=_put(state.aspects, places, state.aspects[places] + rate * change),
            aspect_variances=_put(state.aspect_variances, places, variance),
            trust=_put(state.trust, places, trust),
            unseen=_put(state.unseen, places, np.zeros(len(places))),
        )

    def _updated_feet(
        self,
        state: GroundState,
        places: NDArray[np.intp],
        boxes: Array,
        covariances: Array,
        heights: Array,
        reliable: Array,
        worth: Array,
    ) -> tuple[Array, Array]:
        """Feet and their covariances after observations that show them as likely as `reliable` `(n,)`.

        What hides feet does so for a while: of their row they are `worth` `(n,)` a part of a new one.
        """
        noise = covariances.diagonal(axis1=1, axis2=2)[:, :WIDTH] + ((self.foot_std * heights) ** 2)[:, None]
        hidden = (1 - reliable) * (HALF_HIDDEN * boxes[:, [WIDTH, HEIGHT]].T) ** 2
        hidden[FOOT_Y] /= worth
        noise = noise + hidden.T
        feet, covariance = state.feet[places], state.feet_covariance[places]
        off = boxes[:, :WIDTH] - feet[:, :, 0]
        total = covariance[:, :, 0, 0] + noise
        # People do not jump: a box that does has lost its object, or part of it.
        ratio = _good_over_bad(off**2, total, heights[:, None] ** 2).prod(axis=1)
        doubt = 1 / np.maximum(self._probability_of_good(ratio), 1e-3) - 1
        gain = covariance[:, :, 0] / (total + noise * doubt[:, None])[:, :, None]
        after = covariance - gain[:, :, :, None] * covariance[:, :, None, 0]
        return feet + gain * off[:, :, None], after

    def _probability_of_good(self, ratio: Array) -> Array:
        odds = ratio * (1 / self.outliers - 1)
        return odds / (1 + odds)

    def _with_births_and_deaths(
        self, state: GroundState, identities: NDArray[np.int64], boxes: Array
    ) -> GroundState:
        """The state without objects that have ended, and with new ones."""
        place, is_known = find(state.identities, identities)
        stays, new = state.unseen <= self.max_coast_time, ~is_known
        stays[place[is_known]] = True
        if stays.all() and not new.any():
            return state
        turnover = Turnover.between(state.identities, stays, identities[new])
        heights, n_new, n_stay = boxes[new, HEIGHT], int(new.sum()), int(stays.sum())
        heights = np.maximum(heights, 1.0)
        feet = np.zeros((n_new, 2, 2))
        feet[:, :, 0] = boxes[new, :WIDTH]
        feet_covariance = np.zeros((n_new, 2, 2, 2))
        feet_covariance[:, :, 0, 0] = (10 * heights[:, None]) ** 2
        feet_covariance[:, :, 1, 1] = (self.initial_velocity_std * heights[:, None]) ** 2
        among = np.concatenate([[True, True], stays])
        scene = np.concatenate([state.scene[among], np.zeros(n_new)])
        covariance = np.zeros((2 + n_stay + n_new, 2 + n_stay + n_new))
        covariance[: 2 + n_stay, : 2 + n_stay] = state.scene_covariance[np.ix_(among, among)]
        covariance[range(2 + n_stay, len(scene)), range(2 + n_stay, len(scene))] = self.stature**2
        kept = np.concatenate([[0, 1], 2 + turnover.order])
        return replace(
            state,
            scene=scene[kept],
            scene_covariance=covariance[np.ix_(kept, kept)],
            identities=turnover.identities,
            feet=turnover.rows(state.feet, feet),
            feet_covariance=turnover.rows(state.feet_covariance, feet_covariance),
            heights=turnover.rows(state.heights, heights),
            aspects=turnover.rows(state.aspects, boxes[new, WIDTH] / heights),
            aspect_variances=turnover.rows(state.aspect_variances, 0.1**2),
            trust=turnover.rows(state.trust, INITIAL_TRUST),
            unseen=turnover.rows(state.unseen, self.observation_time),
        )


def _pooled(moments: Array, added: float, off: float, squares: float) -> Array:
    """Weight, mean and variance with further observations; the last `MOST_ASPECTS` count.

    `off` and `squares` are weighted sums of the differences from the mean and of their squares.
    """
    weight, mean, variance = moments.tolist()
    share = added / (weight + added)
    shift = share * off / max(added, 1e-9)
    variance = (1 - share) * variance + share * squares / max(added, 1e-9) - shift**2
    return np.array([min(weight + added, MOST_ASPECTS), mean + shift, variance])


def _good_over_bad(square: Array, variance: Array, more: Array) -> Array:
    """Likelihood ratio of two Gaussians about the same mean, the second one with `more` variance."""
    bad = variance + more
    ratio = np.sqrt(bad / variance) * np.exp(-0.5 * square * (1 / variance - 1 / bad))
    return np.asarray(np.maximum(ratio, 1e-30))


def _are_whole(boxes: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """`(n,)`: whether the picture's edge does not cut off a box."""
    x, y, width, height = boxes.T
    inside = (y - height > 1) & (y < size[0] - 1)
    return np.asarray(inside & (x - 0.5 * width > 1) & (x + 0.5 * width < size[1] - 1))


def _put(values: Array, places: NDArray[np.intp], new: Array) -> Array:
    """A copy of the values with others at some places."""
    copy = values.copy()
    copy[places] = new
    return copy
