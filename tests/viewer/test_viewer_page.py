"""The page in a real browser: Chromium without a screen."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium, complaints, screenshot, wait_until
from runs import finished_run
from scenes import room, state

from mfslam.viewer.client import Viewer
from mfslam.viewer.place import Place
from mfslam.viewer.run import show_run
from mfslam.viewer.server import Server

LIGHT = {"features": [{"name": "prefers-color-scheme", "value": "light"}]}
DARK = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
TAKEN = "return performance.getEntriesByType('resource').map((entry) => entry.name)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as window:
        window.execute_cdp_cmd("Emulation.setEmulatedMedia", LIGHT)
        yield window


@pytest.fixture(scope="module")
def run_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with Server(Place(0), show_run(finished_run(tmp_path_factory))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@dataclass
class Drive:
    """A robot that drives on until it is stopped, and whoever wants its map gets it."""

    viewer: Viewer
    stop: threading.Event = field(default_factory=threading.Event)
    saved: int = 0

    def run(self) -> None:
        grid, k = room(), 0
        while not self.stop.wait(0.05):
            k += 1
            self.viewer.show(state(k % 40, grid))
            wish = self.viewer.wish()
            if wish is not None:
                self.saved += 1
                self.viewer.answer(wish, text=f"written to OUT/ ({self.saved})")


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Drive]:
    with Viewer(Place(0), "robot", tmp_path) as viewer:
        out = Drive(viewer)
        thread = threading.Thread(target=out.run)
        thread.start()
        yield out
        out.stop.set()
        thread.join()


def colour_share(picture: Any, colour: tuple[int, int, int]) -> float:
    return float((np.abs(picture.astype(int) - colour).max(axis=2) < 12).mean())


# --- a finished run -----------------------------------------------------------------------------------


def test_the_map_of_a_finished_run_is_drawn_and_grows_with_its_time(
    browser: Any, run_url: str, tmp_path: Path
) -> None:
    browser.get(run_url)
    wait_until(
        browser, "return mfslam.tiles.loaded >= 4 && mfslam.replay?.table && mfslam.model.scan.length > 100"
    )
    time.sleep(0.3)  # a frame
    whole = screenshot(browser, tmp_path / "whole.png")
    assert colour_share(whole, (255, 255, 255)) > 0.25  # free
    assert colour_share(whole, (27, 32, 38)) > 0.004  # walls
    assert colour_share(whole, (225, 29, 72)) > 0.0005  # the scan
    assert colour_share(whole, (37, 99, 235)) > 0.001  # trajectory and robot
    browser.execute_script("mfslam.replay.seek(2.0)")
    wait_until(browser, "return mfslam.model.robot.stamp_s < 2.01 && mfslam.model.scan.length > 100")
    time.sleep(0.3)
    early = screenshot(browser, tmp_path / "early.png")
    assert colour_share(early, (255, 255, 255)) < 0.8 * colour_share(whole, (255, 255, 255))
    assert complaints(browser) == []


def test_play_moves_the_robot_and_the_slider_seeks(browser: Any, run_url: str) -> None:
    browser.get(run_url)
    wait_until(browser, "return mfslam.replay?.table")
    end_s = browser.execute_script("return mfslam.replay.end")
    browser.execute_script("document.getElementById('play').click()")  # from the end: starts over
    wait_until(browser, "return mfslam.replay.t > 1 && mfslam.replay.t < mfslam.replay.end")
    before = browser.execute_script("return [...mfslam.model.robot.pose]")
    wait_until(
        browser,
        "return mfslam.model.robot.pose.some((v, k) => Math.abs(v - arguments[0][k]) > 0.2)",
        args=[before],
    )
    browser.execute_script("document.getElementById('play').click()")
    assert browser.execute_script("return document.getElementById('play').textContent") in ("play", "pause")
    seek = "const s = document.getElementById('time'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
    browser.execute_script(seek, end_s / 2)
    shown = browser.execute_script("return [mfslam.replay.playing, mfslam.model.robot.stamp_s]")
    assert shown[0] is False and shown[1] == pytest.approx(end_s / 2, abs=0.2)


# --- live ---------------------------------------------------------------------------------------------


def test_a_live_robot_moves_with_map_scan_sensors_and_notes(
    browser: Any, drive: Drive, tmp_path: Path
) -> None:
    browser.get(drive.viewer.url)
    wait_until(browser, "return mfslam.tiles.loaded >= 4 && mfslam.model.poses > 3")
    before = browser.execute_script("return mfslam.model.robot.pose[0]")
    wait_until(browser, "return Math.abs(mfslam.model.robot.pose[0] - arguments[0]) > 0.2", args=[before])
    text = browser.execute_script("return document.getElementById('panel').innerText")
    for told in ("urg:/dev/ttyACM0", "10.0 Hz, 12 ms late", "3 errors: checksum 3", "lost and found again once",
                 "silent for 2 s", "8.1 ms", "the wheels are silent"):  # fmt: skip
        assert told in text
    assert browser.execute_script("return document.getElementById('link').textContent") == "live"
    assert browser.execute_script("return [mfslam.model.scan.length, mfslam.model.loops.length]")[0] == 400
    picture = screenshot(browser, tmp_path / "live.png")
    assert colour_share(picture, (255, 255, 255)) > 0.1 and colour_share(picture, (225, 29, 72)) > 0.0005
    browser.refresh()
    wait_until(browser, "return mfslam.tiles.loaded >= 4 && mfslam.model.path.length > 0")
    assert all(name.startswith(drive.viewer.url) for name in browser.execute_script(TAKEN))
    assert complaints(browser) == []


def test_the_button_saves_and_offers_the_map(browser: Any, drive: Drive) -> None:
    browser.get(drive.viewer.url)
    wait_until(browser, "return !document.getElementById('save').hidden")
    browser.execute_script("document.getElementById('save').click()")
    told = wait_until(
        browser, "return document.getElementById('toast').innerText", good=lambda t: "written" in t
    )
    assert drive.saved == 1 and "download the map" in told
    assert (
        browser.execute_script("return document.querySelector('#toast a').getAttribute('href')") == "map.zip"
    )


def test_a_pan_ends_following_and_the_wheel_zooms(browser: Any, drive: Drive) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    browser.get(drive.viewer.url)
    wait_until(browser, "return mfslam.model.poses > 3")
    assert browser.execute_script("return mfslam.camera.following")
    canvas = browser.find_element("id", "map")
    scale = browser.execute_script("return mfslam.camera.scale")
    ActionChains(browser).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -200).perform()
    assert wait_until(browser, "return mfslam.camera.scale") > 1.2 * scale
    ActionChains(browser).drag_and_drop_by_offset(canvas, 120, 40).perform()
    assert not browser.execute_script("return mfslam.camera.following")
    x = browser.execute_script("return mfslam.camera.x")
    time.sleep(0.3)
    assert browser.execute_script("return mfslam.camera.x") == x  # the robot drives, the map stays
    browser.execute_script("document.getElementById('follow').click()")
    wait_until(browser, "return Math.abs(mfslam.camera.x - mfslam.model.robot.pose[0]) < 0.2")


def test_several_look_on_and_a_lost_viewer_is_found_again(browser: Any, drive: Drive) -> None:
    browser.get(drive.viewer.url)
    first = browser.current_window_handle
    browser.switch_to.new_window("window")
    browser.get(drive.viewer.url)
    for window in (browser.current_window_handle, first):
        browser.switch_to.window(window)
        wait_until(browser, "return mfslam.tiles.loaded >= 4 && mfslam.model.poses > 3")
    os.kill(drive.viewer.process.pid, signal.SIGKILL)
    link = "return document.getElementById('link').textContent"
    wait_until(browser, link, good=lambda text: "no connection" in text)
    poses = browser.execute_script("return mfslam.model.poses")
    wait_until(browser, link, good=lambda text: text == "live")
    wait_until(browser, "return mfslam.model.poses > arguments[0] + 3", args=[poses])
    others = [handle for handle in browser.window_handles if handle != first]
    browser.switch_to.window(others[0])
    browser.close()
    browser.switch_to.window(first)


def test_on_a_phone_in_the_dark(browser: Any, drive: Drive, tmp_path: Path) -> None:
    phone = {"width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", DARK)
    try:
        browser.get(drive.viewer.url)
        wait_until(browser, "return mfslam.tiles.loaded >= 4 && mfslam.model.poses > 3")
        assert browser.execute_script("return document.getElementById('panel').hidden")
        assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        cut = "return [...document.querySelectorAll('header button:not([hidden])')].map((b) => b.getBoundingClientRect().right)"
        assert max(browser.execute_script(cut)) <= 390
        picture = screenshot(browser, tmp_path / "phone.png")
        assert picture.mean() < 90 and colour_share(picture, (43, 49, 57)) > 0.3
    finally:
        browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {**phone, "width": 1280, "deviceScaleFactor": 1, "mobile": False},
        )
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", LIGHT)
