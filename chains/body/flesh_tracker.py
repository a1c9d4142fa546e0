"""Multi-hypothesis tracker of head and hands in the image (RSMCM paper §4.1).

Its only model of the body is that hands are within an arm's length of the shoulders. Alone it coasts where a
hand is not detected, and tells left from right by their motion; a pose chain on the same feature adds the
rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...models.body.parts import FALSE_HANDS, BodyParts, PartMessage
from ...models.body.upper_body import UpperBody
from ...models.core.checks import Positive, PositiveOrInfinite, checked
from ...models.core.frame import Frame
from ...models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures, log_sums
from ...models.core.short_repr import short_repr
from .fixed_lag import FleshTrajectory, filtered, predicted_messages
from .flesh_assignment import (
    VISIBLE,
    JointAssignments,
    MovingParts,
    PartDetections,
    PartOptions,
    log_joint_overlaps,
    log_overlaps,
    log_sides,
    ratios_beside,
)
from .flesh_state import HANDS, HEAD, Clutter, ClutterMatch, FleshTracks, lost_parts, within_reach

Array = NDArray[np.float64]

EXCHANGE_TIME = 60.0  # s, time constant of exchanges of left and right hand
MOST_TRUST = 0.8  # probability in messages that a part is where the tracker has it, at most
LEAST_PROBABILITY = 1e-6  # of either case in messages
HIDDEN_TIME = 0.28  # s for which a part is hidden on average: 7 frames, as those of generated signers
NEW_CLUTTER = 0.5  # share of an image's false blobs that were not there before
DRIFT = 0.15  # head heights per square root of a second, by which clutter moves

JITTER = 0.5
"""Hand radii: standard deviation with which clutter is detected again; about that of the prediction of a
hand, so that a hand at rest is no clutter."""

BESIDE, ABOUT = 2.0, 0.6  # further detections of a hand or face; their standard deviation, hand radii
TOUCHING = 0.8  # hand radii: two detections that are closer are one hand
WITHIN = 0.5  # hand radii: standard deviation, at least, of a part that shares its detection with another one
FACE_RADIUS = 0.42  # head heights: standard deviation of the window in which a face hides a hand
OWN_SHARE = 0.5  # power of its own weights where another chain weighs the hypotheses
FLATTENED = 0.5  # power of the weights in messages


@checked
@short_repr
@dataclass(frozen=True)
class FleshTracker:
    """Multi-hypothesis tracker of head and hands in the image.

    Each of up to 16 hypotheses assigns all detections to head, left and right hand. Given this, each part has
    a position x and a velocity v, z = (x, v), and may jump:

        p(z_t | z_t-1) = c N(z_t; A z_t-1, Q) + (1 - c) N(z_t; m, S),    c = exp(-dt / max_coast_time)
        p(F | X)       = sum_h w_h prod_part delta(F_part - x_h,part)

    A and Q are those of an Ornstein-Uhlenbeck velocity, m and S the moments of all positions in reach. A part
    may be hidden, by itself or by another detection; hands exchange their states at a low rate. Other
    detections are static clutter, or new. In every frame each hypothesis is continued by all assignments of
    the detections, and the best are kept.

    Parameters
    ----------
    body
        its head height is the unit of length, its arms limit the reach of the hands.
    hand_speed, head_speed
        head heights/s, stationary standard deviation of each component of the velocity.
    velocity_time
        s, time constant of velocities.
    max_coast_time
        s, time constant of the probability that a part without detections has not jumped; after so long it
        is lost.
    """

    body: UpperBody
    hand_speed: Positive = 2.5
    head_speed: Positive = 0.7
    velocity_time: Positive = 0.3
    max_coast_time: PositiveOrInfinite = 2.0
    name: str = "flesh"

    ports = (Port(BodyParts),)

    def initial(self, frame: Frame) -> FleshTracks:
        """Return the prior of lost parts."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        height, width = frame.image.shape[:2]
        nothing = FleshTracks(
            size=(height, width),
            max_coast_time=self.max_coast_time,
            log_weights=np.zeros(1),
            means=np.zeros((1, 3, 4)),
            covariances=np.zeros((1, 3, 4, 4)),
            visible=np.full((1, 3), VISIBLE),
            since=np.full((1, 3), np.inf),
            detections=np.full((1, 3), NO_LABEL, np.int64),
            clutter=Clutter.none(1),
        )
        lost = self._lost_parts(nothing)
        return replace(nothing, means=lost.means, covariances=lost.covariances)

    def predict(self, state: FleshTracks, dt: float) -> FleshTracks:
        """Predict the state `dt` seconds ahead."""
        parts = MovingParts(state.means, state.covariances).predict(dt, self._speeds, self.velocity_time)
        forgotten = np.exp(-dt / (HIDDEN_TIME * VISIBLE))
        return replace(
            state,
            means=parts.means,
            covariances=parts.covariances,
            visible=VISIBLE + (state.visible - VISIBLE) * forgotten,
            since=state.since + dt,
            clutter=state.clutter.predict(dt, DRIFT * self.body.head_height),
            elapsed=state.elapsed + dt,
        )

    def message(self, state: FleshTracks, feature: BodyParts, incoming: Incoming) -> PartMessage:
        """Return the predicted positions under each hypothesis (mu_{X -> F}), which integrate to 1.

        Each part is a mixture of its prediction and the prior of lost parts. Weights are flattened: both
        chains have seen the same images, and their product would count these again in every frame. Nothing is
        said of the hands of bare arms, which the tracker does not tell from elbows.
        """
        state = within_reach(state, self._lost_parts(state)).with_exchanges(EXCHANGE_TIME)
        lost, trust = self._lost_parts(state), MOST_TRUST * state.trust
        trust[:, HANDS] *= 1 - feature.bare
        shares = np.log(np.maximum(np.stack([trust, 1 - trust], axis=2), LEAST_PROBABILITY)).reshape(-1, 2)
        means, covariances = (
            np.stack(both, axis=2).reshape(*shares.shape, *both[0].shape[2:])
            for both in (
                (state.means[..., :2], lost.means[..., :2]),
                (state.covariances[..., :2, :2], lost.covariances[..., :2, :2]),
            )
        )
        no_labels = np.full(shares.shape, NO_LABEL, np.int64)
        mixtures = GaussianMixtures(shares, means, covariances, np.zeros(shares.shape, np.bool_), no_labels)
        flat = FLATTENED * state.log_weights
        return PartMessage(mixtures, None, flat - log_sums(flat))

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: FleshTrajectory | None = None
    ) -> Smoothed[FleshTrajectory]:
        """Filter all frames, given the other chains' smoothed messages."""
        tracks = [state for _, state, _ in filtered(self, incoming_over_time)]
        times = np.array([incoming.time for incoming in incoming_over_time])
        return Smoothed(FleshTrajectory(tracks, times))

    def messages(
        self,
        trajectory: FleshTrajectory,
        feature: BodyParts,
        incoming_over_time: Sequence[BatchIncoming] = (),
    ) -> list[PartMessage]:
        """Return the predicted positions of the parts in each frame (mu_{X -> F})."""
        return predicted_messages(self, trajectory.tracks, trajectory.times, feature)

    def update(self, state: FleshTracks, incoming: Incoming) -> FleshTracks:
        """Continue each hypothesis by the assignments that explain the image best.

        Messages of other chains weight the hypotheses but do not move the parts: a pose chain predicts from
        the same images, and the certainty of an unseen part would grow. For the same reason the weights are
        flattened if there are such messages.
        """
        message = incoming[BodyParts]
        detections = PartDetections.from_mixtures(
            None if message.image is None else message.image.mixtures, 3
        )
        informed = bool(message.stacked.informative.any())
        if not len(detections.labels) and not informed:
            return replace(state, detections=np.full_like(state.detections, NO_LABEL))
        state = within_reach(state, self._lost_parts(state)).with_exchanges(EXCHANGE_TIME)
        with_head = self._with_head_detected(state, detections)
        continued, jumped = MovingParts(state.means, state.covariances), self._lost_parts(with_head)
        of_hands = np.asarray(np.isfinite(detections.log_ratios[HANDS]).any(axis=0))
        radii = np.where(of_hands, self.body.hand, FACE_RADIUS * self.body.head_height)
        options = PartOptions.of(continued, jumped, state.trust, state.visible, detections, radii)
        clutter, beside = self._clutter(state, detections, of_hands)

        k, places = len(detections.labels), detections.means
        masses = options.log_masses.copy()
        masses[:, HANDS, :k] -= np.log(NEW_CLUTTER)
        right = places[:, 0] - with_head.means[:, HEAD, :1]
        masses[:, HANDS, :k] += log_sides(right, state.since[:, HANDS], self.body.shoulder_width)
        own = (OWN_SHARE if informed else 1.0) * state.log_weights + clutter.log_absent
        fit = log_overlaps(options, message) if informed else np.zeros(masses.shape)
        close = np.linalg.norm(places[:, None] - places, axis=2) < TOUCHING * self.body.hand
        close &= of_hands & of_hands[:, None]
        best = JointAssignments.best(own, masses + fit, clutter.log_old, clutter.gains, beside, close)
        parts, log_weights = best.parts(options, continued, jumped), best.log_masses
        if informed:
            chosen = best.hypotheses[:, None], np.arange(3), best.options
            log_weights = log_weights - fit[chosen].sum(axis=1) + log_joint_overlaps(parts, message)
        return self._continued(state, detections, best, parts, clutter, log_weights).reduced(self.body.hand)

    def _continued(
        self,
        state: FleshTracks,
        detections: PartDetections,
        assignments: JointAssignments,
        parts: MovingParts,
        clutter: ClutterMatch,
        log_weights: Array,
    ) -> FleshTracks:
        """Return the state with one hypothesis for each assignment."""
        k = len(detections.labels)
        seen, hidden = assignments.options < k, assignments.options > k
        labels = assignments.labels(detections)
        shared = ((labels[:, :, None] == labels[:, None]) & (labels != NO_LABEL)[:, None]).sum(axis=2) > 1
        # the position within a shared detection does not become more certain with more images
        narrower = (WITHIN * self.body.hand) ** 2 - 0.5 * np.trace(
            parts.covariances[..., :2, :2], axis1=-2, axis2=-1
        )
        narrower = np.where(shared | hidden, np.maximum(narrower, 0.0), 0.0)
        covariances = parts.covariances.copy()
        covariances[..., :2, :2] += narrower[..., None, None] * np.eye(2)
        before, detected = state.take(assignments.hypotheses), detections.visible_probabilities
        missed = before.visible * (1 - detected) / (1 - before.visible * detected)
        hands = np.where(seen[..., None], parts.means[..., :2], np.nan)[:, HANDS]
        return replace(
            before,
            log_weights=log_weights,
            means=parts.means,
            covariances=covariances,
            visible=np.where(seen, 1.0, np.where(hidden, before.visible, missed)),
            since=np.where(seen | hidden, 0.0, before.since),
            detections=labels,
            clutter=clutter.updated(assignments.hypotheses, hands, self.body.hand),
            elapsed=0.0,
        )

    def _with_head_detected(self, state: FleshTracks, detections: PartDetections) -> FleshTracks:
        """Update the head of each hypothesis by its most probable detection: hands are in reach of it."""
        rows, k = np.arange(len(state.log_weights)), len(detections.labels)
        head, lost = slice(HEAD, HEAD + 1), self._lost_parts(state)
        options = PartOptions.of(
            MovingParts(state.means[:, head], state.covariances[:, head]),
            MovingParts(lost.means[:, head], lost.covariances[:, head]),
            state.trust[:, head],
            state.visible[:, head],
            detections.take([HEAD]),
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
        self, state: FleshTracks, detections: PartDetections, of_hands: NDArray[np.bool_]
    ) -> tuple[ClutterMatch, Array]:
        """Explain detections that are no part: by clutter, or as further ones of a part (`ratios_beside`)."""
        hand, head = self.body.hand, self.body.head_height
        densities = np.where(of_hands, NEW_CLUTTER * FALSE_HANDS / (state.size[0] * state.size[1]), np.inf)
        variances = 0.5 * np.trace(detections.covariances, axis1=1, axis2=2)
        match = ClutterMatch.of(state.clutter, detections.means, variances, densities, JITTER * hand)
        radii = np.array([FACE_RADIUS * head, ABOUT * hand, ABOUT * hand])
        return match, ratios_beside(detections.means, radii, BESIDE, densities)

    @property
    def _speeds(self) -> Array:
        return self.body.head_height * np.array([self.head_speed, self.hand_speed, self.hand_speed])

    def _lost_parts(self, state: FleshTracks) -> MovingParts:
        heads = MovingParts(state.means[:, HEAD], state.covariances[:, HEAD])
        return lost_parts(self.body, state.size, self._speeds, heads, state.trust[:, HEAD])
