"""What is known of a film before its first frame is answered: from all of it, or from its first seconds."""

from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np

from ...chains.objects.object_trajectories import ObjectsOverTime, ObjectTrajectories
from ...chains.objects.scene_filter import SceneFilter
from ...inference import CoordinateAscent, MultiChain
from ...inference.engine.recursive_bp import RunState
from ...models import Frame, ObjectBoxes, PixelLabels
from ..io.film import Film
from ..io.sources.open_source import Source, open_source
from ..runs.interruption import Interrupted, Interruption
from ..runs.progress import Progress
from .job import BackgroundJob

PASSES = ("reading", "empty scene", "tracks")
"""What is done in the passes over a film before the one in which its masks are written."""


def read_whole(
    job: BackgroundJob,
    source: Source,
    model: MultiChain,
    attach_detections: Callable[[Iterator[Frame]], Iterator[Frame]],
    interruption: Interruption,
) -> tuple[RunState, ObjectsOverTime]:
    """The state before a film's first frame, and who was where in it, given all of it.

    The source is opened again for every pass; `attach_detections` adds given boxes to frames.

    Raises
    ------
    ValueError
        if the source is live, or the model's background cannot begin with an empty scene.
    Interrupted
        if a signal came meanwhile.
    """
    if source.live:
        raise ValueError(
            f"--engine {job.engine}: {source.name} is live and cannot be read more than once, expected a "
            "file or images (--warm-up SECONDS estimates the background of a stream)"
        )
    names = iter(PASSES)

    def passing(frames: Iterator[Frame]) -> Iterator[Frame]:
        with Progress(next(names, PASSES[-1]), source.n_frames) as progress:
            for frame in interruption.items(attach_detections(frames)):
                yield frame
                progress.update()
        if interruption.signal is not None:
            raise Interrupted(interruption.signal)

    def reopened() -> Source:
        return open_source(job.source, job.start, job.stop, job.step, reconnect=job.reconnect)

    scene, objects = SceneFilter(model), ObjectBoxes()
    film_model = MultiChain().connect(scene, PixelLabels()).connect(scene, objects)
    film_model.connect(trajectories := ObjectTrajectories(), objects)
    with Film(reopened, passing) as film:
        # a second round would cost two passes and gains nothing that is seen in the results
        solution = CoordinateAscent(film_model, most_rounds=1, tolerance=None).run(film)
        return scene.initial_state(solution[scene]), solution[trajectories]


def warmed_up(seconds: float, frames: Iterator[Frame], model: MultiChain) -> tuple[RunState, Iterator[Frame]]:
    """The state before the first frame, given the first `seconds` of frames, and all frames again.

    It is a ValueError if the model's background cannot begin with an empty scene.
    """
    scene, held = SceneFilter(model), []
    for frame in frames:
        held.append(frame)
        if frame.time - held[0].time >= seconds:
            break
    seen = [frame for frame in held if frame.image is not None]
    images = [frame.image for frame in seen if frame.image is not None]
    if not images:
        return RunState(), chain(held, frames)
    times = np.array([frame.time for frame in seen])
    every = -(-len(images) // scene.sample_size(images[0].nbytes))
    return scene.state_in(scene.empty_scene(images[::every], times[::every]), held[0].time), chain(
        held, frames
    )
