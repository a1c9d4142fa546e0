"""Where the messages of a command go."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest
from rsmcm.apps.command_line import main
from rsmcm.apps.runs.messages import is_shown, say_wrong, show_messages

LOGGER = logging.getLogger("rsmcm.somewhere")


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    yield
    show_messages(logging.WARNING)


@pytest.mark.parametrize("level", [logging.ERROR, logging.WARNING, logging.INFO])
def test_a_file_has_the_details_whatever_is_shown(
    level: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    show_messages(level, tmp_path / "log.txt")
    LOGGER.info("a detail")
    LOGGER.warning("a warning")
    say_wrong("an error")
    assert [line.split(" ", 2)[2] for line in (tmp_path / "log.txt").read_text().splitlines()] == [
        "INFO a detail",
        "WARNING a warning",
        "ERROR an error",
    ]
    shown = {logging.ERROR: 1, logging.WARNING: 2, logging.INFO: 3}[level]
    assert capsys.readouterr().err.splitlines() == ["a detail", "a warning", "rsmcm: an error"][-shown:]
    assert is_shown(logging.WARNING) == (level <= logging.WARNING)


def test_a_file_grows(tmp_path: Path) -> None:
    for _ in range(2):
        show_messages(logging.ERROR, tmp_path / "log.txt")
        LOGGER.info("a detail")
    assert (tmp_path / "log.txt").read_text().count("a detail") == 2


def test_a_command_says_in_its_file_why_it_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["background", "nowhere", "--out", str(tmp_path / "out"), "--log", str(tmp_path / "log.txt")])
    said = capsys.readouterr().err.removeprefix("rsmcm: ")
    assert (tmp_path / "log.txt").read_text().endswith(f" ERROR {said}")


def test_a_file_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["view", "nowhere", "--log", str(tmp_path / "none" / "log.txt")])
    assert ended.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
