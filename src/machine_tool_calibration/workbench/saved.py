# SPDX-License-Identifier: Apache-2.0
"""Files that a page writes: where they are, and links by which the browser downloads them."""

import secrets
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

import panel as pn
from tornado.web import HTTPError, RequestHandler

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.files import save
from machine_tool_calibration.workbench.look import NO_WIDER, text

_OFFERED: dict[str, Path] = {}  # what may be downloaded, by the part of its address that nobody guesses


class _Download(RequestHandler):
    def get(self, key: str) -> None:
        path = _OFFERED.get(key)
        if path is None or not path.is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quote(path.name)}")
        self.write(path.read_bytes())


PATTERNS = [(r"/saved/([\w-]+)/[^/]+", _Download)]
"""Addresses of the files, behind the server's token."""


class Saved:
    """The folder into which a page writes, and what it has written."""

    def __init__(self, name: str, width: int = 480) -> None:
        self.folder = pn.widgets.TextInput(name=name, width=width, styles=NO_WIDER)
        self.list = text()  # the files with their links
        self._mine: set[Path] = set()

    @property
    def place(self) -> Path:
        """The folder; a CalibrationError if none is given."""
        if not self.folder.value.strip():
            raise CalibrationError("give the folder into which it is to be saved")
        return Path(self.folder.value.strip()).expanduser()

    def claim(self, paths: Sequence[Path]) -> None:
        """Take files for this window, which may overwrite them from now on, also where their writing was stopped.

        A CalibrationError if one is there that is not from here.
        """
        for path in paths:
            if path.exists() and path not in self._mine:
                raise CalibrationError(f"{path}: is there already; choose another folder")
        self._mine.update(paths)

    def offer(self, paths: Sequence[Path]) -> None:
        """Say what was written, with a link to download each."""
        links = []
        for path in paths:
            key = secrets.token_urlsafe(12)
            _OFFERED[key] = path.absolute()
            address = f"saved/{key}/{quote(path.name)}"
            name = escape(path.name)
            links.append(f'<li>{escape(str(path))} <a href="{address}" download="{name}">Download {name}</a></li>')
        self.list.object = f"<p>Saved:</p><ul style='margin:0'>{''.join(links)}</ul>"

    def write(self, folder: Path, files: Mapping[str, str | bytes]) -> None:
        """Write files and offer them; a CalibrationError if one is there that was not written from here."""
        paths = [folder / name for name in files]
        self.claim(paths)
        self.offer([save(path, content) for path, content in zip(paths, files.values(), strict=True)])
