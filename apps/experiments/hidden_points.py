"""Points that go behind something: how many are found again in the pictures.

A textured bar is painted over the film; where points are behind it, the same run on the film without it says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...chains import PointTracker, RecursiveStructure
from ...inference import MultiChain, RecursiveBP
from ...models import PointTracks
from ...models.core.frame import Frame
from ..io import open_source
from ..scenes.random_fields import mottle
from .datasets import data_folder
from .experiment import Findings, by_seed
from .record import Expectation, over_seeds

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

ENTER = 25  # frames before the bar comes, in which points begin and a shape can be found
SOON = 5  # frames in which a point is wanted to be found again, from the first that shows its whole patch
RIGHT = 1.5  # px from where the point is without the bar
LEAST_HIDDEN = 3  # frames in which a point is behind the bar for it to count

SPEED, THICKNESS, LENGTH = (2.0, 8.0), (50.0, 150.0), (120.0, 500.0)
"""px a frame, px and px of bars: a point is hidden for 6 to 75 frames."""

MODELS = {"tracker and shape": True, "feed-forward": False}  # by name, whether the shape speaks to the points

SEEDS = range(10)  # of bars, each of its own size, way and texture


@dataclass(frozen=True, eq=False)
class RecoveredPoints:
    """Results of a run with a bar, of the points behind it; all `(n,)`."""

    # whether the point was found within `SOON` frames, where it is and under its number; of those that the
    # film without the bar shows in all these frames
    again: Mask
    wrong: Numbers  # share of these frames in which it was found elsewhere
    # share of the frames behind the bar in which a point was found nevertheless; of all hidden points
    false: Numbers


def hidden_points() -> Findings:
    """Run both models on CMU's hotel with and without bars.

    Raises
    ------
    OSError
        if the sequence cannot be found.
    """
    with open_source(str(data_folder("cmu-hotel"))) as source:
        frames = list(source)
    truth = {name: tracked(frames, feedback) for name, feedback in MODELS.items()}
    (refound,) = by_seed("bars", partial(behind_a_bar, frames, truth), [None], SEEDS).values()
    return Findings("Points behind a bar", [], over_seeds(expectations_of, refound))


def expectations_of(refound: Mapping[str, Sequence[RecoveredPoints]]) -> list[Expectation]:
    """Return shares over the points of all bars."""
    expectations = []
    for name, runs in refound.items():
        again, wrong, false = (
            np.concatenate([getattr(run, what) for run in runs]) for what in ("again", "wrong", "false")
        )
        wanted, soon = 0.9 if MODELS[name] else None, f"found again within {SOON} frames, share"
        expectations += [
            Expectation(f"{name}: hidden points", len(again) / len(runs)),
            Expectation(f"{name}: {soon}", float(again.mean()), ">=", wanted),
            Expectation(f"{name}: found elsewhere in these frames, share", float(wrong.mean())),
            Expectation(f"{name}: found while hidden, share of frames", float(false.mean())),
            Expectation(f"{name}: found while hidden at least once, share", float((false > 0).mean())),
        ]
    return expectations


def behind_a_bar(
    frames: Sequence[Frame], truth: Mapping[str, Numbers], _: None, seed: int
) -> dict[str, RecoveredPoints]:
    """Run both models on the film with a bar, and compare them with their runs without it."""
    covered, hidden = with_bar(frames, seed)
    return {
        name: compared(tracked(covered, feedback), truth[name], hidden) for name, feedback in MODELS.items()
    }


def with_bar(frames: Sequence[Frame], seed: int) -> tuple[list[Frame], Mask]:
    """Return the film with a bar, and where the bar is, `(n_frames, height, width)`.

    Its middle passes that of the picture, within 15 % of the picture's side, in the middle of the frames
    from `ENTER` on.
    """
    random = np.random.default_rng(seed)
    angle, speed = random.uniform(0, 2 * np.pi), random.uniform(*SPEED)
    half = 0.5 * np.array([random.uniform(*THICKNESS), random.uniform(*LENGTH)])
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    first = frames[0].image
    assert first is not None
    height, width = first.shape[:2]
    middle = 0.5 * np.array([width, height]) + random.uniform(-0.15, 0.15) * min(height, width) * axes[1]
    reach = int(np.ceil(np.hypot(*half))) + 1
    texture = np.clip(110 + 50 * mottle((2 * reach + 1, 2 * reach + 1), 10.0, 1.5, random), 0, 255)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    hidden = np.zeros((len(frames), height, width), np.bool_)
    film = []
    for time, frame in enumerate(frames):
        image = frame.image
        assert image is not None
        if time >= ENTER:
            way = speed * (time - 0.5 * (ENTER + len(frames)))
            place = np.rint(middle + way * axes[0]).astype(int)
            hidden[time] = (np.abs((pixels - place) @ axes.T) <= half).all(axis=-1)
            x, y = (pixels[hidden[time]] - place + reach).T
            image = image.copy()
            image[hidden[time]] = texture[y, x].astype(np.uint8).reshape(-1, *[1] * (image.ndim - 2))
        film.append(replace(frame, image=image))
    return film, hidden


def tracked(frames: Sequence[Frame], feedback: bool) -> Numbers:
    """Return where points were seen in the pictures, by number, `(n_frames, n, 2)` px; NaN where not."""
    points = PointTracks()
    model = MultiChain().connect(PointTracker(), points)
    model.connect(RecursiveStructure(), points, feedback=feedback)
    views = [belief.evidence(points).view for belief in RecursiveBP(model).run(frames)]
    found = [view.points for view in views if view is not None]
    places = np.full((len(frames), 1 + max(each.identities.max(initial=0) for each in found), 2), np.nan)
    for time, each in enumerate(found):
        places[time, each.identities] = each.positions
    return places


def compared(places: Numbers, truth: Numbers, hidden: Mask) -> RecoveredPoints:
    """Compare what was found behind a bar with where points are without it.

    Until the bar comes both runs are the same, and so are the numbers of points. A point is hidden where its
    centre is, and clear where nothing of its patch is.
    """
    half = PointTracks().patch_size // 2
    again, wrong, false = [], [], []
    for point in np.flatnonzero(~np.isnan(truth[ENTER - 1, :, 0])).tolist():
        behind, clear = np.zeros((2, len(truth)), np.bool_)
        for time in np.flatnonzero(~np.isnan(truth[:, point, 0])).tolist():
            x, y = np.rint(truth[time, point]).astype(int)
            behind[time] = hidden[time, y, x]
            clear[time] = not hidden[
                time, max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1
            ].any()
        if np.count_nonzero(behind) < LEAST_HIDDEN:
            continue
        seen = ~np.isnan(places[:, point, 0]) if point < places.shape[1] else np.zeros(len(places), np.bool_)
        false.append(float(seen[behind].mean()))
        end = np.flatnonzero(behind)[-1] + 1
        soon = end + np.flatnonzero(clear[end:])[:SOON]
        if len(soon) < SOON or soon[-1] != soon[0] + SOON - 1:
            continue
        off = np.linalg.norm(places[soon, point] - truth[soon, point], axis=1) if seen.any() else np.inf
        right = off < RIGHT
        again.append(bool(np.any(right)))
        wrong.append(float((seen[soon] & ~right).mean()))
    return RecoveredPoints(np.array(again, np.bool_), np.array(wrong), np.array(false))
