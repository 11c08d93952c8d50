"""The report as a browser shows it: no complaint, no request, nothing wider than the page, every figure drawn."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from report.browser import browser, console_errors, fresh, photograph, printed, requested, screenshots
from report.test_report import SCRIPT, made, ran, settings

from activefail.campaign.on_disk import open_campaign

pytestmark = pytest.mark.needs("browser")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "run"
    ran(folder, settings(extra="validation.size = 60"))
    with open_campaign(folder, write=False) as (campaign, store):
        path = folder / "report.html"
        path.write_text(made(campaign, folder, store), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with browser() as driver:
        yield driver


@pytest.mark.parametrize(("name", "width"), [("desktop", 1280), ("phone", 390)])
def test_the_report_opens_without_a_complaint_or_a_request(report, driver, name, width, tmp_path):
    fresh(driver, width, 900)
    # A headless window is no narrower than 500; the page is what must be.
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    driver.get(report.as_uri())
    assert driver.find_element("tag name", "h1").text == SCRIPT
    assert console_errors(driver) == []
    assert [url for url in requested(driver) if not url.startswith(("file:", "data:"))] == []
    assert driver.execute_script("return document.documentElement.scrollWidth") <= width
    # What does not answer the question at once is folded, and a link to it opens it.
    folded = driver.execute_script("return document.documentElement.scrollHeight")
    assert not driver.find_element("css selector", "#samples svg").is_displayed()
    driver.find_element("css selector", "nav a[href='#samples']").click()
    assert driver.find_element("css selector", "#samples svg").is_displayed()
    driver.execute_script("document.querySelectorAll('details').forEach((it) => (it.open = true))")
    assert folded < 0.6 * driver.execute_script("return document.documentElement.scrollHeight")
    figures = driver.find_elements("tag name", "figure")
    assert len(figures) >= 8
    for figure in figures:
        drawing = figure.find_element("tag name", "svg")
        assert drawing.size["width"] > 300
        assert drawing.size["height"] > 50
        assert figure.find_element("tag name", "figcaption").text
    drawn = driver.execute_script("return [...document.querySelectorAll('figure svg path')].length")
    assert drawn > 1000
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {
            "width": width,
            "height": driver.execute_script("return document.documentElement.scrollHeight"),
            "deviceScaleFactor": 1,
            "mobile": width < 500,
        },
    )
    photograph(driver, screenshots(f"report-{name}.png", tmp_path))


def test_the_report_prints(report, driver, tmp_path):
    fresh(driver)
    driver.get(report.as_uri())
    pdf = printed(driver)
    assert pdf.startswith(b"%PDF")
    pages = pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page/") + pdf.count(b"/Type /Page ")
    assert 6 <= pages <= 25
    screenshots("report.pdf", tmp_path).write_bytes(pdf)
