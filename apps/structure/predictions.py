"""What tracker and shape predicted of points, each without the observation that it is held against."""

import numpy as np

from ...chains.structure.factor_structure import StructureTrajectory
from ...inference import Solution
from ...models.core.gaussian_message import GaussianMessage
from ..evaluation.predictions import PairRecord, PairRecorder


def recorded_predictions(solution: Solution) -> tuple[PairRecord, ...]:
    """Record the final predictions of both chains of a structure run, for `rsmcm validity`.

    The tracker's messages come from the other frames' observations of the same point. The shape has been
    fitted to all of them, so that each is taken out again for its point and frame, as if the fit was linear.
    """
    structure: StructureTrajectory = solution["structure"]
    recorder = PairRecorder("tracker", "structure", "points")
    for frame, by_tracker, by_shape, evidence in zip(
        solution.frames,
        solution.messages("tracker", "points"),
        solution.messages("structure", "points"),
        solution.evidence("points"),
        strict=True,
    ):
        without = _without_observation(by_shape.positions, evidence.positions, structure)
        recorder.add(frame.number, by_tracker.positions, without, evidence.positions)
    record = recorder.record()
    return () if record is None else (record,)


def _without_observation(
    shape: GaussianMessage, evidence: GaussianMessage, structure: StructureTrajectory
) -> GaussianMessage:
    """The shape's message about points that are seen, as if they had not been seen."""
    identities, mean, covariance = shape.moments
    seen, observed, noise = evidence.moments
    common, here, there = np.intersect1d(identities, seen, assume_unique=True, return_indices=True)
    mean, covariance, observed = mean[here], covariance[here], observed[there]
    about = structure.scatter * np.eye(2)  # by which features scatter about the shape, eq. (20)
    fitted = structure.factorisation.noise_variance * np.trace(noise[there], axis1=1, axis2=2) / 2
    of_observation = np.eye(2) / fitted[:, None, None]
    of_shape = np.linalg.inv(covariance - about)
    information = of_shape - of_observation
    # a point that nothing but this observation determines
    left = np.linalg.eigvalsh(information)[:, 0] > 1e-3 * np.linalg.eigvalsh(of_shape)[:, 0]
    rest = np.linalg.inv(information[left])
    vector = of_shape[left] @ mean[left][:, :, None] - of_observation[left] @ observed[left][:, :, None]
    return GaussianMessage.from_moments(common[left], (rest @ vector)[:, :, 0], rest + about)
