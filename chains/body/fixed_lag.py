"""Fixed-lag smoothing of poses: backward simulation, and Metropolis moves of the trajectories.

Backward simulation alone (Godsill, Doucet, West 2004) chooses among poses that a filter has drawn: too few in
so many dimensions. Bunch and Godsill, "Improved particle approximations to the joint smoothing distribution
using Markov chain Monte Carlo" (2013), move each pose x_t where it is

    p(x_t | x_t+1, I_1..t) ~ p(x_t | I_1..t-1) p(I_t | x_t) p(x_t+1 | x_t)
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...inference import Belief, RecursiveBP
from ...inference.engine.protocols import BatchIncoming, Chain, Incoming
from ...inference.engine.recursive_bp import RunState
from ...inference.smc import copied, normalised, systematic
from ...models.body.image_features import BodyImage
from ...models.body.parts import BodyParts, PartMessage
from ...models.body.upper_body import BodyPoses
from ...models.core.checks import CountFrom0, at_least, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.numerics.threads import Background
from .dynamics import Ancestors, BodyDynamics, Prediction, arm_concentrations
from .flesh_state import FleshTracks
from .hand_labelling import NO_EVIDENCE, ExchangeEvidence, Labelling, exchange_evidence, label_hands
from .kernels.proposals import choose_arms, chosen_arms
from .likelihood import BodyLikelihood, ImageLikelihood, PoseLikelihood
from .samples import LONGEST, BodySamples
from .tempering import LogDensity, perturb

Array = NDArray[np.float64]
State = TypeVar("State")

SCALES = np.array([0.1, 0.3, 0.7, 1.2])  # of an arm's move from the next frame's, over the dynamics'
CENTRES = 64  # poses of the filter about whose arms others are drawn
BREADTH = 0.5  # standard deviation about these, over the dynamics'
NEXT = 0.3  # share of arms drawn near the next frame's: a recovered hand is traced back to its loss

LEAST_DENSITY, IMPOSSIBLE = 1e-30, -1e300
"""Floor of a proposal's density; nats of a pose that joints forbid, which any other one replaces."""


@dataclass(frozen=True, eq=False)
class ArmProposal:
    """Proposal of arms: near the filter's, weighted by the dynamics to the next frame, or near the next's.

    p(arm) = NEXT mean_s vMF(arm; next, s) + (1 - NEXT) sum_k v_k vMF(arm; arm_k, BREADTH),
    v_k ~ p(next | arm_k)
    """

    # `(k, 2, 3)` arms of the filter, `(n, 2, 3)` of the next frame
    centres: Array
    near: Array
    shares: Array  # `(n, k)`, with sums 1
    # of both segments, `(2,)` about the centres, and `(4, 2)` about the next frame's
    concentrations: Array
    scaled: Array

    @classmethod
    def of(cls, dynamics: BodyDynamics, elapsed: float, centres: Array, near: Array) -> "ArmProposal":
        """Return the proposal of arms `elapsed` s before `near`."""
        upper, fore = dynamics.upper_arm, dynamics.forearm
        walk = _log_kernels(near, centres, arm_concentrations(upper, fore, elapsed))
        shares = np.exp(np.maximum(walk - walk.max(axis=1, keepdims=True), -20.0))
        shares /= shares.sum(axis=1, keepdims=True)
        about = arm_concentrations(BREADTH * upper, BREADTH * fore, elapsed)
        scaled = np.array([arm_concentrations(scale * upper, scale * fore, elapsed) for scale in SCALES])
        return cls(centres, np.ascontiguousarray(near), shares, about, scaled)

    def draw(self, random: np.random.Generator) -> Array:
        """Draw `(n, 2, 3)`: one arm for each of the next frame."""
        drawn, n = np.empty_like(self.near), len(self.near)
        choose_arms(
            self.shares, random.random(n), self.near, self.centres, random.random(n) < NEXT,
            random.integers(len(SCALES), size=n), self.scaled, self.concentrations, random.random((n, 4)),
            drawn,
        )  # fmt: skip
        return drawn

    def log_density(self, arms: Array) -> Array:
        """`(n,)` nats, of one arm for each of the next frame."""
        values = np.empty(len(arms))
        chosen_arms(
            np.ascontiguousarray(arms), self.shares, self.near, self.centres, self.scaled,
            self.concentrations, self._peaks, NEXT, LEAST_DENSITY, values,
        )  # fmt: skip
        return values

    @cached_property
    def _peaks(self) -> Array:
        """`(5,)`: of the densities about the next frame's, and about the filter's."""
        return _peak(np.vstack([self.scaled, self.concentrations]))


def move_between(
    dynamics: BodyDynamics,
    poses: BodyPoses,
    past: Prediction,
    samples: BodySamples,
    later: BodyPoses,
    elapsed: float,
    log_likelihood: LogDensity,
    moves: int,
    random: np.random.Generator,
) -> BodyPoses:
    """Apply Metropolis moves to poses between a common past and one later pose each.

    Half of the moves are of whole arms, half are those of `perturb`.

    `poses`: n of them; `past`: from the frame before; `samples`: the filter's, of this frame; `later`: n
    poses of the next frame, `elapsed` s later; `log_likelihood`: of this frame's image; `moves`: of every
    pose.
    """
    n = len(poses)

    def log_target(tried: BodyPoses) -> Array:
        total = past.log_density(tried) + dynamics.log_step(later, tried, elapsed)
        allowed = np.flatnonzero(dynamics.body.allowed(tried))
        if len(allowed):
            total[allowed] += log_likelihood(tried.take(allowed))
        possible = np.full(n, -np.inf)
        possible[allowed] = total[allowed]
        return possible

    centres = samples.poses.arms[systematic(samples.log_weights, CENTRES, random)].swapaxes(0, 1).copy()
    proposals = [ArmProposal.of(dynamics, elapsed, centres[side], later.arms[:, side]) for side in (0, 1)]
    value = np.maximum(log_target(poses), IMPOSSIBLE)
    for move in range(moves):
        if move % 2:
            tried, correction = perturb(dynamics, poses, random)
        else:
            tried, correction = _propose_arms(poses, proposals, random)
        new = log_target(tried)
        takes = np.log(random.random(n)) < new - value + correction
        poses, value = poses.replaced(takes, tried), np.where(takes, new, value)
    return poses


def _propose_arms(
    poses: BodyPoses, proposals: list[ArmProposal], random: np.random.Generator
) -> tuple[BodyPoses, Array]:
    """Draw left, right or both arms; return the log of the proposal's ratio, backwards over forwards."""
    n = len(poses)
    which = random.integers(3, size=n)
    arms, correction = poses.arms.copy(), np.zeros(n)
    for side, proposal in enumerate(proposals):
        drawn = proposal.draw(random)
        ratio = proposal.log_density(poses.arms[:, side]) - proposal.log_density(drawn)
        changes = which != 1 - side
        arms[changes, side] = drawn[changes]
        correction[changes] += ratio[changes]
    return BodyPoses.made((*poses.arrays[:3], arms)), correction


def _log_kernels(arms: Array, centres: Array, concentrations: Array) -> Array:
    """`(n, k)` nats: log von Mises-Fisher densities of both segments of `arms` about `centres`."""
    n, k = len(arms), len(centres)
    scaled = (centres * concentrations[:, None]).reshape(k, 6)
    cosines = arms.reshape(n, 6) @ scaled.T - concentrations.sum()
    return np.asarray(cosines + np.log(_peak(concentrations)))


def _peak(concentrations: Array) -> Array:
    """`(...)`: peaks of the products of both segments' densities, of concentrations `(..., 2)`."""
    return np.asarray(np.prod(concentrations / (2 * np.pi * -np.expm1(-2 * concentrations)), axis=-1))


CLOUD = 400  # poses of a frame that are kept until it is smoothed
BLOCK = 6  # frames that are smoothed at a time: a backward pass costs the same for one
LEAST_EXCHANGED = 1e-3  # probability of exchanged hands, and of the opposite, at least
MOVES, MOVES_AHEAD = 8, 2  # Metropolis moves in frames that are returned, and in later ones


@short_repr
@dataclass(frozen=True, eq=False)
class TimedSamples:
    """Weighted poses of a frame."""

    number: int  # of the frame
    time: float  # s
    samples: BodySamples
    evidence: ExchangeEvidence = NO_EVIDENCE  # of smoothed poses, see `Labelling`
    # `(n, 2)` nats: log odds that hands are seen, see `ImageLikelihood`; `None` without an image
    hand_log_odds: Array | None = None

    def ancestors(self, time: float) -> Ancestors:
        """Return the poses as ancestors of those at `time`, s."""
        return Ancestors(self.samples.poses, self.samples.weights, min(time - self.time, LONGEST))


@short_repr
@dataclass(frozen=True, eq=False)
class WaitingFrame:
    """A frame that waits to be smoothed."""

    number: int  # of the frame
    time: float  # s
    samples: BodySamples  # the filter's, thinned
    exchanged: BodyPoses  # some of the same poses with exchanged hands
    evidence: ExchangeEvidence  # for these
    image: BodyImage | None = None  # for the likelihood; `None` if missing, and once it is smoothed
    log_odds: float | None = None  # nats, once it is smoothed: of exchanged hands, given all frames up to it

    def mixed(self, share: float) -> BodySamples:
        """Return the samples with exchanged hands in a share of them."""
        extra = len(self.exchanged)
        if not extra:
            return self.samples
        share = np.clip(share, LEAST_EXCHANGED, 1 - LEAST_EXCHANGED)
        log_weights = [self.samples.log_weights + np.log1p(-share), np.full(extra, np.log(share / extra))]
        return replace(
            self.samples,
            poses=BodyPoses.concatenated([self.samples.poses, self.exchanged]),
            log_weights=np.concatenate(log_weights),
        )


@short_repr
@dataclass(frozen=True, eq=False)
class WaitingFrames:
    """State of fixed-lag smoothing: the frames that are not smoothed yet."""

    frames: tuple[WaitingFrame, ...]  # in the order of time
    past: WaitingFrame | None  # the last smoothed frame; `None` at the beginning
    random: np.random.Generator  # generator of the draws to come


class FixedLag:
    """Fixed-lag smoother of the poses of a particle filter.

    Parameters
    ----------
    dynamics
        of the filter.
    lag
        number of later frames to use, and at most 5 more; 0: no smoothing.
    likelihood
        of images; the default one of the body if `None`.
    trajectories
        number of trajectories to draw, which is the number of smoothed poses per frame.
    seed
        of the random numbers.

    Attributes
    ----------
    waiting
        frames that are not smoothed yet: the whole state, a value that can be saved and restored.
    """

    @checked
    def __init__(
        self,
        dynamics: BodyDynamics,
        lag: CountFrom0 = 12,
        *,
        likelihood: PoseLikelihood | None = None,
        trajectories: Annotated[int, at_least(2)] = 64,
        seed: CountFrom0 = 0,
    ) -> None:
        self.dynamics = dynamics
        self.lag = lag
        self.likelihood = likelihood or BodyLikelihood(dynamics.body)
        self.trajectories = trajectories
        self.waiting = WaitingFrames((), None, np.random.default_rng(seed))
        self._likelihoods: dict[int, LogDensity] = {}

    def add(self, frame: Frame, samples: BodySamples, image: BodyImage | None = None) -> list[TimedSamples]:
        """Add a filtered frame, and return the frames that can now be smoothed.

        Parameters
        ----------
        frame
            later than those before; it may be missing.
        samples
            the filter's posterior, or its prediction.
        image
            features of the image: `image` of the parts' message. Without it, poses are selected from the
            filter's samples.
        """
        if image is not None:
            self._likelihoods[frame.number] = self.likelihood(image)
        likelihood = self._likelihoods.get(frame.number)
        if not self.lag:
            self._likelihoods = {}
            log_odds = _hand_log_odds(likelihood, samples.poses)
            return [TimedSamples(frame.number, frame.time, samples, hand_log_odds=log_odds)]
        random = copied(self.waiting.random)
        evidence, exchanged = exchange_evidence(self.dynamics, samples, likelihood, random)
        few = thin(samples, CLOUD, random)
        new = WaitingFrame(frame.number, frame.time, few, exchanged, evidence, image)
        self.waiting = replace(self.waiting, frames=(*self.waiting.frames, new), random=random)
        if len(self.waiting.frames) < self.lag + BLOCK:
            return []
        return self._smooth(BLOCK)

    def flush(self) -> list[TimedSamples]:
        """Smooth all remaining frames after the last one."""
        return self._smooth(len(self.waiting.frames))

    def _smooth(self, count: int) -> list[TimedSamples]:
        """Smooth the first `count` frames that wait, and remove them from the state."""
        if not count:
            return []
        waiting, random = self.waiting, copied(self.waiting.random)
        self._likelihoods = {
            frame.number: self._likelihoods.get(frame.number) or self.likelihood(frame.image)
            for frame in waiting.frames
            if frame.image is not None
        }
        before = 0 if waiting.past is None else 1
        frames = [*waiting.frames] if waiting.past is None else [waiting.past, *waiting.frames]
        labels = label_hands(
            np.array([frame.number for frame in frames]),
            np.array([frame.time for frame in frames]),
            np.array([frame.evidence.log_odds for frame in frames]),
            np.array([frame.evidence.confusable for frame in frames]),
            first_log_odds=frames[0].log_odds,
        )
        pairs = zip(frames, labels.shares, strict=True)
        clouds = [TimedSamples(each.number, each.time, each.mixed(share)) for each, share in pairs]
        smoothed = self._trajectories(clouds, before, before + count, random)
        last = before + count - 1
        past = replace(frames[last], image=None, log_odds=float(labels.filtered_log_odds[last]))
        self.waiting = WaitingFrames(waiting.frames[count:], past, random)
        return smoothed

    def _trajectories(
        self, clouds: list[TimedSamples], first: int, stop: int, random: np.random.Generator
    ) -> list[TimedSamples]:
        """Draw trajectories backwards through clouds; return their poses from `first` up to before `stop`."""
        newest = len(clouds) - 1
        poses = clouds[newest].samples.resample(self.trajectories, random)
        smoothed = []
        past = None
        for index in range(newest, first - 1, -1):
            cloud, later, elapsed = clouds[index], poses, 0.0
            if past is not None:
                poses = past.ancestors.poses.take(past.draw_ancestors(later, random))
                elapsed = past.ancestors.elapsed
            past = self.dynamics.prediction(clouds[index - 1].ancestors(cloud.time)) if index else None
            likelihood = self._likelihoods.get(cloud.number)
            if index < newest and past is not None and likelihood is not None:
                moves = MOVES if index < stop else MOVES_AHEAD
                poses = move_between(
                    self.dynamics, poses, past, cloud.samples, later, elapsed, likelihood, moves, random
                )
            if index < stop:
                smoothed.append(self._with_evidence(cloud, poses, random))
        return smoothed[::-1]

    def _with_evidence(
        self, cloud: TimedSamples, poses: BodyPoses, random: np.random.Generator
    ) -> TimedSamples:
        n, likelihood = len(poses), self._likelihoods.get(cloud.number)
        samples = replace(cloud.samples, poses=poses, log_weights=np.full(n, -np.log(n)))
        evidence = exchange_evidence(self.dynamics, samples, likelihood, random)[0]
        return replace(
            cloud, samples=samples, evidence=evidence, hand_log_odds=_hand_log_odds(likelihood, poses)
        )


def _hand_log_odds(likelihood: LogDensity | None, poses: BodyPoses) -> Array | None:
    """`(n, 2)` nats: log odds that hands are seen, of a likelihood that tells."""
    return likelihood.hand_log_odds(poses) if isinstance(likelihood, ImageLikelihood) else None


def thin(samples: BodySamples, n: int, random: np.random.Generator) -> BodySamples:
    """Reduce to `n` weighted samples at most, without the origin of a prediction.

    They are drawn by the square roots of their weights, so that improbable ones remain.
    """
    kept, log_weights = np.arange(len(samples.poses)), samples.log_weights
    if len(kept) > n:
        kept, counts = np.unique(systematic(0.5 * log_weights, n, random), return_counts=True)
        log_weights = 0.5 * log_weights[kept] + np.log(counts)
    return replace(
        samples,
        poses=samples.poses.take(kept),
        log_weights=normalised(log_weights),
        ancestors=None,
        before=None,
    )


FILM_LAG = 25  # later frames that are waited for in films: a second and more


class PartFilter(Chain[State], Protocol[State]):
    """A filter on `BodyParts` alone."""

    def message(self, state: State, feature: BodyParts, incoming: Incoming, /) -> PartMessage:
        """As of `Chain`."""
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class PoseTrajectory:
    """Poses in all frames."""

    samples: list[BodySamples | None]  # of each frame; `None` before the first one with an image
    times: Array  # `(n,)` s
    exchanged: Array  # `(n,)`: probability of exchanged hands, given the whole film
    log_prior: float  # mean log density of a frame's poses under those of the frame before


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTrajectory:
    """Head and hands in all frames."""

    tracks: list[FleshTracks | None]  # of each frame; `None` before the first one with an image
    times: Array  # `(n,)` s
    log_prior: float = 0.0  # nats: 0, since a tracker that assigns has no density over its trajectories


def filtered(
    chain: PartFilter[State], incoming_over_time: Sequence[BatchIncoming]
) -> Iterator[tuple[Frame, State | None, BodyImage | None]]:
    """Filter the frames; yield each with its posterior and the image's features."""
    state, time = None, 0.0
    for incoming in incoming_over_time:
        frame, (node,) = incoming.frame, incoming
        if state is None and frame.image is None:
            yield frame, None, None
            continue
        assert isinstance(node, BodyParts)
        state = chain.initial(frame) if state is None else chain.predict(state, frame.time - time)
        others = incoming.others(node)
        own = chain.message(state, node, Incoming({node: node.uniform()}))
        evidence = incoming.search(node, others * own)
        state, time = chain.update(state, Incoming({node: others * evidence})), frame.time
        yield frame, state, evidence.image


def smoothed_poses(
    chain: PartFilter[BodySamples],
    dynamics: BodyDynamics,
    likelihood: PoseLikelihood | None,
    incoming_over_time: Sequence[BatchIncoming],
) -> PoseTrajectory:
    """Filter and smooth the poses of all frames of a film."""
    smoother, labelling = FixedLag(dynamics, FILM_LAG, likelihood=likelihood), Labelling()
    frames, before_start = [], 0
    for frame, state, image in filtered(chain, incoming_over_time):
        if state is None:
            before_start += 1
        else:
            frames += smoother.add(frame, state, image)
    frames += smoother.flush()
    total = 0.0
    for index, each in enumerate(frames):
        labelling.add(each.number, each.time, each.evidence)
        if index:
            past = frames[index - 1].ancestors(each.time)
            total += float(each.samples.weights @ dynamics.log_density(each.samples.poses, past))
    return PoseTrajectory(
        [None] * before_start + [each.samples for each in frames],
        np.array([incoming.time for incoming in incoming_over_time]),
        np.concatenate([np.zeros(before_start), labelling.result().probabilities]),
        total,
    )


def predicted_messages(
    chain: PartFilter[State], states: Sequence[State | None], times: Array, node: BodyParts
) -> list[PartMessage]:
    """Return a filter's message in each frame, predicted from the frame before; the first is uniform."""
    messages = [node.uniform()]
    for state, elapsed in zip(states[:-1], np.diff(times), strict=True):
        if state is None:
            messages.append(node.uniform())
        else:
            ahead = chain.predict(state, float(elapsed))
            messages.append(chain.message(ahead, node, Incoming({node: node.uniform()})))
    return messages


class SmoothedBelief(Belief):
    """Belief of a smoothed frame: `samples` are its poses given later frames as well."""

    samples: TimedSamples


class Smoother:
    """Engine that filters frame after frame and returns each with fixed-lag smoothing.

    Frames are smoothed in the background while the next ones are filtered, and returned `BLOCK` frames later.

    Parameters
    ----------
    engine
        of the filter.
    state
        to start from.
    smoothing
        of the filter's poses.
    pose, parts
        the chain of the poses, and its feature node.
    seed
        of the smoother's draws.

    Attributes
    ----------
    state
        after the last frame that was returned.
    answered
        that frame, smoothed: what `smoothing` continues from; `None` at the beginning.
    """

    def __init__(
        self,
        engine: RecursiveBP,
        state: RunState,
        smoothing: FixedLag,
        pose: Chain[BodySamples],
        parts: BodyParts,
        seed: int,
    ) -> None:
        self.model, self.state, self.answered = engine.model, state, smoothing.waiting.past
        self._engine, self._newest, self._pose, self._parts, self._seed = engine, state, pose, parts, seed
        self._waiting: deque[SmoothedBelief] = deque()
        self._smoothing, self._background = smoothing, Background()
        self._begun: deque[Future[tuple[list[TimedSamples], WaitingFrame | None]]] = deque()

    def step(self, frame: Frame) -> list[Belief]:
        """Filter a frame, and return the beliefs of the frames that are smoothed by now."""
        belief = self._engine.step(self._newest, frame)
        self._newest = belief.state
        # without messages, which are large
        self._waiting.append(SmoothedBelief(belief.frame, belief.state, None))
        image = belief.evidence(self._parts).image
        self._begun.append(
            self._background.begin(partial(self._add, belief.frame, belief[self._pose], image))
        )
        return self._answers(BLOCK if self._smoothing.lag else 0)

    def flush(self) -> list[Belief]:
        """Return the beliefs of the last frames, after which there are fewer."""
        beliefs = self._answers(0)
        self._begin_draws(0)
        beliefs += self._beliefs(self._smoothing.flush())
        self.answered = self._smoothing.waiting.past
        return beliefs

    def _add(
        self, frame: Frame, samples: BodySamples, image: BodyImage | None
    ) -> tuple[list[TimedSamples], WaitingFrame | None]:
        self._begin_draws(frame.number)
        return self._smoothing.add(frame, samples, image), self._smoothing.waiting.past

    def _answers(self, most: int) -> list[Belief]:
        """Return the beliefs that are smoothed when at most so many frames are still to be added."""
        beliefs = []
        while len(self._begun) > most:
            poses, self.answered = self._begun.popleft().result()
            beliefs += self._beliefs(poses)
        return beliefs

    def _beliefs(self, poses: Sequence[TimedSamples]) -> list[Belief]:
        beliefs: list[Belief] = []
        for each in poses:
            belief = self._waiting.popleft()
            belief.samples, self.state = each, belief.state
            beliefs.append(belief)
        return beliefs

    def _begin_draws(self, number: int) -> None:
        """Seed the draws by the frame: a resumed run adds some frames again."""
        random = np.random.default_rng((self._seed, number))
        self._smoothing.waiting = replace(self._smoothing.waiting, random=random)
