"""The page of a real `mfslam live`, from the first scan to its end, in Chromium."""

from __future__ import annotations

import io
import json
import signal
import time
import urllib.request
import zipfile
from pathlib import Path

from browser import chromium, complaints, wait_until
from live_command import SIMULATED, live

from mfslam.output import read_map

LINK = "return document.getElementById('link').textContent"


def test_the_button_saves_the_map_of_the_engine_and_the_page_tells_how_it_ended(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"
    with live(folder, *SIMULATED, "--view", "0") as run, chromium() as browser:
        address = run.until(lambda: next((w for w in run.said.split() if w.startswith("http://")), None))
        browser.get(address)
        wait_until(browser, "return mfslam.tiles.loaded && mfslam.model.scan.length > 100", 60.0)
        assert browser.execute_script(LINK) == "live"
        browser.execute_script("document.getElementById('save').click()")
        toast = "return document.getElementById('toast').innerText"
        told = wait_until(browser, toast, 60.0, lambda text: "written" in text)
        assert str(folder) in told
        # a whole run folder, while the robot drives on
        saved = json.loads((folder / "summary.json").read_text())
        assert saved["counts"]["keyframes"] > 0 and (folder / "graph.g2o").exists()
        with urllib.request.urlopen(f"{address}map.zip") as reply:
            zipfile.ZipFile(io.BytesIO(reply.read())).extractall(tmp_path / "copy")
        assert (read_map(tmp_path / "copy" / "map.yaml").occupancy == 100).sum() > 50
        scans = browser.execute_script("return mfslam.model.poses")
        wait_until(browser, "return mfslam.model.poses > arguments[0] + 3", args=[scans])
        assert complaints(browser) == []
        run.process.send_signal(signal.SIGINT)
        wait_until(browser, LINK, good=lambda text: text.startswith("the drive is over"))
        wait_until(browser, LINK, good=lambda text: text == f"ended, saved in {folder}/")
        assert run.ends() == 0, run.said
        time.sleep(1.0)  # in which it finds that nobody answers any more
        assert "no connection" not in browser.execute_script(LINK)
    assert json.loads((folder / "summary.json").read_text())["counts"]["scans"] > saved["counts"]["scans"]
