"""The page Design in a real browser: sliders move the required value, and a button verifies it."""

from collections.abc import Iterator
from typing import Any

import pytest
from explorer.conftest import Visitor, served, there
from explorer.test_design_answers import asked, required
from patience import until
from report.browser import browser, console_errors, fresh, photograph, requested, screenshots
from report.test_report import SCRIPT

from activefail.explorer.answers import Answers
from activefail.explorer.design import DesignAnswers
from activefail.explorer.verification import Verification

pytestmark = pytest.mark.needs("browser")


class Designer(Visitor):
    def shown(self) -> tuple[float, float] | None:
        """The required value (NaN if there is none) and its probability, once they are there."""
        data = self.driver.execute_script("return {...document.getElementById('required').dataset}")
        if not data:
            return None
        required = float("nan") if data["required"] == "null" else float(data["required"])
        return required, float(data["probability"])

    def until_shown(self, expected: dict[str, Any]) -> None:
        """Wait for an answer."""

        def is_there() -> bool:
            shown = self.shown()
            same = shown is not None and abs(shown[1] - expected["probability"]) < 1e-9
            return same and self.one("#required").text.replace("\n", "") == expected["text"].replace("_", "")

        until(is_there, expected["text"])

    def settled(self) -> None:
        """Wait until the answer is there."""
        until(self.shown, "the answer")
        until(lambda: self.driver.find_elements("css selector", "#curve svg"), "the curve")


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
def design(answers: Answers) -> DesignAnswers:
    return DesignAnswers(answers)


def start(design: DesignAnswers) -> dict[str, Any]:
    """The request of the page when it is opened."""
    about = design.about()
    return {
        "site": {v["name"]: v["start"] for v in (about["periods"][0], *about["site"])},
        "bearing": {v["name"]: v["start"] for v in about["bearing"]},
        "target": 0.1,
    }


def test_a_slider_moved_by_the_keyboard_changes_the_required_value(visitor, design):
    from selenium.webdriver.common.keys import Keys

    assert visitor.one("h1").text == SCRIPT
    question = start(design)
    visitor.until_shown(required(design, question))
    before = visitor.one("#curve").get_attribute("innerHTML")
    pgv = visitor.one("#v3")
    assert visitor.one("#t3").get_attribute("aria-label") == "PGV in m/s, as a number"
    pgv.send_keys(Keys.HOME)
    question["site"]["median_pgv"] = 0.1
    visitor.until_shown(required(design, question))
    assert pgv.get_attribute("aria-valuetext") == "0.1 m/s"
    assert visitor.one("#t3").get_attribute("value") == "0.1"
    assert visitor.one("#curve").get_attribute("innerHTML") != before


def test_the_median_period_takes_the_place_of_the_magnitude(visitor, design):
    from selenium.webdriver.common.keys import Keys

    assert visitor.one("#s0").is_displayed()
    assert not visitor.one("#s1").is_displayed()
    visitor.one("[name=period][value='0']").send_keys(Keys.ARROW_RIGHT)
    assert not visitor.one("#s0").is_displayed()
    assert visitor.one("#s1").is_displayed()
    visitor.one("#v1").send_keys(Keys.END)
    question = start(design)
    del question["site"]["magnitude"]
    question["site"]["median_period"] = 8.0
    visitor.until_shown(required(design, question))
    assert "Median Tp 8 s." in visitor.one("#accuracy").text.replace("\n", "")


def test_a_target_is_a_category_or_a_number_and_one_out_of_range_is_refused(visitor, design):
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    question = start(design)
    Select(visitor.one("#category")).select_by_value("0.025")
    visitor.until_shown(required(design, question | {"target": 0.025}))
    field = visitor.one("#target")
    assert field.get_attribute("value") == "2.5"

    def types(text: str) -> None:
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(Keys.BACKSPACE, text, Keys.ENTER)

    types("20")
    visitor.until_shown(required(design, question | {"target": 0.2}))
    assert visitor.one("#category").get_attribute("value") == ""
    for text in ("0", "much", ""):
        types(text)
        says = f"Target: a number from 0.1 to 90 %, not “{text}”."
        until(lambda says=says: there(visitor, "#target-fault", says), "a reason")
        assert field.get_attribute("aria-invalid") == "true"
        assert required(design, question | {"target": 0.2})["probability"] == visitor.shown()[1]


def test_the_button_verifies_with_a_progress_bar_and_an_interval(visitor, design, tmp_path):
    from selenium.webdriver.common.keys import Keys

    visitor.driver.execute_script(
        """
        window.seen = new Set();
        const find = (id) => document.getElementById(id);
        const note = () => find("running").hidden || window.seen.add(find("bar").value);
        new MutationObserver(note).observe(find("job"), { subtree: true, childList: true });
        """
    )
    button = visitor.one("#verify")
    button.send_keys(Keys.ENTER)
    until(lambda: visitor.one("#job").get_attribute("data-state") == "done", "the verification")
    assert visitor.driver.execute_script("return window.seen.size") > 0
    assert not visitor.one("#running").is_displayed()
    until(button.is_enabled, "the button")
    expected = design.verified(Verification(), **asked(design, start(design)))
    assert visitor.one("#verdict").text.replace("\n", "") == expected["verdict"].replace("_", "")
    assert visitor.one("#estimate").text.replace("\n", "") == expected["text"].replace("_", "")
    assert " between " in expected["text"]
    summary = visitor.one("#found summary")
    summary.send_keys(Keys.ENTER)
    until(lambda: visitor.one("#assumptions li").is_displayed(), "the assumptions")
    assert len(visitor.driver.find_elements("css selector", "#assumptions li")) == len(expected["assumptions"])
    photograph(visitor.driver, screenshots("explorer-design.png", tmp_path))
    assert not visitor.one("#earlier").is_displayed()
    visitor.one("#v3").send_keys(Keys.HOME)
    until(lambda: visitor.one("#earlier").is_displayed(), "the word that the result is of earlier values")


def test_a_verification_can_be_stopped_and_is_followed_after_the_page_is_loaded_again(answers, monkeypatch):
    def verified(self, verification, **asked):
        verification.stage("waiting")
        until(verification.check, "a stop")

    monkeypatch.setattr(DesignAnswers, "verified", verified)
    # A browser of its own, whose end lets the server end: it would keep its connections open.
    with served(answers) as server, browser() as driver:
        driver.get(f"{server.address}design")
        visitor = Designer(driver)
        visitor.one("#verify").click()
        until(lambda: "waiting" in visitor.one("#job").text, "its stage")
        assert not visitor.one("#verify").is_enabled()
        driver.refresh()
        until(lambda: "waiting" in visitor.one("#job").text, "its stage after the page is loaded again")
        visitor.one("#stop").click()
        until(lambda: visitor.one("#job").text == "Stopped.", "its end")
        assert visitor.one("#verify").is_enabled()
        assert not visitor.one("#found").is_displayed()


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


def test_every_control_is_reached_by_the_tab_key_and_has_a_name(visitor):
    from selenium.webdriver.common.keys import Keys

    visitor.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    reached = []
    for _ in range(36):
        visitor.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(visitor.driver.execute_script("return document.activeElement.id"))
    expected = ["category", "target", "verify", *(f"{kind}{i}" for i in (0, *range(2, 12)) for kind in "tv")]
    assert [name for name in expected if name not in reached] == []
    for control in visitor.driver.find_elements("css selector", "button, select, input, progress"):
        if control.is_displayed():
            assert control.accessible_name
