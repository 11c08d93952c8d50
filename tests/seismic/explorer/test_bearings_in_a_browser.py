"""The explorer of a campaign on bearings in a real browser."""

from collections.abc import Iterator
from typing import Any

import pytest
from explorer.bearings import form
from explorer.conftest import served, site_of, there, tunnel
from explorer.test_answers import place_in
from explorer.test_explorer_in_a_browser import Explorer
from patience import until
from report.browser import console_errors, fresh, photograph, requested, screenshots

pytestmark = pytest.mark.needs("browser")


@pytest.fixture
def visitor(address: str, driver: Any) -> Iterator[Explorer]:
    fresh(driver, 1400, 1000)
    driver.get(address)
    visitor = Explorer(driver)
    visitor.settled()
    yield visitor
    assert console_errors(driver) == []
    assert [url for url in requested(driver) if not url.startswith((address, "data:"))] == []


def test_the_simulation_says_the_outcome_and_plays_the_motion(visitor, one, tmp_path):
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    outcomes = ['data-outcome="failure"' in one.simulate(form(X)) for _, X in one.presets]
    failing = outcomes.index(True)
    visitor.driver.execute_script(
        """
        window.seen = new Set();
        const note = () => {
          const place = document.querySelector("#slider")?.getCTM();
          if (place) window.seen.add(place.e);
          requestAnimationFrame(note);
        };
        note();
        """
    )
    Select(visitor.one("#preset")).select_by_index(failing)
    visitor.one("[value=simulate]").click()
    until(lambda: there(visitor, "#simulate .result", "Failure by "), "the outcome")
    until(lambda: visitor.one("#play").text == "Play", "the end of the film")
    assert visitor.driver.execute_script("return window.seen.size") > 10
    assert visitor.one("#time").get_attribute("value") == "1"
    drawing, cursor = visitor.one(".film .drawing").rect, visitor.one(".cursor").rect
    place = place_in(one.simulate(form(one.presets[failing][1])))
    assert cursor["x"] + 1.0 == pytest.approx(drawing["x"] + place["right"] * drawing["width"], abs=2.0)
    assert cursor["height"] == pytest.approx((place["bottom"] - place["top"]) * drawing["height"], abs=2.0)
    visitor.one("#time").send_keys(Keys.HOME)
    until(lambda: visitor.one(".cursor").rect["x"] < cursor["x"] - 10.0, "the upright line")
    assert there(visitor, ".stage text", " m")
    assert visitor.one("#command").text.startswith("activefail simulate --t-b ")
    visitor.driver.set_window_size(1400, 2000)
    photograph(visitor.driver, screenshots("explorer-desktop.png", tmp_path))
    assert not visitor.one(".stale").is_displayed()
    visitor.slider("A_p").send_keys(Keys.HOME)
    until(lambda: visitor.one(".stale").is_displayed(), "the word that the motion is of an earlier design")
    visitor.one("[value=simulate]").click()
    until(lambda: there(visitor, "#simulate:not([data-stale]) .result"), "the motion of this design")
    assert not visitor.one(".stale").is_displayed()


def test_on_a_phone_nothing_is_wider_than_the_page(address, driver, tmp_path):
    fresh(driver, 500, 900)
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    driver.get(address)
    visitor = Explorer(driver)
    visitor.settled()
    visitor.one("[value=simulate]").click()
    until(lambda: driver.find_elements("css selector", "#simulate .result"), "the outcome")
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
    for control in driver.find_elements("css selector", "button, select, input"):
        if control.is_displayed():
            assert control.size["height"] >= 24
    height = driver.execute_script("return document.documentElement.scrollHeight")
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size | {"height": height, "deviceScaleFactor": 1})
    photograph(driver, screenshots("explorer-phone.png", tmp_path))
    assert console_errors(driver) == []


def test_every_control_of_a_simulation_is_reached_by_the_tab_key_and_has_a_name(visitor, one):
    from selenium.webdriver.common.keys import Keys

    visitor.one("[value=simulate]").click()
    until(lambda: visitor.driver.find_elements("css selector", ".film"), "the film")
    visitor.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    reached = []
    for _ in range(34):
        visitor.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(
            visitor.driver.execute_script("return document.activeElement.id || document.activeElement.ariaLabel")
        )
    sliders = [visitor.slider(name).get_attribute("aria-label") for name in one.space.names]
    wanted = ["preset", *one.space.names, *sliders, "across", "up", "shown", "plane", "along", "play", "time"]
    assert [name for name in wanted if name not in reached] == []
    for control in visitor.driver.find_elements("css selector", "button, select, input"):
        if control.is_displayed():
            assert control.accessible_name


@pytest.mark.parametrize("prefix", ["", "/user/ann/proxy/8050"])
def test_through_a_tunnel_on_another_port_and_a_proxy_with_a_path_the_page_design_opens(driver, findings, prefix):
    fresh(driver, 1400, 1000)
    with served(site_of(findings), needs_token=True) as running, tunnel(running.server_address[1], prefix) as port:
        address = f"http://localhost:{port}{prefix}/"
        driver.get(f"{address}?token={running.token}")
        driver.get(f"{address}design")
        until(lambda: driver.find_elements("css selector", "h1"), "the page Design")
        driver.get("about:blank")
