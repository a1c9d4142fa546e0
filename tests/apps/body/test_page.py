"""A body's page: what of a run is on it, and what can be done with it in a browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.body.page import PART_JOINTS, PER_PX, SAMPLES, drawn_of, over_the_film, with_final_names
from rsmcm.apps.scenes import signer
from rsmcm.apps.view.film import Film, read_film
from rsmcm.apps.view.page import SEEN, Page
from rsmcm.models.body.upper_body import JOINTS

from ...support.browser import PHONE, Browser, landmarks, overflow, reached_by_tab
from ...support.view_page import Turned, ViewPage, shown_page, write_pages

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
        lambda index: drawn_of(made[index]),
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


def test_rows_say_when_a_part_was_seen(folder: Path) -> None:
    _, timeline = over_the_film(read_film(folder), ARM)
    assert [row.identity for row in timeline[:3]] == sorted(PART_JOINTS)
    assert len(timeline) == len(JOINTS)
    for row in timeline:
        seen = np.zeros(N_FRAMES, np.bool_)
        for first, last, kind in row.spans.tolist():
            seen[first : last + 1] = kind == SEEN
        expected = np.full(N_FRAMES, row.identity in PART_JOINTS)
        expected[20] = False
        if row.identity == LEFT_HAND:
            expected[list(HIDDEN)] = False
        np.testing.assert_array_equal(seen, expected, err_msg=row.label)


def test_hands_have_the_names_of_the_end(folder: Path, joints: NDArray[np.float64]) -> None:
    film, others = read_film(folder), rows(joints + 7)
    columns = {name: np.stack([np.asarray(row[name]) for row in others]) for name in others[0]}
    columns |= {"frames": film.numbers, "relabelled": np.arange(N_FRAMES) == 4}
    changed = with_final_names(film, columns)
    for name, before in film.columns.items():
        after, expected = changed.columns[name], drawn_of(others[4])[name]
        per_frame = len(before) // N_FRAMES
        kept = np.delete(np.arange(len(before)), np.arange(4 * per_frame, 5 * per_frame))
        np.testing.assert_array_equal(after[kept], before[kept])
        np.testing.assert_array_equal(after[4 * per_frame : 5 * per_frame], expected, err_msg=name)


# --- in a browser -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [LEFT_HAND, JOINTS.index("head"), JOINTS.index("right_elbow")])
def test_a_click_on_a_joint_selects_it(shown: ViewPage, joints: NDArray[np.float64], joint: int) -> None:
    for index in (0, 12, N_FRAMES - 1):
        shown.show(index)
        shown.click(joints[index, joint, :2])
        assert shown.selected == JOINTS[joint].replace("_", " ")
        np.testing.assert_allclose(shown.numbers("place"), joints[index, joint, :2], atol=0.06)
        np.testing.assert_allclose(shown.numbers("unsure by"), DEVIATIONS[:2], atol=0.06)
        assert abs(shown.numbers("depth")[0] - abs(joints[index, joint, 2])) < 0.06
    shown.click((2, 2))
    assert shown.selected is None


def test_what_is_hidden_is_said(shown: ViewPage) -> None:
    shown.page.locator(f"#row-{LEFT_HAND} .label").click()
    for index, said in ((9, "seen"), (10, "hidden, predicted"), (17, "hidden, predicted"), (18, "seen")):
        shown.show(index)
        assert shown.details["now"] == said
    shown.page.locator(f"#row-{JOINTS.index('neck')} .label").click()
    assert shown.details["now"] == "inferred"


def test_a_second_answer_is_drawn_and_said(shown: ViewPage, joints: NDArray[np.float64]) -> None:
    shown.page.locator(f"#row-{LEFT_HAND} .label").click()
    for index, there in ((2, False), (3, True), (6, True), (7, False)):
        shown.show(index)
        before = shown.inked()
        shown.page.keyboard.press("a")
        assert (shown.inked() < before) == there
        shown.page.keyboard.press("a")
        assert (shown.details["or"] != "–") == there
        if there:
            expected = [*(joints[index, LEFT_HAND] + ELSEWHERE)[:2], 25]
            np.testing.assert_allclose(shown.numbers("or"), expected, atol=0.5 / PER_PX + 0.06)


@pytest.mark.parametrize(
    ("name", "key"), [("skeleton", "s"), ("90 % regions", "u"), ("drawn from", "d"), ("path", "p")]
)
def test_layers_are_switched(shown: ViewPage, name: str, key: str) -> None:
    shown.page.locator(f"#row-{LEFT_HAND} .label").click()
    box = shown.page.locator("#switches label").filter(has_text=name).locator("input")
    before, was_on = shown.inked(), box.is_checked()
    shown.page.keyboard.press(key)
    assert box.is_checked() != was_on
    changed = shown.inked()
    assert changed != before
    if name != "path":  # of which most lies below the skeleton
        assert (changed < before) == was_on
    shown.page.keyboard.press(key)
    assert shown.inked() == before


def test_the_body_turns_in_space(shown: ViewPage, folder: Path, joints: NDArray[np.float64]) -> None:
    """Wherever it is turned to, joints are clicked where they then are."""
    layer = layer_of(read_film(folder))
    shown.show(5)
    space = shown.in_space(layer["centre"], layer["reach"])
    for across, down in ((0, 0), (70, 0), (-30, 45), (-120, -80)):
        if across or down:
            before = shown.inked(".space")
            space.drag(across, down)
            assert shown.inked(".space") != before
        for joint in apart_from_others(space, joints[5]):
            space.click(joints[5, joint])
            assert shown.selected == JOINTS[joint].replace("_", " "), (across, down)


def apart_from_others(space: Turned, places: NDArray[np.float64]) -> list[int]:
    drawn = np.array([space.place(place)[:2] for place in places])
    distances = np.linalg.norm(drawn[:, None] - drawn, axis=2) + 100 * np.eye(len(places))
    found = np.flatnonzero(distances.min(axis=1) > 4).tolist()
    assert len(found) >= 4
    return found


def test_keys_turn_it_and_leave_the_film_alone(shown: ViewPage) -> None:
    shown.show(7)
    shown.page.locator(".space").focus()
    before = shown.inked(".space")
    for key, back in (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"), ("+", "-")):
        shown.page.keyboard.press(key)
        assert shown.inked(".space") != before
        shown.page.keyboard.press(back)
    shown.page.keyboard.press("ArrowLeft")
    shown.page.keyboard.press("0")
    assert shown.inked(".space") == before
    assert shown.frame == 8


def test_space_goes_with_the_film(shown: ViewPage) -> None:
    before = shown.inked(".space")
    shown.page.locator("#play").click()
    shown.page.wait_for_function("document.querySelector('video').currentTime > 0.5")
    shown.page.locator("#play").click()
    assert shown.frame > 10
    assert shown.inked(".space") != before


def test_plots_of_what_is_selected(shown: ViewPage, joints: NDArray[np.float64]) -> None:
    assert not shown.page.get_by_label("selected: depth over time").is_visible()
    shown.page.locator(f"#row-{LEFT_HAND} .label").click()
    shown.show(4)
    plot = shown.page.locator(".plot").filter(has_text="selected: depth")
    said = float((plot.locator("output").text_content() or "").split()[0])
    assert said == pytest.approx(joints[4, LEFT_HAND, 2], rel=5e-3)


@pytest.mark.parametrize("dark", [False, True])
def test_on_a_phone(browser: Browser, folder: Path, dark: bool) -> None:
    with browser.page(folder / "view.html", PHONE, dark=dark) as page:
        page.locator(f"#row-{LEFT_HAND} .label").click()
        assert overflow(page) <= 0
        count, headings = landmarks(page)
        assert count == 1
        assert "In space" in headings
        box = page.locator(".space").bounding_box()
        assert box is not None
        assert box["width"] > 300


# --- fingers and the whole screen ---------------------------------------------------------------------------


def test_fingers_turn_it_and_pull_it_apart(browser: Browser, folder: Path) -> None:
    with shown_page(browser, folder, SIZE, PHONE) as shown:
        session = shown.page.context.new_cdp_session(shown.page)
        session.send("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
        canvas = shown.page.locator(".space")
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        assert box is not None
        middle, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

        def move(*ways: tuple[float, float]) -> int:
            """Fingers go from one place to another beside the middle, px."""
            for kind, share in (("Start", 0.0), ("Move", 0.3), ("Move", 0.6), ("Move", 1.0), ("End", None)):
                places = [] if share is None else [a + share * (b - a) for a, b in ways]
                points = [{"x": middle + x, "y": y, "id": number} for number, x in enumerate(places)]
                session.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
            return shown.inked(".space")

        pictures = [shown.inked(".space"), move((0, 60)), move((-20, -70), (20, 70))]
        assert len(set(pictures)) == 3
        assert shown.selected is None, "none of it was a click"
        assert move((0, -60)) != pictures[2]
        assert not overflow(shown.page)


def test_everything_is_reached_by_keys(shown: ViewPage) -> None:
    reached = reached_by_tab(shown.page)
    assert {"CANVAS", "Full screen", "play", "seek"} <= reached


def test_a_film_of_one_frame(browser: Browser, joints: NDArray[np.float64], tmp_path: Path) -> None:
    (frame, *_), (row, *_) = signer(1, size=SIZE), rows(joints)
    write_pages(
        tmp_path,
        [frame],
        lambda _: drawn_of(row),
        page_of,
    )
    with shown_page(browser, tmp_path, SIZE) as page:
        page.click(joints[0, LEFT_HAND, :2])
        assert page.selected == "left hand"
        assert not any("NaN" in value for value in page.details.values())


def test_the_whole_screen(shown: ViewPage) -> None:
    shown.page.get_by_role("button", name="Full screen").click()
    shown.page.wait_for_function("document.fullscreenElement?.className === 'space'")
    shown.page.wait_for_function("document.querySelector('.space').clientHeight === innerHeight")
    assert shown.inked(".space") > 0
    shown.page.evaluate("document.exitFullscreen()")
