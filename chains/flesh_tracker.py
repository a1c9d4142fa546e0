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

from ..inference.body.flesh_tracks import HANDS, HEAD, LEFT, RIGHT, FleshTracks
from ..inference.body.part_assignment import Assignment, PartChoices
from ..inference.body.part_filter import MovingParts, PartPosterior
from ..inference.core.protocols import Incoming, Port
from ..models.body.part_message import PartMessage
from ..models.body.parts import BodyParts
from ..models.body.upper_body import UpperBody
from ..models.core.frame import Frame
from ..models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures
from ..models.core.short_repr import short_repr

Array = NDArray[np.float64]

HANDS_BELOW = 0.25
"""Of an arm's length: how far below the shoulder the middle of the places is where a hand may be."""

EXCHANGE_TIME = 60.0
"""s, time constant with which it is forgotten which hand is which: they may be exchanged unnoticed."""

LEAST_EXCHANGED, MOST_TRUST = 0.01, 0.8
"""However long it goes well, the tracker may be wrong about a part, or about which hand is which."""

LEAST_PROBABILITY = 1e-6
"""That a part is where it should be, or that it is not."""


@short_repr
@dataclass(frozen=True)
class FleshTracker:
    """Low-level chain over head and hands.

    Each part has a position x and a velocity v in the picture, z = (x, v), and may jump:

        p(z_t | z_t-1) = c N(z_t; A z_t-1, Q) + (1 - c) N(z_t; m, S),    c = exp(-dt / patience)
        p(F | X)       = prod_part delta(F_part - x_part)

    A and Q are those of a velocity that is an Ornstein-Uhlenbeck process: hands stop. m and S are anywhere in
    reach. Besides, the hands exchange their states at a slow rate. Detections in the picture are assigned to
    parts, which follow what they are assigned; a part may be missing. The message to F is the prediction of
    its parts' positions.

    Parameters
    ----------
    body
        whose head's height is the unit of length, and whose arms are the reach of the hands.
    hand_speed, head_speed
        head heights/s, standard deviation of a velocity's components in the long run.
    velocity_time
        s, time constant of velocities.
    patience
        s, time constant of the trust in a part that nothing confirms; after so long it is lost.
    hiding
        nats by which a part is more probably not seen where another one is than elsewhere.
    """

    body: UpperBody
    hand_speed: float = 2.5
    head_speed: float = 0.7
    velocity_time: float = 0.3
    patience: float = 1.0
    hiding: float = 1.5
    name: str = "flesh"

    ports = (Port(BodyParts),)

    def __post_init__(self) -> None:
        for name in ("hand_speed", "head_speed", "velocity_time", "patience"):
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
        """Parts move on, but for random pushes; trust fades."""
        parts = MovingParts(state.means, state.covariances).moved(dt, self._speeds, self.velocity_time)
        return replace(
            state,
            means=parts.means,
            covariances=parts.covariances,
            trust=state.trust * np.exp(-dt / self.patience),
            exchanged=0.5 + (state.exchanged - 0.5) * float(np.exp(-dt / EXCHANGE_TIME)),
            unseen=state.unseen + dt,
        )

    def message(self, state: FleshTracks, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Where each part should be (mu_{X -> F}) or, as far as that is not trusted, anywhere in reach.

        Hands that may be exchanged are at both places. It integrates to 1.
        """
        state = self._within_reach(state)
        anywhere, other = self._anywhere(state), state.exchanged_hands
        # of each hand on its own, so that the pair of them is exchanged with this probability
        swapped = np.sqrt(max(state.exchanged, LEAST_EXCHANGED))
        sure, other_sure = state.trust, other.trust
        own_share, other_share = sure * (1 - swapped), other_sure * swapped
        own_share[HEAD], other_share[HEAD] = sure[HEAD], 0.0
        shares = np.stack([own_share, other_share, 1 - own_share - other_share], axis=1)
        places = (state.means, other.means, anywhere.means)
        spreads = (state.covariances, other.covariances, anywhere.covariances)
        mixtures = GaussianMixtures.of_parts(
            list(np.log(np.maximum(shares, LEAST_PROBABILITY**2))),
            list(np.stack(places, axis=1)[..., :2]),
            list(np.stack(spreads, axis=1)[..., :2, :2]),
        )
        return PartMessage(mixtures)

    def update(self, state: FleshTracks, incoming: Incoming) -> FleshTracks:
        """Parts that are assigned something in the picture follow it, others coast.

        Other chains decide what is assigned to which part, and whether the hands are exchanged. They are not
        followed themselves, as the product of messages would have it: a chain of poses predicts from the same
        pictures that the parts have been seen in, and a part that nothing confirms would grow ever surer.
        """
        message = incoming[BodyParts]
        state = self._within_reach(state)
        kept, swapped = (_Hypothesis.of(self, each, message) for each in (state, state.exchanged_hands))
        log_odds = float(logit(max(state.exchanged, LEAST_PROBABILITY)))
        log_odds += float((swapped.best.log_masses - kept.best.log_masses).sum())
        better = swapped if log_odds > 0 else kept
        return better.updated(float(expit(-abs(log_odds))))

    def posterior(
        self, state: FleshTracks, detections: GaussianMixtures, others: GaussianMixtures
    ) -> PartPosterior:
        """Where parts should be, or anywhere, times what is detected; other chains weigh it."""
        own = MovingParts(state.means, state.covariances)
        trust = np.clip(state.trust, LEAST_PROBABILITY, 1 - LEAST_PROBABILITY)
        log_shares = np.log(trust), np.log1p(-trust)
        return PartPosterior.of((own, self._anywhere(state)), log_shares, detections).weighed(others)

    @property
    def _speeds(self) -> Array:
        """`(3,)` px/s."""
        return self.body.head_height * np.array([self.head_speed, self.hand_speed, self.hand_speed])

    def _within_reach(self, state: FleshTracks) -> FleshTracks:
        """The same, in which a part of which less is known than that it is in reach may be anywhere there."""
        anywhere = self._anywhere(state)
        own, reach = (np.linalg.det(each.covariances[:, :2, :2]) for each in (state, anywhere))
        forgotten = own > reach
        return replace(
            state,
            means=np.where(forgotten[:, None], anywhere.means, state.means),
            covariances=np.where(forgotten[:, None, None], anywhere.covariances, state.covariances),
        )

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
        means[HANDS, 1] = head[1] + body.neck + HANDS_BELOW * reach
        covariances[HANDS, :2, :2] = spread + 0.25 * reach**2 * np.eye(2)
        return MovingParts(means, covariances)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """What a picture and other chains say of parts, if the hands are as in the state."""

    tracker: FleshTracker
    state: FleshTracks
    detections: GaussianMixtures
    others: GaussianMixtures
    posterior: PartPosterior
    best: Assignment

    @classmethod
    def of(cls, tracker: FleshTracker, state: FleshTracks, message: PartMessage) -> Self:
        others, image = message.predicted, message.image
        detections = GaussianMixtures.uniform(others.n_parts) if image is None else image.mixtures
        posterior = tracker.posterior(state, detections, others)
        choices = PartChoices.of(posterior, detections, tracker.body.hand, tracker.hiding)
        return cls(tracker, state, detections, others, posterior, choices.best())

    def updated(self, exchanged: float) -> FleshTracks:
        """Parts follow what they are assigned; `exchanged`: probability that the hands are the other way."""
        state, detections, posterior, best = self.state, self.detections, self.posterior, self.best
        labels = best.labels
        assigned = labels != NO_LABEL
        shared = assigned & ((labels[:, None] == labels).sum(axis=1) > 1)
        within = self.tracker.body.hand**2 * np.eye(2)
        if shared.any():
            # Parts that are one thing are somewhere in it, not all in its middle.
            wider = detections.covariances + np.where(shared[:, None, None], within, 0.0)[:, None]
            posterior = self.tracker.posterior(state, replace(detections, covariances=wider), self.others)
        parts, located = posterior.assigned(labels)
        covariances = parts.covariances.copy()
        # Where in the thing a hidden part is does not become clearer with more pictures.
        narrower = self.tracker.body.hand**2 - 0.5 * np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
        narrower = np.where(best.hidden, np.maximum(narrower, 0.0), 0.0)
        covariances[:, :2, :2] += narrower[:, None, None] * np.eye(2)
        # The other hand may have been mistaken for this one just now.
        mistaken = 0.0
        if labels[LEFT] != labels[RIGHT]:
            mistaken = float(expit(-best.advantage(LEFT, RIGHT)))
        exchanged = exchanged + mistaken - 2 * exchanged * mistaken
        informed = detections.informative & np.isfinite(located)
        return replace(
            state,
            means=np.where(informed[:, None], parts.means, state.means),
            covariances=np.where(informed[:, None, None], covariances, state.covariances),
            trust=np.where(informed, np.minimum(located * best.shares, MOST_TRUST), state.trust),
            exchanged=min(exchanged, 0.5),
            unseen=np.where(assigned, 0.0, state.unseen),
            labels=labels,
        )
