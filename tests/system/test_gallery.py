"""Examples of the gallery show what their text says; `make docs` runs them as well."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rsmcm.inference.validity import RecordedPredictions, compare_predictions

pytestmark = pytest.mark.slow

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
Names = dict[str, Any]
"""Variables that an example has defined."""


def near_the_person(names: Names) -> bool:
    """Where the tracks are, there he is."""
    off = [
        abs(x + width / 2 - left - across / 2)
        for number, _, x, _, width, _ in names["tracks"]
        for truth in names["scene"].boxes(number - 1)
        for left, _, across, _ in [truth.box]
    ]
    return len(off) > 150 and max(off) < 30


def structure_is_better(names: Names) -> bool:
    """Its share of the tracker's error is 0.160 in the mean of 20 such films, with a deviation of 0.012."""
    alone, together = (np.nanmean(errors[10:]) for errors in names["errors"].values())
    return bool(abs(together / alone - 0.160) < 4 * 0.012)


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
    "plot_09_online_structure": structure_is_better,
    "plot_10_face_and_background": lambda n: (
        np.mean(n["errors"]["face and background"]) < np.mean(n["errors"]["face alone"])
    ),
    "plot_11_flow_and_template": lambda n: (
        n["errors"]["constant texture"][0] < n["errors"]["constant texture"][-1]
        and n["errors"]["constant texture"][0] < min(n["errors"]["changing texture"])
    ),
    "plot_12_signer": lambda n: all(
        each.mean() < 0.5 * n["body"].head_height for each in n["errors"].values()
    ),
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
    "plot_18_loop": lambda n: (
        n["model"].has_loops
        and n["settled"].all()
        and n["is_open"][n["times"] < 5].max() < 0.1
        and n["is_open"][(n["times"] > 8.1) & (n["times"] < 15)].min() > 0.9
        and n["is_open"][-5:].max() < 0.1
    ),
}
"""What an example's text says, by the name of its file."""


def test_every_example_has_a_claim() -> None:
    assert sorted(path.stem for path in GALLERY.glob("plot_*.py")) == sorted(CLAIMS)


@pytest.mark.parametrize("stem", CLAIMS)
def test_an_example_shows_what_it_says(stem: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    path, names = GALLERY / f"{stem}.py", Names(__name__="__main__")
    exec(compile(path.read_text(), str(path), "exec"), names)
    assert CLAIMS[stem](names)
    plt.close("all")
