"""Tracker of head and hands in the picture, by several hypotheses of what is what (RSMCM §4.1).

It knows nothing of bodies but that hands are within an arm's length of the shoulders. Alone it coasts where a
hand is not seen, and tells left from right only by how they move; a chain of whole bodies over the same
feature knows better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...models.body.parts import FALSE_HANDS, BodyParts, PartMessage
from ...models.body.upper_body import UpperBody
from ...models.core.frame import Frame
from ...models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures, log_sums
from ...models.core.short_repr import short_repr
from .fixed_lag import FleshTrajectory, filtered, predicted_messages
from .flesh_assignment import (
    VISIBLE,
    Answers,
    MovingParts,
    PartOptions,
    Things,
    log_joint_overlaps,
    log_overlaps,
    log_sides,
    ratios_beside,
)
from .flesh_state import HANDS, HEAD, Clutter, ClutterMatch, FleshTracks, anywhere, within_reach

Array = NDArray[np.float64]

EXCHANGE_TIME = 60.0  # s, time constant with which it is forgotten which hand is which
MOST_TRUST = 0.8  # however long it goes well, the tracker may be wrong about a part, as others are told
LEAST_PROBABILITY = 1e-6  # that a part is where it should be, or that it is not
HIDDEN_TIME = 0.28  # s for which a part is hidden on average
NEW_CLUTTER = 0.5  # of the false blobs in a picture: those that were not there before
DRIFT = 0.15  # head heights a root of a second, by which clutter moves

JITTER = 0.5
"""Hand radii: standard deviation with which clutter is found again. It is about that of a place at which a
hand is expected, or else a hand that rests would be clutter."""

BESIDE, ABOUT = 2.0, 0.6  # other things that a hand or face shows as; their deviation about it, hand radii
TOUCHING = 0.8  # hand radii: two places that are closer are one hand
WITHIN = 0.5  # hand radii: standard deviation, at least, of a part in a thing that it shares with another one
FACE_RADIUS = 0.42  # head heights: standard deviation of the window in which a face hides a hand
OWN_SHARE = 0.5  # of its own weights' logarithms, where another chain says how probable hypotheses are
FLATTENED = 0.5  # power of the weights that others are told


@short_repr
@dataclass(frozen=True)
class FleshTracker:
    """Low-level chain over head and hands.

    Each of up to 16 hypotheses says which thing in the picture was head, left and right hand all along. Given
    that, each part has a position x and a velocity v, z = (x, v), and may jump:

        p(z_t | z_t-1) = c N(z_t; A z_t-1, Q) + (1 - c) N(z_t; m, S),    c = exp(-dt / patience)
        p(F | X)       = sum_h w_h prod_part delta(F_part - x_h,part)

    A and Q are those of a velocity that is an Ornstein-Uhlenbeck process: hands stop. m and S are anywhere in
    reach. Hands are hidden for a while, or behind something, and exchange their states at a slow rate. What
    is no part is clutter, which stays where it is, or new. In every frame each hypothesis goes on in all
    ways to assign the detections; weights add up what each of them makes of the pictures, and the best are
    kept.

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
    """

    body: UpperBody
    hand_speed: float = 2.5
    head_speed: float = 0.7
    velocity_time: float = 0.3
    patience: float = 2.0
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
            patience=self.patience,
            log_weights=np.zeros(1),
            means=np.zeros((1, 3, 4)),
            covariances=np.zeros((1, 3, 4, 4)),
            visible=np.full((1, 3), VISIBLE),
            since=np.full((1, 3), np.inf),
            things=np.full((1, 3), NO_LABEL, np.int64),
            clutter=Clutter.none(1),
        )
        lost = self._anywhere(nothing)
        return replace(nothing, means=lost.means, covariances=lost.covariances)

    def predict(self, state: FleshTracks, dt: float) -> FleshTracks:
        """Parts move on, but for random pushes; what was hidden may be visible again, and the other way."""
        parts = MovingParts(state.means, state.covariances).moved(dt, self._speeds, self.velocity_time)
        forgotten = np.exp(-dt / (HIDDEN_TIME * VISIBLE))
        return replace(
            state,
            means=parts.means,
            covariances=parts.covariances,
            visible=VISIBLE + (state.visible - VISIBLE) * forgotten,
            since=state.since + dt,
            clutter=state.clutter.moved(dt, DRIFT * self.body.head_height),
            elapsed=state.elapsed + dt,
        )

    def message(self, state: FleshTracks, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Where each part should be under each hypothesis (mu_{X -> F}) or, as far as that is not trusted,
        anywhere in reach. It integrates to 1.

        Weights are flattened. Each of two chains that see the same pictures has gathered what all of them
        say; multiplied with each other in every frame, it would count again and again.
        """
        state = within_reach(state, self._anywhere(state)).exchanged_now_and_then(EXCHANGE_TIME)
        lost, trust = self._anywhere(state), MOST_TRUST * state.trust
        shares = np.log(np.maximum(np.stack([trust, 1 - trust], axis=2), LEAST_PROBABILITY)).reshape(-1, 2)
        means, spreads = (
            np.stack(both, axis=2).reshape(*shares.shape, *both[0].shape[2:])
            for both in (
                (state.means[..., :2], lost.means[..., :2]),
                (state.covariances[..., :2, :2], lost.covariances[..., :2, :2]),
            )
        )
        no_labels = np.full(shares.shape, NO_LABEL, np.int64)
        mixtures = GaussianMixtures(shares, means, spreads, np.zeros(shares.shape, np.bool_), no_labels)
        flat = FLATTENED * state.log_weights
        return PartMessage(mixtures, None, flat - log_sums(flat))

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: FleshTrajectory | None = None
    ) -> Smoothed[FleshTrajectory]:
        """Parts in all frames, forwards, given what other chains say with hindsight."""
        tracks = [state for _, state, _ in filtered(self, incoming_over_time)]
        times = np.array([incoming.time for incoming in incoming_over_time])
        return Smoothed(FleshTrajectory(tracks, times))

    def messages(
        self,
        trajectory: FleshTrajectory,
        feature: BodyParts,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PartMessage]:
        """Where each part should be, by the frames before (mu_{X -> F})."""
        return predicted_messages(self, trajectory.tracks, trajectory.times, feature)

    def update(self, state: FleshTracks, incoming: Incoming) -> FleshTracks:
        """Hypotheses go on in all ways in which they explain the picture, of which the best are kept.

        Other chains are not followed themselves, as the product of messages would have it: a chain of poses
        predicts from the same pictures that the parts have been seen in, and a part that nothing confirms
        would grow ever surer. They decide between hypotheses: each weighs as much as it overlaps with what
        they say, which holds what they know of the past; of its own weight, a root is left, since it is of
        the same pictures.
        """
        message = incoming[BodyParts]
        things = Things.of(None if message.image is None else message.image.mixtures, 3)
        heard = bool(message.stacked.informative.any())
        if not len(things.labels) and not heard:
            return replace(state, things=np.full_like(state.things, NO_LABEL))
        state = within_reach(state, self._anywhere(state)).exchanged_now_and_then(EXCHANGE_TIME)
        with_head = self._with_head_seen(state, things)
        went_on, elsewhere = MovingParts(state.means, state.covariances), self._anywhere(with_head)
        of_hands = np.asarray(np.isfinite(things.log_ratios[HANDS]).any(axis=0))
        radii = np.where(of_hands, self.body.hand, FACE_RADIUS * self.body.head_height)
        options = PartOptions.of(went_on, elsewhere, state.trust, state.visible, things, radii)
        clutter, beside = self._clutter(state, things, of_hands)

        k = len(things.labels)
        masses = options.log_masses.copy()
        masses[:, HANDS, :k] -= np.log(NEW_CLUTTER)
        right = things.means[:, 0] - with_head.means[:, HEAD, :1]
        masses[:, HANDS, :k] += log_sides(right, state.since[:, HANDS], self.body.shoulder_width)
        own = (OWN_SHARE if heard else 1.0) * state.log_weights + clutter.log_absent
        fit = log_overlaps(options, message) if heard else np.zeros(masses.shape)
        close = np.linalg.norm(things.means[:, None] - things.means, axis=2) < TOUCHING * self.body.hand
        close &= of_hands & of_hands[:, None]
        answers = Answers.best(own, masses + fit, clutter.log_known, clutter.gains, beside, close)
        parts, log_weights = answers.parts(options, went_on, elsewhere), answers.log_masses
        if heard:
            chosen = answers.hypotheses[:, None], np.arange(3), answers.options
            log_weights = log_weights - fit[chosen].sum(axis=1) + log_joint_overlaps(parts, message)
        return self._after(state, things, answers, parts, clutter, log_weights).reduced(self.body.hand)

    def _after(
        self,
        state: FleshTracks,
        things: Things,
        answers: Answers,
        parts: MovingParts,
        clutter: ClutterMatch,
        log_weights: Array,
    ) -> FleshTracks:
        """The state with a hypothesis for every answer."""
        k = len(things.labels)
        seen, hidden = answers.options < k, answers.options > k
        labels = answers.labels(things)
        shared = ((labels[:, :, None] == labels[:, None]) & (labels != NO_LABEL)[:, None]).sum(axis=2) > 1
        # Where in a thing a part is that shares it does not become clearer with more pictures.
        narrower = (WITHIN * self.body.hand) ** 2 - 0.5 * np.trace(
            parts.covariances[..., :2, :2], axis1=-2, axis2=-1
        )
        narrower = np.where(shared | hidden, np.maximum(narrower, 0.0), 0.0)
        covariances = parts.covariances.copy()
        covariances[..., :2, :2] += narrower[..., None, None] * np.eye(2)
        before = state.take(answers.hypotheses)
        missed = before.visible * (1 - things.chances) / (1 - before.visible * things.chances)
        hands = np.where(seen[..., None], parts.means[..., :2], np.nan)[:, HANDS]
        return replace(
            before,
            log_weights=log_weights,
            means=parts.means,
            covariances=covariances,
            visible=np.where(seen, 1.0, np.where(hidden, before.visible, missed)),
            since=np.where(seen | hidden, 0.0, before.since),
            things=labels,
            clutter=clutter.updated(answers.hypotheses, hands, self.body.hand),
            elapsed=0.0,
        )

    def _with_head_seen(self, state: FleshTracks, things: Things) -> FleshTracks:
        """The same with each hypothesis' most probable head after the picture, which hands are about."""
        rows, k = np.arange(len(state.log_weights)), len(things.labels)
        head, lost = slice(HEAD, HEAD + 1), self._anywhere(state)
        options = PartOptions.of(
            MovingParts(state.means[:, head], state.covariances[:, head]),
            MovingParts(lost.means[:, head], lost.covariances[:, head]),
            state.trust[:, head],
            state.visible[:, head],
            things.take([HEAD]),
            np.ones(k),
        )
        best = options.log_masses[:, 0, : k + 1].argmax(axis=1)
        case = options.shares[rows, 0, :, best].argmax(axis=1)
        means, covariances, since = state.means.copy(), state.covariances.copy(), state.since.copy()
        means[:, HEAD, :2] = options.means[rows, 0, case, best]
        covariances[:, HEAD, :2, :2] = options.covariances[rows, 0, case, best]
        since[:, HEAD] = np.where(best < k, 0.0, since[:, HEAD])
        return replace(state, means=means, covariances=covariances, since=since)

    def _clutter(
        self, state: FleshTracks, things: Things, of_hands: NDArray[np.bool_]
    ) -> tuple[ClutterMatch, Array]:
        """What things are if they are no part: clutter, or more of some part (`ratios_beside`)."""
        hand, head = self.body.hand, self.body.head_height
        densities = np.where(of_hands, NEW_CLUTTER * FALSE_HANDS / (state.size[0] * state.size[1]), np.inf)
        variances = 0.5 * np.trace(things.covariances, axis1=1, axis2=2)
        match = ClutterMatch.of(state.clutter, things.means, variances, densities, JITTER * hand)
        radii = np.array([FACE_RADIUS * head, ABOUT * hand, ABOUT * hand])
        return match, ratios_beside(things.means, radii, BESIDE, densities)

    @property
    def _speeds(self) -> Array:
        return self.body.head_height * np.array([self.head_speed, self.hand_speed, self.hand_speed])

    def _anywhere(self, state: FleshTracks) -> MovingParts:
        """Parts of which nothing is known."""
        heads = MovingParts(state.means[:, HEAD], state.covariances[:, HEAD])
        return anywhere(self.body, state.size, self._speeds, heads, state.trust[:, HEAD])
