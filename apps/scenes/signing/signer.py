"""A generated signer who sits in front of a room, with exact poses and with faults of the detectors.

Any frame is rendered on its own, from the seed and the frame's index only.
"""

from collections.abc import Iterable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ....models.body.upper_body import PARTS, BodyPoses, UpperBody
from ....models.core.checks import Count, CountFrom0, NotNegative, between, checked
from ....models.core.frame import Frame
from ..generated_film import GeneratedFilm
from ..random_fields import wander
from ..rendering_kernels import EMPTY_DEPTH, draw_mesh
from .faults import MISSING, Distractor, ListedFaces, bursts, face_boxes, false_skin
from .motion import signing
from .paint import Palette, paint_background, paint_cloth, paint_head, paint_skin
from .shape import HandShape, Solid, blob, surface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Pixels = NDArray[np.float32]

SHUTTER = 0.5  # of the time between frames that light is gathered
BLUR_STEP = 4.0  # px that a hand moves between two pictures of one exposure
MOST_PICTURES = 4  # of one exposure

SAMPLES = 2  # of a pixel, across and down
AMBIENT = 0.45  # share of the light that has no direction
BRIGHTEST = 1.12  # light on what faces the lamp
GLARE = np.array([236.0, 240.0, 242.0])  # BGR of blown-out skin

Sleeves = Literal["long", "short"]


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colours, textures and lamp of a scene, and rendering with them."""

    seed: int
    size: tuple[int, int]
    head_height: float
    clutter: float

    @cached_property
    def palette(self) -> Palette:
        """The scene's colours."""
        return Palette(np.random.default_rng([self.seed, 2]))

    def draw(self, solids: Iterable[tuple[Solid, str]]) -> Pixels:
        """`(height, width, 3)` grey levels under full light: solids of materials in front of the room."""
        colours = self._room.copy()
        depths = np.full(colours.shape[:2], EMPTY_DEPTH, np.float32)
        for solid, material in solids:
            density = self._head_density if material == "head" else 1.0
            # sample k of a pixel lies at (k - (SAMPLES - 1) / 2) / SAMPLES from its centre
            places = solid.places.copy()
            places[:, :2] = (places[:, :2] + 0.5) * SAMPLES - 0.5
            shade = np.maximum(0.15 + 0.85 * (solid.normals @ self._lamp), 0)
            light = AMBIENT + (BRIGHTEST - AMBIENT) * shade
            attributes = np.column_stack([density * solid.texels, light])
            facing = solid.normals[:, 2] < 0.2
            seen = solid.triangles[facing[solid.triangles].any(axis=1)]
            draw_mesh(colours, depths, places, attributes, seen, self._textures[material])
        return np.asarray(cv2.resize(colours, self.size, interpolation=cv2.INTER_AREA), np.float32)

    @cached_property
    def _room(self) -> Pixels:
        """The room in samples."""
        room = paint_background(self.size, self.palette, self.clutter, np.random.default_rng([self.seed, 5]))
        return np.ascontiguousarray(room.repeat(SAMPLES, axis=0).repeat(SAMPLES, axis=1))

    @cached_property
    def _textures(self) -> dict[str, Pixels]:
        """By material, a texel a px but for the head."""
        generator = np.random.default_rng([self.seed, 6])
        palette, side = self.palette, int(np.ceil(4 * self.head_height))
        top = paint_cloth(side, palette.top, generator)
        return {
            "head": paint_head(self._head_density, palette, generator),
            "skin": paint_skin(side, palette.skin, generator),
            "top": top,
            "trousers": paint_cloth(side, palette.trousers, generator),
            "glove": np.float32(0.6) * top,
            "glare": paint_skin(side, GLARE, generator),
        }

    @property
    def _head_density(self) -> float:
        """Texels a rad of the head's picture."""
        return 0.75 * self.head_height

    @cached_property
    def _lamp(self) -> Array:
        """`(3,)` unit vector towards the lamp."""
        generator = np.random.default_rng([self.seed, 8])
        azimuth, elevation = generator.uniform(-0.9, 0.9), generator.uniform(0.3, 0.9)
        across, towards = np.sin(azimuth), np.cos(azimuth)
        return np.array([across * np.cos(elevation), -np.sin(elevation), -towards * np.cos(elevation)])


@checked
@dataclass(frozen=True, eq=False)
class SignerScene(GeneratedFilm):
    """A signer in front of a cluttered room, with detections that fail for some time.

    Hands move across the face, each other and towards the viewer; the head sways and rotates. The height of
    the head is 21 to 27 % of that of the image. The first frames of a longer scene are those of a shorter
    one.

    Parameters
    ----------
    n_frames
        length of the scene, 25 frames a second.
    seed
        of person, motion, room, light, faults and noise.
    detector_dropout
        share of frames, 0 to 1, in which the feature of a part is missing, independently for head and hands,
        in bursts of 2 to 12 frames: no face is detected, a hand does not have the colour of skin.
    clutter
        amount of objects in the room, some in the colour of skin: 0, a plain wall; 1, shelves, pictures and
        wooden objects, and false hands in 15 % of the frames.
    size
        `(width, height)` px.
    noise
        standard deviation of the sensor's noise, grey levels.
    sleeves
        "long", or "short": forearms and the lower halves of upper arms have the colour of skin, also where
        that of the hand is missing.

    Raises
    ------
    ValueError
        if the picture is less than 120 px high or higher than wide.
    """

    n_frames: Count = 120
    seed: CountFrom0 = 0
    detector_dropout: Annotated[float, between(0, 1)] = 0.2
    clutter: NotNegative = 1.0
    size: tuple[int, int] = (640, 360)
    _: KW_ONLY
    noise: NotNegative = 2.5
    sleeves: Sleeves = "long"

    def __post_init__(self) -> None:
        width, height = self.size
        if not 120 <= height <= width:
            raise ValueError(
                f"size: got {self.size}, expected (width, height), 120 px high or more and at least as wide"
            )

    def make(self, index: int) -> Frame:
        """Frame `index` with its time; the picture has colours."""
        return self._seen(self._exposed(index) * self._light[index].astype(np.float32), self.noise, 3, index)

    # The truth

    @cached_property
    def body(self) -> UpperBody:
        """Lengths of the signer, px; proportions differ between scenes."""
        generator = np.random.default_rng([self.seed, 0])
        head = self.size[1] * generator.uniform(0.21, 0.275)
        usual = UpperBody.from_head(float(head))
        stretch = dict(
            zip(
                ("head_width", "neck", "shoulder_width", "upper_arm", "forearm", "hand"),
                np.clip(1 + generator.normal(0, 0.04, 6), 0.9, 1.1),
                strict=True,
            )
        )
        return replace(
            usual, **{name: float(share * getattr(usual, name)) for name, share in stretch.items()}
        )

    @cached_property
    def poses(self) -> BodyPoses:
        """Pose of every frame, in the middle of its exposure."""
        return self._motion.take(slice(self.n_frames))

    @cached_property
    def _motion(self) -> BodyPoses:
        """Poses of the frames, and of one more, for the last exposure."""
        generator = np.random.default_rng([self.seed, 1])
        width, height = self.size
        top = self.body.neck + 0.62 * self.body.head_height  # of the hair
        lap = 1.95 * self.body.head_height
        # room above the head and below the lap is shared out
        spare = max(0.0, height - top - lap)
        home = np.array([width * generator.uniform(0.38, 0.62), top + spare * generator.uniform(0.2, 0.9)])
        return signing(self.body, home, self.size, self.n_frames + 1, self.dt, self.seed)

    @cached_property
    def joints(self) -> Array:
        """`(n_frames, 8, 3)` px: where the `JOINTS` are; z is away from the viewer."""
        return self.body.joints(self.poses)

    @cached_property
    def hidden(self) -> Mask:
        """`(n_frames, 3)` bool: whether the feature of each of `PARTS` is missing."""
        return self._bursts > 0

    @cached_property
    def detector(self) -> ListedFaces:
        """Face detector of this scene's frames, with errors, misses and false alarms."""
        heads = self.joints[:, 0, :2]
        return face_boxes(heads, self.hidden[:, 0], self.body.head_height, self.size, self.clutter, self.seed)

    @cached_property
    def distractors(self) -> tuple[Distractor, ...]:
        """False hands."""
        return false_skin(self.poses.roots, self.body.head_height, self.size, self.clutter, self.seed)

    @cached_property
    def _bursts(self) -> NDArray[np.int64]:
        generators = [np.random.default_rng([self.seed, 20, part]) for part in range(len(PARTS))]
        share = self.detector_dropout
        return np.stack([bursts(self.n_frames, share, MISSING, each) for each in generators], axis=1)

    # What it looks like

    @property
    def _times(self) -> Array:
        return self.dt * np.arange(self.n_frames + 1, dtype=np.float64)

    @cached_property
    def _appearance(self) -> Appearance:
        return Appearance(self.seed, self.size, self.body.head_height, self.clutter)

    @cached_property
    def _light(self) -> Array:
        """`(n_frames + 1, 3)`: light of every channel, as a share of full light, that changes slowly."""
        generator = np.random.default_rng([self.seed, 7])
        tint = 1 + 0.05 * generator.standard_normal(3)
        gain = 1 + 0.05 * np.tanh(wander(self._times, (4.0, 12.0), generator))
        light: Array = gain[:, None] * tint * generator.uniform(0.88, 1.08)
        return light

    @cached_property
    def _gestures(self) -> Array:
        """`(n_frames + 1, 2, 7)`: roll, bend and the curl of five fingers of both hands."""
        generator = np.random.default_rng([self.seed, 9])
        waves = [wander(self._times, (0.8, 4.0), generator) for _ in range(14)]
        gestures = np.stack(waves, axis=1).reshape(-1, 2, 7)
        gestures[:, :, 0] *= 0.9
        gestures[:, :, 1] = 0.5 * np.tanh(gestures[:, :, 1])
        gestures[:, :, 2:] = 1 / (1 + np.exp(-2.5 * gestures[:, :, 2:]))
        return gestures

    def _between(self, moment: float) -> tuple[BodyPoses, list[HandShape]]:
        """Pose and hands at frame `moment`, between two frames."""
        first = max(0, int(np.floor(moment)))
        share = max(0.0, moment - first)
        before, after = self._motion.take([first]), self._motion.take([first + 1])

        def mixed(a: Array, b: Array) -> Array:
            mixture: Array = a + share * (b - a)
            return mixture

        arms = mixed(before.arms, after.arms)
        arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
        pose = BodyPoses(
            mixed(before.roots, after.roots),
            mixed(before.torsos, after.torsos),
            mixed(before.necks, after.necks),
            arms,
        )
        gestures = mixed(self._gestures[first], self._gestures[first + 1])
        return pose, [HandShape(float(row[0]), float(row[1]), row[2:]) for row in gestures]

    def _exposed(self, index: int) -> Pixels:
        """The picture before light and noise: the mean of some moments of the exposure."""
        hands = self.body.parts(self._motion.take(slice(max(0, index - 1), index + 2)))[:, 1:]
        step = float(np.linalg.norm(np.diff(hands, axis=0), axis=2).max())
        pictures = int(np.clip(np.ceil(SHUTTER * step / BLUR_STEP), 1, MOST_PICTURES))
        moments = index + SHUTTER * ((np.arange(pictures) + 0.5) / pictures - 0.5)
        exposed = self._appearance.draw(self._solids(index, float(moments[0])))
        for moment in moments[1:]:
            exposed += self._appearance.draw(self._solids(index, float(moment)))
        exposed /= np.float32(pictures)
        return exposed

    def _solids(self, index: int, moment: float) -> Iterator[tuple[Solid, str]]:
        """Yield all surfaces before the room at one moment of frame `index`, with their materials."""
        pose, hands = self._between(moment)
        shown = {}
        for part, name in ((1, "left hand"), (2, "right hand")):
            burst = int(self._bursts[index, part])
            shown[name] = "skin" if not burst else "glare" if (burst + self.seed) % 3 == 0 else "glove"
        for solid in surface(self.body, self._appearance.palette, pose, hands, self.sleeves == "short"):
            yield solid, shown.get(solid.material, solid.material)
        for thing in self.distractors:
            if thing.first <= index <= thing.last:
                yield blob(thing, moment, self.body.head_height), "skin"


signer = SignerScene
