"""`{parameters} rsmcm.chains.BlobTracker`: a table of a dataclass's parameters, from its code."""

import inspect
from dataclasses import MISSING, fields
from importlib import import_module

from docutils import nodes
from docutils.statemachine import StringList
from numpydoc.docscrape import NumpyDocString
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def rows(kind: type) -> list[tuple[str, str, str]]:
    """Names, defaults and meaning of the parameters that the docstring of a dataclass lists.

    Raises
    ------
    ValueError
        if it lists one that the class does not have.
    """
    known = {field.name: field for field in fields(kind)}
    found = []
    for entry in NumpyDocString(inspect.getdoc(kind) or "")["Parameters"]:
        names = [name.strip() for name in entry.name.split(",")]
        if unknown := set(names) - set(known):
            raise ValueError(f"{kind.__name__}: the docstring tells of {unknown}, which it has not")
        defaults = [known[name].default for name in names]
        shown = ["" if value is MISSING else f"`{value!r}`" for value in defaults]
        meaning = " ".join(line.strip() for line in entry.desc)
        found.append((", ".join(f"`{name}`" for name in names), ", ".join(shown), meaning))
    return found


class Parameters(SphinxDirective):
    """The table."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse it as the page's own Markdown."""
        module, name = self.arguments[0].rsplit(".", 1)
        kind = getattr(import_module(module), name)
        self.env.note_dependency(inspect.getfile(kind))
        table = [("parameter", "default", "what it is"), ("---",) * 3, *rows(kind)]
        lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in table]
        holder = nodes.container()
        self.state.nested_parse(StringList(lines), self.content_offset, holder)
        return holder.children


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("parameters", Parameters)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
