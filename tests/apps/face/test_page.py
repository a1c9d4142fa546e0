"""A face's page: what of a run is on it, and what can be done with it in a browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.face.page import FaceDrawing, FaceRecord, face_page
from rsmcm.apps.face.texture import vertices_on_texture
from rsmcm.apps.scenes import face
from rsmcm.apps.scenes.talking_face import FaceScene
from rsmcm.apps.view.film import Film, read_film
from rsmcm.apps.view.page import SEEN, Page
from rsmcm.models.face.surface import SurfaceTexels

from ...support.browser import Browser
from ...support.records import log_of
from ...support.view_page import Turned, ViewPage, shown_page, write_pages

N_FRAMES = 25
SIZE = (240, 180)
LOST = range(8, 14)  # indices of frames
MISSING = 20
DEVIATIONS = np.array([2.0, 1.0, 3.0])  # px
LANDMARKS = 7


@pytest.fixture(scope="module")
def scene() -> FaceScene:
    return face(N_FRAMES, size=SIZE, max_yaw=25.0)


@pytest.fixture(scope="module")
def drawing(scene: FaceScene) -> FaceDrawing:
    return FaceDrawing(scene.model)


def row(scene: FaceScene, index: int) -> dict[str, Any]:
    """Of `poses.npz`: the truth, with known errors."""
    pose = scene.poses[index]
    return {
        "vertices_2d": scene.vertices[index],
        "covariance": np.tile(np.diag(DEVIATIONS**2), (scene.model.n_vertices, 1, 1)),
        "mean_rotation": pose.rotations[0],
        "mean_translation": pose.translations[0],
        "mean_morphs": pose.morphs[0],
        "weights": np.full(4, 0.25),
        "landmarks": scene.vertices[index, :LANDMARKS],
        "log_evidence": np.float64(np.nan if index == MISSING else -index),
        "fit": np.float64(0.9),
        "lost": np.bool_(index in LOST),
        "tracked_probability": np.float64(index not in LOST),
        "missing": np.bool_(index == MISSING),
        "reinitialised": np.bool_(index == LOST.stop),
    }


def record_of(scene: FaceScene, n_frames: int, error: float) -> FaceRecord:
    rows = []
    for index in range(n_frames):
        made = row(scene, index)
        of_record = (
            "weights",
            "mean_rotation",
            "mean_morphs",
            "log_evidence",
            "fit",
            "lost",
            "tracked_probability",
            "reinitialised",
        )
        found = {name: made[name] for name in of_record}
        rows.append({**found, "error": np.nan if index == 0 else error})
    return FaceRecord(log_of(rows))


def page_of(film: Film, scene: FaceScene, drawing: FaceDrawing, error: float = 1.5) -> Page:
    morphs = scene.poses.morphs[-1]
    places = vertices_on_texture(scene.model, morphs, SurfaceTexels.dense(scene.model, 500))
    rows, columns = np.indices((480, 360))
    pictures = [(columns // 2).astype(np.uint8) + 40, (rows // 3).astype(np.uint8) + 40]
    textures = dict(zip(("mean", "variance"), pictures, strict=True))
    record = record_of(scene, len(film.numbers), error)
    summary = {
        "frames": len(film.numbers), "frames_per_second": 10.0, "frames_per_second_of_engine": 12.0,
        "lost_frames": 6, "reinitialised": [15], "missing_frames": 1, "error": None, "notes": [],
        "parameters": {"experts": 4},
    }  # fmt: skip
    layer = drawing.layer(film, textures, places)
    return face_page("a face", record, summary, film, layer, scene.model.names)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, scene: FaceScene, drawing: FaceDrawing) -> Path:
    path = tmp_path_factory.mktemp("face")
    write_pages(
        path,
        scene,
        lambda index: drawing.view_row(row(scene, index), np.nan if index == 0 else 1.5),
        lambda film: page_of(film, scene, drawing),
    )
    return path


@pytest.fixture
def shown(browser: Browser, folder: Path) -> Iterator[ViewPage]:
    with shown_page(browser, folder, SIZE) as page:
        yield page


def test_what_is_on_the_page(folder: Path, scene: FaceScene, drawing: FaceDrawing) -> None:
    page = page_of(read_film(folder), scene, drawing)
    layer = page.layers["face"]
    points = layer["points"].reshape(N_FRAMES, -1, 5)
    np.testing.assert_allclose(points[..., :2], scene.vertices[:, layer["shown"]], atol=1e-3)
    np.testing.assert_array_equal(points[..., 2:] - (4.0, 0.0, 1.0), 0)
    assert sorted(layer["shown"]) == list(range(scene.model.n_vertices)), "all of a coarse model"
    np.testing.assert_array_equal(layer["shown"][layer["mesh"]], scene.model.triangles)
    (row_of_face,) = page.timeline
    seen = np.zeros(N_FRAMES, np.bool_)
    for first, last, kind in row_of_face.spans.tolist():
        seen[first : last + 1] = kind == SEEN
    expected = [index not in LOST and index != MISSING for index in range(N_FRAMES)]
    np.testing.assert_array_equal(seen, expected)
    plots = {plot.name: plot.lines[0].values for plot in page.plots}
    np.testing.assert_allclose(plots["experts, effective"], 4)
    np.testing.assert_allclose(plots["picture explained"], 90, rtol=1e-6)
    np.testing.assert_allclose(plots["points ±"], np.sqrt(5), rtol=1e-6)
    assert np.isnan(plots["error"][0])


# --- in a browser -------------------------------------------------------------------------------------------


def apart(drawn: NDArray[np.float64], least: float) -> list[int]:
    """Those of places `(n, 2)` that are not near to others."""
    distances = np.linalg.norm(drawn[:, None] - drawn, axis=2) + 1e3 * np.eye(len(drawn))
    found = np.flatnonzero(distances.min(axis=1) > least).tolist()
    assert len(found) >= 5
    return found[:: max(1, len(found) // 5)]


def test_a_click_on_a_point_selects_it(shown: ViewPage, scene: FaceScene) -> None:
    for index in (0, N_FRAMES - 1):
        shown.show(index)
        for vertex in apart(scene.vertices[index], 3.0):
            shown.click(scene.vertices[index, vertex])
            assert shown.selected == f"point {vertex + 1}"
            np.testing.assert_allclose(shown.numbers("place"), scene.vertices[index, vertex], atol=0.06)
            assert shown.numbers("unsure by")[0] == pytest.approx(np.sqrt(5), abs=0.006)
    shown.click((1, 1))
    assert shown.selected is None


def test_what_is_said_of_the_face(shown: ViewPage, scene: FaceScene) -> None:
    shown.page.locator("#row-0 .label").click()
    assert shown.selected == "face"
    for index, said in ((7, "followed"), (8, "lost"), (14, "found again"), (MISSING, "no picture")):
        shown.show(index)
        assert shown.details["now"] == said
    np.testing.assert_allclose(shown.numbers("place"), scene.poses.translations[MISSING], atol=0.06)
    np.testing.assert_allclose(shown.numbers("size"), scene.poses.sizes[MISSING], atol=0.06)
    assert shown.numbers("error") == [1.5]
    shown.show(0)
    assert "error" not in shown.details


def head(scene: FaceScene, shown: ViewPage) -> Turned:
    shape = scene.model.bases[0]
    low, high = shape.min(axis=0), shape.max(axis=0)
    return shown.in_space((low + high) / 2, 0.62 * (high - low).max())


@pytest.mark.parametrize("with_film", [True, False])
def test_the_head_turns(shown: ViewPage, scene: FaceScene, with_film: bool) -> None:
    """By the hand, and with the film; points are clicked where they then are."""
    shown.page.get_by_label("turns as in the film").set_checked(with_film)
    space = head(scene, shown)
    for index, across, down in ((3, 0, 0), (17, -100, 50)):
        shown.show(index)
        shown.page.locator(".space").scroll_into_view_if_needed()
        if across or down:
            space.drag(across, down)
        pose = scene.poses[index]
        shape = np.einsum("k,kva->va", pose.morphs[0] / pose.morphs[0, 0], scene.model.bases)
        if with_film:
            shape = shape @ pose.rotations[0].T
        for vertex in apart(np.array([space.place(place)[:2] for place in shape]), 3.0):
            space.click(shape[vertex])
            assert shown.selected == f"point {vertex + 1}", index
