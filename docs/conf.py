"""How Sphinx makes these pages: `make docs`. Nothing here needs a network."""

import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

import matplotlib
from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
matplotlib.use("Agg")
os.environ.setdefault("TQDM_DISABLE", "1")  # no progress bars among what examples print

project = "rsmcm"
author = "the authors of rsmcm"
project_copyright = ""
version = release = installed_version("rsmcm")

extensions = [
    "mathml",
    "parameters",
    "records",
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_templates", "gallery/*.md", "gallery/*.rst", "results/*.md"]
templates_path = ["_templates"]
suppress_warnings = ["config.cache"]  # the order of examples is a function, which the cache cannot hold
default_role = "py:obj"
nitpicky = False  # docstrings name shapes and symbols in backticks, too

html_theme = "pydata_sphinx_theme"
html_title = "rsmcm"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_math_renderer = "mathml"
html_context = {"default_mode": "auto"}
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {
    "header_links_before_dropdown": 6,
    "navigation_with_keys": True,
    "show_prev_next": True,
    "footer_start": [],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "generated/gallery",
    "filename_pattern": r"[\\/]plot_",
    "capture_repr": (),  # what an example shows, it prints or draws
    "thumbnail_size": (480, 240),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "within_subsection_order": "FileNameSortKey",
}


def write_command_reference(app: Sphinx) -> None:
    """Write the page of all commands and options from the command line itself, if it has changed."""
    from rsmcm.apps.command_line import app as command_line

    page = HERE / "generated" / "commands.rst"
    text = command_line.generate_docs(output_format="rst")
    text = re.sub(r"=+\nrsmcm\n=+", "Commands\n========", text, count=1)
    text = re.sub(r"\.\. contents::.*\n(   .*\n)+", "", text)  # the theme shows them beside the page
    text = re.sub(r"(?m)^(``-.*``)\n(?! )", r"\1\n\n", text)  # an option of which nothing is said
    page.parent.mkdir(exist_ok=True)
    if not page.exists() or page.read_text() != text:
        page.write_text(text)


def keep_formulas(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Show the formulas of docstrings, indented after a colon, as they were typed."""
    for number in range(len(lines) - 2):
        line, empty, formula = lines[number : number + 3]
        indent = len(line) - len(line.lstrip())
        if line.endswith(":") and not empty.strip() and formula.startswith(" " * (indent + 4)):
            lines[number] = f"{line}:"


def setup(app: Sphinx) -> None:
    """Add the page that is made from code, and what docstrings need before numpydoc reads them."""
    app.connect("builder-inited", write_command_reference)
    app.connect("autodoc-process-docstring", keep_formulas, priority=400)
