"""A body's page: what of a run is on it, and what can be done with it in a browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.body.page import PER_PX, SAMPLES, over_the_film, view_row_of, with_final_names
from rsmcm.apps.scenes import signer
from rsmcm.apps.view.film import Film, read_film
from rsmcm.apps.view.page import Page
from rsmcm.models.body.upper_body import JOINTS

from ...support.browser import Browser
from ...support.view_page import ViewPage, shown_page, write_pages

N_FRAMES = 30
SIZE = (320, 180)
DEVIATIONS = np.array([3.0, 4.0, 9.0])  # px
LEFT_HAND = JOINTS.index("left_hand")
HIDDEN = range(10, 18)  # indices of frames in which the left hand is not seen
DOUBTFUL = range(3, 7)  # indices of frames with two answers
ELSEWHERE = np.array([30.0, -20.0, 5.0])  # px, from the first to the second
ARM = 60.0


@pytest.fixture(scope="module")
def joints() -> NDArray[np.float64]:
    return signer(N_FRAMES, size=SIZE).joints


def rows(joints: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Of `poses.npz`: the truth, with known errors."""
    draws = np.random.default_rng(0)
    made = []
    for index, places in enumerate(joints):
        noise = DEVIATIONS * draws.standard_normal((40, *places.shape))
        made.append(
            {
                "joints_3d": places,
                "joints_3d_covariances": np.tile(np.diag(DEVIATIONS**2), (len(places), 1, 1)),
                "samples": (places + noise).astype(np.float32),
                "hypotheses": np.array([0.7, 0.25, 0.05, 0] if index in DOUBTFUL else [0.95, 0.05, 0, 0]),
                "hypothesis_joints": np.stack([places, places + ELSEWHERE, *np.full((2, 8, 3), np.nan)]),
                "seen": np.array([True, index not in HIDDEN, True]),
                "stationary": np.bool_(False),
                "missing": np.bool_(index == 20),
            }
        )
    return made


def page_of(film: Film) -> Page:
    layers, timeline = over_the_film(film, ARM)
    return Page("a body", film=film, layers=layers, timeline=timeline, numbers=film.numbers, times=film.times)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, joints: NDArray[np.float64]) -> Path:
    path, made = tmp_path_factory.mktemp("body"), rows(joints)
    write_pages(
        path,
        signer(N_FRAMES, size=SIZE),
        lambda index: view_row_of(made[index]),
        page_of,
    )
    return path


@pytest.fixture
def shown(browser: Browser, folder: Path) -> Iterator[ViewPage]:
    with shown_page(browser, folder, SIZE) as page:
        yield page


def layer_of(film: Film) -> dict[str, Any]:
    layer: dict[str, Any] = over_the_film(film, ARM)[0]["body"]
    return layer


def test_what_is_on_the_page(folder: Path, joints: NDArray[np.float64]) -> None:
    film = read_film(folder)
    layer = layer_of(film)
    held = layer["joints"].reshape(N_FRAMES, len(JOINTS), 9)
    np.testing.assert_allclose(held[..., :3], joints, atol=1e-3)
    upper = np.diag(DEVIATIONS**2)[np.triu_indices(3)]
    np.testing.assert_array_equal(held[..., 3:], np.broadcast_to(upper, held[..., 3:].shape))
    samples = layer["samples"].reshape(N_FRAMES, SAMPLES, len(JOINTS), 3) / PER_PX
    made = np.stack([row["samples"] for row in rows(joints)])
    for index in (0, N_FRAMES - 1):
        distances = np.abs(samples[index, :, None] - made[index][None]).max(axis=(2, 3))
        assert (distances.min(axis=1) <= 0.5 / PER_PX).all(), "each is one of the run's"
        assert len(set(distances.argmin(axis=1))) == SAMPLES


def test_hands_have_the_names_of_the_end(folder: Path, joints: NDArray[np.float64]) -> None:
    film, others = read_film(folder), rows(joints + 7)
    columns = {name: np.stack([np.asarray(row[name]) for row in others]) for name in others[0]}
    columns |= {"frames": film.numbers, "relabelled": np.arange(N_FRAMES) == 4}
    changed = with_final_names(film, columns)
    for name, before in film.columns.items():
        after, expected = changed.columns[name], view_row_of(others[4])[name]
        per_frame = len(before) // N_FRAMES
        kept = np.delete(np.arange(len(before)), np.arange(4 * per_frame, 5 * per_frame))
        np.testing.assert_array_equal(after[kept], before[kept])
        np.testing.assert_array_equal(after[4 * per_frame : 5 * per_frame], expected, err_msg=name)


# --- in a browser -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [LEFT_HAND])
def test_a_click_on_a_joint_selects_it(shown: ViewPage, joints: NDArray[np.float64], joint: int) -> None:
    for index in (0, 12):
        shown.show(index)
        shown.click(joints[index, joint, :2])
        assert shown.selected == JOINTS[joint].replace("_", " ")
        np.testing.assert_allclose(shown.numbers("place"), joints[index, joint, :2], atol=0.06)
        np.testing.assert_allclose(shown.numbers("unsure by"), DEVIATIONS[:2], atol=0.06)
        assert abs(shown.numbers("depth")[0] - abs(joints[index, joint, 2])) < 0.06
    shown.click((2, 2))
    assert shown.selected is None
