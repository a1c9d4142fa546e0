"""Formulas as MathML, which browsers show by themselves: no network, no script; screen readers read it."""

import re
from html import escape, unescape
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)

MATHML = "http://www.w3.org/1998/Math/MathML"
ACCENTS = "ˆˉ˜˙¨"


def _mathml(node: nodes.math | nodes.math_block, as_block: bool) -> str:
    """MathML of a node's TeX; what is not understood is a warning, and stays TeX."""
    text = node.astext()
    try:
        return _with_accents(str(tex2mathml(text, as_block=as_block)))
    except MathError as error:
        logger.warning("formula %r: %s", text, error, location=node)
        return f"<code>{escape(text)}</code>"


def _with_accents(mathml: str) -> str:
    """With subscripts of what has an accent beside it, and not below, where `tex2mathml` puts them."""
    ElementTree.register_namespace("", MATHML)
    # names such as &ApplyFunction; are HTML's, of which XML knows but a few
    named = re.sub(r"&(?!lt;|gt;|amp;)\w+;", lambda found: unescape(found[0]), mathml)
    root = ElementTree.fromstring(named)
    for node in root.iter(f"{{{MATHML}}}munderover"):
        base, below, accent = node
        if accent.text in ACCENTS:
            over = ElementTree.Element(f"{{{MATHML}}}mover", accent="true")
            over.extend((base, accent))
            node[:] = over, below
            node.tag = f"{{{MATHML}}}msub"
    return ElementTree.tostring(root, encoding="unicode")


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(_mathml(node, as_block=False))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(translator.starttag(node, "div", CLASS="math"))
    translator.body.append(_mathml(node, as_block=True))
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Make it known as the renderer `mathml`."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
