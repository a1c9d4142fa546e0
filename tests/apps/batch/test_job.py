"""Options of an application pass through a batch: the same names, the same help, the same values."""

from pathlib import Path
from typing import Any

import pytest
from cyclopts import App
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.batch.job import APPLICATIONS, OWN, job_of, options_of, typed, words_of
from rsmcm.apps.command_line import app
from rsmcm.apps.face.job import FaceJob

OUT = ["film", "--out", "results"]


def arguments(command: App) -> dict[str, tuple[Any, ...]]:
    """Options with what the help says of them."""
    return {
        each.name: (each.parameter.help, each.parameter.group, each.hint)
        for each in command.assemble_argument_collection()
        if not each.children
    }


@pytest.mark.parametrize("application", APPLICATIONS)
def test_a_batch_has_every_option_of_the_single_run(application: str) -> None:
    single, batch = arguments(app[application]), arguments(app["batch"][application])
    own = {f"--{name}" for name in OWN}
    assert set(single) - own <= set(batch)
    assert {name: batch[name] for name in set(single) - own} == {
        name: single[name] for name in set(single) - own
    }


@pytest.mark.parametrize("application", APPLICATIONS)
def test_what_is_not_typed_is_as_of_the_single_run(application: str) -> None:
    assert typed(options_of(application)()) == {}
    assert job_of(application, OUT) == APPLICATIONS[application]("film", out=Path("results"))


background = st.fixed_dictionaries(
    {},
    optional={
        "seed": st.integers(0, 99),
        "every": st.integers(1, 99),
        "masks": st.sampled_from(["none", "png", "video"]),
        "roi": st.sampled_from(["-1,2,3,4", "mask.png"]),
        "chain": st.lists(st.sampled_from(["a", "b-c"]), max_size=2).map(tuple),
        "stop": st.integers(1, 9),
        "reconnect": st.floats(0.1, 1e6),
        "ground_truth": st.just(Path("a folder/gt.txt")),
        "learned": st.just(Path("state.npz")),
    },
)


@given(background)
def test_what_is_typed_comes_through(values: dict[str, Any]) -> None:
    options = options_of("background")(**values)
    job = job_of("background", [*OUT, *words_of("background", typed(options))])
    assert job == BackgroundJob("film", out=Path("results"), **values)


def test_values_of_a_list_of_cameras() -> None:
    words = words_of("face", {"gain": "learned", "experts": 3, "resume": False, "detector": "yunet.onnx"})
    assert job_of("face", [*OUT, *words]) == FaceJob(
        "film", out=Path("results"), gain="learned", experts=3, detector=Path("yunet.onnx")
    )
    with pytest.raises(ValueError, match="unknown option --frobnicate"):
        job_of("face", [*OUT, *words_of("face", {"frobnicate": 1})])
    with pytest.raises(ValueError, match=r"--gain: got 7\.0, expected 0 to 1"):
        job_of("face", [*OUT, *words_of("face", {"gain": 7})])
