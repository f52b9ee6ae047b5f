"""What a model's unknowns are, in words: of a setup, of a table of error motions, of an effect."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

__all__ = ["POINTS", "in_map", "unknown_in_words", "unknowns_in_words"]

POINTS = "the points' own unknowns"
"""How the free points of a map are named where an effect is absorbed by them."""

_MOTION = re.compile(r"(angle\.)?(E[XYZABC][XYZABC]|[ABC]0[XYZ])(\(.*\))?")
# Endings of names, and what such an unknown is; {} stands for the setup, station or target.
_ENDINGS = (
    (re.compile(r"offset_\d+"), "zero of each run of {}"),
    (re.compile(r"offset"), "offset of {}"),
    (re.compile(r"tilt_[12]"), "tilt of the mirror in {}"),
    (re.compile(r"(shift|turn)_[xyzabc]"), "how {} lies on the machine"),
    (re.compile(r"(\d+\.)?dead_path"), "distance at which {} reads zero"),
    (re.compile(r"[xyz]"), "place of {}"),
)


def unknown_in_words(name: str, effects: Collection[str] = ()) -> str:
    """What one unknown is; its name where nothing is known of it.

    Args:
        name: under which it is published, such as `Z.offset_1`, `npp.tilt_2`, `A.x`, `EXX(0.08)`.
        effects: ids of effects in the model.
    """
    kind, what = _kind(name, effects)
    repeat = re.fullmatch(r".+\.offset_(\d+)", name)
    return kind.format(what) if repeat is None else f"zero of {what}, repeat {repeat[1]}"


def unknowns_in_words(names: Iterable[str], effects: Collection[str] = ()) -> str:
    """What several unknowns are; those of the same kind are told together."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        kind, what = _kind(name, effects)
        if what not in kinds.setdefault(kind, []):
            kinds[kind].append(what)
    parts = [kind.format(_list(sorted(what)) if "{}" in kind else "") for kind, what in kinds.items()]
    return _list(parts)


def in_map(name: str) -> bool:
    """Whether an unknown is part of what the map of errors says: a motion, a squareness, the points themselves."""
    return name == POINTS or _MOTION.fullmatch(name) is not None


def _kind(name: str, effects: Collection[str]) -> tuple[str, str]:
    """A text with a place for what it is of, and that."""
    if name == POINTS:
        return "the points of the map, each with an error of its own", ""
    if _MOTION.fullmatch(name):
        bare = name.removeprefix("angle.").split("(")[0]
        return ("squareness {}", bare) if bare[1] == "0" else ("error motion {}", bare)
    owner = name.partition(".")[0]
    if owner in effects:
        return "effect {}", owner
    session, _, own = owner.rpartition("/")
    if session and own in effects:
        return "effect {}", f"{own} in session {session}"
    for pattern, text in _ENDINGS:
        # A setup or a target may have a dot in its id: the ending is what follows it.
        match = re.fullmatch(rf"(?P<owner>.+?)\.(?:{pattern.pattern})", name)
        if match is not None:
            return text, match["owner"]
    return "{}", name


def _list(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""
