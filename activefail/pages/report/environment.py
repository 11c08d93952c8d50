"""The environments of the pages' templates. All text of a page leaves through them, with escapes."""

import math
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from activefail.space.shares import bounds_percent, interval_percent, percent, power, short, significant
from activefail.visible import visible, words


def subscripts(text: str) -> Markup:
    """Markup in which `_x` is a subscript, as in D_tot."""
    parts = text.split("_")
    out = escape(parts[0])
    for part in parts[1:]:
        end = next((i for i, letter in enumerate(part) if not letter.isalnum()), len(part))
        out += Markup("<sub>{}</sub>{}").format(part[:end], part[end:])
    return out


def probability(p: float) -> str:
    """A probability, as `share` of common.js: a power of ten below 0.01, its nines, up to six, above 0.99."""
    rest = 1.0 - p
    if p < 1e-6:
        return "< 10⁻⁶"
    if rest < 1e-6:
        return "> 0.999999"
    return power(p, 2) if p < 0.01 else f"{p:.{min(6, 1 - math.floor(math.log10(rest))) if rest < 0.01 else 2}f}"


def _shown(value: object) -> object:
    """Foreign text with visible control characters; pictures and other markup unchanged."""
    return visible(value, keep="\n\t") if type(value) is str else value


REPORT = "activefail.pages.report"
"""The package with the frame of pages and the parts that they share."""


def page_environment(*packages: str) -> Environment:
    """The environment of the HTML pages' templates in packages, by default the report; the first has precedence."""
    return _environment(*packages, autoescape=True, trim_blocks=True, lstrip_blocks=True)


def markdown_environment(*packages: str) -> Environment:
    """The environment of the Markdown pages' templates, in packages as above."""
    return _environment(*packages, keep_trailing_newline=True)


def _environment(*packages: str, **more: Any) -> Environment:
    loader = ChoiceLoader([PackageLoader(one, ".") for one in packages or (REPORT,)])
    environment = Environment(loader=loader, undefined=StrictUndefined, finalize=_shown, **more)
    environment.filters |= {one.__name__: one for one in (subscripts, words, percent, short, significant, probability)}
    environment.globals |= {one.__name__: one for one in (interval_percent, bounds_percent)}
    return environment
