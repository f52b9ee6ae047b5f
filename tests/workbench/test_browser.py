# SPDX-License-Identifier: Apache-2.0
"""The whole loop in a real browser: from a session with a hidden effect to the improved fit."""

import http.client
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

import machine_tool_calibration as mtcal
from machine_tool_calibration.recording.session_bag import reading_columns
from machine_tool_calibration.reports.history_file import history_path, read_history
from machine_tool_calibration.session.parse import description_yaml

if TYPE_CHECKING:
    from machine_tool_calibration.nodes.ros.guest import Guest

CHROMIUM = Path("/usr/bin/chromium")
pytestmark = pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: Debian's package chromium has one")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")

# Chromium started by root, in a closed network.
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
START = 1_700_000_000_000_000_000  # ns
WAIT = 60_000  # ms; the last resort on a busy machine


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


@pytest.fixture
def browser() -> Iterator["playwright.Browser"]:
    with playwright.sync_playwright() as run:
        opened = run.chromium.launch(executable_path=str(CHROMIUM), args=list(FLAGS))
        yield opened
        opened.close()


def status(address: str, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=WAIT / 1000)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


def test_from_opening_to_the_improved_fit(hidden: Path, address: str, browser: "playwright.Browser") -> None:
    asked: list[str] = []
    faults: list[str] = []

    def window() -> "playwright.Page":
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(WAIT)
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(address)
        page.get_by_text("model free: 288 readings").wait_for()
        return page

    def press(page: "playwright.Page", name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    one, two = window(), window()

    # Compare: what is selected in one plot is set aside, and put back.
    press(one, "Compare")
    one.get_by_text("0 of 288 readings selected").wait_for()
    plot = one.locator(".bk-Figure >> visible=true").first.bounding_box()
    assert plot is not None
    one.mouse.move(plot["x"] + 0.3 * plot["width"], plot["y"] + 0.25 * plot["height"])
    one.mouse.down()
    one.mouse.move(plot["x"] + 0.6 * plot["width"], plot["y"] + 0.7 * plot["height"], steps=5)
    one.mouse.up()
    one.get_by_text("Readings selected").wait_for()
    said = one.get_by_text(re.compile(r"\d+ of 288 readings selected; 0 set aside")).inner_text()
    count = int(said.split()[0])
    assert 0 < count < 288
    press(one, "Set the selected aside")
    one.get_by_text(f"{288 - count} readings, residual").wait_for()
    press(one, "Put back")
    one.get_by_text("0 of 288 readings selected; 0 set aside").wait_for()

    # Diagnose: what is missing, and its pattern; by keyboard.
    press(one, "Diagnose")
    button = one.get_by_role("button", name="Look for what is missing", exact=True)
    button.focus()
    one.keyboard.press("Enter")
    one.get_by_text("The model lacks backlash of Y (backlash_y).").wait_for()
    one.get_by_text("With backlash_y: b = 1.9").wait_for()
    one.get_by_text("An effect of your own by its formula").click()
    one.get_by_label("Formula (a length, m)").fill("b * dir_y + 1")
    one.get_by_role("alert").filter(has_text="the formula").wait_for()

    # Improve: the residual falls, the other window knows nothing of it, and the history does.
    press(one, "Add it to the model")
    one.get_by_text("model free with backlash_y: 288 readings").wait_for()
    press(one, "Improve")
    one.get_by_text("Models tried").wait_for()
    one.get_by_text("RMS residual, µm").wait_for()
    assert two.get_by_text("model free: 288 readings").is_visible()
    kept = read_history(history_path(hidden))
    assert kept.in_use is not None and kept.in_use.effects == ("backlash_y",)
    assert kept.in_use.rms_residual < 0.3 * kept.models[0].rms_residual
    press(one, "Undo")
    one.get_by_text("model free: 288 readings").wait_for()

    place = urlsplit(address)
    elsewhere = [url for url in asked if urlsplit(url).netloc not in ("", place.netloc)]
    assert not elsewhere, "nothing comes from the network"
    assert not faults


def test_readings_of_a_graph_become_a_map_and_are_opened(
    hidden: Path, address: str, browser: "playwright.Browser", ros_domain: int
) -> None:
    pytest.importorskip("rclpy", reason="the graph needs ROS 2")
    from machine_tool_calibration.nodes.ros.guest import Guest

    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(WAIT)
    page.goto(address)
    page.get_by_role("button", name="Live", exact=True).click()
    page.get_by_text(f"Nothing is heard in ROS domain {ros_domain} yet").wait_for()
    with closing(Guest("procedure_of_the_test", ros_domain)) as guest:
        kept = publish(guest, hidden)
        page.get_by_text("The map, calculated here from 288 readings").wait_for()
        assert kept
        page.get_by_role("button", name="Open in the other pages", exact=True).click()
        page.get_by_text("mtcal_output/live is open in the other pages.").wait_for()
    taken, given = (mtcal.load(folder).readings for folder in (hidden.parent / "mtcal_output" / "live", hidden))
    assert taken["displacement"].tolist() == given["displacement"].tolist()


def publish(guest: "Guest", folder: Path) -> list[object]:
    """What a procedure publishes of a session; kept for those who come late as long as the publishers are."""
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, to_message

    session = mtcal.load(folder).sessions[0]
    sessions = guest.node.create_publisher(String, "session", LATCHED)
    readings = guest.node.create_publisher(JointState, "reading", READINGS)
    sessions.publish(String(data=description_yaml(session.description)))
    names, table = reading_columns(session)
    for row in table:
        message = JointState(name=names, position=row.tolist())
        message.header.stamp = to_message(START + round(row[names.index("time")] * 1e9))
        readings.publish(message)
    return [sessions, readings]


def test_without_the_token_there_is_nothing(address: str) -> None:
    path = urlsplit(address).path
    token = path.split("/")[1]
    static = "/static/js/bokeh.min.js"
    assert status(address, path) == 200 == status(address, f"/{token}{static}")
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
    for wrong in ("", "/x", f"/{token[:-1]}", f"/{token}x"):
        for known in ("/", "/workbench", "/workbench/ws", "/workbench/autoload.js", static, "/favicon.ico"):
            assert status(address, f"{wrong}{known}") == 404
        assert status(address, f"{wrong}/workbench/ws", Origin=address.split(token)[0][:-1], **upgrade) == 404
    # A page of another address may not use the websocket, even with the token.
    assert status(address, f"{path}/ws", Origin="http://example.org", **upgrade) == 403
