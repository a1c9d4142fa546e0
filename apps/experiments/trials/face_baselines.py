"""The other systems of the G-flow paper's Table 3, run alike: frames and a first pose in, a pose a frame out.

What they have in common with `GFlow` (levels, local mean, texels, dynamics, effective pixels) is set as it is
there, so that they differ in what the table says alone.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ....chains.face.gflow import GFlow, GFlowState
from ....chains.face.image_pyramid import Level, image_pyramid
from ....chains.face.pose_dynamics import PoseDynamics, PosePrior
from ....chains.face.texture_likelihood import TexturedObject
from ....inference.engine.protocols import Incoming
from ....models.core.frame import Frame
from ....models.face.morphable_model import MorphableModel
from ....models.face.pose import Poses
from ....models.face.surface_texels import SurfaceTexels
from ....models.pixels.pixel_labels import PixelLabels, PixelMessage
from .generative_template import ClipTemplate, GenerativeTemplate
from .template_subspace import TextureSubspace, best_pose

Amendment = Callable[[GFlowState, GFlowState], GFlowState]
"""From the states before and after a frame's picture, the one to go on with."""


def states(chain: GFlow, frames: Sequence[Frame], amended: Amendment | None = None) -> Iterator[GFlowState]:
    """The state after every frame of a chain that is on its own.

    Raises
    ------
    ValueError
        if a frame has no picture.
    """
    state = chain.initial(frames[0])
    for number, frame in enumerate(frames):
        before = chain.predict(state, frame.time - frames[number - 1].time) if number else state
        state = chain.update(before, Incoming({PixelLabels(): PixelMessage(image=_picture(frame))}))
        if amended is not None:
            state = amended(before, state)
        yield state


def followed(chain: GFlow, frames: Sequence[Frame], amended: Amendment | None = None) -> Poses:
    """The mean pose in every frame; parameters as of `states`."""
    return Poses.concatenated([chain.mean_pose(state) for state in states(chain, frames, amended)])


def constrained_flow(frames: Sequence[Frame], model: MorphableModel, start: Poses) -> Poses:
    """Constrained optic flow: online, small windows, one estimate, no memory but the last picture.

    Parameters
    ----------
    frames
        all with a picture.
    model, start
        shape, and its pose in the first frame.

    Raises
    ------
    ValueError
        if a frame has no picture.
    """
    return followed(GFlow.optic_flow(model, start), frames)


def template_subspace(
    frames: Sequence[Frame], model: MorphableModel, start: Poses, subspace: TextureSubspace
) -> Poses:
    """The 2D+3D AAM in its role: online, dense mesh, one estimate, appearance fixed before.

    Parameters
    ----------
    frames
        all with a picture.
    model, start
        shape, and its pose in the first frame.
    subspace
        from `learned_subspace`, for the same model.

    Raises
    ------
    ValueError
        if a frame has no picture.
    """
    surface, size, poses = dense_surface(model), float(start.sizes[0]), [start]
    for number, levels in enumerate(_levels(frames, size)):
        if number:
            elapsed = frames[number].time - frames[number - 1].time
            prior = PosePrior.after(poses[-1], PoseDynamics(), size, elapsed)
            poses.append(best_pose(surface, subspace, levels, prior, GFlow.effective_pixels).poses)
    return Poses.concatenated(poses)


def learned_subspace(
    frames: Sequence[Frame], model: MorphableModel, poses: Poses, n_modes: int
) -> TextureSubspace:
    """Templates for `template_subspace`, from frames in which the pose is known, one a frame.

    Raises
    ------
    ValueError
        if a frame has no picture, or there are not more frames than modes.
    """
    surface, observed, seen = dense_surface(model), [], []
    for number, levels in enumerate(_levels(frames, float(poses.sizes[0]))):
        shown, inside = surface.observe(levels, poses[number], surface.visible(poses[number]))
        observed.append(shown)
        seen.append(inside)
    return TextureSubspace.learned(np.concatenate(observed), np.concatenate(seen), n_modes)


def generative_template(
    frames: Sequence[Frame],
    model: MorphableModel,
    track: Poses,
    *,
    surface: Literal["dense", "patches"] = "patches",
) -> ClipTemplate:
    """Torresani and Hertzmann's tracker in its role: batch EM over the clip, small windows, one template.

    Parameters
    ----------
    frames
        all with a picture.
    model
        shape.
    track
        a pose in every frame to start from, such as those of `constrained_flow`.
    surface
        small windows, as they have it, or a dense mesh.

    Raises
    ------
    ValueError
        if a frame has no picture, or there is not one pose a frame.
    """
    where = TexturedObject(model, SurfaceTexels.patches(model, GFlow.radius))
    tracker = GenerativeTemplate(
        where if surface == "patches" else dense_surface(model), GFlow.effective_pixels, GFlow.levels
    )
    return tracker.fit([_picture(frame) for frame in frames], track)


def dense_surface(model: MorphableModel) -> TexturedObject:
    """The texels of which a `TextureSubspace` of the model is."""
    return TexturedObject(model, SurfaceTexels.dense(model, GFlow.texels))


def _levels(frames: Sequence[Frame], size: float) -> Iterator[list[Level]]:
    for frame in frames:
        yield image_pyramid(_picture(frame), size, n_levels=GFlow.levels, local_mean=GFlow.local_mean)


def _picture(frame: Frame) -> NDArray[np.uint8]:
    if frame.image is None:
        raise ValueError(f"frame {frame.number}: got no picture, expected one in every frame")
    return frame.image
