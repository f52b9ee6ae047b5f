# SPDX-License-Identifier: Apache-2.0
"""How long the workbench takes from a click until its picture is drawn anew, in a real browser.

    python benchmarks/workbench.py [--repeats 7] [--clicks 10]

Of a simulated session (144 readings a repeat) some readings are set aside and put back on the page Compare, as a person
would; both clicks count. Said is the median, in all and in its parts: from the click until the browser has heard of the
new residuals (the calculation, and the page's process), and from then until frames follow each other without a pause
(the browser draws). Needs playwright and Debian's Chromium; any other load on the machine counts too.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

import machine_tool_calibration as mtcal

FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync")
WAIT = 30_000  # ms
# Begins at the next click. When the residuals have come, and four frames in a row without a pause, it is over.
TIMER = """() => new Promise(done => {
    let clicked = 0, heard = 0, last = 0, calm = 0
    const models = [...Bokeh.documents.flatMap(d => [...d.all_models])]
    const source = models.find(model => model.type === "ColumnDataSource" && "residual" in (model.data ?? {})
        && "studentized" in model.data)
    window.addEventListener("click", event => { clicked = event.timeStamp }, {capture: true, once: true})
    let before = JSON.stringify([...source.data["residual"]])
    const look = () => {
        if (!heard && JSON.stringify([...source.data["residual"]]) !== before) heard = performance.now()
    }
    source.properties.data.change.connect(look)
    source.patching?.connect(look)
    const frame = now => {
        calm = heard && now - last < 22 ? calm + 1 : 0
        last = now
        if (calm < 4) return requestAnimationFrame(frame)
        done({wait: heard - clicked, draw: now - 4 * 1000 / 60 - heard})
    }
    requestAnimationFrame(frame)
})"""


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """The address of a workbench."""
    command = [sys.executable, "-m", "machine_tool_calibration", "workbench", "--no-browser", *arguments]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as run:
        assert run.stdout is not None
        try:
            yield run.stdout.readline().strip()
        finally:
            run.send_signal(signal.SIGINT)


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def timed(page: Page, name: str) -> tuple[float, float]:
    """Press a button that changes the model: s until the browser has heard of it, and until it is drawn."""
    page.evaluate(f"() => {{ window.timed = ({TIMER})() }}")
    press(page, name)
    found = page.evaluate("() => window.timed")
    page.wait_for_timeout(300)
    return found["wait"] / 1e3, found["draw"] / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--clicks", type=int, default=10)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as run:
        session = Path(folder) / "session"
        mtcal.simulate("tracking_2d", effects={"backlash_y": 2e-6}, seed=3, repeats=chosen.repeats).save(session)
        with served(str(session)) as address:
            browser = run.chromium.launch(executable_path="/usr/bin/chromium", args=list(FLAGS))
            page = browser.new_page(viewport={"width": 1500, "height": 950})
            page.set_default_timeout(WAIT)
            page.goto(address)
            page.get_by_text(re.compile(r"model .*: \d+ readings")).first.wait_for()
            press(page, "Compare")
            page.get_by_text(re.compile(r"^0 of \d+ readings selected")).wait_for()
            page.wait_for_timeout(2000)
            found = []
            for _ in range(-(-chosen.clicks // 2)):
                plot = page.locator(".bk-Figure canvas >> visible=true").first.bounding_box()
                assert plot is not None
                page.mouse.move(plot["x"] + 0.3 * plot["width"], plot["y"] + 0.3 * plot["height"])
                page.mouse.down()
                page.mouse.move(plot["x"] + 0.45 * plot["width"], plot["y"] + 0.5 * plot["height"], steps=3)
                page.mouse.up()
                page.get_by_text(re.compile(r"^[1-9]\d* of \d+ readings selected; 0 set aside")).wait_for()
                page.wait_for_timeout(500)
                found.append(timed(page, "Set the selected aside"))
                found.append(timed(page, "Put back"))
            browser.close()
    times = np.array(found)
    print(f"{144 * chosen.repeats} readings, {len(times)} clicks; median (smallest to largest)")
    for name, values in (("in all", times.sum(axis=1)), ("until heard", times[:, 0]), ("until drawn", times[:, 1])):
        print(f"{name:12s} {np.median(values):.3f} s ({values.min():.3f} to {values.max():.3f})")


if __name__ == "__main__":
    main()
