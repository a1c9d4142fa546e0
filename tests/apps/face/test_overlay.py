"""What is drawn of a tracked face."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.face.overlay import (
    DOT,
    FRONT,
    LANDMARK,
    MOST_DOTS,
    PROFILE,
    FaceOverlay,
    TrackedFace,
    texture_picture,
)
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel
from rsmcm.models.face.pose import Poses
from rsmcm.models.face.surface_texels import SurfaceTexels
from rsmcm.models.numerics.rotations import exponential

GREY = 90
NOWHERE = np.zeros((0, 2))


@pytest.fixture(scope="module")
def model() -> MorphableModel:
    return face_model()


@pytest.fixture(scope="module")
def overlay(model: MorphableModel) -> FaceOverlay:
    return FaceOverlay(model)


def tracked(
    model: MorphableModel, landmarks: NDArray[np.float64] = NOWHERE, lost: bool = False, **change: float
) -> TrackedFace:
    """Three experts about a face in the middle of a picture of 320 x 240."""
    mean = Poses.upright(np.array([[160.0, 110.0]]), np.array([40.0]), model.n_bases)
    changes = np.zeros((3, mean.dimension))
    changes[:, 3] = (-6, 0, 6)
    changes[:, 4] = change.get("down", 0.0)
    return TrackedFace(mean.moved(changes), mean, landmarks, lost)


def blank(height: int = 240, width: int = 320) -> NDArray[np.uint8]:
    return np.full((height, width, 3), GREY, np.uint8)


def is_colour(picture: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = (picture == np.array(colour)).all(axis=2)
    return found


def test_vertices_of_all_experts_are_dots(model: MorphableModel, overlay: FaceOverlay) -> None:
    face = tracked(model)
    picture = overlay.draw(blank(), face, "frame 1")
    assert picture.shape == (480, 640 + round(0.32 * 480), 3), "enlarged, and the mean beside it"
    yellow = is_colour(picture, DOT)
    places = np.rint(2 * (model.project(face.experts) + 0.5) - 0.5).astype(int)
    shown = yellow[places[..., 1], places[..., 0]]
    assert np.count_nonzero(shown) >= 3 * min(model.n_vertices, MOST_DOTS)
    far = np.ones_like(yellow)
    for x, y in places.reshape(-1, 2):
        far[y - 4 : y + 5, x - 4 : x + 5] = False
    assert not (yellow & far).any()


@pytest.mark.parametrize("grey", [0, 40, 90, 150, 200, 255])
@pytest.mark.parametrize(("height", "size"), [(240, 40.0), (480, 80.0), (1080, 60.0), (1080, 180.0)])
def test_dots_stand_out_from_any_skin(
    model: MorphableModel, overlay: FaceOverlay, grey: int, height: int, size: float
) -> None:
    """Some of every dot is much brighter or darker than the skin, and most of the face is left to be seen."""
    width = height * 4 // 3
    mean = Poses.upright(np.array([[width / 2, height / 2]]), np.array([size]), model.n_bases)
    image = np.full((height, width, 3), grey, np.uint8)
    picture = overlay.draw(image, TrackedFace(mean, mean, NOWHERE, False), "")
    scale = picture.shape[0] // height
    luma = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(int)
    contrast = cv2.dilate(np.abs(luma - grey).astype(np.uint8), np.ones((9, 9)))
    x, y = np.rint(scale * (model.project(mean)[0] + 0.5) - 0.5).astype(int).T
    drawn = is_colour(picture, DOT)[y, x]
    assert np.count_nonzero(drawn) >= min(model.n_vertices, MOST_DOTS)
    assert contrast[y, x][drawn].min() >= 60
    left, right, top, bottom = x.min(), x.max(), y.min(), y.max()
    hidden = (picture[top:bottom, left:right] != grey).any(axis=2).mean()
    assert hidden < 0.5


def test_nothing_but_dots_is_drawn_on_the_face(model: MorphableModel, overlay: FaceOverlay) -> None:
    """Wherever the face is in the picture: the views are beside it."""
    for x, y in ((40, 40), (280, 40), (40, 200), (280, 200), (160, 120)):
        mean = Poses.upright(np.array([[x, y]], float), np.array([40.0]), model.n_bases)
        picture = overlay.draw(blank(), TrackedFace(mean, mean, NOWHERE, False), "")
        places = np.rint(2 * (model.project(mean)[0] + 0.5) - 0.5).astype(int)
        elsewhere = (picture[:, :640] != GREY).any(axis=2)
        for column, row in places:
            elsewhere[max(row - 5, 0) : row + 6, max(column - 5, 0) : column + 6] = False
        assert not elsewhere[30:].any(), "below the caption"


def test_landmarks_are_drawn_where_they_are(model: MorphableModel, overlay: FaceOverlay) -> None:
    landmarks = np.array([[20.0, 100.0], [np.nan, np.nan], [-50.0, 4.0], [1e12, 1.0], [60.5, 30.25]])
    found = is_colour(overlay.draw(blank(), tracked(model, landmarks), ""), LANDMARK).astype(np.uint8)
    count, _, _, centres = cv2.connectedComponentsWithStats(found)
    assert count == 3, "two dots and what is none; missing ones and those far outside are left out"
    expected = 2 * (landmarks[[4, 0]] + 0.5) - 0.5
    np.testing.assert_allclose(centres[1:], expected, atol=0.75)  # to whole pixels


def test_lost_is_said(model: MorphableModel, overlay: FaceOverlay) -> None:
    found, lost = (overlay.draw(blank(), tracked(model, lost=lost), "frame 7") for lost in (False, True))
    differs = (found != lost).any(axis=2)
    assert differs[:100, 200:440].sum() > 500
    assert not differs[120:].any()


@pytest.mark.parametrize(
    ("height", "width", "scale"), [(240, 320, 2), (480, 640, 1), (479, 9, 2), (16, 16, 30), (1000, 700, 1)]
)
def test_any_size_of_picture(
    overlay: FaceOverlay, model: MorphableModel, height: int, width: int, scale: int
) -> None:
    for image in (blank(height, width), blank(height, width)[..., 0]):
        picture = overlay.draw(image, tracked(model), "frame 1")
        assert picture.shape == (scale * height, scale * width + round(0.32 * scale * height), 3)


def test_a_face_far_outside(model: MorphableModel, overlay: FaceOverlay) -> None:
    for down in (1e4, -1e300):
        assert not is_colour(overlay.draw(blank(), tracked(model, down=down), ""), DOT).any()


def test_axes_turn_with_the_face(model: MorphableModel, overlay: FaceOverlay) -> None:
    """The tip of the gaze (blue) moves to the left as seen when the head turns there."""

    def gaze(turn: float) -> float:
        face = tracked(model)
        turned = Poses(exponential(np.array([[0.0, turn, 0.0]])), face.mean.translations, face.mean.morphs)
        picture = overlay.draw(blank(), TrackedFace(face.experts, turned, NOWHERE, False), "").astype(int)
        blue = (picture[..., 0] > 200) & (picture[..., 2] < 120)
        return float(np.nonzero(blue[400:, 640:])[1].mean())

    assert gaze(0.6) < gaze(0.0) - 5
    assert gaze(-0.6) > gaze(0.0) + 5


def test_views_show_the_shape(model: MorphableModel, overlay: FaceOverlay) -> None:
    morphs = np.zeros(model.n_bases)
    morphs[0] = 40.0
    picture, covered = overlay.view(morphs, FRONT, 150)
    assert picture.shape == (*covered.shape, 3)
    share = covered.mean()
    assert 0.5 < share < 0.95
    assert np.mean(covered == covered[:, ::-1]) > 0.97, "a face is symmetric"
    filled = cv2.morphologyEx(covered.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5)))
    assert filled.sum() - covered.sum() < 0.01 * filled.sum(), "without holes"
    twice, _ = overlay.view(2 * morphs, FRONT, 150)
    np.testing.assert_array_equal(twice, picture)
    side, beside = overlay.view(morphs, PROFILE, 150)
    assert side.shape[1] < picture.shape[1], "narrower"
    assert np.nonzero(beside)[1].min() < 0.15 * side.shape[1], "with the nose on the left"
    for k in range(1, model.n_bases):
        changed = morphs.copy()
        changed[k] = 40.0
        assert np.mean(overlay.view(changed, FRONT, 150)[0] != picture) > 0.02


# --- texture ------------------------------------------------------------------------------------------------


def test_a_texture_lies_where_its_texels_are(model: MorphableModel) -> None:
    """A texture that grows to the right gives columns that do, wherever there is surface."""
    texels = SurfaceTexels.dense(model, 2000)
    morphs = np.zeros(model.n_bases)
    morphs[0] = 40.0
    corners = model.bases[0][texels.groups[texels.group_of_texel], 0]
    right = 40 * (texels.weights * corners).sum(axis=1)
    picture = texture_picture(model, morphs, texels, right)
    assert picture.shape[0] == 480
    known = np.isfinite(picture)
    assert 0.5 < known.mean() < 0.95
    columns = np.nonzero(known)[1]
    fit = np.polyfit(columns, picture[known], 1)
    px = float(np.ptp(model.bases[0, :, 1]) * 40) / 480
    assert fit[0] == pytest.approx(px, rel=0.15)  # texels that face aside are not shown
    rest = picture[known] - np.polyval(fit, columns)
    assert np.abs(rest).mean() < 0.02 * np.ptp(right)


def test_patches_are_discs(model: MorphableModel) -> None:
    texels = SurfaceTexels.patches(model, 2.0)
    morphs = np.zeros(model.n_bases)
    morphs[0] = 60.0
    picture = texture_picture(model, morphs, texels, np.full(len(texels), 77.0))
    known = np.isfinite(picture)
    np.testing.assert_allclose(picture[known], 77)
    assert known.mean() < 0.9, "with gaps between them"


def test_random_textures_stay_within_their_values(model: MorphableModel) -> None:
    texels = SurfaceTexels.dense(model, 500)
    values: Any = np.random.default_rng(0).uniform(3, 9, len(texels))
    morphs = np.zeros(model.n_bases)
    morphs[0] = 1.0
    picture = texture_picture(model, morphs, texels, values)
    assert np.nanmin(picture) >= 3
    assert np.nanmax(picture) <= 9
