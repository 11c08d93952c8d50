"""Sphinx builds the site of the documentation with these settings: `make docs`.

The pages are Markdown that GitHub shows as well. No page loads anything from another host: mathematics is MathML, and
the styles and scripts of the theme are copied into the site.
"""

import html
import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from myst_parser.parsers.sphinx_ import MystParser
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import activefail  # noqa: E402

MATHML = "http://www.w3.org/1998/Math/MathML"
ElementTree.register_namespace("", MATHML)

project = "activefail"
author = "The activefail developers"
copyright = author
version = release = activefail.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
nitpicky = True
nitpick_ignore_regex = [("py:class", ".*")]  # types of other libraries, and those without a page, are not links

default_role = "literal"  # docstrings set names between single backticks
highlight_language = "text"  # what a command prints
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_custom_sections = ["Returns"]  # as text: a colon in it does not end a type
napoleon_use_ivar = True  # the attributes of a class are listed once, in its docstring

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

smartquotes = False  # two hyphens begin an option

html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_title = "activefail"
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"


def with_accents_on_letters(formula: str) -> str:
    """MathML with the index of an accented letter beside it: docutils sets the index of an accent below."""
    tree = ElementTree.fromstring(re.sub(r"&(?!lt|gt|amp)\w+;", lambda name: html.unescape(name[0]), formula))
    for stack in tree.iter(f"{{{MATHML}}}munderover"):
        letter, index, accent = stack
        if accent.get("stretchy") == "false":
            stack.tag = f"{{{MATHML}}}msub"
            stack[:] = [ElementTree.Element(f"{{{MATHML}}}mover", accent="true"), index]
            stack[0].extend((letter, accent))
    return ElementTree.tostring(tree, encoding="unicode")


def mathml(self, node: nodes.Node) -> None:
    """A formula as MathML, which browsers draw without a script.

    Raises:
        ExtensionError: naming the formula, if docutils cannot read it.
    """
    block = isinstance(node, nodes.math_block)
    try:
        drawn = with_accents_on_letters(tex2mathml(node.astext(), as_block=block))
    except MathError as error:
        raise ExtensionError(f"{node.astext()!r} is not a formula that docutils reads: {error}") from None
    self.body.append(f'<div class="math">{drawn}</div>\n' if block else drawn)
    raise nodes.SkipNode


class NotebookParser(MystParser):
    """A notebook as a page: its text, and its code as blocks."""

    supported = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Parse the notebook's JSON into the document."""
        cells = []
        for cell in json.loads(inputstring)["cells"]:
            text = "".join(cell["source"])
            cells.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        super().parse("\n\n".join(cells), document)


def with_pages_outside_docs(app: Sphinx, name: str, source: list[str]) -> None:
    """Lead the links to pages beside README.md, which GitHub shows, to their pages of the site."""
    source[0] = re.sub(
        r"\]\((?:\.\./)+(CONTRIBUTING|CHANGELOG)\.md", lambda link: f"](/{link[1].lower()}.md", source[0]
    )


def register_anchors(app: Sphinx, tree: nodes.document) -> None:
    """Make the HTML anchors of a page, which GitHub reads too, known as targets of links."""
    page = app.env.current_document.docname
    for raw in tree.findall(nodes.raw):
        for anchor in re.findall(r'<a id="([^"]+)">', raw.astext()):
            app.env.get_domain("std").anonlabels[f"{page}#{anchor}".lower()] = page, anchor


def with_dashes(app: Sphinx, tree: nodes.document) -> None:
    """Set dashes between the parameters of a function and their meanings, where Sphinx sets hyphens."""
    for text in list(tree.findall(nodes.Text)):
        if text.astext() == " -- ":
            text.parent.replace(text, nodes.Text(" – "))


def with_links(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Link the keys of references.bib in a docstring to the page of references."""
    key = r"\[([A-Z][A-Za-z]+\d{4})((?:, [^\]]*)?)\]"
    lines[:] = re.sub(key, r":ref:`\1\2 <references#\1>`", "\n".join(lines)).split("\n")


def setup(app: Sphinx) -> None:
    """Register what this file adds to Sphinx."""
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
    app.add_lexer("csv", TextLexer)  # tables in examples, without colours
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)
    app.connect("source-read", with_pages_outside_docs)
    app.connect("autodoc-process-docstring", with_links)
    app.connect("doctree-read", register_anchors)
    app.connect("doctree-read", with_dashes)
