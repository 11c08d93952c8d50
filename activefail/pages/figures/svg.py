"""Figures as inline SVG: self-contained, with ids that are unique on the page, and small."""

import io
import re
from collections.abc import Iterable

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from activefail.pages.figures.style import lay_out, styled

_WIDE = 5.8
"""Width [in] beyond which a figure has the class "wide"."""

_NO_METADATA: dict[str, None] = {"Date": None, "Creator": None, "Format": None, "Type": None}
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_MARKS = re.compile(r"(?:<use [^>]*/>\s*){4,}")


def _shorter(number: re.Match[str]) -> str:
    value = float(number[0])
    return f"{value:.{1 if abs(value) >= 10.0 else 2}f}".rstrip("0").rstrip(".")


def _as_markers(text: str, name: str) -> str:
    """Replace runs of identical marks by one path with a marker at each vertex: a tenth of the bytes."""
    markers: dict[tuple[str, str], str] = {}

    def path(run: re.Match[str]) -> str:
        marks = re.findall(r'<use href="(#[^"]*)" x="([^"]*)" y="([^"]*)" (style="[^"]*")\s*/>', run[0])
        looks = {(href, style) for href, _, _, style in marks}
        if len(looks) != 1 or len(marks) != run[0].count("<use "):
            return run[0]
        look = looks.pop()
        definition = ""
        if look not in markers:
            markers[look] = f"{name}-mark{len(markers)}"
            definition = (
                f'<marker id="{markers[look]}" overflow="visible" markerUnits="userSpaceOnUse">'
                f'<use href="{look[0]}" {look[1]}/></marker>'
            )
        vertices = "L".join(f"{x} {y}" for _, x, y, _ in marks)
        references = " ".join(f'marker-{part}="url(#{markers[look]})"' for part in ("start", "mid", "end"))
        return f'{definition}<path d="M{vertices}" fill="none" {references}/>\n'

    return _MARKS.sub(path, text)


def _with_own_ids(text: str, name: str) -> str:
    """Keep the ids that something refers to, with a prefix.

    matplotlib derives ids from content: elements with the same id are equal, and the first one suffices.
    """
    referenced = set(re.findall(r'(?:href="#|url\(#)([^")]*)', text))

    def kept(match: re.Match[str]) -> str:
        if match[1] not in referenced:
            return ""
        referenced.remove(match[1])
        return f' id="{name}-{match[1]}"'

    return re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", re.sub(r'\s+id="([^"]*)"', kept, text))


def _as_svg(figure: Figure) -> str:
    buffer = io.StringIO()
    lay_out(figure)
    with styled():
        figure.savefig(buffer, format="svg", metadata=_NO_METADATA)
    return buffer.getvalue()


def inline(figure: Figure, name: str, alternative: str) -> Markup:
    """A figure as an `<svg>` element that scales to its container.

    Args:
        figure: to draw.
        name: prefix of its ids, unique on the page; letters, digits and hyphens.
        alternative: text for screen readers.
    """
    text = _as_svg(figure)
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # matplotlib's rule for all elements would apply to the whole page; the page restricts it to figures.
    text = re.sub(r'<style type="text/css">\*\{[^}]*\}</style>\s*', "", text)
    text = text.replace("xlink:href", "href")
    text = _with_own_ids(text, name)
    text = re.sub(r'\b(?:d|x|y)="[^"]*"', lambda match: _LONG_NUMBER.sub(_shorter, match[0]), text)
    text = _as_markers(re.sub(r"\n\s*", "\n", text), name)
    width, height = figure.get_size_inches().tolist()
    opening = Markup('<svg role="img" aria-label="{}"{} viewBox="0 0 {:g} {:g}" xmlns="{}">').format(
        alternative,
        Markup(' class="wide"' if width > _WIDE else ""),
        72 * width,
        72 * height,
        "http://www.w3.org/2000/svg",
    )
    return opening + Markup(text[text.index(">") + 1 :])


def place_of(upper: Axes, lower: Axes | None = None) -> dict[str, float]:
    """Where axes are in their figure: shares of its width from the left, and of its height from the top."""
    top, bottom = upper.get_position(), (lower or upper).get_position()
    return {"left": top.x0, "right": top.x1, "top": 1.0 - top.y1, "bottom": 1.0 - bottom.y0}


def inlined(figures: Iterable[Figure], name: str, alternative: str) -> Markup:
    """Figures as one picture, whose parts stand side by side where there is room; see `inline`.

    The alternative of each also has its title.
    """
    drawn = []
    for number, one in enumerate(figures, start=1):
        title = re.sub(r"[${}\\]", "", one.axes[0].get_title("left")).replace("\n", " ")
        drawn.append(
            inline(one, f"{name}-{number}", alternative if title in alternative else f"{alternative}: {title}")
        )
    return Markup("").join(drawn)
