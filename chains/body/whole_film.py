"""A filter over a whole film as a chain of coordinate ascent: forwards through all frames, with hindsight.

Nothing is held of a frame but its states: pictures are read again in every round, and what they say of a
body, which is large, is not kept.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Incoming
from ...models.body.image_features import BodyImage
from ...models.body.part_message import PartMessage
from ...models.body.parts import BodyParts
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from .dynamics import BodyDynamics
from .fixed_lag import FixedLag
from .flesh_state import FleshTracks
from .hand_labelling import Labelling
from .likelihood import PoseLikelihood
from .samples import BodySamples

Array = NDArray[np.float64]

FILM_LAG = 25
"""Frames that are heard before one is answered: of a second ago, or more, nothing else is remembered."""

State = TypeVar("State")


class PartFilter(Protocol[State]):
    """A filter that meets the parts of a body and nothing else."""

    def initial(self, frame: Frame, /) -> State:
        """As of `Chain`."""
        ...

    def predict(self, state: State, dt: float, /) -> State:
        """As of `Chain`."""
        ...

    def message(self, state: State, feature: BodyParts, incoming: Incoming, /) -> PartMessage:
        """As of `Chain`."""
        ...

    def update(self, state: State, incoming: Incoming, /) -> State:
        """As of `Chain`."""
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class PoseTrajectory:
    """Poses in all frames.

    Parameters
    ----------
    samples
        of each frame; `None` before the first one with an image.
    times
        `(n,)` s.
    exchanged
        `(n,)`: probability that the names of the hands are still exchanged, by the whole film.
    log_prior
        mean log density of a frame's poses under those of the frame before.
    """

    samples: list[BodySamples | None]
    times: Array
    exchanged: Array
    log_prior: float


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTrajectory:
    """Head and hands in all frames.

    Parameters
    ----------
    tracks
        of each frame; `None` before the first one with an image.
    times
        `(n,)` s.
    log_prior
        nats: 0, since a tracker that assigns has no density over its trajectories.
    """

    tracks: list[FleshTracks | None]
    times: Array
    log_prior: float = 0.0


def filtered(
    chain: PartFilter[State], incoming_over_time: Sequence[BatchIncoming]
) -> Iterator[tuple[Frame, State | None, BodyImage | None]]:
    """Frame by frame, what a filter knows after it, and what the image says of the body."""
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
    """Poses in all frames of a film, with the names of the hands as later frames have them."""
    hindsight, labelling = FixedLag(dynamics, FILM_LAG, likelihood=likelihood), Labelling()
    answers, unknown = [], 0
    for frame, state, image in filtered(chain, incoming_over_time):
        if state is None:
            unknown += 1
        else:
            answers += hindsight.add(frame, state, image)
    answers += hindsight.rest()
    total = 0.0
    for index, answer in enumerate(answers):
        labelling.add(answer.number, answer.time, answer.evidence)
        if index:
            past = answers[index - 1].ancestors(answer.time)
            total += float(answer.samples.weights @ dynamics.log_density(answer.samples.poses, past))
    return PoseTrajectory(
        [None] * unknown + [answer.samples for answer in answers],
        np.array([incoming.time for incoming in incoming_over_time]),
        np.concatenate([np.zeros(unknown), labelling.result().probabilities]),
        total,
    )


def predicted_messages(
    chain: PartFilter[State], states: Sequence[State | None], times: Array, node: BodyParts
) -> list[PartMessage]:
    """What a filter would say in each frame, from what is known of the frame before; at first, nothing."""
    messages = [node.uniform()]
    for state, elapsed in zip(states[:-1], np.diff(times), strict=True):
        if state is None:
            messages.append(node.uniform())
        else:
            ahead = chain.predict(state, float(elapsed))
            messages.append(chain.message(ahead, node, Incoming({node: node.uniform()})))
    return messages
