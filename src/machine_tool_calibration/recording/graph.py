# SPDX-License-Identifier: Apache-2.0
"""The topics of a measurement's graph: which there are, and how they are found in a bag, whatever the namespace."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import yaml

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording.metadata import Qos, Topic

MACHINE = "machine"
"""The frame of commands, readings and maps: its axes are the machine's, its origin is their zero."""


@dataclass(frozen=True)
class GraphTopic:
    """A topic of the graph by its relative name; latched ones reach subscribers that come late."""

    name: str
    type: str
    latched: bool = False
    depth: int = 1


_TABLE = resources.files("machine_tool_calibration.recording") / "graph.yaml"
GRAPH_TOPICS = tuple(
    GraphTopic(name, **entry) for name, entry in yaml.safe_load(_TABLE.read_text(encoding="utf-8")).items()
)
"""Subscribed from the start, so that a node that comes later loses nothing."""

_GROUPS = {topic.name.partition("/")[0] for topic in GRAPH_TOPICS if "/" in topic.name}


def belongs_to_graph(name: str, namespace: str) -> bool:
    """Whether a topic, by its absolute name, is one of the graph's in that namespace beyond `GRAPH_TOPICS`."""
    prefix = namespace.rstrip("/") + "/"
    return name.startswith(prefix) and name.removeprefix(prefix).split("/")[0] in _GROUPS


def with_depth(name: str, message_type: str, offered: Qos) -> Qos:
    """What a publisher offers, with the depth that its topic has in the graph where discovery does not tell it (0).

    A replay that does not know that `reading` keeps all its messages would latch the last one only.
    """
    if offered.depth:
        return offered
    for topic in GRAPH_TOPICS:
        if topic.type == message_type and f"/{name}".endswith(f"/{topic.name}"):
            return replace(offered, history="keep_last", depth=topic.depth)
    return offered


def request_for(offered: Iterable[Qos]) -> Qos:
    """What a recorder asks for, so that every publisher matches and latched messages come too."""
    profiles = list(offered)
    reliable = bool(profiles) and all(profile.reliability == "reliable" for profile in profiles)
    latched = bool(profiles) and all(profile.latched for profile in profiles)
    return Qos(
        depth=1000,
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


SESSION, READING, LABELS = "session", "reading", "reading_labels"
_TYPES = {topic.name: topic.type for topic in GRAPH_TOPICS if topic.name in (SESSION, READING)}


def find_topics(path: Path, topics: Mapping[str, Topic], names: Mapping[str, str] | None = None) -> dict[str, str]:
    """The bag's `session` and `reading`, or `names` by role; a RecordingError: one is missing, or it is not clear."""
    names = dict(names or {})
    if unknown := [role for role in names if role not in _TYPES]:
        raise RecordingError(f"{path}: unknown role {unknown[0]!r} of a topic; the roles are {', '.join(_TYPES)}")
    candidates = {role: _candidates(path, role, topics, names.get(role)) for role in _TYPES}
    for role, found in candidates.items():
        if not found:
            raise RecordingError(
                f"{path}: no topic {role!r} of type {_TYPES[role]} with messages; it holds {_listed(topics)}"
            )
    if len(candidates[READING]) > 1 or len(candidates[SESSION]) > 1:
        spaces = {name.rsplit("/", 1)[0]: name for name in candidates[SESSION]}
        readings = ((name.rsplit("/", 1)[0], name) for name in candidates[READING])
        pairs = [(spaces[space], name) for space, name in readings if space in spaces]
        if len(pairs) != 1:
            role = READING if len(candidates[READING]) > 1 else SESSION
            several = sorted(candidates[role])
            raise RecordingError(
                f"{path}: several measurements: {', '.join(several)}; say which, as in {role}={several[0]}"
            )
        return {SESSION: pairs[0][0], READING: pairs[0][1]}
    return {role: found[0] for role, found in candidates.items()}


def _candidates(path: Path, role: str, topics: Mapping[str, Topic], name: str | None) -> list[str]:
    if name is not None:
        name = name if name.startswith("/") else f"/{name}"
        if name not in topics:
            raise RecordingError(f"{path}: no topic {name!r}; it holds {_listed(topics)}")
        if topics[name].type != _TYPES[role]:
            raise RecordingError(f"{path}: {name} has the type {topics[name].type}, not {_TYPES[role]}")
        return [name]
    return [
        topic.name
        for topic in topics.values()
        if topic.type == _TYPES[role] and topic.name.rsplit("/", 1)[-1] == role and topic.messages
    ]


def _listed(topics: Mapping[str, Topic]) -> str:
    names = sorted(topics)
    return ", ".join(names[:10]) + (f" … ({len(names)} in all)" if len(names) > 10 else "") if names else "no topics"
