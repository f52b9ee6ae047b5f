"""The topics of a measurement in a bag: found by type and last name, whatever the namespace."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from machine_tool_calibration.recording.cdr import JOINT_STATE, TEXT
from machine_tool_calibration.recording.errors import RecordingError
from machine_tool_calibration.recording.reader import Topic

__all__ = ["LABELS", "READING", "SESSION", "find_topics"]

SESSION, READING, LABELS = "session", "reading", "reading_labels"
_TYPES = {SESSION: TEXT, READING: JOINT_STATE}


def find_topics(path: Path, topics: Mapping[str, Topic], names: Mapping[str, str] | None = None) -> dict[str, str]:
    """Names in the bag of the topics `session` and `reading`.

    Args:
        path: the bag, for messages.
        topics: what it holds.
        names: topic by role (`session`, `reading`) where the bag uses other names.

    Raises:
        RecordingError: one is missing, or there are several and no name says which.
    """
    names = dict(names or {})
    unknown = [role for role in names if role not in _TYPES]
    if unknown:
        raise RecordingError(f"{path}: unknown role {unknown[0]!r} of a topic; the roles are {', '.join(_TYPES)}")
    candidates = {role: _candidates(path, role, topics, names.get(role)) for role in _TYPES}
    for role, found in candidates.items():
        if not found:
            raise RecordingError(
                f"{path}: no topic {role!r} of type {_TYPES[role]} with messages; it holds {_listed(topics)}"
            )
    if len(candidates[READING]) > 1 or len(candidates[SESSION]) > 1:
        pairs = _pairs(candidates[SESSION], candidates[READING])
        if len(pairs) != 1:
            several = candidates[READING] if len(candidates[READING]) > 1 else candidates[SESSION]
            role = READING if len(candidates[READING]) > 1 else SESSION
            raise RecordingError(
                f"{path}: several measurements: {', '.join(sorted(several))}; say which, as in "
                f"{role}={sorted(several)[0]}"
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


def _pairs(sessions: list[str], readings: list[str]) -> list[tuple[str, str]]:
    """Those that stand in the same namespace."""
    spaces = {name.rsplit("/", 1)[0]: name for name in sessions}
    return [(spaces[name.rsplit("/", 1)[0]], name) for name in readings if name.rsplit("/", 1)[0] in spaces]


def _listed(topics: Mapping[str, Topic]) -> str:
    names = sorted(topics)
    return ", ".join(names[:10]) + (f" … ({len(names)} in all)" if len(names) > 10 else "") if names else "no topics"
