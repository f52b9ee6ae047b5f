"""Message definitions and type hashes, as a bag carries them.

Standard types come from the `rosbags` library's tables of ROS 2 Jazzy, so that bags can be written where no ROS is
installed; other types from the `.msg` files of the ROS packages that are installed.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

__all__ = ["Definition", "definition_of", "typestore"]

_SEPARATOR = "=" * 80 + "\n"
_FIELD = re.compile(r"^([A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_/]*)?)(?:<=\d+)?(?:\[[^\]]*\])?\s+[a-z]")
_INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_PRIMITIVES = frozenset(["bool", "byte", "char", "string", "wstring", "float32", "float64", *_INTEGERS])


@dataclass(frozen=True)
class Definition:
    """How a message type is described in a bag.

    Attributes:
        text: definition with those of its parts, in `ros2msg` form; empty if it is not known.
        type_hash: `RIHS01_…`; empty if it is not known.
    """

    text: str = ""
    type_hash: str = ""


@cache
def typestore() -> Typestore:
    """The standard types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def definition_of(name: str) -> Definition:
    """Definition and hash of a type such as `sensor_msgs/msg/JointState`; empty where it cannot be found."""
    store = typestore()
    if name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=2)
        return Definition(text, store.hash_rihs01(name))
    return Definition(_installed(name), "")


def _installed(name: str) -> str:
    """The definition from installed `.msg` files, with those of its parts."""
    texts: dict[str, str] = {}
    waiting = [name]
    while waiting:
        current = waiting.pop(0)
        if current in texts:
            continue
        text = _msg_file(current)
        if text is None:
            return ""
        texts[current] = text
        package = current.split("/")[0]
        for line in text.splitlines():
            match = _FIELD.match(line.strip())
            if match and match.group(1) not in _PRIMITIVES:
                part = match.group(1)
                parts = part.split("/") if "/" in part else [package, part]
                waiting.append(f"{parts[0]}/msg/{parts[-1]}")
    first, *rest = texts
    return texts[first] + "".join(f"{_SEPARATOR}MSG: {part.replace('/msg/', '/')}\n{texts[part]}" for part in rest)


def _msg_file(name: str) -> str | None:
    parts = name.split("/")
    if len(parts) != 3 or not all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", part) for part in parts):
        return None
    for prefix in [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]:
        path = Path(prefix) / "share" / parts[0] / parts[1] / f"{parts[2]}.msg"
        if prefix and path.is_file():
            return path.read_text(encoding="utf-8").rstrip("\n") + "\n"
    return None
