# SPDX-License-Identifier: Apache-2.0
"""What msg_docs says of the topics, and messages made from its examples."""

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from rosidl_parser.definition import AbstractNestedType, BasicType, NamespacedType

FOLDER = Path(__file__).parents[2] / "msg_docs"
PAGES = {page.stem: page.read_text() for page in FOLDER.glob("*.md")}

_ROW = re.compile(
    r"^\| `([\w/]+)` \| (\w+)/(\w+) \| ([^|]+) → ([^|:]+)[^|]* \| ([^|]+) \| \[\w+\]\((\w+)\.md\) \|$", re.M
)
_TOPIC = re.compile(r"^## ((?:`[\w/]+` ?)+) ?\((\w+)/(\w+)\)$")


@dataclass(frozen=True)
class Row:
    """A line of the table of topics; publishers and subscribers are nodes, or words."""

    type: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    qos: str
    page: str


@dataclass(frozen=True)
class Section:
    """What a page says of a topic.

    Attributes:
        type: of its messages.
        page: the page.
        facts: publisher, QoS, rate, frame, subscribe.
        names: of the fields or values that are explained.
        examples: blocks of YAML.
    """

    type: str
    page: str
    facts: dict[str, str]
    names: tuple[str, ...]
    examples: tuple[str, ...]


def rows() -> dict[str, Row]:
    """The table of topics in README.md, by name."""
    return {
        name: Row(f"{package}/msg/{kind}", *(tuple(end.strip().split(", ")) for end in ends), qos.strip(), page)
        for name, package, kind, *ends, qos, page in _ROW.findall(PAGES["README"])
    }


def sections() -> dict[str, list[Section]]:
    """Sections on topics, by name of the topic."""
    found: dict[str, list[Section]] = {}
    for page, text in PAGES.items():
        for part in re.split(r"(?m)^(?=## )", text):
            heading = _TOPIC.match(part.split("\n", 1)[0])
            if heading is None or heading[2] == "std_srvs":
                continue
            cells = [
                [cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\|.*\|$", part, re.M)
            ]
            facts = {row[0]: row[1] for row in cells if len(row) == 2 and re.fullmatch(r"[A-Za-z]+", row[0])}
            names = tuple(name for row in cells for name in re.findall(r"`([^`]+)`", row[0]))
            examples = tuple(re.findall(r"^```yaml\n(.*?)^```", part, re.M | re.S))
            made = Section(f"{heading[2]}/msg/{heading[3]}", page, facts, names, examples)
            for name in re.findall(r"`([\w/]+)`", heading[1]):
                found.setdefault(name, []).append(made)
    return found


def anchors(page: str) -> set[str]:
    """Targets of links within a page."""
    headings = re.findall(r"^#+ (.+)$", PAGES[page], re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def message_of(kind: str, example: str) -> Any:
    """The message that an example shows; fails where a field is not there or has another type."""
    return _fill(_class(kind)(), yaml.safe_load(example))


def _class(kind: str) -> Any:
    package, _, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def _fill(message: Any, content: dict[str, Any]) -> Any:
    types = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    for name, value in content.items():
        assert name in types, f"{type(message).__name__} has no field {name}"
        setattr(message, name, _value(types[name], value))
    return message


def _value(kind: Any, value: Any) -> Any:
    if isinstance(kind, AbstractNestedType):
        return [_value(kind.value_type, entry) for entry in value]
    if isinstance(kind, NamespacedType):
        return _fill(_class(f"{kind.namespaces[0]}/msg/{kind.name}")(), value)
    if isinstance(kind, BasicType) and kind.typename == "octet":
        return bytes([value])
    return value
