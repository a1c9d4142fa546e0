"""A type checker refuses what `connect` would refuse, and more: a message that is none of its feature."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy")

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[2] / "docs" / "own-chain.md"

IMPORTS = """
from collections.abc import Sequence
import numpy as np
from rsmcm.models import Layer, LayerStack, PixelLabels, PixelMessage
"""

CHAINS = """
from typing import overload
from rsmcm.inference import BatchIncoming, Belief, MultiChain, Smoothed, Solution
from rsmcm.models import ObjectBoxes
from rsmcm.models.objects.box_message import BoxMessage


class Wrong(Door):
    def message(  # type: ignore[override]
        self, state: DoorState, feature: PixelLabels, incoming: Incoming
    ) -> BoxMessage:
        return BoxMessage()


class Both(Door):
    @overload
    def message(self, state: DoorState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: DoorState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage: ...
    def message(
        self, state: DoorState, feature: PixelLabels | ObjectBoxes, incoming: Incoming
    ) -> PixelMessage | BoxMessage:
        reveal_type(incoming[PixelLabels])  # PixelMessage
        reveal_type(incoming.get(ObjectBoxes))  # BoxMessage | None
        return feature.uniform()


class Path:
    log_prior = 0.0


class Batch:
    name = "batch"
    ports = (Port(ObjectBoxes),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Path | None = None
    ) -> Smoothed[Path]:
        return Smoothed(Path())

    def messages(
        self, trajectory: Path, feature: ObjectBoxes, incoming_over_time: Sequence[BatchIncoming]
    ) -> Sequence[BoxMessage]:
        return []


box, model = (0, 0, 9, 9), MultiChain()
model.connect(Door(box), PixelLabels())
model.connect(Both(box), PixelLabels()).connect(Both(box), ObjectBoxes())
model.connect(Batch(), ObjectBoxes())
model.connect(Wrong(box), PixelLabels())  # refused
model.connect(Door(box), ObjectBoxes())  # refused
model.connect(Door, PixelLabels())  # refused
model.connect(Batch(), PixelLabels())  # refused


def read(belief: Belief, solution: Solution) -> None:
    reveal_type(belief[Door(box)])  # DoorState
    reveal_type(belief[PixelLabels()])  # PixelMessage
    reveal_type(solution[Batch()])  # Path
    reveal_type(solution[ObjectBoxes()])  # list[BoxMessage]
    reveal_type(solution.evidence(ObjectBoxes()))  # list[BoxMessage]
"""


def test_a_checker_knows_what_is_said_to_which_feature(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    door = next(block for block in blocks if "class Door:" in block)
    source = IMPORTS + door + CHAINS
    path = tmp_path / "user.py"
    path.write_text(source)
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(path)]
    output = subprocess.run(command, capture_output=True, text=True, cwd=PAGE.parents[1]).stdout
    lines = source.splitlines()
    found = {int(number) for number in re.findall(r"user\.py:(\d+): error", output)}
    assert found == {number for number, line in enumerate(lines, 1) if line.endswith("# refused")}, output
    revealed = dict(re.findall(r'user\.py:(\d+): note: Revealed type is "(.*)"', output))
    for number, line in enumerate(lines, 1):
        if line.strip().startswith("reveal_type"):
            without_modules = re.sub(r"(\w+\.)+", "", revealed[str(number)])
            assert without_modules == line.split("# ")[1], line
