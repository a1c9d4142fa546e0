"""Speed of G-flow: frames a second; one expert beside optic flow, the fused loop beside `cv2.remap`."""

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....chains.face.gflow import GFlow, GFlowState
from ....chains.face.texture_filter import Texture
from ....chains.face.texture_likelihood import TexturedObject, TextureLikelihood, image_pyramid
from ....inference.engine.protocols import Incoming
from ....models.core.frame import Frame
from ....models.face.morphable_model import Poses
from ....models.face.surface import SurfaceTexels
from ....models.numerics.threads import set_threads
from ....models.pixels.pixel_labels import PixelLabels, PixelMessage
from ...scenes import FaceScene, face
from ..expectations import Expectation
from ..experiment import Findings
from .timing import Spent, in_turns, over_rounds

RATE = 25.0  # frames a second, of the film
SIZE = (640, 480)
EXPERTS, TEXELS = 20, 4000
N_FRAMES = 25
WARM_UP = 5  # frames that do not count
ROUNDS, TURNS = 7, 10
WANTED = {EXPERTS: 6.0, 1: 13.0}
"""Times real time, by experts."""

Numbers = NDArray[np.float64]


def faces() -> Findings:
    """All of them; on two threads where the tracker runs, on one where a peer runs beside it."""
    scene = face(N_FRAMES, seed=0, size=SIZE)
    set_threads(2)
    rates = rate_expectations(scene)
    set_threads(1)
    return Findings("Faces", [], [*rates, *flow_expectations(scene), *fused_expectations(scene)])


@lru_cache(maxsize=1)
def _frames(scene: FaceScene) -> Sequence[Frame]:
    """Rendered once."""
    return tuple(scene)


def seconds_a_frame(scene: FaceScene, experts: int, texels: int) -> Numbers:
    """Of every frame after the first few."""
    chain = GFlow(scene.model, scene.poses[0], experts=experts, texels=texels, spread=float(experts > 1))
    state: GFlowState | None = None
    seconds = []
    for frame in _frames(scene):
        started = time.perf_counter()
        state = _followed(chain, state, frame)
        seconds.append(time.perf_counter() - started)
    return np.array(seconds[WARM_UP:])


def _followed(chain: GFlow, state: GFlowState | None, frame: Frame) -> GFlowState:
    state = chain.initial(frame) if state is None else chain.predict(state, 1 / RATE)
    return chain.update(state, Incoming({PixelLabels(): PixelMessage(image=frame.image)}))


def rate_expectations(scene: FaceScene) -> list[Expectation]:
    """How often faster than the film: over continuation and resampling frames, in several runs."""
    spent: Spent = {str(experts): [] for experts in WANTED}
    for _ in range(ROUNDS):
        for experts in WANTED:
            spent[str(experts)].append(float(seconds_a_frame(scene, experts, TEXELS).mean()))
    what = "G-flow 480x640, {} x {} texels, two threads: speed over {:g} frames/s"
    return over_rounds(
        lambda seconds: [
            Expectation(what.format(experts, TEXELS, RATE), 1 / (RATE * seconds[str(experts)]), ">=", wanted)
            for experts, wanted in WANTED.items()
        ],
        spent,
    )


def flow_expectations(scene: FaceScene) -> list[Expectation]:
    """One expert, dense, beside optic flow of as many points, forwards only and without a model."""
    after = _frames(scene)[WARM_UP + 1]
    here, there = scene.image(WARM_UP), scene.image(WARM_UP + 1)
    chain = GFlow(scene.model, scene.poses[0], experts=1, texels=TEXELS, spread=0.0)
    state: GFlowState | None = None
    for frame in _frames(scene)[: WARM_UP + 1]:
        state = _followed(chain, state, frame)
    surface = chain.object
    corners = surface.positions(scene.poses[WARM_UP])[0][surface.used_texels.groups]
    points = np.einsum("na,nac->nc", surface.texels.weights, corners[surface.texels.group_of_texel])
    nowhere: Any = None  # to begin from
    spent = in_turns(
        {
            "expert": lambda: _followed(chain, state, after),
            "flow": lambda: cv2.calcOpticalFlowPyrLK(here, there, points[:, None], nowhere),
        },
        ROUNDS,
        TURNS,
    )
    what = f"G-flow: PyrLK of {TEXELS} points over one expert of {TEXELS} texels, time"
    return over_rounds(
        lambda seconds: [Expectation(what, seconds["flow"] / seconds["expert"], ">=", 1.0)], spent
    )


def fused_expectations(scene: FaceScene) -> list[Expectation]:
    """Normal equations of one expert, beside three remaps and numpy."""
    image = scene.image(1)
    surface = TexturedObject(scene.model, SurfaceTexels.dense(scene.model, TEXELS))
    poses = scene.poses[0]
    level = image_pyramid(image, float(poses.sizes[0]), n_levels=1, local_mean=True)
    texture = Texture.unknown(1, 1, len(surface.texels), learn=False)
    likelihood = TextureLikelihood(
        surface, level, texture.mean, np.full_like(texture.variance, 36), surface.visible(poses)
    )
    slopes = [cv2.Sobel(level[0].image, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))]
    owner = np.zeros(1, np.int64)
    spent = in_turns(
        {
            "fused": lambda: likelihood.equations(0, poses, owner),
            "remap": lambda: _by_remap(surface, likelihood, [level[0].image, *slopes], poses),
        },
        TURNS,
        5,
    )
    what = f"G-flow: remap and numpy over the fused normal equations, {TEXELS} texels, time"
    return over_rounds(
        lambda seconds: [Expectation(what, seconds["remap"] / seconds["fused"], ">=", 6.0)], spent
    )


def _by_remap(
    surface: TexturedObject, likelihood: TextureLikelihood, pictures: list[Any], poses: Poses
) -> tuple[Numbers, Numbers]:
    """The same normal equations with a Jacobian of every texel."""
    texels = surface.texels
    positions, rows = surface.rows(poses)
    corners = surface.used_texels.groups[texels.group_of_texel]
    places = np.einsum("na,nac->nc", texels.weights, positions[0][corners])
    texel_rows = np.einsum("na,nacd->ncd", texels.weights, rows[0][corners][..., : poses.dimension])
    value, across, down = (
        cv2.remap(picture, places[:, 0], places[:, 1], cv2.INTER_LINEAR)[:, 0] for picture in pictures
    )
    jacobian = across[:, None] * texel_rows[:, 0] + down[:, None] * texel_rows[:, 1]
    triangles = positions[0][surface.used_texels.groups]
    edges = triangles[:, 1:] - triangles[:, :1]
    size = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    area = (size / texels.counts)[texels.group_of_texel]
    weight = area * likelihood.visible[0] / likelihood.temperature[0]
    weighted = jacobian * weight[:, None]
    return weighted.T @ jacobian, weighted.T @ (value - likelihood.mean[0, 0])
