"""Fig. 4 of the G-flow paper: experts scattered about the pose find it, if they know what they look for."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...models.face.morphable_model import Poses
from .expectations import Expectation, over_seeds
from .experiment import Findings, Plot, by_seed
from .face_trackers import Clip, ground_truth_texture, states
from .record import Table

Numbers = NDArray[np.float64]
Picture = NDArray[np.uint8]

SEEDS = range(20)
SCENE: Mapping[str, Any] = {"n_frames": 82}
N_EXPERTS = 20
SCATTER = 9.5
"""px: mean distance of the experts' vertices from the true ones in the first frame."""
GAIN = 0.03
SOON = 9
"""Index of the frame by which the pose is wanted to be found, the tenth."""
SHOWN = (0, SOON, 80)
NEAR = 1.5
"""px: error up to which the pose counts as found."""

KNOWN = "known texture"
BLANK = "blank texture"
STARTS = (KNOWN, BLANK)


@dataclass(frozen=True, eq=False)
class Recovery:
    """How scattered experts did on a sequence.

    Parameters
    ----------
    errors
        `(n_frames,)` px: mean distance of the mean pose's vertices from the true ones.
    each
        `(n_frames, n_experts)` px: the same for every expert.
    vertices
        `(n_shown, n_experts, n_vertices, 2)` px, in the frames `SHOWN`.
    """

    errors: Numbers
    each: Numbers
    vertices: Numbers


def recovery() -> Findings:
    """Fig. 4: the texture is known at the start, or learned by each expert at its own wrong pose."""
    (found,) = by_seed("recovery", recover, [N_EXPERTS], SEEDS).values()
    lines = [
        [start, *(_in_words([float(one.errors[index]) for one in runs]) for index in SHOWN)]
        for start, runs in found.items()
    ]
    header = ("texture at the start", *(f"error in frame {index + 1}, px" for index in SHOWN))
    clip = Clip.of(seed=SEEDS[0], **SCENE)
    pictures = [clip.scene.image(index) for index in SHOWN]
    firsts = {start: found[start][0] for start in STARTS}
    captions = (
        f"Fig. 4: vertices of all {N_EXPERTS} experts on the first sequence.",
        f"Error of the mean pose on {len(SEEDS)} sequences.",
    )
    return Findings(
        "Recovery",
        [Table(header, lines, "Medians over the sequences (least - most).")],
        over_seeds(expectations_of, found),
        [
            Plot(
                "fig-4.png", lambda canvas: draw_experts(canvas, pictures, firsts), (12.0, 6.5), captions[0]
            ),
            Plot("errors.png", lambda canvas: draw_errors(canvas, found), (9.0, 4.0), captions[1]),
        ],
        runs={start: {"errors": [one.errors for one in runs]} for start, runs in found.items()},
    )


def recover(n_experts: int, seed: int) -> dict[str, Recovery]:
    """Start experts about the true pose of a sequence, with both textures."""
    clip = Clip.of(seed=seed, **SCENE)
    scene = clip.scene
    start = scattered(clip, np.random.default_rng([seed, 9]))
    blank = GFlow(scene.model, start, experts=n_experts, gain=GAIN, recover=False, seed=seed)
    known = replace(blank, texture=ground_truth_texture(clip, blank))
    return {KNOWN: _followed(clip, known), BLANK: _followed(clip, blank)}


def scattered(clip: Clip, random: np.random.Generator) -> Poses:
    """Experts about the true pose of the first frame, `SCATTER` px from it in the mean over all vertices.

    Turned, shifted, sized and deformed at random, in proportions in which each of these moves vertices by
    about as much.
    """
    scene = clip.scene
    truth = scene.poses[np.zeros(N_EXPERTS, np.int64)]
    size = truth.sizes[0]
    deviations = np.full(truth.dimension, 0.5 * size)
    deviations[:5] = 0.2, 0.2, 0.2, 0.15 * size, 0.15 * size
    deviations[5] = 0.1 * size
    changes = deviations * random.standard_normal((N_EXPERTS, truth.dimension))
    factor = 1.0
    for _ in range(20):  # vertices do not move in proportion to a turn, but nearly
        poses = truth.moved(factor * changes)
        factor *= SCATTER / float(_distances(clip, poses, 0).mean())
    return poses


def _distances(clip: Clip, poses: Poses, index: int) -> Numbers:
    """`(n_poses,)` px: mean distance of vertices from the true ones."""
    off = clip.scene.model.project(poses) - clip.scene.vertices[index]
    distances: Numbers = np.linalg.norm(off, axis=2).mean(axis=1)
    return distances


def _followed(clip: Clip, chain: GFlow) -> Recovery:
    errors, each, vertices = [], [], []
    for index, state in enumerate(states(chain, clip.frames)):
        errors.append(float(_distances(clip, chain.mean_pose(state), index)[0]))
        each.append(_distances(clip, state.poses, index))
        if index in SHOWN:
            vertices.append(clip.scene.model.project(state.poses))
    return Recovery(np.array(errors), np.array(each), np.array(vertices))


def expectations_of(found: Mapping[str, list[Recovery]]) -> list[Expectation]:
    """What is wanted, in the worst run; with a blank texture nothing is."""
    known, blank = found[KNOWN], found[BLANK]
    soon = SOON + 1
    return [
        Expectation("experts' mean error at the start, px", float(np.mean([one.each[0] for one in known]))),
        Expectation(
            f"{KNOWN}: largest error in frame {soon}, px",
            max(float(one.errors[SOON]) for one in known),
            "<=",
            NEAR,
        ),
        Expectation(
            f"{KNOWN}: runs within {NEAR} px in frame {soon}, share",
            float(np.mean([one.errors[SOON] <= NEAR for one in known])),
            ">=",
            1.0,
        ),
        Expectation(
            f"{BLANK}: median error in frame {soon}, px",
            float(np.median([one.errors[SOON] for one in blank])),
        ),
        Expectation(
            f"{BLANK}: median error at the end, px", float(np.median([one.errors[-1] for one in blank]))
        ),
        Expectation(
            f"{BLANK}: runs within {NEAR} px in frame {soon}, share",
            float(np.mean([one.errors[SOON] <= NEAR for one in blank])),
        ),
    ]


def draw_experts(canvas: Figure, pictures: list[Picture], runs: Mapping[str, Recovery]) -> None:
    """Vertices of all experts over the pictures, a row for each start."""
    axes = canvas.subplots(len(runs), len(pictures), squeeze=False)
    for row, (start, run) in zip(axes, runs.items(), strict=True):
        for axis, index, picture, vertices in zip(row, SHOWN, pictures, run.vertices, strict=True):
            axis.imshow(picture, cmap="gray", vmin=0, vmax=255)
            axis.plot(*vertices.reshape(-1, 2).T, ".", color="#ff3020", markersize=1.5)
            axis.set(xlim=(0, picture.shape[1] - 1), ylim=(picture.shape[0] - 1, 0), xticks=[], yticks=[])
            axis.set_title(f"{start}, frame {index + 1}: {run.errors[index]:.2g} px", fontsize=9)
            axis.grid(visible=False)


def draw_errors(canvas: Figure, found: Mapping[str, list[Recovery]]) -> None:
    """Error of every run over the frames."""
    axes = canvas.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for axis, (start, runs) in zip(axes, found.items(), strict=True):
        for run in runs:
            axis.plot(np.arange(1, len(run.errors) + 1), run.errors, color="#1f5fa8", alpha=0.4, linewidth=1)
        axis.axhline(NEAR, color="#c0504d", linewidth=1, linestyle="--")
        axis.set_yscale("log")
        axis.set_title(start, fontsize=10)
        axis.set_xlabel("frame")
    axes[0].set_ylabel("mean error of vertices, px")


def _in_words(errors: list[float]) -> str:
    return f"{np.median(errors):.3g} ({min(errors):.3g}-{max(errors):.3g})"
