"""Trajectories as a chain of a whole film: what a tracker says, smoothed, joined, and cleaned."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rsmcm.chains import ObjectTrajectories
from rsmcm.inference import BatchIncoming, CoordinateAscent, MultiChain, Port, Smoothed
from rsmcm.models import Frame, ObjectBoxes
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.box_message import BoxMessage

N_FRAMES = 100
BOXES = ObjectBoxes()


@dataclass(frozen=True)
class Nothing:
    log_prior: float = 0.0


@dataclass(frozen=True)
class Tracker:
    """Says that 7 walks to the right, is lost for a while and is 9 then; and that 8 is there for a moment."""

    name: str = "a-tracker"

    ports = (Port(ObjectBoxes),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Nothing | None = None
    ) -> Smoothed[Nothing]:
        return Smoothed(Nothing())

    def messages(
        self, trajectory: Nothing, feature: ObjectBoxes, incoming_over_time: Sequence[BatchIncoming]
    ) -> list[BoxMessage]:
        said = []
        for frame in range(N_FRAMES):
            boxes = {}
            if not 40 <= frame < 60:
                boxes[7 if frame < 40 else 9] = [100 + 2 * frame, 150, 20, 50]
            if frame in (3, 4):
                boxes[8] = [200, 100, 12, 30]
            covariances = np.broadcast_to(np.eye(4), (len(boxes), 4, 4))
            message = GaussianMessage.from_moments(
                list(boxes), np.reshape([*boxes.values()], (-1, 4)), covariances
            )
            said.append(BoxMessage(message) if boxes else BoxMessage())
        return said


def test_one_walk_is_one_object_and_a_moment_is_none() -> None:
    trajectories = ObjectTrajectories()
    model = MultiChain().connect(Tracker(), BOXES).connect(trajectories, BOXES, feedback=False)
    frames = [Frame(np.zeros((300, 400), np.uint8), number / 25, number + 1) for number in range(N_FRAMES)]
    solution = CoordinateAscent(model, tolerance=None).run(frames)
    assert len(solution.rounds) == 1
    found = solution[trajectories]
    assert set(found.boxes.identities.tolist()) == {7}
    for frame in (0, 30, 50, 99):
        (track,) = found.at(frame)
        assert track.identity == 7
        np.testing.assert_allclose(track.box, [100 + 2 * frame - 10, 100, 20, 50], atol=0.5)
        np.testing.assert_allclose(track.velocity, (50, 0), atol=3)  # 25 frames a second
        assert track.seen == (frame != 50)
    hidden, shown = (np.linalg.det(found.at(frame)[0].position_covariance) for frame in (50, 30))
    assert hidden > 4 * shown > 0
    said = solution.messages(trajectories, BOXES)
    _, means, _ = said[50].objects.moments
    np.testing.assert_allclose(means, [[200, 150, 20, 50]], atol=0.5)
    assert found.at(N_FRAMES) == []
