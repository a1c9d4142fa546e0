"""What the applications state of themselves, against the truth: probabilities, regions, and plain claims.

A probability is right if what was stated with it is so as often; a region of 50 % is right if half of the
true places are in it; a claim, such as "this camera is known", is a probability of 1. What is not claimed is
no error, but counted as unknown.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, Self

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2

from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import FixedLag
from ...chains.body.likelihood import SEEN
from ...chains.reconstruction import Reconstruction, reconstruct
from ...inference import RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...inference.sfm.nonrigid.learning import learn_shape
from ...models.body.parts import HAND_DETECTED
from ...models.core.frame import Frame
from ...models.core.gaussian_message import squared_distances
from ...models.numerics.rotations import logarithm
from ..background.application import build_model
from ..body.application import NEAR_MEAN, SPREAD, apart_and_shared, hands_are_seen, run_body
from ..body.job import BodyJob
from ..body.measures import HANDS, LEAST_VARIANCE, PLACES
from ..evaluation.tracks import box_overlap, match_boxes
from ..io.ground_truth import Kind
from ..io.point_files import read_shapes
from ..io.sources.open_source import open_source
from ..scenes import cylinder, face, signer, sleeping_man, turntable
from ..scenes.signing.signer import SignerScene, Sleeves
from ..scenes.street import mottle
from ..trackers.body import BodyTracker
from ..trackers.face import FaceTracker, TrackedFace
from .body import LAG, RSMCM, SignerFilm
from .datasets import data_folder
from .experiment import Findings, Image, Plot, by_seed, noisy
from .pets import AnnotatedFilm
from .record import Expectation, Table, over_seeds
from .shapes import nearer_image, sequence_file

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEEDS = range(5)
TENTHS = 10
LEVELS = (np.arange(TENTHS) + 0.5) / TENTHS  # of regions
ENOUGH = 30  # cases in a tenth that is judged
BOUND = 0.1  # by which what is stated may differ from what is observed


@dataclass(frozen=True, eq=False)
class Reliability:
    """Stated probabilities in tenths from 0 to 1: how many `(10,)`, their sum, and how many were so.

    Regions are counted in each of their `LEVELS`. `unknown` counts cases of which nothing was claimed.
    """

    count: Numbers
    stated: Numbers
    so: Numbers
    unknown: int = 0
    regions: bool = False

    @classmethod
    def nothing(cls) -> Self:
        """Return that of no statement."""
        return cls(*np.zeros((3, TENTHS)))

    @classmethod
    def of_probabilities(cls, stated: NDArray[np.floating], so: Mask) -> Self:
        """Return that of probabilities and of whether what they were stated of was so, both of one shape."""
        tenth = np.minimum((stated.ravel() * TENTHS).astype(np.int64), TENTHS - 1)
        count, sums, shares = (
            np.bincount(tenth, of.ravel(), TENTHS).astype(np.float64)
            for of in (np.ones(stated.shape), stated, so)
        )
        return cls(count, sums, shares)

    @classmethod
    def of_regions(cls, squares: Numbers, dimension: int) -> Self:
        """Return that of Gaussian regions of `LEVELS`, by the squared Mahalanobis distances of the truth."""
        inside = chi2.cdf(squares.ravel()[:, None], dimension) <= LEVELS
        count = np.full(TENTHS, float(len(inside)))
        return cls(count, count * LEVELS, inside.sum(axis=0).astype(np.float64), regions=True)

    @classmethod
    def of_claims(cls, right: Mask, claimed: Mask) -> Self:
        """Return that of claims, each of which is or is not right."""
        made = cls.of_probabilities(np.ones(np.count_nonzero(claimed)), right[claimed])
        return cls(made.count, made.stated, made.so, int(np.count_nonzero(~claimed)))

    def __add__(self, other: Self) -> Self:
        sums = self.count + other.count, self.stated + other.stated, self.so + other.so
        return type(self)(*sums, self.unknown + other.unknown, self.regions or other.regions)

    @property
    def cases(self) -> int:
        """How many things something was stated of."""
        return int(self.count.max() if self.regions else self.count.sum())

    @property
    def rates(self) -> tuple[Numbers, Numbers]:
        """Mean probability that was stated, and share that was so, of the tenths with enough cases."""
        enough = self.count >= ENOUGH
        return self.stated[enough] / self.count[enough], self.so[enough] / self.count[enough]

    @property
    def worst(self) -> float:
        """Largest difference of the rates of a tenth; NaN without enough cases."""
        stated, so = self.rates
        return float(np.abs(stated - so).max()) if len(so) else np.nan

    @property
    def mean(self) -> float:
        """Mean difference of the rates, weighted by the cases."""
        return float(np.abs(self.stated - self.so).sum() / max(self.count.sum(), 1))

    @property
    def square(self) -> float:
        """Mean square of these differences."""
        squares = (self.stated - self.so) ** 2 / np.maximum(self.count, 1)
        return float(squares.sum() / max(self.count.sum(), 1))


Statements = dict[str, Reliability]

# --- objects and pixels -------------------------------------------------------------------------------------

OVERLAP = 0.5  # of a box that is somebody's
STREETS: Mapping[str, tuple[str, str, str]] = {
    "pets2009-s2l1": ("vtest.avi", "gt.txt", "det.txt"),
    "tud-campus": ("img1", "gt/gt.txt", "det/det.txt"),
    "mot15-kitti-17": ("img1", "gt/gt.txt", "det/det.txt"),
}
"""Film, true boxes and a detector's."""


def generated_street(seed: int) -> Statements:
    """Pixels and boxes of a generated street."""
    scene, pixels, places = sleeping_man(seed=seed), Reliability.nothing(), Reliability.nothing()
    for index, belief in enumerate(RecursiveBP(build_model("recursive-bp")).run(scene)):
        covered = 1 - belief["pixels"].background_probability()
        pixels += Reliability.of_probabilities(covered, scene.masks[index])
        tracks, true = belief["blobs"].tracks(), boxes_of(each.box for each in scene.boxes(index))
        found = boxes_of(track.box for track in tracks)
        whose, which = match_boxes(box_overlap(true, found), OVERLAP)
        off = (true[whose] - found[which]) @ TO_MIDDLE
        unsure = np.array([tracks[each].position_covariance for each in which]).reshape(-1, 2, 2)
        places += Reliability.of_regions(squared_distances(off, unsure), 2)
    return {"pixel is foreground": pixels, "middle of a box": places}


TO_MIDDLE = np.array([[1, 0], [0, 1], [0.5, 0], [0, 0.5]])
"""From x, y, width and height."""


def boxes_of(boxes: Iterable[tuple[float, float, float, float]]) -> Numbers:
    """Return `(n, 4)`, also of none."""
    return np.array(list(boxes), np.float64).reshape(-1, 4)


def detected_objects(seed: int) -> Statements:
    """Existence of objects on streets with a detector."""
    made = Reliability.nothing()
    for name, files in STREETS.items():
        film = AnnotatedFilm.read(name, *(data_folder(name) / file for file in files))
        with open_source(film.source) as source:
            frames = film.prepare(source, seed, 1)
            for belief in RecursiveBP(build_model("recursive-bp")).run(frames):
                tracks, true = belief["blobs"].tracks(), film.truth.at(belief.frame.number)
                overlap = box_overlap(true.box, boxes_of(track.box for track in tracks))
                whose, which = match_boxes(overlap, OVERLAP)
                so, judged = np.zeros(len(tracks), np.bool_), np.ones(len(tracks), np.bool_)
                so[which], judged[which[true.kind[whose] == Kind.IGNORED]] = True, False
                stated = np.array([track.confidence for track in tracks])
                made += Reliability.of_probabilities(stated[judged], so[judged])
    return {"detected object exists": made}


# --- points and cameras -------------------------------------------------------------------------------------

STEPS = (6.0, 10.0, 15.0, 23.0)  # degrees between the pictures of a turntable
TURN = 3.0  # degrees by which a camera that is known may be wrong


def generated_cylinder(drift: float, seed: int) -> Statements:
    """Positions of the points of a cylinder, visible and hidden ones; tracks may drift, which is no noise."""
    truth = cylinder(seed=seed, p_drift=drift)
    unit = 100.0  # px per radius
    found = reconstruct(unit * truth.tracks(), camera="affine")
    pairs = [(found.point_of_track[track], point) for track, point in enumerate(truth.point_of_track)]
    whose = {int(mine): int(point) for mine, point in pairs if mine >= 0}
    mine, true = np.array(list(whose)), np.array(list(whose.values()))
    off = found.positions[:, mine] - unit * truth.positions[:, true]
    squares, seen = squared_distances(off, found.covariances[:, mine]), found.observed[:, mine]
    return {
        "observed point of a shape": Reliability.of_regions(squares[seen], 2),
        "hidden point of a shape": Reliability.of_regions(squares[~seen], 2),
    }


def generated_turntable(seed: int) -> Statements:
    """Cameras and focal lengths of turntables, from close pictures to wide ones."""
    known, focal = Reliability.nothing(), Reliability.nothing()
    for step in STEPS:
        scene = turntable(16, (288, 360), step, seed=seed)
        found = structure_of(scene.frames())
        known += known_cameras(found, scene.rotations)
        focal += focal_length(found, scene.focal)
    return {"camera is known": known, "focal length": focal}


def real_turntable(seed: int) -> Statements:
    """Cameras and focal lengths of a plaster dinosaur: all pictures, and some of them."""
    folder = data_folder("middlebury-dino")
    lines = [line.split() for line in (folder / "dino_par.txt").read_text(encoding="utf-8").splitlines()[1:]]
    truth = {line[0]: np.array(line[10:19], np.float64).reshape(3, 3) for line in lines}
    paths = [path for path in sorted(folder.glob("*.png")) if path.name in truth]
    random = np.random.default_rng(seed)
    some = np.sort(random.choice(len(paths), 16, replace=False))
    known, focal = Reliability.nothing(), Reliability.nothing()
    for chosen in (some, np.arange(seed % 2, len(paths), 2), np.arange(seed % 3, len(paths), 3)):
        frames = [picture(paths[index], number) for number, index in enumerate(chosen, 1)]
        found = structure_of([noisy(frame, seed) for frame in frames])
        known += known_cameras(found, np.array([truth[paths[index].name] for index in chosen]))
        focal += focal_length(found, float(lines[0][1]))
    return {"camera is known": known, "focal length": focal}


def picture(path: Path, number: int) -> Frame:
    """Return a grey picture as frame of a film."""
    return Frame(np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)), number / 25, number)


def structure_of(frames: Sequence[Frame]) -> Reconstruction | None:
    """Return the structure, or `None` where the application says that there is none."""
    try:
        return reconstruct(frames)
    except ValueError:
        return None


def known_cameras(found: Reconstruction | None, truth: Numbers) -> Reliability:
    """Return whether rotations `(n_frames, 3, 3)` of the cameras that are stated to be known are right."""
    right, known = np.zeros((2, len(truth)), np.bool_)
    if found is not None and found.perspective is not None:
        known = found.perspective.frame_determined
        right[known] = wrong_by(found.perspective.cameras.rotations[known], truth[known]) <= TURN
    return Reliability.of_claims(right, known)


def wrong_by(rotations: Numbers, truth: Numbers) -> Numbers:
    """Return by how many degrees each rotation `(n, 3, 3)` is wrong.

    The world's axes are arbitrary: they are those of the one by which most others are right.
    """
    worlds = np.swapaxes(truth, 1, 2) @ rotations
    off = (truth @ worlds[:, None]) @ np.swapaxes(rotations, 1, 2)
    wrong = np.degrees(np.linalg.norm(logarithm(off.reshape(-1, 3, 3)), axis=1)).reshape(off.shape[:2])
    best: Numbers = wrong[np.argmin(np.median(wrong, axis=1))]
    return best


def focal_length(found: Reconstruction | None, truth: float) -> Reliability:
    """Return whether the true focal length is in the regions of the stated one, if one is stated."""
    known = None if found is None else found.perspective
    if known is None or not 2 * known.focal_deviation < known.cameras.focal:
        return Reliability.of_claims(np.zeros(1, np.bool_), np.zeros(1, np.bool_))
    off = (known.cameras.focal - truth) / known.focal_deviation
    return Reliability.of_regions(np.array([off**2]), 1)


# --- faces, bodies, shapes ----------------------------------------------------------------------------------

N_FRAMES = 80
NEAR = 0.25  # of a face's or a head's size: what is tracked is within that


def generated_face(hidden: range, seed: int) -> Statements:
    """Places of the vertices of a face, and whether it is where it is stated to be.

    In frames of the range `hidden` another face is in its place.
    """
    scene, other = face(N_FRAMES, seed=seed), face(N_FRAMES, seed=seed + len(SEEDS))
    tracker = FaceTracker(model=scene.model, seed=seed)
    places, tracked = Reliability.nothing(), Reliability.nothing()
    for index, true in enumerate(scene.vertices):
        image = (other if index in hidden else scene).image(index)
        found = tracker.update(image, landmarks=scene.vertices[0])
        assert found is not None
        off, size = found.vertices[:, :2] - true, float(np.ptp(true[:, 0]))
        near = index not in hidden and np.linalg.norm(off, axis=1).mean() < NEAR * size
        tracked += probable(found, right=bool(near))
        if not found.lost and index not in hidden:
            places += in_the_picture(off, found.covariances)
    return {"vertex of a face": places, "face is where it is stated": tracked}


def probable(found: TrackedFace | None, *, right: bool) -> Reliability:
    """Return that of the probability of a face, of which nothing is claimed where it is lost or not found."""
    if found is None or found.lost:
        return replace(Reliability.nothing(), unknown=1)
    return Reliability.of_probabilities(np.array([found.probability]), np.array([right]))


WITH_FACE, WITHOUT = "films with a face", "films without a face"
FACES: Mapping[str, Mapping[str, str]] = {
    WITH_FACE: {
        "talking-face": "franck.webm",
        "carphone": "carphone_pristine.mp4",
        "signer": "signseg_demo_video.mp4",
        "sign-pose": "wave.mp4",
    },
    WITHOUT: {"cmu-hotel": "", "bobot": "", "middlebury-dino": ""},
}
"""Public films that show one all the time, or never: folders, and files in them."""
N_FRAMES_OF_FILMS = 100
MINUTE = 60 * 25  # frames


def faces_of_films(kind: str, seed: int) -> Statements:
    """Whether there is a face, in films that show one all the time or never."""
    shown = Reliability.nothing()
    for name, file in FACES[kind].items():
        tracker = FaceTracker(seed=seed)
        with open_source(str(data_folder(name) / file), stop=N_FRAMES_OF_FILMS) as source:
            for frame in source:
                shown += probable(tracker.update(noisy(frame, seed).image), right=kind == WITH_FACE)
    return {"face is in view": shown}


def in_the_picture(off: Numbers, covariances: Numbers) -> Reliability:
    """Return that of places in the picture, of experts that may all coincide."""
    return Reliability.of_regions(
        squared_distances(off, covariances[:, :2, :2] + LEAST_VARIANCE * np.eye(2)), 2
    )


def nobody(seed: int) -> Statements:
    """Faces and people in films of smooth random texture, where there are none."""
    random, statements = np.random.default_rng(seed), {}
    texture = 128 + 40 * mottle((320, 240), 40.0, random)
    noise = 3 * random.standard_normal((30, *texture.shape))
    film = np.repeat(np.clip(texture + noise, 0, 255).astype(np.uint8)[..., None], 3, axis=3)
    trackers: Mapping[str, FaceTracker | BodyTracker]
    trackers = {"face is there": FaceTracker(seed=seed), "person is there": BodyTracker(seed=seed)}
    for name, tracker in trackers.items():
        stated = any(tracker.update(image) is not None for image in film)
        statements[name] = Reliability.of_claims(np.zeros(1, np.bool_), np.array([stated]))
    return statements


SIGNERS: Mapping[str, Sleeves] = {
    "generated signer": "long",
    "generated signer in short sleeves": "short",
    "generated head and shoulders": "long",
}
BELOW = (0.3, 1.0)  # head heights below the shoulders at which pictures of head and shoulders end


def rows_of(kind: str, scene: SignerScene) -> int:
    """Return how many rows of a scene's pictures are shown."""
    rows = scene.size[1]
    if kind == "generated head and shoulders":
        below = np.random.default_rng(scene.seed).uniform(*BELOW) * scene.body.head_height
        rows = min(rows, int(np.median(scene.joints[:, 1, 1]) + below))
    return rows


def generated_signer(kind: str, seed: int) -> Statements:
    """Places of the hands of a signer, and whether they are seen."""
    scene = signer(N_FRAMES, seed, sleeves=SIGNERS[kind])
    head, rows = scene.body.head_height, rows_of(kind, scene)
    x, y = scene.joints[0, 0, :2]
    box = f"{x - 0.4 * head:.0f},{y - 0.5 * head:.0f},{0.8 * head:.0f},{head:.0f}"
    truth = scene.joints[:, PLACES[HANDS], :2]
    truth[truth[..., 1] >= rows] = np.inf
    images = (frame.required_image()[:rows] for frame in scene)
    return hands_of(images, truth, 2 * NEAR * head, seed, head=box, hidden=scene.hidden[:, 1:])


def real_signers(seed: int) -> Statements:
    """Hands of real people, and of one of whom only the face is in view."""
    total: Statements = {}
    for name, near in (("soup", 25.0), ("wave", 80.0)):
        path = data_folder("sign-pose") / f"{name}.mp4"
        table = np.genfromtxt(path.with_suffix(".csv"), delimiter=",", skip_header=1)
        total = joined(total, hands_of_film(path, table[:, 1:], near, seed))
    nowhere = np.full((60, 4), np.inf)
    return joined(total, hands_of_film(data_folder("talking-face") / "franck.webm", nowhere, 1.0, seed))


def joined(one: Statements, other: Statements) -> Statements:
    """Return the statements of both."""
    return {what: one.get(what, Reliability.nothing()) + each for what, each in other.items()}


def hands_of_film(path: Path, places: Numbers, near: float, seed: int) -> Statements:
    """Return the statements on the first frames of a film; `places` `(n, 4)` px are of both palms."""
    with open_source(str(path), stop=len(places)) as source:
        images = [noisy(frame, seed).image for frame in source]
    return hands_of(images, places.reshape(-1, 2, 2), near, seed)


def hands_of(
    images: Iterable[Image | None],
    truth: Numbers,
    near: float,
    seed: int,
    *,
    head: str | None = None,
    hidden: Mask | Literal[False] = False,
) -> Statements:
    """Return what `rsmcm body` states of the hands.

    Truth is `(n, 2, 2)` px, infinite for a hand that is not in the image and NaN for one of which nothing is
    known. It is right that a hand is seen if it is within so many px, and not `hidden` `(n, 2)`.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "film").mkdir()
        for number, image in enumerate(images):
            assert image is not None
            cv2.imwrite(str(folder / "film" / f"{number:04d}.png"), image)
        try:
            run_body(BodyJob(str(folder / "film"), out=folder / "out", head=head, seed=seed))
        except ValueError:  # nobody is there
            nothing = np.zeros(2 * len(truth), np.bool_)
            return {
                "hand of a body": Reliability.nothing(),
                "hand is seen": Reliability.of_claims(nothing, nothing),
            }
        poses = np.load(folder / "out" / "poses.npz")
        stated = poses["seen_probability"][:, 1:]
        off = poses["joints_2d"][:, PLACES[HANDS]] - truth
        unsure = poses["joints_2d_covariances"][:, PLACES[HANDS]] + LEAST_VARIANCE * np.eye(2)
    known, placed = ~np.isnan(off).any(axis=2), np.isfinite(off).all(axis=2)
    right = (np.linalg.norm(off, axis=2) < near) & ~np.asarray(hidden)
    return {
        "hand of a body": Reliability.of_regions(squared_distances(off[placed], unsure[placed]), 2),
        "hand is seen": Reliability.of_probabilities(stated[known], right[known]),
    }


def noisy_shape(seed: int) -> Statements:
    """Points in space of a deforming shape whose tracks have noise."""
    truth = read_shapes(sequence_file("jaws"))
    size = np.ptp(truth[..., :2])
    noise = np.random.default_rng(seed).normal(0, 0.002 * size, truth[..., :2].shape)
    learned = learn_shape(truth[..., :2] + noise, 3)
    found, unsure = learned.shapes(), learned.shape_covariances()
    off = nearer_image(found, truth) - (truth - truth.mean(axis=1, keepdims=True))
    flat = squared_distances(found[..., :2] - truth[..., :2], unsure[..., :2, :2])
    return {
        "point of a deforming shape, in the picture": Reliability.of_regions(flat, 2),
        "depth of a deforming shape": Reliability.of_regions(off[..., 2] ** 2 / unsure[..., 2, 2], 1),
    }


# --- constants of the statement that a hand is seen ---------------------------------------------------------

SEEDS_OF_CONSTANTS = range(100, 108)  # of other scenes than those on which statements are judged
DRAWS = 100  # of scenes, with replacement
NAMES = ("spread of the hands", "factor of the skin's nats")
USED = (SPREAD, SEEN)
TRIED = tuple(product((2.0, 3.0, 3.5, 4.0, 4.5, 5.0), (4.0, 6.0, 7.0, 8.0, 9.0)))
PRIOR = np.log(HAND_DETECTED / (1 - HAND_DETECTED))  # nats: of a signer's hand, without evidence
OF_CONSTANTS = (
    "Constants of the probability that a hand is seen: those with which tenths of what is stated differ "
    "least from what is observed, in the mean square, on all kinds of generated signers, of "
    f"{len(SEEDS_OF_CONSTANTS)} seeds that are judged nowhere; standard deviation over {DRAWS} draws of them."
)

Constants = tuple[float, float]
Evidence = tuple[Numbers, Numbers, Numbers, Mask]


def evidence_of_hands(kind: str, seed: int) -> dict[str, Evidence]:
    """Return what statements about the hands of a signer rest on, and whether they would be right.

    Of samples `(n_frames, n_samples, 2)`, see `apart_and_shared`, and their nats of skin; whether a hand is
    seen and near the mean, `(n_frames, 2)`.
    """
    scene = signer(N_FRAMES, seed, sleeves=SIGNERS[kind])
    rows = rows_of(kind, scene)
    film = SignerFilm.of_scene(scene, rows)
    model, pose = RSMCM.connected(film)
    engine, state, found = RecursiveBP(model), RunState(), []
    smoothing = FixedLag(BodyDynamics(scene.body), LAG, seed=seed)
    for frame in film.frames:
        belief = engine.step(state, frame)
        state = belief.state
        found += smoothing.add(frame, state.states[pose], belief.evidence(film.parts).image)
    found += smoothing.flush()
    hands = np.array([scene.body.parts(each.samples.poses)[:, 1:] for each in found])
    nats = (np.array([each.hand_log_odds for each in found]) - PRIOR) / SEEN
    mean, near = hands.mean(axis=1), NEAR_MEAN * scene.body.head_height
    truth = scene.joints[:, PLACES[HANDS], :2]
    seen = (truth[..., 1] < rows) & ~scene.hidden[:, 1:]
    apart, shared = apart_and_shared(scene.body, hands, hands - mean[:, None])
    return {"hands": (apart, shared, nats, seen & (np.linalg.norm(mean - truth, axis=2) < near))}


def reliability(constants: Constants, evidence: Evidence) -> Reliability:
    """Return that of what would be stated with other constants."""
    (spread, factor), (apart, shared, nats, right) = constants, evidence
    stated = hands_are_seen(apart, shared, PRIOR + factor * nats, spread)
    return Reliability.of_probabilities(stated.mean(axis=1), right)


def best_constants(made: Mapping[Constants, Sequence[Reliability]], films: Iterable[int]) -> Constants:
    """Return those of the least difference on some films."""
    films = list(films)
    return min(made, key=lambda each: sum((made[each][film] for film in films), Reliability.nothing()).square)


def constants_of_hands() -> Table:
    """Compare constants of the statement with the best ones."""
    films = by_seed("constants", evidence_of_hands, list(SIGNERS), SEEDS_OF_CONSTANTS)
    evidence = [each for kind in SIGNERS for each in films[kind]["hands"]]
    made = {constants: [reliability(constants, each) for each in evidence] for constants in TRIED}
    draws = np.random.default_rng(0).integers(len(evidence), size=(DRAWS, len(evidence)))
    spread = np.std([best_constants(made, draw) for draw in draws], axis=0)
    rows = zip(NAMES, USED, best_constants(made, range(len(evidence))), spread, strict=True)
    return Table(
        ("constant", "used", "best", "standard deviation"), [list(row) for row in rows], OF_CONSTANTS
    )


# --- the experiment -----------------------------------------------------------------------------------------

CASES: Mapping[str, Callable[[int], Statements]] = {
    "generated street": generated_street,
    "three streets with a detector": detected_objects,
    "cylinder": partial(generated_cylinder, 0.0),
    "cylinder with drift": partial(generated_cylinder, 0.3),
    "generated turntables": generated_turntable,
    "middlebury-dino": real_turntable,
    "generated face": partial(generated_face, range(0)),
    "generated face that another hides for a second": partial(generated_face, range(30, 55)),
    WITH_FACE: partial(faces_of_films, WITH_FACE),
    WITHOUT: partial(faces_of_films, WITHOUT),
    "random texture": nobody,
    **{kind: partial(generated_signer, kind) for kind in SIGNERS},
    "real people": real_signers,
    "jaws with noise": noisy_shape,
}
"""What makes the statements of a seed, by what they are stated of."""
LINE = ("of", "statement", "cases", "unknown, %", "mean difference", "largest in a tenth")
EXPLANATION = (
    "Difference between the probability that is stated and the share that is so: mean over all cases, and "
    f"in the worst tenth of probabilities with {ENOUGH} cases or more. Regions are Gaussian, of 5, 15, ... "
    "95 %. A plain claim counts as a probability of 1; unknown: cases without a claim."
)


def calibration() -> Findings:
    """Compare what all applications state of themselves with the truth.

    Raises
    ------
    OSError
        if a sequence cannot be found.
    """
    made = by_seed("calibration", _statements, list(CASES), SEEDS)
    lines, totals = [], {}
    for of, statements in made.items():
        for what, seeds in statements.items():
            total = totals[f"{what}, {of}"] = sum(seeds, Reliability.nothing())
            unknown = 100 * total.unknown / max(total.cases + total.unknown, 1)
            lines.append([of, what, total.cases, unknown, total.mean, total.worst])
    return Findings(
        "Calibration",
        [Table(LINE, lines, EXPLANATION), constants_of_hands()],
        over_seeds(expectations_of, made),
        [
            Plot(
                "fig-reliability.png",
                partial(draw, totals),
                (13.0, 13.0),
                "Stated against observed; exact: diagonal.",
            )
        ],
    )


def _statements(case: str, seed: int) -> Statements:
    return CASES[case](seed)


def expectations_of(made: Mapping[str, Mapping[str, Sequence[Reliability]]]) -> list[Expectation]:
    """Return how far what is stated is from what is observed, and mistakes a minute of films."""
    expected = [
        Expectation(f"{what}, {of}: mean difference", sum(seeds, Reliability.nothing()).mean, "<=", BOUND)
        for of, statements in made.items()
        for what, seeds in statements.items()
    ]
    for kind, mistakes in ((WITH_FACE, "misses"), (WITHOUT, "false alarms")):
        total = sum(made[kind]["face is in view"], Reliability.nothing())
        wrong = total.unknown if kind == WITH_FACE else total.cases
        rate = MINUTE * wrong / (total.cases + total.unknown)
        expected.append(Expectation(f"{mistakes} a minute, {kind}", rate, "<=", 0))
    return expected


def draw(totals: Mapping[str, Reliability], canvas: Figure) -> None:
    """Draw the rates of every statement."""
    columns = 4
    all_axes = canvas.subplots(-(-len(totals) // columns), columns, squeeze=False).reshape(-1)
    for axes in all_axes[len(totals) :]:
        axes.set_visible(False)
    for axes, (name, total) in zip(all_axes, totals.items(), strict=False):
        axes.plot([0, 1], [0, 1], color="#9a9a9a", linewidth=1)
        axes.plot(*total.rates, "o-", color="#1f5fa8", markersize=4)
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal", xlabel="stated", ylabel="observed")
        axes.set_title(name.replace(", ", "\n"), fontsize=8)
