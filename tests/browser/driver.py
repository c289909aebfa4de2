"""A headless Chromium that opens a page from the disk and tells what it asked for and what its console said."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium.webdriver import Chrome, ChromeOptions, Keys
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--force-device-scale-factor=1",
)  # fmt: skip
PATIENCE = 30.0
"""Seconds to wait for something to appear: far more than it takes, so that a slow machine fails nothing."""


class Page:
    """One page of an exploration, opened in a browser."""

    def __init__(self, driver: Chrome, folder: Path) -> None:
        self.driver, self.folder = driver, folder
        self.requests: list[str] = []
        self.messages: list[str] = []

    def open(self, address: str = "") -> None:
        """Load the page afresh at an address, such as ``#/statistics``."""
        self.driver.get("about:blank")
        self.driver.get(f"file://{self.folder}/index.html{address}")
        self.ready()

    def go(self, address: str) -> None:
        """Follow an address within the page."""
        before = self.run("return document.body.dataset.ready || '0'")
        same = self.run("return location.hash") == address
        self.run("location.hash = arguments[0]", address)
        if not same:
            self.until("return document.body.dataset.ready !== arguments[0]", before)
        self.settle()

    def ready(self) -> None:
        """Wait until a view is shown."""
        self.until("return Boolean(document.body.dataset.ready) || Boolean(document.querySelector('[role=alert]'))")
        self.settle()

    def settle(self) -> None:
        """Wait for two frames, and note what the page asked for and said."""
        self.driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
        self.note()

    def note(self) -> None:
        """Read the browser's logs, which are emptied by reading."""
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
        self.messages += [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def outside(self) -> list[str]:
        """Return the addresses that were asked for outside the page's folder."""
        own = (f"file://{self.folder}/", "about:", "chrome:", "data:")
        return [address for address in self.requests if not address.startswith(own)]

    def run(self, script: str, *values: Any) -> Any:
        """Run JavaScript in the page."""
        return self.driver.execute_script(script, *values)

    def until(self, script: str, *values: Any) -> None:
        """Wait until a script returns true."""
        WebDriverWait(self.driver, PATIENCE, 0.05).until(lambda _: self.run(script, *values), script)

    def all(self, selector: str) -> list[WebElement]:
        """Return the elements of a selector."""
        found: list[WebElement] = self.driver.find_elements("css selector", selector)
        return found

    def one(self, selector: str) -> WebElement:
        """Wait for the first element of a selector."""
        self.until("return Boolean(document.querySelector(arguments[0]))", selector)
        return self.all(selector)[0]

    def texts(self, selector: str) -> list[str]:
        """Return the text content of the elements of a selector."""
        found: list[str] = self.run(
            "return [...document.querySelectorAll(arguments[0])].map((node) => node.textContent)", selector
        )
        return found

    def hover(self, selector: str) -> None:
        """Move the pointer over an element."""
        element = self.one(selector)
        self.run("arguments[0].scrollIntoView({block: 'center'})", element)
        ActionChains(self.driver).move_to_element(element).perform()
        self.settle()

    def key(self, name: str) -> None:
        """Press a key on the page."""
        ActionChains(self.driver).send_keys(getattr(Keys, name, name)).perform()

    def size(self, width: int, height: int = 900) -> None:
        """Set the size of the page itself."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        self.settle()

    def dark(self, on: bool) -> None:
        """Prefer a dark or a light page."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if on else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        self.settle()

    def picture(self, path: Path) -> None:
        """Write a picture of the whole page."""
        height = int(self.run("return document.documentElement.scrollHeight"))
        width = int(self.run("return document.documentElement.clientWidth"))
        self.size(width, min(height + 10, 4000))
        self.driver.save_screenshot(str(path))


@contextmanager
def browser(profile: Path) -> Iterator[Chrome]:
    """Start a browser with a profile of its own."""
    options = ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = Chrome(options=options, service=Service(shutil.which("chromedriver") or ""))
    driver.set_script_timeout(4 * PATIENCE)  # an audit of thousands of elements takes seconds on an idle machine
    try:
        yield driver
    finally:
        driver.quit()
