"""The site of the documentation builds without a warning, and loads nothing from another host."""

import importlib.util
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from report.browser import browser, console_errors, photograph, requested, screenshots

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("sphinx") is None, reason="needs Sphinx: pip install 'activefail[docs]'"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    options = ["-b", "html", "-d", str(folder / "doctrees"), "-W", "--keep-going", "-q"]
    command = [sys.executable, "-m", "sphinx", *options, str(ROOT / "docs"), str(folder / "html")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


class Loads(HTMLParser):
    """Collects the addresses that a browser loads with a page; links are not loaded."""

    def __init__(self):
        super().__init__()
        self.addresses = []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        names = {"src", "srcset", "poster", "data", "action"} | ({"href"} if tag in ("link", "image", "use") else set())
        self.addresses += [given[name] for name in names if given.get(name)]
        self.addresses += re.findall(r"url\(([^)]*)\)", given.get("style") or "")


def is_remote(address):
    return re.match(r"\s*['\"]?(?:\w+:)?//", address) is not None


def loads(html):
    parser = Loads()
    parser.feed(html)
    return parser.addresses


def test_a_remote_address_is_recognised():
    html = '<script src="https://a.org/b.js"></script><link href="//a.org/c.css"><a href="https://a.org"></a>'
    assert list(map(is_remote, loads(html + '<img src="_images/d.png">'))) == [True, True, False]


def test_no_page_loads_anything_from_another_host(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        remote = [address for address in loads(page.read_text(encoding="utf-8")) if is_remote(address)]
        assert not remote, f"{page.relative_to(site)}: {remote}"
    for style in site.rglob("*.css"):
        text = style.read_text(encoding="utf-8")
        addresses = re.findall(r"url\(([^)]*)\)", text) + re.findall(r"@import\s+([^;]*)", text)
        assert not [address for address in addresses if is_remote(address)], style


def test_every_page_is_in_the_site(site):
    pages = [*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/**/*.ipynb")]
    built = {file.relative_to(site).with_suffix("") for file in site.rglob("*.html")}
    assert {page.relative_to(ROOT / "docs").with_suffix("") for page in pages} <= built


def test_formulas_are_mathml_and_nothing_of_tex_is_left(site):
    page = (site / "bearing.html").read_text(encoding="utf-8")
    formulas = re.findall(r"<math .*?</math>", page, re.DOTALL)
    assert len(formulas) > 40
    accelerations = re.findall(
        r"<msub>\s*<mover accent=\"true\">\s*<mi>(\w)</mi>.*?<mi>(\w)</mi>\s*</msub>", page, re.DOTALL
    )
    assert {"x s", "z s", "x t", "z t", "u g"} == {" ".join(letters) for letters in accelerations}
    assert not re.search(r"\\(frac|sqrt|ddot|theta|left|text)|\$\$", page)


WIDE = """
const scrolls = (one) => one.tagName != "ARTICLE" &&
    (["auto", "scroll"].includes(getComputedStyle(one).overflowX) || scrolls(one.parentElement));
return [...document.querySelectorAll("article *")]
    .filter((one) => one.getBoundingClientRect().right > innerWidth + 1 && !scrolls(one))
    .map((one) => `${one.tagName} ${one.textContent.slice(0, 60)}`);
"""
"""Elements of the page that are wider than the screen, and not inside a table or block that scrolls by itself."""


def turn(driver, width):
    """Give the screen a width: below 500, that of a phone."""
    size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


@pytest.mark.needs("browser")
def test_pages_fit_a_screen_without_errors_and_requests(site, tmp_path):
    widths = [390, 1280]
    with browser() as driver:
        for page in sorted(site.rglob("*.html")):
            name = page.relative_to(site).with_suffix("").as_posix()
            for width in widths:
                turn(driver, width)
                # A page is loaded once, and then turned to the other width.
                if width == widths[0]:
                    driver.get(page.as_uri())
                assert driver.execute_script("return innerWidth") == width, name
                assert driver.execute_script("return document.documentElement.scrollWidth") <= width, name
                assert driver.execute_script(WIDE) == [], name
                if name in ("index", "bearing", "guide", "which", "reference/commands", "reference/settings"):
                    photograph(driver, screenshots(f"site-{name.replace('/', '-')}-{width}.png", tmp_path))
            assert console_errors(driver) == [], name
            assert [address for address in requested(driver) if not address.startswith(("file:", "data:"))] == [], name
            # The next page is loaded at the width of this one's end, so both widths load pages.
            widths.reverse()
        driver.execute_script(
            "document.querySelector('article').insertAdjacentHTML('beforeend', '<p style=\"width: 2000px\">wide</p>')"
        )
        for width in widths:
            turn(driver, width)
            assert driver.execute_script(WIDE) == ["P wide"]
