"""Cost of poses: of bodies over samples, of faces over experts and texels; two threads, as they run."""

from collections.abc import Callable, Sequence

import numpy as np

from ....chains.body.articulated_pose import ArticulatedPose
from ....chains.body.flesh_tracker import FleshTracker
from ....chains.face.gflow import GFlow
from ....inference import Incoming, MultiChain, RecursiveBP, RunState
from ....models import PixelLabels, PixelMessage
from ....models.body.poses import ANGLES
from ....models.numerics.threads import set_threads
from ...scenes import FaceScene, face
from ..bench import face as face_tracker
from ..bench.body_tracker import BodyFilm
from ..measuring.machine import drawing, moving, multiplying
from ..measuring.stages import n_bytes, of_chain, timed
from .curve import Curve, Measured

ROUNDS, WARM_UP = 7, 3
SAMPLES = (250, 1000, 4000, 16_000)
EXPERTS = (1, 5, 20, 80)
TEXELS = (1000, 4000, 16_000)
OF_FACE = (20, 4000)
"""Experts and texels, of which the one is kept while the other grows."""

OF_TEXEL = 30
"""Operations at least for a value and a gradient of a texel, before its part of the normal equations."""


def over_samples() -> list[Curve]:
    """The chain of poses of a body: drawing, prior, likelihood."""
    set_threads(2)
    film = BodyFilm.found()
    points = []
    for count in SAMPLES:
        pose = ArticulatedPose(film.body, count)
        model = MultiChain().connect(FleshTracker(film.body), film.parts).connect(pose, film.parts)
        same, spent = timed(model)
        engine, state, seconds = RecursiveBP(same), RunState(), []
        for frame in film.frames[: WARM_UP + ROUNDS]:
            spent.clear()
            state = engine.step(state, frame).state
            seconds.append(of_chain(pose.name, spent))
        held = n_bytes(state.states[pose.name])
        limit = max(moving(2 * held), drawing(count * ANGLES))
        points.append(Measured.of(count, seconds[WARM_UP:], limit, held))
    return [Curve("poses of a body", "samples", points)]


def over_experts() -> list[Curve]:
    """G-flow."""
    return [_face_curve("experts", EXPERTS, lambda count: (count, OF_FACE[1]))]


def over_texels() -> list[Curve]:
    """G-flow."""
    return [_face_curve("texels", TEXELS, lambda count: (OF_FACE[0], count))]


def _face_curve(unit: str, sizes: Sequence[int], both: Callable[[int], tuple[int, int]]) -> Curve:
    set_threads(2)
    scene = face(face_tracker.N_FRAMES, seed=0, size=face_tracker.SIZE)
    points = []
    for size in sizes:
        experts, texels = both(size)
        seconds = face_tracker.seconds_a_frame(scene, experts, texels)
        rounds = [float(part.mean()) for part in np.array_split(seconds, ROUNDS)]
        held, numbers = _state_of_face(scene, experts, texels)
        products = OF_TEXEL + numbers * (numbers + 3)  # of a row with itself, and with the error
        limit = max(moving(2 * held), multiplying(products * experts * texels))
        points.append(Measured.of(size, rounds, limit, held))
    return Curve("G-flow, 640x480", unit, points)


def _state_of_face(scene: FaceScene, experts: int, texels: int) -> tuple[int, int]:
    """Bytes of the state after a frame, and the numbers of a pose."""
    chain = GFlow(scene.model, scene.poses[0], experts=experts, texels=texels, spread=float(experts > 1))
    frame = scene.frame(0)
    others = Incoming({PixelLabels(): PixelMessage(image=frame.image)})
    state = chain.update(chain.initial(frame), others)
    return n_bytes(state), state.poses.dimension
