"""Methods take turns, and ratios are those of what was measured together."""

from rsmcm.apps.background.application import build_model
from rsmcm.apps.experiments.bench.timing import of_chains, over_frames, over_rounds
from rsmcm.apps.experiments.record import Expectation
from rsmcm.apps.scenes import sleeping_man
from rsmcm.models.core.frame import Frame


def test_methods_get_all_frames_in_order() -> None:
    frames = [Frame(None, number / 25, number) for number in range(1, 51)]
    seen: dict[str, list[int]] = {"a": [], "b": []}
    spent = over_frames(
        {name: lambda f, name=name: seen[name].append(f.number) for name in seen},  # type: ignore[misc]
        frames,
        turn=20,
        warm_up=20,
    )
    assert seen["a"] == seen["b"] == [*range(1, 51)]
    assert {name: len(turns) for name, turns in spent.items()} == {"a": 2, "b": 2}


def test_a_machine_that_slows_down_for_both_leaves_their_ratio_sure() -> None:
    seconds = [1.0, 1.0, 3.0, 8.0, 1.5]
    spent = {"ours": seconds, "theirs": [2 * each for each in seconds]}
    ratio, alone = over_rounds(
        lambda of: [
            Expectation("ratio", of["theirs"] / of["ours"]),
            Expectation("s", of["ours"]),
        ],
        spent,
    )
    assert (ratio.measured, ratio.quartiles, ratio.seeds) == (2.0, (2.0, 2.0), 5)
    assert (alone.measured, alone.quartiles) == (1.5, (1.0, 3.0))
    assert (ratio.ratio, alone.ratio) == (True, False)


def test_times_of_chains_are_parts_of_the_whole() -> None:
    found, _ = of_chains(build_model(), sleeping_man(6, size=(96, 72)))
    assert len(found) == 6
    for each in found:
        assert {"background", "blobs", "pixels", "objects"} <= each.keys()
        parts = sum(seconds for name, seconds in each.items() if name != "whole")
        assert 0 < parts <= each["whole"]
