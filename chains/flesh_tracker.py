"""Tracker of head and hands in the picture: a robust Kalman filter each (RSMCM §4.1).

It knows nothing of bodies but that hands are within an arm's length of the shoulders. Alone it coasts where a
hand is not seen, and tells left from right only by how they move; a chain of whole bodies over the same
feature knows better.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ..inference.body.part_assignment import Assignment, PartChoices
from ..inference.body.part_filter import MovingParts, PartPosterior
from ..inference.core.protocols import Incoming, Port
from ..models.body.parts import BodyParts, PartMessage
from ..models.body.upper_body import UpperBody
from ..models.core.frame import Frame
from ..models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures
from ..models.core.short_repr import short_repr

Array = NDArray[np.float64]

HEAD, LEFT, RIGHT = range(3)
HANDS = [LEFT, RIGHT]
EXCHANGED = [HEAD, RIGHT, LEFT]

LOWER = 0.25
"""Of an arm's length: how far below the shoulder the middle of the places is where a hand may be."""

UNNOTICED = 60.0
"""s, time constant with which it is forgotten which hand is which: they may be exchanged unnoticed."""

LEAST_EXCHANGED, MOST_TRUST = 0.01, 0.8
"""However long it goes well, the tracker may be wrong about a part, or about which hand is which."""

LEAST = 1e-6
"""Smallest probability that a part is where it should be, or that it is not."""


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTracks:
    """Head, left hand and right hand: where they are and how they move, each on its own.

    With probability `trust` a part is where its Gaussian says, otherwise anywhere in reach; and with
    probability `exchanged` each hand is where the other one's Gaussian says.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    means
        `(3, 4)`: x, y px and their velocities px/s.
    covariances
        `(3, 4, 4)`, in the same order.
    trust
        `(3,)` probabilities.
    exchanged
        probability, at most 0.5.
    unseen
        `(3,)` s since a part was last confirmed by something in the picture; infinite before the first time.
    labels
        `(3,)` int64: number of the thing in the last picture that a part was taken for, -1 for none.
    patience
        s after which a part that is not confirmed is lost.
    """

    size: tuple[int, int]
    means: Array
    covariances: Array
    trust: Array
    exchanged: float
    unseen: Array
    labels: NDArray[np.int64]
    patience: float

    @property
    def positions(self) -> Array:
        """`(3, 2)` px."""
        return self.means[:, :2]

    @property
    def position_covariances(self) -> Array:
        """`(3, 2, 2)` px^2."""
        return self.covariances[:, :2, :2]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """`(3,)`: parts that may be anywhere in reach, since nothing has confirmed them for too long."""
        return self.unseen > self.patience


@short_repr
@dataclass(frozen=True)
class FleshTracker:
    """Low-level chain over head and hands.

    A part's velocity is an Ornstein-Uhlenbeck process: hands stop. A part may besides jump to anywhere in
    reach, or be missing. Things in the picture are assigned to parts, which follow what they are taken for.

    Parameters
    ----------
    body
        whose head's height is the unit of length, and whose arms are the reach of the hands.
    hand_speed, head_speed
        head heights/s, standard deviation of a velocity's components in the long run.
    lasts
        s, time constant of velocities.
    patience
        s, time constant of the trust in a part that nothing confirms; after so long it is lost.
    hiding
        nats by which a part is more probably not seen where another one is than elsewhere.
    """

    body: UpperBody
    hand_speed: float = 2.5
    head_speed: float = 0.7
    lasts: float = 0.3
    patience: float = 1.0
    hiding: float = 1.5
    name: str = "flesh"

    ports = (Port(BodyParts),)

    def __post_init__(self) -> None:
        for name in ("hand_speed", "head_speed", "lasts", "patience"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")

    def initial(self, frame: Frame) -> FleshTracks:
        """Nothing known: parts are anywhere."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        height, width = frame.image.shape[:2]
        nothing = FleshTracks(
            size=(height, width),
            means=np.zeros((3, 4)),
            covariances=np.zeros((3, 4, 4)),
            trust=np.zeros(3),
            exchanged=0.0,
            unseen=np.full(3, np.inf),
            labels=np.full(3, NO_LABEL, np.int64),
            patience=self.patience,
        )
        anywhere = self._anywhere(nothing)
        return replace(nothing, means=anywhere.means, covariances=anywhere.covariances)

    def predict(self, state: FleshTracks, dt: float) -> FleshTracks:
        """Parts move on, but for random pushes; one that may be anywhere in reach is forgotten."""
        parts = MovingParts(state.means, state.covariances).moved(dt, self._speeds, self.lasts)
        moved = replace(
            state,
            means=parts.means,
            covariances=parts.covariances,
            trust=state.trust * np.exp(-dt / self.patience),
            exchanged=0.5 + (state.exchanged - 0.5) * float(np.exp(-dt / UNNOTICED)),
            unseen=state.unseen + dt,
        )
        anywhere = self._anywhere(moved)
        own, reach = (np.linalg.det(each.covariances[:, :2, :2]) for each in (parts, anywhere))
        forgotten = own > reach
        return replace(
            moved,
            means=np.where(forgotten[:, None], anywhere.means, parts.means),
            covariances=np.where(forgotten[:, None, None], anywhere.covariances, parts.covariances),
        )

    def message(self, state: FleshTracks, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Where each part should be (mu_{X -> F}) or, as far as that is not trusted, anywhere in reach.

        Hands that may be exchanged are at both places. It integrates to 1.
        """
        anywhere, other = self._anywhere(state), _exchanged(state)
        # of each hand on its own, so that the pair of them is exchanged with this probability
        swapped = np.sqrt(max(state.exchanged, LEAST_EXCHANGED))
        sure, other_sure = state.trust, other.trust
        own_share, other_share = sure * (1 - swapped), other_sure * swapped
        own_share[HEAD], other_share[HEAD] = sure[HEAD], 0.0
        shares = np.stack([own_share, other_share, 1 - own_share - other_share], axis=1)
        places = (state.means, other.means, anywhere.means)
        spreads = (state.covariances, other.covariances, anywhere.covariances)
        mixtures = GaussianMixtures.of_parts(
            list(np.log(np.maximum(shares, LEAST**2))),
            list(np.stack(places, axis=1)[..., :2]),
            list(np.stack(spreads, axis=1)[..., :2, :2]),
        )
        return PartMessage(mixtures)

    def update(self, state: FleshTracks, incoming: Incoming) -> FleshTracks:
        """Parts after a look: those that are taken for something in the picture follow it, others coast.

        Other chains decide what is taken for which part, and whether the hands are exchanged. They are not
        followed themselves, as the product of messages would have it: a chain of poses predicts from the same
        pictures that the parts have been seen in, and a part that nothing confirms would grow ever surer.
        """
        message = incoming[BodyParts]
        looks = _Look.at(self, state, message), _Look.at(self, _exchanged(state), message)
        log_odds = float(logit(max(state.exchanged, LEAST))) + float(
            (looks[1].best.log_masses - looks[0].best.log_masses).sum()
        )
        return looks[int(log_odds > 0)].followed(float(expit(-abs(log_odds))))

    def posterior(
        self, state: FleshTracks, seen: GaussianMixtures, others: GaussianMixtures
    ) -> PartPosterior:
        """What is known of parts: where they should be, or anywhere, times what is seen; others weigh it."""
        own = MovingParts(state.means, state.covariances)
        return PartPosterior.of((own, self._anywhere(state)), _log_shares(state), seen).weighed(others)

    @property
    def _speeds(self) -> Array:
        """`(3,)` px/s."""
        return self.body.head_height * np.array([self.head_speed, self.hand_speed, self.hand_speed])

    def _anywhere(self, state: FleshTracks) -> MovingParts:
        """Parts of which nothing is known: a head in the picture, hands in reach of their shoulders.

        Positions have the moments of a uniform distribution over the picture, and over a disc.
        """
        body, (height, width) = self.body, state.size
        means, covariances = np.zeros((3, 4)), np.zeros((3, 4, 4))
        covariances[:, 2:, 2:] = (self._speeds**2)[:, None, None] * np.eye(2)
        means[HEAD, :2] = 0.5 * width, 0.5 * height
        covariances[HEAD, :2, :2] = np.diag([width**2, height**2]) / 12
        trust, off = state.trust[HEAD], state.positions[HEAD] - means[HEAD, :2]
        head = means[HEAD, :2] + trust * off
        spread = trust * state.position_covariances[HEAD] + (1 - trust) * covariances[HEAD, :2, :2]
        spread = spread + trust * (1 - trust) * np.outer(off, off)
        reach = body.upper_arm + body.forearm
        # The person's own left is on the right of the picture.
        means[HANDS, 0] = head[0] + np.array([0.5, -0.5]) * body.shoulder_width
        means[HANDS, 1] = head[1] + body.neck + LOWER * reach
        covariances[HANDS, :2, :2] = spread + 0.25 * reach**2 * np.eye(2)
        return MovingParts(means, covariances)


@dataclass(frozen=True, eq=False)
class _Look:
    """What a picture and other chains say of parts, if the hands are not exchanged."""

    tracker: FleshTracker
    state: FleshTracks
    seen: GaussianMixtures
    others: GaussianMixtures
    known: PartPosterior
    best: Assignment

    @classmethod
    def at(cls, tracker: FleshTracker, state: FleshTracks, message: PartMessage) -> Self:
        others, image = message.predicted, message.image
        seen = GaussianMixtures.uniform(others.n_parts) if image is None else image.mixtures
        known = tracker.posterior(state, seen, others)
        choices = PartChoices.of(known, seen, tracker.body.hand, tracker.hiding)
        return cls(tracker, state, seen, others, known, choices.best())

    def followed(self, exchanged: float) -> FleshTracks:
        """Parts that follow what they are taken for; before, hands were `exchanged` with this probability."""
        state, seen, known, best = self.state, self.seen, self.known, self.best
        labels = best.labels
        taken = labels != NO_LABEL
        shared = taken & ((labels[:, None] == labels).sum(axis=1) > 1)
        within = self.tracker.body.hand**2 * np.eye(2)
        if shared.any():
            # Parts that are one thing are somewhere in it, not all in its middle.
            wider = seen.covariances + np.where(shared[:, None, None], within, 0.0)[:, None]
            known = self.tracker.posterior(state, replace(seen, covariances=wider), self.others)
        parts, located = known.taken_for(labels)
        covariances = parts.covariances.copy()
        # Where in the thing a hidden part is does not become clearer by looking again.
        narrower = self.tracker.body.hand**2 - 0.5 * np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
        narrower = np.where(best.hidden, np.maximum(narrower, 0.0), 0.0)
        covariances[:, :2, :2] += narrower[:, None, None] * np.eye(2)
        # The other hand may have been taken for this one just now.
        mistaken = 0.0
        if labels[LEFT] != labels[RIGHT]:
            mistaken = float(expit(-best.advantage(LEFT, RIGHT)))
        exchanged = exchanged + mistaken - 2 * exchanged * mistaken
        heard = seen.informative & np.isfinite(located)
        return replace(
            state,
            means=np.where(heard[:, None], parts.means, state.means),
            covariances=np.where(heard[:, None, None], covariances, state.covariances),
            trust=np.where(heard, np.minimum(located * best.shares, MOST_TRUST), state.trust),
            exchanged=min(exchanged, 0.5),
            unseen=np.where(taken, 0.0, state.unseen),
            labels=labels,
        )


def _exchanged(state: FleshTracks) -> FleshTracks:
    """The same with the hands exchanged."""
    return replace(
        state,
        means=state.means[EXCHANGED],
        covariances=state.covariances[EXCHANGED],
        trust=state.trust[EXCHANGED],
        unseen=state.unseen[EXCHANGED],
    )


def _log_shares(state: FleshTracks) -> tuple[Array, Array]:
    """Logs of the probabilities that parts are where they should be, and that they are anywhere."""
    trust = np.clip(state.trust, LEAST, 1 - LEAST)
    return np.log(trust), np.log1p(-trust)
