"""Pages of the documentation, and a reader who types what they show.

What a fenced block is for stands in its info string, of which a page shows nothing:

- `python`: run in order, in one namespace a page.
- `sh`: commands, run in order; a `make` target is looked up, not made, and what takes minutes or shows a
  browser is only parsed.
- `output`: what the block before it, or its last command, prints, with numbers to 20 %, since other machines
  round otherwise.
- `toml NAME`, `csv NAME` and so on: a file of that name, which is written before what follows is run.
- `python not-run`, `sh not-run`: needs a network, a camera, or files that nobody else has. It is compiled, or
  its options are parsed.
"""

import re
import shlex
import subprocess
import sys
import tomllib
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rsmcm.apps.command_line import app, main

ROOT = Path(__file__).parents[2]
ONLY_PARSED = ("rsmcm demo", "rsmcm reproduce", "rsmcm view")
NOT_RUN = "not-run"
NUMBER = r"-?\d+(?:\.\d+)?"


@dataclass(frozen=True)
class Block:
    """A fenced block: the words of its info string, its text, and the number of its first line."""

    info: tuple[str, ...]
    text: str
    line: int

    @property
    def language(self) -> str:
        return self.info[0] if self.info else ""

    @property
    def run(self) -> bool:
        return NOT_RUN not in self.info

    @property
    def commands(self) -> list[str]:
        """Lines of a shell, those that go on in the next one joined, without comments."""
        lines = re.sub(r"\\\n\s*", "", self.text).splitlines()
        return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def pages() -> dict[str, Path]:
    """All pages of docs by their names, and those of the checkout that some of them include."""
    docs = ROOT / "docs"
    made = [docs / "_build", docs / "generated"]
    found = [path for path in sorted(docs.rglob("*.md")) if not set(made) & set(path.parents)]
    top = {name: ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")}
    return {str(path.relative_to(docs).with_suffix("")): path for path in found} | top


def blocks(path: Path) -> list[Block]:
    """All fenced blocks of a page, directives of Sphinx left out."""
    text = path.read_text()
    found = re.finditer(r"^(`{3,})([^`\n]*)\n(.*?)^\1\s*$", text, re.DOTALL | re.MULTILINE)
    every = [Block(tuple(each[2].split()), each[3], text[: each.start()].count("\n") + 2) for each in found]
    return [block for block in every if not block.language.startswith("{")]


@dataclass
class Reader:
    """Somebody in a folder of his own who types what a page shows, from its first line to its last."""

    page: Path
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "page"})
    printed: list[str] = field(default_factory=list)

    def read(self, *, commands: bool = True) -> "Reader":
        """Do what the page shows; without `commands`, those of the shell are only parsed."""
        last = ""
        for block in blocks(self.page):
            where = f"{self.page.name}, line {block.line}"
            if block.language == "python":
                # as many empty lines before it that errors name the page's line
                code = compile("\n" * (block.line - 1) + block.text, str(self.page), "exec")
                if block.run:
                    last = self._run(lambda code=code: exec(code, self.names))
            elif block.language == "sh":
                for line in block.commands:
                    last = self._command(line, block.run and commands, where)
            elif block.language == "output":
                assert_same(last, block.text, where)
            elif block.language == "toml":
                tomllib.loads(block.text)
            if len(block.info) == 2 and block.run:
                Path(block.info[1]).write_text(block.text)
        return self

    def _run(self, something: Any) -> str:
        with redirect_stdout(StringIO()) as output:
            something()
        self.printed += output.getvalue().splitlines()
        return output.getvalue()

    def _command(self, line: str, run: bool, where: str) -> str:
        program, *arguments = shlex.split(line, comments=True)
        if program == "make":
            targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
            assert arguments[-1] in targets, f"{where}: {line}"
        elif program == ".":
            assert arguments == [".venv/bin/activate"], f"{where}: {line}"
        elif program == "rsmcm" and (not run or line.startswith(ONLY_PARSED)):
            app.parse_args(arguments, exit_on_error=False, print_error=False)
        elif program == "rsmcm":
            return self._run(lambda: self._rsmcm(arguments, f"{where}: {line}"))
        elif program == "python" and run:
            script = ROOT / arguments.pop(0)
            subprocess.run([sys.executable, script, *arguments], check=True, timeout=120)
        else:
            assert not run, f"{where}: {program} is not known to the test; is its block to be {NOT_RUN}?"
        return ""

    def _rsmcm(self, arguments: list[str], where: str) -> None:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0, where


def assert_same(printed: str, shown: str, where: str) -> None:
    """Words as they are, numbers to 20 % (or 2 grey levels, or 0.05)."""
    words = [re.sub(r"-{3,}", "---", re.sub(NUMBER, "#", text)).split() for text in (printed, shown)]
    assert words[0] == words[1], f"{where}: printed was\n{printed}"
    found, expected = (list(map(float, re.findall(NUMBER, text))) for text in (printed, shown))
    assert found == pytest.approx(expected, rel=0.2, abs=2 if "grey levels" in shown else 0.05), where
