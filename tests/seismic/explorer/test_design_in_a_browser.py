"""The page Design in a real browser: sliders move the required value, and a button verifies it."""

from collections.abc import Iterator
from typing import Any

import pytest
from explorer.conftest import Visitor, served, site_of, there
from explorer.test_design_answers import Shown
from patience import until
from report.browser import browser, console_errors, fresh, photograph, requested, screenshots
from report.test_report import SCRIPT

from activefail.analyses.findings.results import Findings
from activefail.pages.explorer.jobs import Job, Jobs
from activefail.seismic.explorer.design import PERIODS, TARGET, DesignPage

pytestmark = pytest.mark.needs("browser")


class Designer(Visitor):
    def shown(self) -> dict[str, str]:
        """The required value and its probability, once they are there."""
        found = self.driver.find_elements("css selector", "#required .result")
        return self.driver.execute_script("return {...arguments[0].dataset}", found[0]) if found else {}

    def until_shown(self, expected: Shown) -> None:
        """Wait for an answer."""

        def is_there() -> bool:
            text = self.driver.execute_script("return document.querySelector('#required .result')?.textContent")
            return text == expected.text.replace("_", "") and float(self.shown()["probability"]) == expected.probability

        until(is_there, expected.text)

    def settled(self) -> None:
        """Wait until the answer is there."""
        until(self.shown, "the answer")
        until(lambda: self.driver.find_elements("css selector", "#verify button"), "the button")

    def slider(self, name: str) -> Any:
        return self.one(f"#s-{name} [type=range]")


@pytest.fixture
def visitor(address: str, driver: Any) -> Iterator[Designer]:
    fresh(driver, 1400, 1100)
    driver.get(f"{address}design")
    visitor = Designer(driver)
    visitor.settled()
    yield visitor
    assert console_errors(driver) == []
    assert [url for url in requested(driver) if not url.startswith((address, "data:"))] == []


@pytest.fixture(scope="module")
def design(findings: Findings) -> DesignPage:
    return site_of(findings).others["design"]


def start(design: DesignPage, **changes: object) -> dict[str, Any]:
    """The form of the page when it is opened, with these changes."""
    fields = (*PERIODS, *design.site, *design.bearing, TARGET)
    return {"period": "magnitude"} | {one.name: one.start for one in fields} | changes


def test_a_slider_moved_by_the_keyboard_changes_the_required_value(visitor, design):
    from selenium.webdriver.common.keys import Keys

    assert visitor.one("h1").text == SCRIPT
    visitor.until_shown(Shown(design, start(design)))
    before = visitor.one("#required figure").get_attribute("innerHTML")
    assert visitor.slider("median_pgv").accessible_name == "PGV in m/s"
    visitor.slider("median_pgv").send_keys(Keys.HOME)
    visitor.until_shown(Shown(design, start(design, median_pgv=0.1)))
    assert visitor.one("#median_pgv").get_attribute("value") == "0.1"
    assert visitor.one("#required figure").get_attribute("innerHTML") != before


def test_the_median_period_takes_the_place_of_the_magnitude(visitor, design):
    from selenium.webdriver.common.keys import Keys

    assert visitor.one("#s-magnitude").is_displayed()
    assert not visitor.one("#s-median_period").is_displayed()
    visitor.one("[name=period][value=magnitude]").send_keys(Keys.ARROW_RIGHT)
    assert not visitor.one("#s-magnitude").is_displayed()
    assert visitor.one("#s-median_period").is_displayed()
    visitor.slider("median_period").send_keys(Keys.END)
    visitor.until_shown(Shown(design, start(design, period="median_period", median_period=8.0)))
    assert "Median Tp 8.00 s." in visitor.one("#required").text.replace("\n", "")


def test_a_target_is_a_category_or_a_number_and_one_out_of_range_is_refused(visitor, design):
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    Select(visitor.one("#category")).select_by_visible_text("2.5 % (risk category IV)")
    visitor.until_shown(Shown(design, start(design, target=2.5)))
    field = visitor.one("#target")
    assert field.get_attribute("value") == "2.5"

    def types(text: str) -> None:
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(Keys.BACKSPACE, text, Keys.ENTER)

    types("20")
    expected = Shown(design, start(design, target=20))
    visitor.until_shown(expected)
    assert visitor.one("#category").get_attribute("value") == ""
    for text in ("0", "much", ""):
        types(text)
        assert field.get_attribute("validationMessage")
        visitor.until_shown(expected)


def test_the_button_verifies_with_a_progress_bar_and_an_interval(visitor, design, tmp_path):
    from selenium.webdriver.common.keys import Keys

    visitor.driver.execute_script(
        """
        window.seen = new Set();
        const note = () => window.seen.add(document.querySelector("progress")?.value);
        new MutationObserver(note).observe(document.getElementById("verify"), { subtree: true, childList: true });
        """
    )
    visitor.one("#do").send_keys(Keys.ENTER)
    until(lambda: there(visitor, "[data-state=done] #estimate"), "the verification")
    assert visitor.driver.execute_script("return [...window.seen].filter((it) => it !== undefined).length") > 0
    assert not visitor.driver.find_elements("css selector", "progress")
    assert visitor.driver.execute_script("return document.activeElement.id") == "do"
    expected = design.verified(Job(None), design.asked(start(design)))
    assert visitor.one("#verify .result").text.replace("\n", "") == expected["verdict"].replace("_", "")
    assert visitor.one("#estimate").text.replace("\n", "") == expected["text"].replace("_", "")
    assert " between " in expected["text"]
    visitor.one("#verify summary").send_keys(Keys.ENTER)
    until(lambda: visitor.one("#verify li").is_displayed(), "the assumptions")
    assert len(visitor.driver.find_elements("css selector", "#verify li")) == len(expected["assumptions"])
    photograph(visitor.driver, screenshots("explorer-design.png", tmp_path))
    assert not there(visitor, "#earlier")
    visitor.slider("median_pgv").send_keys(Keys.HOME)
    until(lambda: there(visitor, "#earlier"), "the word that the result is of earlier values")


def test_a_verification_can_be_stopped_and_is_followed_after_the_page_is_loaded_again(findings, monkeypatch):
    def verified(self, job, asked):
        job.stage("waiting")
        until(job.check, "a stop")

    monkeypatch.setattr(DesignPage, "verified", verified)
    # A browser of its own, whose end lets the server end: it would keep its connections open.
    with Jobs() as jobs, served(site_of(findings, jobs=jobs)) as server, browser() as driver:
        driver.get(f"{server.address}design")
        visitor = Designer(driver)
        visitor.settled()
        visitor.one("#verify [value=verify]").click()
        until(lambda: there(visitor, "#verify", "waiting"), "its stage")
        driver.refresh()
        until(lambda: there(visitor, "#verify", "waiting"), "its stage after the page is loaded again")
        visitor.one("#verify [value=stop]").click()
        until(lambda: there(visitor, "#verify", "Stopped."), "its end")
        assert visitor.one("#verify [value=verify]").is_enabled()


def test_on_a_phone_nothing_is_wider_than_the_page(address, driver, tmp_path):
    fresh(driver, 500, 900)
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    driver.get(f"{address}design")
    visitor = Designer(driver)
    visitor.settled()
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
    for control in driver.find_elements("css selector", "button, select, summary, input:not([type=radio])"):
        if control.is_displayed():
            assert control.size["height"] >= 24
    photograph(driver, screenshots("explorer-design-phone.png", tmp_path))
    assert console_errors(driver) == []


def test_every_control_is_reached_by_the_tab_key_and_has_a_name(visitor, design):
    from selenium.webdriver.common.keys import Keys

    visitor.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    reached = []
    for _ in range(36):
        visitor.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(
            visitor.driver.execute_script("return document.activeElement.id || document.activeElement.ariaLabel")
        )
    shown = [one.name for one in (PERIODS[0], *design.site, *design.bearing, TARGET)]
    sliders = [visitor.slider(name).get_attribute("aria-label") for name in shown]
    assert [name for name in ("category", "do", *shown, *sliders) if name not in reached] == []
    for control in visitor.driver.find_elements("css selector", "button, select, input, progress"):
        if control.is_displayed():
            assert control.accessible_name
