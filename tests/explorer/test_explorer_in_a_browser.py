"""The explorer in a real browser: a slider, the plane and the simulation do what a person expects to see."""

from collections.abc import Iterator
from typing import Any

import pytest
from explorer.conftest import Visitor, served, there, tunnel
from patience import until
from report.browser import console_errors, fresh, photograph, requested, screenshots
from report.test_report import SCRIPT

from activefail.errors import InputError
from activefail.explorer.site import CampaignSite, Slow

pytestmark = pytest.mark.needs("browser")


class Explorer(Visitor):
    def probabilities(self) -> dict[str, float]:
        bars = "[...document.querySelectorAll('#probabilities .bar')]"
        script = f"return {bars}.map(b => [b.dataset.outcome, +b.dataset.probability])"
        return dict(self.driver.execute_script(script))

    def marker(self) -> tuple[float, float]:
        return tuple(
            self.driver.execute_script(
                "const m = document.getElementById('marker').style; return [parseFloat(m.left), parseFloat(m.top)]"
            )
        )

    def settled(self) -> None:
        """Wait until prediction, plane and curve are there."""
        until(lambda: self.probabilities(), "a prediction")
        until(lambda: self.driver.find_elements("css selector", "#plane svg"), "the plane")
        until(lambda: self.driver.find_elements("css selector", "#fragility svg"), "the curve")
        until(lambda: self.marker()[0] > 0.0, "the marker")


@pytest.fixture
def visitor(address: str, driver: Any) -> Iterator[Explorer]:
    fresh(driver, 1400, 1000)
    driver.get(address)
    visitor = Explorer(driver)
    visitor.settled()
    yield visitor
    assert console_errors(driver) == []
    assert [url for url in requested(driver) if not url.startswith((address, "data:"))] == []


def test_the_name_of_the_campaign_is_text_and_no_program(visitor):
    assert visitor.one("h1").text == SCRIPT
    assert visitor.driver.execute_script("return document.scripts.length") == 2


def test_a_slider_moved_by_the_keyboard_changes_the_prediction_and_the_value_shown(visitor, answers):
    from selenium.webdriver.common.keys import Keys

    slider = visitor.one("#v8")
    slider.send_keys(Keys.HOME)
    weakest = until(
        lambda: visitor.one("#t8").get_attribute("value") == "0.1" and visitor.probabilities(), "A_p at its least"
    )
    point = answers.about()["presets"][0]["point"]
    expected = answers.predict([*point[:8], 0.1])["probabilities"]
    until(lambda: abs(visitor.probabilities()["no_impact"] - expected[0]) < 1e-9, "its prediction")
    slider.send_keys(Keys.END)
    strongest = answers.predict([*point[:8], 0.8])["probabilities"]
    until(lambda: abs(visitor.probabilities()["failure"] - strongest[2]) < 1e-9, "A_p at its largest")
    assert visitor.one("#t8").get_attribute("value") == "0.8"
    assert visitor.one("#v8").get_attribute("aria-valuetext") == "0.8 g"
    assert strongest[2] > expected[2]
    assert visitor.one("#preset").get_attribute("value") == ""
    assert set(weakest) == {"no_impact", "impact", "failure"}


@pytest.mark.parametrize("prefix", ["", "/user/ann/proxy/8050"])
def test_through_a_tunnel_on_another_port_and_a_proxy_with_a_path_the_page_works(driver, answers, prefix):
    from selenium.webdriver.common.keys import Keys

    fresh(driver, 1400, 1000)
    with served(answers, needs_token=True) as running, tunnel(running.server_address[1], prefix) as port:
        address = f"http://localhost:{port}{prefix}/"
        driver.get(f"{address}?token={running.token}")
        visitor = Explorer(driver)
        visitor.settled()
        point = answers.about()["presets"][0]["point"]
        visitor.one("#v8").send_keys(Keys.HOME)
        expected = answers.predict([*point[:8], 0.1])["probabilities"]
        until(lambda: abs(visitor.probabilities()["no_impact"] - expected[0]) < 1e-9, "its prediction")
        assert driver.current_url == address
        assert console_errors(driver) == []
        assert [url for url in requested(driver) if not url.startswith((address, "data:"))] == []
        driver.get(f"{address}design")
        until(lambda: driver.find_elements("css selector", "h1"), "the page Design")
        driver.get("about:blank")


def test_a_number_that_is_typed_is_the_design_s_and_one_outside_the_space_is_refused(visitor, answers):
    from selenium.webdriver.common.keys import Keys

    def types(place: int, text: str) -> None:
        field = visitor.one(f"#t{place}")
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(Keys.BACKSPACE, text, Keys.ENTER)

    point = answers.about()["presets"][0]["point"]
    types(6, "2.5e9")
    types(8, "0.4567")
    expected = answers.predict([*point[:6], 2.5e9, point[7], 0.4567])["probabilities"]
    until(lambda: abs(visitor.probabilities()["failure"] - expected[2]) < 1e-9, "its prediction")
    for text in ("0.9", "much", ""):
        types(8, text)
        until(
            lambda result=text: there(visitor, "#t8-fault", f"A_p: a number from 0.1 to 0.8, not “{result}”."),
            "a reason",
        )
        assert visitor.one("#t8").get_attribute("aria-invalid") == "true"
        assert visitor.one("#t8").value_of_css_property("border-color") == "rgb(180, 35, 24)"
    assert abs(visitor.probabilities()["failure"] - expected[2]) < 1e-9
    types(8, "0.4567")
    assert not there(visitor, "#t8-fault")
    assert visitor.one("#t6").get_attribute("value") == "2.5e9"


def test_a_click_on_the_plane_moves_the_design_and_the_arrow_keys_move_it_on(visitor, answers):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    x, y = answers.about()["plane"]
    columns = [answers.space.names.index(name) for name in (x, y)]
    before = visitor.marker(), [visitor.one(f"#t{i}").get_attribute("value") for i in range(9)]
    drawing = visitor.one("#plane svg")
    visitor.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", drawing)
    box = drawing.size
    ActionChains(visitor.driver).move_to_element_with_offset(
        drawing, -box["width"] // 5, box["height"] // 5
    ).click().perform()
    until(lambda: visitor.marker() != before[0], "the marker to move")
    left, top = visitor.marker()
    assert left == pytest.approx(30.0, abs=1.5)
    assert top == pytest.approx(70.0, abs=1.5)
    after = [visitor.one(f"#t{i}").get_attribute("value") for i in range(9)]
    assert {i for i in range(9) if after[i] != before[1][i]} == set(columns)
    visitor.one("#plane").send_keys(Keys.ARROW_RIGHT)
    until(lambda: visitor.marker()[0] > left, "the arrow key")
    assert visitor.marker()[1] == pytest.approx(top)


def test_the_simulation_says_the_outcome_and_plays_the_motion(visitor, answers, tmp_path):
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.select import Select

    presets = answers.about()["presets"]
    failing = next(i for i, preset in enumerate(presets) if answers.simulate(preset["point"])["outcome"] == "failure")
    # A twentieth of a second passes from one frame to the next, however few of them a busy machine draws.
    visitor.driver.execute_script(
        """
        const draw = window.requestAnimationFrame.bind(window);
        let now = performance.now();
        window.requestAnimationFrame = (tick) => draw(() => tick((now += 50)));
        window.seen = new Set();
        const note = () => window.seen.add(document.querySelector("#slider")?.getAttribute("transform"));
        const changes = { subtree: true, childList: true, attributes: true };
        new MutationObserver(note).observe(document.querySelector("#stage"), changes);
        """
    )
    Select(visitor.one("#preset")).select_by_index(failing)
    visitor.one("#simulate").click()
    until(lambda: visitor.one("#outcome").get_attribute("data-outcome") == "failure", "the outcome")
    assert visitor.one("#outcome").text.startswith("Failure by ")
    until(lambda: visitor.one("#play").text == "Play", "the end of the film")
    assert visitor.driver.execute_script("return window.seen.size") > 10
    assert visitor.one("#time").get_attribute("value") == "239"
    until(lambda: visitor.driver.find_elements("css selector", "#histories svg"), "the histories")
    cursor, drawing = visitor.one("#cursor").rect, visitor.one("#histories svg").rect
    point = presets[failing]["point"]
    figure, end = answers.histories(point, narrow=False), answers.simulate(point)["frames"]["t"][-1]
    axes, (first, last) = figure["axes"], figure["times"]
    across = axes["left"] + (end - first) / (last - first) * (axes["right"] - axes["left"])
    assert cursor["x"] + 1.0 == pytest.approx(drawing["x"] + across * drawing["width"], abs=2.0)
    assert cursor["height"] == pytest.approx((axes["bottom"] - axes["top"]) * drawing["height"], abs=2.0)
    visitor.one("#time").send_keys(Keys.HOME)
    until(lambda: visitor.one("#cursor").rect["x"] < cursor["x"] - 10.0, "the upright line")
    assert visitor.one("#ruler").text in {"0.5 m", "0.2 m", "0.1 m"}
    assert visitor.one("#command").text.startswith("activefail simulate --t-b ")
    assert float(visitor.one("body").get_attribute("data-simulate-ms")) > 0.0
    visitor.driver.set_window_size(1400, 2000)
    photograph(visitor.driver, screenshots("explorer-desktop.png", tmp_path))
    assert not visitor.one("#earlier").is_displayed()
    visitor.one("#v8").send_keys(Keys.HOME)
    until(lambda: visitor.one("#earlier").is_displayed(), "the word that the motion is of an earlier design")
    visitor.one("#simulate").click()
    until(lambda: not visitor.one("#earlier").is_displayed(), "the motion of this design")


def test_on_a_phone_nothing_is_wider_than_the_page(address, driver, tmp_path):
    fresh(driver, 500, 900)
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    driver.get(address)
    visitor = Explorer(driver)
    visitor.settled()
    visitor.one("#simulate").click()
    until(lambda: visitor.one("#outcome").text, "the outcome")
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
    for control in driver.find_elements("css selector", "button, select, input"):
        if control.is_displayed():
            assert control.size["height"] >= 24
    height = driver.execute_script("return document.documentElement.scrollHeight")
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size | {"height": height, "deviceScaleFactor": 1})
    photograph(driver, screenshots("explorer-phone.png", tmp_path))
    assert console_errors(driver) == []


def test_a_question_that_fails_says_so_in_its_place(driver, answers):
    def fail() -> None:
        raise InputError("The code was moved.")

    fresh(driver, 1400, 1000)
    with served(answers) as running:
        running.site = CampaignSite(answers, Slow(lambda: answers.findings.classifier, fail, lambda: None))
        driver.get(running.address)
        until(lambda: there(Visitor(driver), "#failure", "No answer: The code was moved."), "the reason")
        assert not there(Visitor(driver), "#failure", "Computing")
        driver.get("about:blank")


def test_every_control_is_reached_by_the_tab_key(visitor):
    from selenium.webdriver.common.keys import Keys

    visitor.one("#simulate").click()
    until(lambda: visitor.one("#film").is_displayed(), "the film")
    visitor.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    reached = []
    for _ in range(34):
        visitor.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(visitor.driver.execute_script("return document.activeElement.id"))
    expected = [
        "preset",
        *(f"{kind}{i}" for i in range(9) for kind in "tv"),
        "plane-x",
        "plane-y",
        "plane-shown",
        "plane",
        "along",
    ]
    assert [name for name in [*expected, "simulate", "play", "time"] if name not in reached] == []
