# SPDX-License-Identifier: Apache-2.0
"""Files that the package brings, wherever it was installed, and the help of executables, which is made of them.

Help comes from a node's module and from msg_docs, which tests hold against the nodes.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError

__all__ = ["TopicRow", "procedure_file", "procedure_names", "shared_file", "topics", "usage"]

_PACKAGE = "machine_tool_calibration"


def _shares() -> Iterator[Path]:
    source = Path(__file__).parents[3]
    if (source / "package.xml").is_file():
        yield source
    with suppress(PackageNotFoundError):
        for file in distribution(_PACKAGE).files or ():
            if file.name == "package.xml" and file.parent.name == _PACKAGE:
                yield Path(str(file.locate())).resolve().parent
    yield Path(sys.prefix, "share", _PACKAGE)
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix, "share", _PACKAGE)


def shared_file(name: str) -> Path:
    """A file of the package by its path below the package's share folder, such as `msg_docs/estimator.md`.

    Raises:
        CalibrationError: it is not installed.
    """
    for share in _shares():
        if (share / name).is_file():
            return share / name
    raise CalibrationError(f"the package's file {name} is not installed")


def procedure_file(name: str) -> Path:
    """A procedure by its file, or by the name of one that the package brings.

    Raises:
        CalibrationError: there is no such file; the message names those that there are.
    """
    path = Path(name)
    if path.is_file() or path.suffix or path.parent != Path():
        return path
    with suppress(CalibrationError):
        return shared_file(f"config/procedures/{name}.yaml")
    known = ", ".join(procedure_names())
    raise CalibrationError(f"{name}: no such file, and no procedure of that name; known are {known}")


def procedure_names() -> list[str]:
    """Names of the procedures that the package brings."""
    return sorted({file.stem for share in _shares() for file in (share / "config" / "procedures").glob("*.yaml")})


_WIDTH = 100
_SECTION = "## Parameters of `{}`"


@dataclass(frozen=True)
class TopicRow:
    """A line of the table of topics.

    Attributes:
        name: relative, or absolute.
        type: of its messages.
        publishers: nodes, and in words what else publishes it.
        subscribers: likewise.
        content: in words; may be empty.
    """

    name: str
    type: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    content: str


def topics() -> list[TopicRow]:
    """The table of topics of msg_docs."""
    found = []
    for name, kind, way, *_ in _rows(_page("README"), "## Topics"):
        ends, _, content = way.partition(": ")
        publishers, _, subscribers = ends.partition(" → ")
        found.append(TopicRow(name, kind, tuple(publishers.split(", ")), tuple(subscribers.split(", ")), content))
    return found


def usage(node: str, about: str) -> str:
    """The help of a node's executable.

    Args:
        node: name of the executable.
        about: what it is.

    Raises:
        CalibrationError: msg_docs is not installed.
    """
    known = topics()
    own = next(page for page in _PAGES if _SECTION.format(node) in _page(page))
    services = [
        (names, what.partition(": ")[2])
        for names, what, *_ in _rows(_page("README"), "## Services")
        if node in what.partition(": ")[0].split(", ")
    ]
    parts = [
        f"Usage: ros2 run machine_tool_calibration {node} [--ros-args [-p PARAMETER:=VALUE] [-r NAME:=NAME] …]\n"
        f"       mtcal-{node.replace('_', '-')} [--ros-args …]",
        about.strip(),
        _listed(
            "Parameters",
            [
                _parameter(row)
                for row in (*_rows(_page(own), _SECTION.format(node)), *_rows(_page("README"), "## Parameters"))
            ],
        ),
        _listed("Publishes", [(f"{t.name} ({t.type})", t.content) for t in known if node in t.publishers]),
        _listed("Listens to", [(f"{t.name} ({t.type})", t.content) for t in known if node in t.subscribers]),
        _listed("Services", services),
        f"More in {shared_file(f'msg_docs/{own}.md')}",
    ]
    return "\n\n".join(part for part in parts if part)


_PAGES = ("axes", "pointer", "instrument", "probe", "procedure", "estimator", "recorder", "player")


def _page(name: str) -> str:
    return shared_file(f"msg_docs/{name}.md").read_text(encoding="utf-8")


def _rows(page: str, heading: str) -> Iterator[list[str]]:
    """Lines of the table in a section, without its head, as plain text."""
    section = page.split(f"\n{heading}\n", 1)[1].split("\n## ", 1)[0]
    for line in re.findall(r"^\|(.*)\|$", section, re.M)[2:]:
        cells = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", line).replace("`", "")
        yield [cell.strip() for cell in cells.split("|")]


def _parameter(row: list[str]) -> tuple[str, str]:
    name, default, *unit, meaning = row
    notes = [f" = {default}" if default else "", *(f" [{one.strip(', ')}]" for one in unit if one)]
    return name + "".join(notes), meaning


def _listed(title: str, entries: list[tuple[str, str]]) -> str:
    if not entries:
        return ""
    lines = [title]
    for name, text in entries:
        lines.append(f"  {name}")
        lines += textwrap.wrap(text, _WIDTH, initial_indent="      ", subsequent_indent="      ")
    return "\n".join(lines)
