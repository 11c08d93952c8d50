"""The explorer in a real browser: a slider, the plane and the simulation do what a person expects to see."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from explorer.conftest import Visitor, served, site_of, there, tunnel
from patience import until
from report.browser import console_errors, fresh, requested
from report.test_report import SCRIPT

from activefail.errors import InputError

pytestmark = pytest.mark.needs("browser")


class Explorer(Visitor):
    def probabilities(self) -> dict[str, float]:
        bars = "[...document.querySelectorAll('#predict [data-outcome]')]"
        script = f"return {bars}.map(b => [b.dataset.outcome, +b.dataset.probability])"
        return dict(self.driver.execute_script(script))

    def marker(self) -> tuple[float, float]:
        """Where the design is on the plane's axes [%]: from the left, and from the top."""
        script = """
            const { style } = document.querySelector("#plane .drawing");
            return ["--x", "--y"].map((name) => Number(style.getPropertyValue(name)));
        """
        x, y = self.driver.execute_script(script)
        return 100.0 * x, 100.0 * (1.0 - y)

    def slider(self, name: str) -> Any:
        return self.one(f"#s-{name} [type=range]")

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


def expected(one, **changes: float) -> dict[str, float]:
    """The prediction for the design at which the page starts, with these changes."""
    X = [dict(zip(one.space.names, one.presets[0][1], strict=True)) | changes]
    shares = one.findings.classifier.predicted(np.array([[*X[0].values()]])).probabilities[0]
    return dict(zip(one.outcomes, shares.tolist(), strict=True))


def shows(visitor: Explorer, prediction: dict[str, float]) -> None:
    """Wait until the page shows a prediction."""
    until(lambda: visitor.probabilities() == pytest.approx(prediction, abs=1e-9), "a prediction")


def test_the_name_of_the_campaign_is_text_and_no_program(visitor):
    assert visitor.one("h1").text == SCRIPT
    assert visitor.driver.execute_script("return document.scripts.length") == 1


def test_a_slider_moved_by_the_keyboard_changes_the_prediction_and_the_value_shown(visitor, one):
    from selenium.webdriver.common.keys import Keys

    assert visitor.slider("A_g").accessible_name == "A_g in g"
    visitor.slider("A_g").send_keys(Keys.HOME)
    shows(visitor, expected(one, A_g=0.1))
    assert visitor.one("#A_g").get_attribute("value") == "0.1"
    visitor.slider("A_g").send_keys(Keys.END)
    shows(visitor, expected(one, A_g=0.8))
    assert visitor.one("#A_g").get_attribute("value") == "0.8"
    assert expected(one, A_g=0.8)["failure"] > expected(one, A_g=0.1)["failure"]
    assert visitor.one("#preset").get_attribute("value") == ""


@pytest.mark.parametrize("prefix", ["", "/user/ann/proxy/8050"])
def test_through_a_tunnel_on_another_port_and_a_proxy_with_a_path_the_page_works(driver, findings, one, prefix):
    from selenium.webdriver.common.keys import Keys

    fresh(driver, 1400, 1000)
    with served(site_of(findings), needs_token=True) as running, tunnel(running.server_address[1], prefix) as port:
        address = f"http://localhost:{port}{prefix}/"
        driver.get(f"{address}?token={running.token}")
        visitor = Explorer(driver)
        visitor.settled()
        visitor.slider("A_g").send_keys(Keys.HOME)
        shows(visitor, expected(one, A_g=0.1))
        assert driver.current_url == address
        assert console_errors(driver) == []
        assert [url for url in requested(driver) if not url.startswith((address, "data:"))] == []
        driver.get("about:blank")


def test_a_number_that_is_typed_is_the_design_s_and_one_outside_the_space_is_refused(visitor, one):
    from selenium.webdriver.common.keys import Keys

    def types(name: str, text: str) -> None:
        field = visitor.one(f"#{name}")
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(Keys.BACKSPACE, text, Keys.ENTER)

    types("k", "2.5e9")
    types("A_g", "0.4567")
    shows(visitor, expected(one, k=2.5e9, A_g=0.4567))
    for text in ("0.9", "much", ""):
        types("A_g", text)
        assert visitor.driver.execute_script("return arguments[0].matches(':invalid')", visitor.one("#A_g"))
        assert visitor.one("#A_g").get_attribute("validationMessage")
        assert visitor.one("#A_g").value_of_css_property("border-color") == "rgb(180, 35, 24)"
    shows(visitor, expected(one, k=2.5e9, A_g=0.4567))
    types("A_g", "0.4567")
    assert not visitor.driver.execute_script("return arguments[0].matches(':invalid')", visitor.one("#A_g"))
    assert visitor.one("#k").get_attribute("value") == "2.5e9"


def test_a_click_on_the_plane_moves_the_design_and_the_arrow_keys_move_it_on(visitor, one):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    def values() -> dict[str, str]:
        return {name: visitor.one(f"#{name}").get_attribute("value") for name in one.space.names}

    x, y = (visitor.one(f"#{name}").get_attribute("value") for name in ("across", "up"))
    before = visitor.marker(), values()
    drawing = visitor.one("#plane svg")
    visitor.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", drawing)
    box = drawing.size
    place = visitor.driver.execute_script(
        "const { style } = document.querySelector('#plane .drawing');"
        "return ['left', 'right', 'top', 'bottom'].map((side) => Number(style.getPropertyValue(`--${side}`)))"
    )
    left, right, top, bottom = place
    ActionChains(visitor.driver).move_to_element_with_offset(
        drawing,
        round(box["width"] * (left + 0.2 * (right - left) - 0.5)),
        round(box["height"] * (bottom - 0.3 * (bottom - top) - 0.5)),
    ).click().perform()
    until(lambda: visitor.marker() != before[0], "the marker to move")
    assert visitor.marker() == pytest.approx((20.0, 70.0), abs=1.5)
    after = values()
    assert {name for name in after if after[name] != before[1][name]} == {x, y}
    ring = visitor.one("#plane .ring").rect
    assert ring["x"] + 9 == pytest.approx(drawing.rect["x"] + (left + 0.2 * (right - left)) * box["width"], abs=3)
    across, down = visitor.marker()
    visitor.one("#plane").send_keys(Keys.ARROW_RIGHT)
    until(lambda: visitor.marker()[0] > across, "the arrow key")
    assert visitor.marker()[1] == pytest.approx(down)
    said = [f"{visitor.one(f'#s-{name} b').text}".replace("\n", "") + f" {values()[name]}" for name in (x, y)]
    until(lambda: all(there(visitor, "#plane [role=status]", text) for text in said), "the word of the move")
    assert there(visitor, "#plane [role=status]", visitor.one("#predict .card b").text)


def test_two_equal_axes_are_exchanged(visitor):
    from selenium.webdriver.support.select import Select

    x, y = (visitor.one(f"#{name}").get_attribute("value") for name in ("across", "up"))
    Select(visitor.one("#across")).select_by_value(y)
    until(lambda: there(visitor, f"#plane [data-axes='{y} {x}']"), "the plane")


def test_a_panel_that_fails_says_so_in_its_place(driver, findings):
    def fail() -> None:
        raise InputError("The code was moved.")

    fresh(driver, 1400, 1000)
    with served(site_of(findings, failure=fail)) as running:
        driver.get(running.address)
        until(lambda: there(Visitor(driver), "#failure", "No answer: The code was moved."), "the reason")
        driver.get("about:blank")


def test_every_control_is_reached_by_the_tab_key_and_has_a_name(visitor, one):
    from selenium.webdriver.common.keys import Keys

    visitor.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    reached = []
    for _ in range(34):
        visitor.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(
            visitor.driver.execute_script("return document.activeElement.id || document.activeElement.ariaLabel")
        )
    sliders = [visitor.slider(name).get_attribute("aria-label") for name in one.space.names]
    wanted = ["preset", *one.space.names, *sliders, "across", "up", "shown", "plane", "along"]
    assert [name for name in wanted if name not in reached] == []
    for control in visitor.driver.find_elements("css selector", "button, select, input"):
        if control.is_displayed():
            assert control.accessible_name
