"""Every example of the gallery runs by itself, is short, draws something, and shows what its text says."""

import ast
import io
import re
import tokenize
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rsmcm.inference.validity import RecordedPredictions, compare_predictions

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
EXAMPLES = sorted(GALLERY.glob("plot_*.py"))
MOST_LINES = 40
"""Of code, in one example."""

Names = dict[str, Any]
"""What an example has defined."""


@pytest.fixture(autouse=True)
def figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Of an example, which are closed after it; what it writes, it writes elsewhere."""
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    yield
    plt.close("all")


def run(stem: str) -> Names:
    path = GALLERY / f"{stem}.py"
    names: Names = {"__name__": "__main__"}
    exec(compile(path.read_text(), str(path), "exec"), names)
    return names


def near_the_person(names: Names) -> bool:
    """Where the tracks are, there he is."""
    off = [
        abs(x + width / 2 - left - across / 2)
        for number, _, x, _, width, _ in names["tracks"]
        for truth in names["scene"].boxes(number - 1)
        for left, _, across, _ in [truth.box]
    ]
    return len(off) > 150 and max(off) < 30


def together_is_better(names: Names) -> bool:
    """Of two errors over time, that of the model with more in it is the smaller one."""
    alone = [error for name, error in names["errors"].items() if "alone" in name]
    together = [error for name, error in names["errors"].items() if "alone" not in name]
    return bool(np.nanmean(together[0][10:]) < 0.7 * np.nanmean(alone[0][10:]))


def error_at_the_door(names: Names) -> list[float]:
    """Grey levels, alone and with its chain."""
    return [abs(picture - names["street"])[40:68, 70:86].mean() for picture in names["pictures"]]


def verdicts(names: Names) -> list[str]:
    """On all pairs, with the noise of the scene."""
    found = []
    for one, two in names["pairs"].values():
        known = ~np.isnan(one + two).any(axis=2)
        observed = names["turning"].observed[20:][known]
        recorded = RecordedPredictions(one[known], two[known], observed, np.diag([0.01, 0.01]))
        found.append(compare_predictions(recorded, np.nonzero(known)[1]).verdict)
    return found


def whole_film_is_better(names: Names) -> bool:
    """Its masks have more in common with the person than those that were found frame by frame."""
    person = names["person"][:60]
    online, whole = (np.array(masks)[:60] for masks in names["masks"].values())
    return bool(
        (person & whole).sum() / (person | whole).sum()
        > 2 * (person & online).sum() / (person | online).sum()
    )


CLAIMS: dict[str, Callable[[Names], bool]] = {
    "plot_01_one_pixel": lambda n: n["runs"][0][-1]["floor"][1] < 0.2 and n["runs"][1][-1]["floor"][1] > 0.99,
    "plot_02_sleeping_man": lambda n: (
        np.nanmean(n["found"]["with feedback"][150:270]) > 0.8
        and np.nanmean(n["found"]["feed-forward"][150:270]) < 0.2
    ),
    "plot_03_detector": near_the_person,
    "plot_04_ground_plane": lambda n: np.abs(n["mean"] - (n["rows"] - 60) / 2).max() < 4,
    "plot_05_own_chain": lambda n: [wrong > 50 for wrong in error_at_the_door(n)] == [True, False],
    "plot_06_own_feature": lambda n: np.abs(np.angle(n["vectors"] / np.exp(1j * n["angles"]))).max() < 0.5,
    "plot_07_save_and_resume": lambda n: np.array_equal(n["whole"][75:], n["halves"]),
    "plot_08_cylinder": lambda n: len(n["structure"].factorisation.shape) == len(n["turning"].shape),
    "plot_09_online_structure": together_is_better,
    "plot_10_face_and_background": lambda n: (
        np.mean(n["errors"]["face and background"]) < np.mean(n["errors"]["face alone"])
    ),
    "plot_11_flow_and_template": lambda n: (
        n["errors"]["texture stays"][0] < n["errors"]["texture stays"][-1]
        and n["errors"]["texture stays"][0] < min(n["errors"]["texture changes"])
    ),
    "plot_12_signer": together_is_better,
    "plot_13_do_they_help": lambda n: verdicts(n) == ["does not help", "helps"],
    "plot_14_whole_film": whole_film_is_better,
    "plot_15_zones": lambda n: (
        [event.kind for event in n["events"]] == ["crossed", "entered", "stands", "left", "stood"]
        and n["events"][-1].duration == pytest.approx(n["scene"].stand * n["scene"].dt, abs=2)
    ),
    "plot_16_batch": lambda n: [row["state"] for row in n["rows"]] == ["failed", "complete", "complete"],
    "plot_17_own_application": lambda n: (
        n["outcome"].summary["frames"] == len(n["rows"]) == 120
        and 0 < n["outcome"].summary["mean_objects"] < 1.5
    ),
}
"""What an example's text says, by the name of its file."""


def test_every_example_has_a_claim_and_there_are_enough() -> None:
    assert [path.stem for path in EXAMPLES] == sorted(CLAIMS)
    assert len(EXAMPLES) >= 12


@pytest.mark.parametrize("stem", CLAIMS)
def test_an_example_runs_and_shows_what_it_says(stem: str, capsys: pytest.CaptureFixture[str]) -> None:
    names = run(stem)
    assert CLAIMS[stem](names)
    assert plt.get_fignums()
    for number in plt.get_fignums():
        axes = plt.figure(number).axes
        assert axes
        assert all(axis.has_data() for axis in axes)
    assert capsys.readouterr().out.strip()


def code_lines(text: str) -> set[int]:
    """Numbers of lines that hold code: no comment, no blank line, not the text at the top."""
    top = ast.parse(text).body[0].end_lineno or 0
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    code = [token for token in tokens if token.type != tokenize.COMMENT and token.string.strip()]
    return {line for token in code for line in range(token.start[0], token.end[0] + 1) if line > top}


def test_code_lines_are_counted() -> None:
    assert code_lines('"""\nTop\n"""\n\n# %%\n# text\nf(\n    1,  # one\n)\n\nx = """a\nb"""\n') == {
        7,
        8,
        9,
        11,
        12,
    }


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_what_is_public(path: Path) -> None:
    text = path.read_text()
    assert len(code_lines(text)) <= MOST_LINES
    title, underline, *_ = (ast.get_docstring(ast.parse(text)) or "").splitlines()
    assert set(underline) == {"="}
    assert len(underline) >= len(title)
    assert not re.search(r"import.*\b_\w|[\w\])]\._\w", text)


def sums_over_all(floor: Any, person: Any, image: Any, before: tuple[Any, Any]) -> list[Any]:
    """Beliefs in pixel, floor and person, of every case of what was, is and is seen as bright, one by one."""
    sums = [np.zeros(3), np.zeros(2), np.zeros(2)]
    for x_before, y_before, x, y, f in product(range(2), range(2), range(2), range(2), range(3)):
        weight = before[0][x_before] * floor.follows[x_before, x] * floor.shows[x, f]
        weight *= before[1][y_before] * person.follows[y_before, y] * person.shows[y, f]
        for total, value in zip(sums, (f, x, y), strict=True):
            total[value] += weight * image[1, f]
    return [total / total.sum() for total in sums]


def test_the_toy_is_what_a_sum_over_all_cases_says(capsys: pytest.CaptureFixture[str]) -> None:
    names = run("plot_01_one_pixel")
    floor, person, pixel, (beliefs, _) = (names[name] for name in ("floor", "person", "pixel", "runs"))
    expected = [
        sums_over_all(floor, person, names["image"], (belief[floor], belief[person]))
        for belief in beliefs[:-1]
    ]
    for (_, belief), wanted in zip(pairwise(beliefs), expected, strict=True):
        found = [belief[pixel].probabilities(), belief[floor], belief[person]]
        np.testing.assert_allclose(np.concatenate(found), np.concatenate(wanted), atol=1e-12)
    numbers = {
        line[:9]: [float(text) for text in re.findall(r"\d\.\d+", line)]
        for line in capsys.readouterr().out.splitlines()
    }
    for name in ("all cases", "the engin"):
        assert numbers[name] == pytest.approx(np.concatenate(expected[0]), abs=6e-5)
    assert numbers["times ima"][3:] == pytest.approx(expected[0][0], abs=6e-5)
