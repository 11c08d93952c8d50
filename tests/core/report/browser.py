"""A real browser for the tests: Debian's Chromium, driven by Selenium, for tests that need "browser" (`tools`)."""

import base64
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from patience import PATIENCE


def screenshots(name: str, fallback: Path) -> Path:
    """Where a screenshot goes: the folder that ACTIVEFAIL_SCREENSHOTS names, where it is set, else the test's own."""
    folder = Path(os.environ.get("ACTIVEFAIL_SCREENSHOTS") or fallback)
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


@contextmanager
def browser(width: int = 1280, height: int = 900) -> Iterator[Any]:
    """A headless Chromium whose console and requests are recorded."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    # As root, in a container without much shared memory.
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    options.add_argument(f"--window-size={width},{height}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(str(shutil.which("chromedriver")))
    driver = webdriver.Chrome(options, service)
    try:
        driver.set_page_load_timeout(PATIENCE)
        driver.set_script_timeout(PATIENCE)
        yield driver
    finally:
        driver.quit()


def fresh(driver: Any, width: int = 1280, height: int = 900) -> None:
    """Make a browser like one that has just been started: it shows no page, and nothing is stored or recorded.

    Starting one takes longer than most of what a test does with it.
    """
    driver.execute_script(
        "try { sessionStorage.clear(); localStorage.clear(); } catch { /* a page without storage */ }"
    )
    driver.execute_cdp_cmd("Network.clearBrowserCookies", {})
    driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    driver.get("about:blank")
    driver.set_window_size(width, height)
    console_errors(driver)
    requested(driver)


def photograph(driver: Any, path: Path) -> None:
    """Save a picture of the page. The driver's own command gives up after ten seconds, too early on a busy machine."""
    path.write_bytes(base64.b64decode(driver.execute_cdp_cmd("Page.captureScreenshot", {})["data"]))


def printed(driver: Any) -> bytes:
    """The page as a PDF; as `photograph`, without the driver's limit of ten seconds."""
    return base64.b64decode(driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})["data"])


def console_errors(driver: Any) -> list[str]:
    """The console's complaints since the last call."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def requested(driver: Any) -> list[str]:
    """Addresses that were requested since the last call."""
    import json

    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    return [
        message["params"]["request"]["url"] for message in messages if message["method"] == "Network.requestWillBeSent"
    ]
