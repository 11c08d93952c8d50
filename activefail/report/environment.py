"""The environment of the pages' templates."""

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from activefail.findings.quantities import words
from activefail.shares import bounds_percent, interval_percent, percent
from activefail.visible import visible


def subscripts(text: str) -> Markup:
    """Markup in which `_x` is a subscript, as in D_tot."""
    parts = text.split("_")
    out = escape(parts[0])
    for part in parts[1:]:
        end = next((i for i, letter in enumerate(part) if not letter.isalnum()), len(part))
        out += Markup("<sub>{}</sub>{}").format(part[:end], part[end:])
    return out


def _shown(value: object) -> object:
    """Foreign text with visible control characters; pictures and other markup unchanged."""
    return visible(value, keep="\n\t") if type(value) is str else value


def page_environment() -> Environment:
    """The environment of the pages' templates."""
    environment = Environment(
        loader=PackageLoader("activefail.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )
    environment.filters |= {"subscripts": subscripts, "words": words, "percent": percent}
    environment.globals["interval_percent"] = interval_percent
    environment.globals["bounds_percent"] = bounds_percent
    return environment


def markdown_environment() -> Environment:
    """The environment of the Markdown pages' templates."""
    return Environment(
        loader=PackageLoader("activefail.report", "."), undefined=StrictUndefined, keep_trailing_newline=True
    )
