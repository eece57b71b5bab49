"""Chromium without a screen, for tests of the viewer's page."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless=new", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync",
    "--disable-component-update", "--disable-default-apps", "--disable-quic", "--hide-scrollbars",
    "--force-color-profile=srgb", "--disable-dev-shm-usage",
)  # fmt: skip
WHERE = "install Debian's packages chromium and chromium-driver (apt-get install chromium chromium-driver)"


@contextmanager
def chromium(width: int = 1280, height: int = 800, *flags: str) -> Iterator[Any]:
    """A window of a given size. Skips where there is no Chromium; with MFSLAM_NEED_BROWSER (CI) that fails."""
    binary = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if binary is None or driver is None:
        if os.environ.get("MFSLAM_NEED_BROWSER"):
            pytest.fail(f"no Chromium with its driver: {WHERE}")
        pytest.skip(f"no Chromium with its driver: {WHERE}")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    root = ("--no-sandbox",) if os.geteuid() == 0 else ()  # Chromium's own rule
    with tempfile.TemporaryDirectory(prefix="mfslam-chromium-") as profile:
        for flag in (*FLAGS, *root, *flags, f"--window-size={width},{height}", f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        browser = webdriver.Chrome(options, webdriver.ChromeService(driver))
        try:
            browser.execute_cdp_cmd(
                "Emulation.setDeviceMetricsOverride",
                {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600},
            )
            yield browser
        finally:
            browser.quit()


def wait_until(
    browser: Any, script: str, timeout_s: float = 30.0, good: Callable[[Any], bool] = bool, args: Any = ()
) -> Any:
    """What a script returns, once that is good."""
    end_s = time.monotonic() + timeout_s
    while True:
        value = browser.execute_script(script, *args)
        if good(value):
            return value
        assert time.monotonic() < end_s, f"in {timeout_s} s not good: {script}: {value!r}"
        time.sleep(0.05)


def screenshot(browser: Any, path: Path) -> Any:
    """The page as a picture (rows, cols, 3), also as a file."""
    import numpy as np
    from PIL import Image

    path.write_bytes(browser.get_screenshot_as_png())
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def complaints(browser: Any) -> list[str]:
    """What the browser's console says of the page."""
    return [entry["message"] for entry in browser.get_log("browser")]
