"""Algorithm 1 inside Algorithm 2: messages of a filter over a whole sequence, forwards, none of them kept."""

from collections.abc import Callable, Sequence
from typing import Generic, overload

from .protocols import BatchIncoming, MessageType
from .recursive_bp import Belief, RecursiveBP, RunState


class ForwardPass(Sequence[MessageType], Generic[MessageType]):
    """What a filter says in each frame, worked out when it is asked for.

    Asked for forwards, a frame costs one step of the filter; asked for an earlier frame, it begins again. It
    holds one state and one belief, however long the sequence is.

    Parameters
    ----------
    engine
        of the filter.
    start
        its state before the first frame.
    incoming_over_time
        whose frames it takes in.
    read
        what is said in a frame, given the belief after it.
    """

    def __init__(
        self,
        engine: RecursiveBP,
        start: RunState,
        incoming_over_time: Sequence[BatchIncoming],
        read: Callable[[Belief], MessageType],
    ) -> None:
        self._engine = engine
        self._start = start
        self._incoming = incoming_over_time
        self._read = read
        self._state = start
        self._next = 0
        self._belief: Belief

    def __len__(self) -> int:
        return len(self._incoming)

    @overload
    def __getitem__(self, time: int) -> MessageType: ...
    @overload
    def __getitem__(self, time: slice) -> Sequence[MessageType]: ...
    def __getitem__(self, time: int | slice) -> MessageType | Sequence[MessageType]:
        numbers = range(len(self))[time]  # which raises IndexError beyond the end
        if isinstance(numbers, range):
            return [self[number] for number in numbers]
        if numbers < self._next - 1:
            self._state, self._next = self._start, 0
        while self._next <= numbers:
            self._belief = self._engine.step(self._state, self._incoming[self._next].frame)
            self._state = self._belief.state
            self._next += 1
        return self._read(self._belief)
