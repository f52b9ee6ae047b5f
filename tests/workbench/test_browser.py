# SPDX-License-Identifier: Apache-2.0
"""The whole loop in a real browser: from a session with a hidden effect to the report."""

import http.client
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, suppress
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

import pandas as pd
import pytest

import machine_tool_calibration as mtcal
from machine_tool_calibration.reports.history import history_path, read_history

CHROMIUM = Path("/usr/bin/chromium")
pytestmark = pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: Debian's package chromium has one")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")

# Chromium started by root, in a closed network.
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
START = 1_700_000_000_000_000_000  # ns
WAIT = 300_000  # ms; the last resort on a busy machine
AGAIN = 20_000  # ms


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session whose machine has a backlash of Y that the model lacks."""
    folder = tmp_path_factory.mktemp("workbench") / "cube"
    mtcal.simulate("tracking_2d", effects={"backlash_y": 2e-6}, seed=3).save(folder)
    return folder


@pytest.fixture(scope="module")
def address(hidden: Path) -> Iterator[str]:
    """Of a workbench that `mtcal workbench` serves."""
    command = [sys.executable, "-m", "machine_tool_calibration", "workbench", "--no-browser", str(hidden)]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=hidden.parent) as run:
        assert run.stdout is not None
        try:
            yield run.stdout.readline().strip()
        finally:
            run.send_signal(signal.SIGINT)
        assert run.wait(WAIT / 1000) == 0, "Ctrl-C ends it"


@pytest.fixture(scope="module")
def browser() -> Iterator["playwright.Browser"]:
    with playwright.sync_playwright() as run:
        opened = run.chromium.launch(executable_path=str(CHROMIUM), args=list(FLAGS), timeout=WAIT)
        yield opened
        opened.close()


def answer(address: str, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=WAIT / 1000)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def status(address: str, path: str, **headers: str) -> int:
    return answer(address, path, **headers).status


# Controls that are seen and cannot be reached with Tab, or have no words: all shadow roots are looked through.
UNREACHABLE = """() => {
    const found = []
    const text = one => one.matches && one.matches('style, link') ? ''
        : [...one.childNodes, ...(one.shadowRoot ? [one.shadowRoot] : [])].map(n => n.nodeValue || text(n)).join('')
    const look = root => root.querySelectorAll('*').forEach(one => {
        if (one.shadowRoot) look(one.shadowRoot)
        if (!one.matches('button, input, select, textarea, a') || one.disabled || !one.getClientRects().length) return
        const label = one.labels && one.labels.length ? one.labels[0].innerText : ''
        const own = one.matches('button, a') ? text(one) : ''
        const words = label || one.getAttribute('aria-label') || one.title || own.trim()
        if (one.tabIndex < 0 || !words) found.push(one.outerHTML.slice(0, 200))
    })
    look(document)
    return found
}"""

# Five plots are seen, which the window has narrowed, and none of which it has squeezed.
FIVE_WIDE_PLOTS = """() => {
    const wide = []
    const look = root => root.querySelectorAll('*').forEach(one => {
        if (one.shadowRoot) look(one.shadowRoot)
        if (one.matches('.bk-Figure') && one.getClientRects().length) wide.push(one.getBoundingClientRect().width)
    })
    look(document)
    return wide.length == 5 && wide.every(width => 300 < width && width <= 700)
}"""


@pytest.mark.long
def test_from_opening_to_the_report(hidden: Path, address: str, browser: "playwright.Browser", ros_domain: int) -> None:
    asked: list[str] = []
    faults: list[str] = []

    def window() -> "playwright.Page":
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(WAIT)
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(address)
        return page

    page = window()
    page.get_by_text("model free: 288 readings").wait_for()

    def press(name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    # Compare: what is selected in one plot is set aside, and put back.
    press("Compare")
    page.get_by_text("0 of 288 readings selected").wait_for()
    count = int(dragged(page, re.compile(r"^[1-9]\d* of 288 readings selected; 0 set aside")).split()[0])
    assert 0 < count < 288
    press("Set the selected aside")
    page.get_by_text(f"{288 - count} readings, residual").wait_for()
    press("Put back")
    page.get_by_text("0 of 288 readings selected; 0 set aside").wait_for()
    unreachable = page.evaluate(UNREACHABLE)

    # Diagnose: what is missing, and its pattern; by keyboard.
    press("Diagnose")
    button = page.get_by_role("button", name="Look for what is missing", exact=True)
    button.press("Enter")
    page.get_by_text("The model lacks backlash of Y (backlash_y).").wait_for()
    page.get_by_text("With backlash_y: b = 1.9").wait_for()
    page.get_by_text("An effect of your own by its formula").click()
    page.get_by_label("Formula (m; of a rotation rad)").fill("b * dir_y + 1")
    page.get_by_role("alert").filter(has_text="the formula").wait_for()
    unreachable += page.evaluate(UNREACHABLE)

    # Improve: the residual falls, and the history holds it.
    press("Add it to the model")
    page.get_by_text("model free with backlash_y: 288 readings").wait_for()
    press("Improve")
    page.get_by_text("RMS residual, µm").wait_for()
    kept = read_history(history_path(hidden))
    assert kept.in_use is not None and kept.in_use.effects == ("backlash_y",)
    assert kept.in_use.rms_residual < 0.3 * kept.models[0].rms_residual
    page.set_viewport_size({"width": 700, "height": 900})
    page.wait_for_function(FIVE_WIDE_PLOTS)  # none is squeezed
    page.set_viewport_size({"width": 1400, "height": 900})
    unreachable += page.evaluate(UNREACHABLE)

    # Plan: what the next measurement would tell, and its plan in a folder.
    press("Plan")
    press("Look ahead")
    page.get_by_role("heading", name="What the next measurement would tell").wait_for()
    press("Save the plan")
    page.get_by_text("Download observations.csv").wait_for()
    planned = pd.read_csv(hidden.parent / "mtcal_output" / "plan" / "observations.csv")
    assert len(planned) == 144 and planned["displacement"].isna().all()
    unreachable += page.evaluate(UNREACHABLE)

    # Export: what a controller would leave, and the report, on the disk and downloaded.
    press("Export")
    press("Show what would be left")
    page.get_by_text("RMS left").wait_for()
    press("Save the files")
    page.get_by_text("Download compensation.ini").wait_for()
    page.get_by_label("Diagnosis in the report").select_option("left out")
    press("Save the report as HTML")
    with page.expect_download() as download:
        page.get_by_text("Download report.html").click()
    written = hidden.parent / "mtcal_output" / "export_cube"
    report = (written / "report.html").read_text(encoding="utf-8")
    assert "backlash_y" in report and Path(download.value.path()).read_text(encoding="utf-8") == report
    assert (written / "linuxcnc" / "y.comp").exists()
    unreachable += page.evaluate(UNREACHABLE)

    if find_spec("rclpy") is not None:
        beside_a_graph(window(), hidden, ros_domain)
        assert page.get_by_text("model free with backlash_y: 288 readings").is_visible()

    place = urlsplit(address)
    elsewhere = [url for url in asked if urlsplit(url).netloc not in ("", place.netloc)]
    assert not elsewhere, "nothing comes from the network"
    assert not faults
    assert not unreachable


def dragged(page: "playwright.Page", expected: re.Pattern[str]) -> str:
    """What the page says once the mouse was dragged over the first plot; again where the plot was not ready for it."""
    for _ in range(WAIT // AGAIN):
        plot = page.locator(".bk-Figure canvas >> visible=true").first.bounding_box()
        assert plot is not None
        page.mouse.move(plot["x"] + 0.3 * plot["width"], plot["y"] + 0.25 * plot["height"])
        page.mouse.down()
        page.mouse.move(plot["x"] + 0.6 * plot["width"], plot["y"] + 0.7 * plot["height"], steps=3)
        page.mouse.up()
        with suppress(playwright.TimeoutError):
            return str(page.get_by_text(expected).inner_text(timeout=AGAIN))
    raise AssertionError("nothing is selected")


def beside_a_graph(page: "playwright.Page", hidden: Path, domain: int) -> None:
    """Readings that come are drawn, become a map, and are opened in the other pages."""
    from machine_tool_calibration.nodes.client import Client

    from ..nodes.publishing import publish

    page.get_by_role("button", name="Live", exact=True).click()
    page.get_by_text(f"Nothing is heard in ROS domain {domain} yet").wait_for()
    with closing(Client(domain)) as guest:
        kept = publish(guest.node, mtcal.load(hidden).sessions[0], START)
        page.get_by_text("The map, calculated here from 288 readings").wait_for()
        assert kept
        page.get_by_role("button", name="Open in the other pages", exact=True).click()
        page.get_by_text("mtcal_output/live is open in the other pages.").wait_for()
    taken, given = (mtcal.load(folder).readings for folder in (hidden.parent / "mtcal_output" / "live", hidden))
    assert taken["displacement"].tolist() == given["displacement"].tolist()


@pytest.mark.long
def test_no_page_is_wider_than_a_phone(address: str, browser: "playwright.Browser") -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.set_default_timeout(WAIT)
    page.goto(address)
    page.get_by_text("288 readings, residual").wait_for()
    for title in ("Measurement", "Result", "Compare", "Diagnose", "Improve", "Plan", "Export", "Live"):
        page.get_by_role("button", name=title, exact=True).click()
        page.get_by_role("heading", name=title, exact=True).wait_for()
        # Plots are laid out when they are drawn, and again when their width is known.
        page.wait_for_function("Bokeh.documents.every(one => one.is_idle)")
        page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        page.wait_for_function("document.documentElement.scrollWidth <= 390")


def test_without_the_token_there_is_nothing(address: str) -> None:
    path = urlsplit(address).path
    token = path.split("/")[1]
    static = "/static/js/bokeh.min.js"
    page = answer(address, path)
    assert page.status == 200 == status(address, f"/{token}{static}")
    assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"]
    assert page.headers["X-Frame-Options"] == "DENY"
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
    for wrong in ("", "/x", f"/{token[:-1]}", f"/{token}x"):
        for known in ("/", "/workbench", "/workbench/ws", "/workbench/autoload.js", static, "/saved/a/b"):
            assert status(address, f"{wrong}{known}") == 404
        assert status(address, f"{wrong}/workbench/ws", Origin=address.split(token)[0][:-1], **upgrade) == 404
    # A page of another address may not use the websocket, even with the token, nor may another name lead here.
    assert status(address, f"{path}/ws", Origin="http://example.org", **upgrade) == 403
    assert status(address, path, Host=f"example.org:{urlsplit(address).port}") == 403
