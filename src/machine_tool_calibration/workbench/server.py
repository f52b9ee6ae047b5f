# SPDX-License-Identifier: Apache-2.0
"""The server of the pages: this machine only, and only for who knows the token in its address."""

import logging
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from traceback import extract_tb
from typing import Any

import panel as pn
from bokeh.server import connection
from panel.io.server import get_server
from tornado.httputil import HTTPHeaders
from tornado.web import ErrorHandler, OutputTransform

from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.look import CSS
from machine_tool_calibration.workbench.page import window
from machine_tool_calibration.workbench.process import warm_up
from machine_tool_calibration.workbench.saved import PATTERNS

_HERE = "127.0.0.1"
# Panel keeps a page that was closed for a while; a window's work is not needed after a lost connection's time.
_SESSION_LIFETIME = 60_000  # ms
_HEADERS = {
    # Scripts stand in Bokeh's page, and Panel makes functions of texts; all comes from here, and into no other's frame.
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",  # the token is in the address
}


def quieten() -> None:
    """Keep from the terminal what is no fault.

    A browser asks for files that are not there, an icon first, and closes pages that are being told something or were
    just clicked at.
    """
    for name in ("tornado.access", "bokeh.server.views.ws"):
        logging.getLogger(name).setLevel(logging.ERROR)
    logging.getLogger("bokeh.server.protocol_handler").addFilter(_of_an_open_page)


def _of_an_open_page(record: logging.LogRecord) -> bool:
    """Whether a fault is another than that a message came from a page that is closed: Bokeh asserts that it is not."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, AssertionError) or extract_tb(error.__traceback__)[-1].filename != connection.__file__


def serve(
    targets: Sequence[Path],
    own: Sequence[Effect] = (),
    variant: str | None = None,
    *,
    live: bool = False,
    domain: int | None = None,
    namespace: str = "",
    port: int = 0,
    ready: Callable[[str], None],
) -> None:
    """Serve until the process is interrupted; an OSError if the port is taken.

    The token is the first part of every path that is answered, pages, scripts and websocket alike: whoever does not
    know it is told that there is nothing. The scripts come from the installed packages. Targets are a session, a
    recording, or a folder of such, or several sessions and recordings of one machine, with effects of the user's own
    and a variant of the method's model; none where only a running graph is shown, of a ROS domain (that of the
    environment if None) and namespace, on the page Live that `live` begins with. `ready` is told the address, with the
    token, for a browser; the port is one that is free for 0.
    """
    quieten()
    pn.extension(raw_css=[CSS], notifications=False)
    warm_up()
    feed = Feed(own, variant, domain, namespace)
    token = secrets.token_urlsafe(24)
    server = get_server(
        {"workbench": lambda: window(targets, own, variant, feed, live)},
        port=port,
        address=_HERE,
        title=" · ".join([*(target.absolute().name for target in targets), "mtcal workbench"]),
        prefix=token,
        unused_session_lifetime_milliseconds=_SESSION_LIFETIME,
        use_index=False,
        extra_patterns=PATTERNS,
        ico_path="none",
    )
    _guard(server._tornado, f"{_HERE}:{server.port}")  # the port is not known before
    server.start()
    ready(f"http://{_HERE}:{server.port}/{token}/workbench")
    # Panel's own handler of Ctrl-C ends the loop.
    server.io_loop.start()
    server.stop()
    feed.close()


class _Headers(OutputTransform):
    """What every answer tells the browser to refuse."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        headers.update(_HEADERS)
        return status_code, headers, chunk


def _guard(application: Any, host: str) -> None:
    """Answer only what asks for this very address, which another name that leads here (DNS rebinding) is not.

    Only its pages may open the websocket.
    """
    find = application.find_handler

    def found(request: Any, **more: Any) -> Any:
        if request.host == host:
            return find(request, **more)
        return application.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    application.find_handler = found
    application.add_transform(_Headers)
    application.websocket_origins.clear()
    application.websocket_origins.add(host)
