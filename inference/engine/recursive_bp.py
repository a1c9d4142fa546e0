"""Algorithm 1 of the RSMCM paper, recursive belief propagation, for any number of chains and features."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import inf
from pathlib import Path
from typing import Any, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.numerics.threads import side_by_side
from ..engine import checkpoint
from .graph import IMAGE, MultiChain, require_model
from .protocols import Chain, FeatureNode, MessageType, Named, name_of, require
from .time_slice import TimeSlice

State = TypeVar("State")


@short_repr
@dataclass(frozen=True, eq=False)
class RunState:
    """All that a run needs to go on: a value that can be kept, branched from, saved and loaded.

    `RunState()` is that of a run which has not begun.

    Parameters
    ----------
    states
        state of every chain by its name; empty as long as there was nothing to see.
    number, time
        of the last frame (1-based, seconds).
    shape
        of the frames' images; `None` as long as there was none.
    """

    states: Mapping[str, Any] = field(default_factory=dict)
    number: int = 0
    time: float = -inf
    shape: tuple[int, ...] | None = None

    @staticmethod
    def kinds(chains: Mapping[str, Any]) -> dict[str, Any]:
        """What the state of these chains (or classes of chains) by name consists of, for `checkpoint`.

        Raises
        ------
        TypeError
            if a chain does not say what its state is.
        """
        states = {}
        for name, chain in chains.items():
            hints = get_type_hints(chain.initial)
            if "return" not in hints:
                raise TypeError(f"chain {name!r}: initial has no return annotation, which says what is saved")
            states[name] = hints["return"]
        return {"states": states, "number": int, "time": float, "shape": tuple[int, ...] | None}

    def saved(self) -> dict[str, Any]:
        """Everything, as a record of these kinds."""
        return {
            "states": dict(self.states) or None,
            "number": self.number,
            "time": self.time,
            "shape": self.shape,
        }

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> "RunState":
        """The state of which `saved` was kept."""
        return cls(**{**saved, "states": saved["states"] or {}})


class Belief:
    """What is known after a frame.

    `belief[chain]` or `belief["name"]` is the posterior state of a chain, `belief[feature]` or
    `belief["name"]` the belief over a feature node: the product of all messages that reach it. As long as all
    frames were missing there is no belief, and asking for one is a `KeyError`.

    Attributes
    ----------
    frame
        the frame.
    state
        from which the run can go on.
    """

    def __init__(self, frame: Frame, state: RunState, time_slice: TimeSlice | None) -> None:
        self.frame = frame
        self.state = state
        self._slice = time_slice

    def __repr__(self) -> str:
        missing = ", missing" if self.frame.missing else ""
        names = "nothing yet" if self._slice is None else self._slice.model.names
        return f"Belief(frame {self.frame.number} at {self.frame.time:.6g} s{missing}: {names})"

    def _repr_png_(self) -> bytes | None:
        """The frame with what is believed of its features, for notebooks."""
        if self._slice is None or self.frame.image is None:
            return None
        from .belief_picture import png  # OpenCV is slow to import

        features = self._slice.model.features
        return png(self.frame.image, [(node, self[name]) for name, node in features.items()])

    @property
    def states(self) -> Mapping[str, Any]:
        """Posterior states of the chains by name."""
        return self.state.states

    @cached_property
    def log_evidence(self) -> float:
        """log p(I_t | I_1..t-1), worked out when asked for; 0 before the first image.

        At each feature that chains speak to, it is the log of the integral of the product with the image less
        the log of the integral of the same product without it: summed over all images, the probabilities are
        1, whatever the scale of the messages, so that models can be compared. Features that share a chain
        follow each other (their evidence is given that of those before); a component that reads another one
        through a cut edge is conditioned on it. What is not exact is what chains approximate: a message that
        was decided on by its cavity is taken as it is.
        """
        return 0.0 if self._slice is None else self._slice.log_evidence()

    def message(self, chain: Named | str, feature: FeatureNode[MessageType]) -> MessageType:
        """What the chain said to the feature in this frame, before it heard what the image shows of it.

        Raises
        ------
        KeyError
            if it has not said anything there: it is not connected, or its message is cut.
        """
        return self._sent(name_of(chain), feature)

    def evidence(self, feature: FeatureNode[MessageType]) -> MessageType:
        """What the frame shows of the feature; nothing (uniform) where it is missing.

        Raises
        ------
        KeyError
            if the feature is not part of the model, or nothing is believed yet.
        """
        return feature.uniform() if self.frame.missing else self._sent(IMAGE, feature)

    def _sent(self, sender: str, feature: FeatureNode[MessageType]) -> MessageType:
        if self._slice is None:
            raise KeyError(f"{feature.name}: nothing is said before the first frame that is not missing")
        message: MessageType = self._slice.sent(sender, feature.name)
        return message

    @overload
    def __getitem__(self, key: Chain[State], /) -> State: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> MessageType: ...
    @overload
    def __getitem__(self, key: str, /) -> Any: ...
    def __getitem__(self, key: Named | str, /) -> object:
        name = name_of(key)
        if self._slice is None:
            raise KeyError(f"{name}: nothing is believed before the first frame that is not missing")
        if name in self.state.states:
            return self.state.states[name]
        if name in self._slice.model.features:
            return self._slice.product(name)
        known = ", ".join([*self._slice.model.chains, *self._slice.model.features])
        raise KeyError(f"{name}: not part of the model, expected one of {known}")


class RecursiveBP:
    """Recursive belief propagation (Algorithm 1): predict, exchange messages, update, frame by frame.

    The marginals of the chains after a frame are the priors of the next; within a frame sum-product runs on
    the tree of chains and features, one message each way on every edge.

    Parameters
    ----------
    model
        as it is now: later connections need a new engine.
    sweeps
        how often the messages are exchanged. One is enough, and exact, for chains that ignore their cavity;
        with more, chains that use it see the latest messages of the others.

    Raises
    ------
    ValueError
        if the model has no chain or has a loop, or `sweeps` is below 1.
    TypeError
        if one of the chains cannot filter.
    """

    def __init__(self, model: MultiChain, sweeps: int = 1) -> None:
        require_model(model)
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, Chain)
        if sweeps < 1:
            raise ValueError(f"sweeps: got {sweeps}, expected 1 or more")
        model.check_complete()
        self.model = model.copy()
        self.sweeps = sweeps
        self._schedule = self.model.schedule()

    def __repr__(self) -> str:
        return f"RecursiveBP({self.model})"

    def step(self, state: RunState, frame: Frame) -> Belief:
        """Take in one frame.

        The first frame with an image or points is met with the chains' initial states, later ones
        with predictions. A missing frame brings no evidence: chains predict, hear each other, and go on.

        Parameters
        ----------
        state
            of the run until now, which is left as it is; `RunState()` at the beginning.
        frame
            the next frame.

        Raises
        ------
        ValueError
            if the frame is not later than the last one, has another size or type, or if `state` belongs to
            other chains.
        TypeError
            if a chain gives something that is no message of the feature, or no state.
        """
        shape = state.shape if frame.image is None else frame.image.shape
        if not frame.time > state.time:
            raise ValueError(
                f"frames: got time {frame.time} s at frame {frame.number}, "
                f"expected later than {state.time} s at frame {state.number}"
            )
        if state.shape is not None and shape != state.shape:
            raise ValueError(
                f"frames: got {shape} uint8 at frame {frame.number}, expected {state.shape} uint8"
            )
        if not state.states and frame.image is None and frame.points is None:
            # boxes alone are nothing that chains could start from
            return Belief(replace(frame, boxes=None), RunState({}, frame.number, frame.time, None), None)

        chains = self.model.chains
        if not state.states:
            predictions = {name: chain.initial(frame) for name, chain in chains.items()}
        elif state.states.keys() == chains.keys():
            dt = frame.time - state.time
            predictions = {
                name: _following(chain, "predict", before := state.states[name], chain.predict(before, dt))
                for name, chain in chains.items()
            }
        else:
            raise ValueError(f"state: got chains {', '.join(state.states)}, expected {', '.join(chains)}")
        time_slice = TimeSlice(self.model, predictions, frame)
        for sender, feature in self._schedule * self.sweeps:
            time_slice.send(sender, feature)
        # what chains hear is there before they update, so that none of them waits for another
        incoming = {name: time_slice.incoming(name) for name in chains}
        for heard in incoming.values():
            heard.work_out()
        updated = side_by_side(
            [partial(chain.update, predictions[name], incoming[name]) for name, chain in chains.items()]
        )
        states = {
            name: _following(chain, "update", predictions[name], state)
            for (name, chain), state in zip(chains.items(), updated, strict=True)
        }
        return Belief(frame, RunState(states, frame.number, frame.time, shape), time_slice)

    def run(
        self,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: float = 1 / 25,
        state: RunState | None = None,
    ) -> Iterator[Belief]:
        """Take in frames one after the other, and give the belief after each.

        Parameters
        ----------
        frames
            `Frame`s, or plain images `dt` seconds apart (`None` for a missing one).
        dt
            seconds from one plain image to the next.
        state
            to go on from; from the beginning where it is left out.

        Raises
        ------
        ValueError
            as `step` does, or if something is not an image.
        """
        if isinstance(frames, str | Path):
            raise TypeError(
                f"frames: got {str(frames)!r}, expected frames; open_source of rsmcm.apps.io opens a film"
            )
        state = state or RunState()
        for item in frames:
            if isinstance(item, Frame):
                frame = item
            else:
                image = None if item is None else np.asarray(item)
                time = state.time + dt if state.time > -inf else 0.0
                frame = Frame(image, time, state.number + 1)
            belief = self.step(state, frame)
            state = belief.state
            yield belief

    def save(self, path: str | Path, state: RunState, about: Mapping[str, Any] | None = None) -> None:
        """Write the state of a run to one `.npz` file: all of it, or none.

        Parameters
        ----------
        path
            of the file, which is replaced if it is there.
        state
            of the run.
        about
            plain JSON to be kept with it (parameters, source, versions).

        Raises
        ------
        TypeError
            if a chain's state is not what the return annotation of its `initial` says.
        OSError
            if the file cannot be written; an older one is then left as it was.
        """
        values = {**state.saved(), "about": dict(about or {})}
        checkpoint.save(path, values, {**RunState.kinds(self.model.chains), "about": dict[str, Any]})

    def load(self, path: str | Path) -> tuple[RunState, dict[str, Any]]:
        """Read back what `save` wrote: the state of the run, and `about`.

        Raises
        ------
        ValueError
            if the file is broken, of another version, or of a model with other chains.
        OSError
            if the file cannot be opened.
        """
        values = checkpoint.load(path, {**RunState.kinds(self.model.chains), "about": dict[str, Any]})
        about = values.pop("about")
        return RunState.restored(values), about


def _following(chain: Named, method: str, before: State, after: State) -> State:
    """The state that a method gave for the one before; a forgotten `return` is said in words."""
    if after is None and before is not None:
        raise TypeError(f"chain {chain.name!r}: {method} gave None, expected a state")
    return after
