"""`{record} cylinder`: what an experiment measured, from `docs/results/cylinder.json`, and its pictures.

Pictures are those of `docs/pictures/figures` whose names begin with the experiment's.
"""

from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from rsmcm.apps.experiments.record import Record
from rsmcm.apps.experiments.results import figures
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def origin(record: Record) -> str:
    """Where and when it was measured."""
    made = record.made
    return f"Measured on {made.date[:10]} with commit `{made.commit}`: {made.machine}."


class RecordOf(SphinxDirective):
    """Table and pictures."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse them as the page's own Markdown."""
        name, docs = self.arguments[0], Path(self.env.srcdir)
        path = docs / "results" / f"{name}.json"
        lines = ["*Not recorded yet: the command makes it.*"]
        self.env.note_dependency(str(path))
        self.env.note_dependency(str(docs / "pictures" / "figures"))
        if path.exists():
            record = Record.read(path)
            lines = [*figures(record).splitlines(), "", origin(record)]
        for picture in sorted((docs / "pictures" / "figures").glob(f"{name}-*.png")):
            title = picture.stem.removeprefix(f"{name}-").replace("fig-", "figure ")
            lines += ["", f"![{name}, {title}](/pictures/figures/{picture.name})"]
        holder = nodes.container()
        self.state.nested_parse(StringList(lines), self.content_offset, holder)
        return holder.children


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("record", RecordOf)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
