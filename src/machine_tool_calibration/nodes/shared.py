# SPDX-License-Identifier: Apache-2.0
"""Files that the package brings, wherever it was installed, and the help of executables, which is made of them."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError

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
    """A file by its path below the package's share folder, as `msg_docs/probe.md`; a CalibrationError: missing."""
    for share in _shares():
        if (share / name).is_file():
            return share / name
    raise CalibrationError(f"the package's file {name} is not installed")


def procedure_file(name: str) -> Path:
    """A procedure by its file, or the name of one that the package brings; a CalibrationError names these."""
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


def usage(node: str, about: str) -> str:
    """A node's help: what it is, and its parameters as in msg_docs; a CalibrationError if these are missing."""
    common = shared_file("msg_docs/README.md")
    heading = f"\n## Parameters of `{node}`\n"
    page = next(page for page in common.parent.glob("*.md") if heading in page.read_text(encoding="utf-8"))
    rows = "\n".join([*_rows(page, heading), *_rows(common, "\n## Parameters\n")[2:]])
    return (
        f"Usage: ros2 run machine_tool_calibration {node} [--ros-args [-p PARAMETER:=VALUE] [-r NAME:=NAME] …]\n"
        f"       mtcal-{node.replace('_', '-')} [--ros-args …]\n\n"
        f"{about.strip()}\n\nParameters\n{rows}\n\nTopics and services: {page}"
    )


def _rows(page: Path, heading: str) -> list[str]:
    section = page.read_text(encoding="utf-8").split(heading, 1)[1].split("\n## ", 1)[0]
    return [line for line in section.splitlines() if line.startswith("|")]
