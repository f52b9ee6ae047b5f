"""Quality of service as rosbag2 writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

__all__ = ["LATCHED", "RELIABLE", "Qos", "parse_qos", "qos_records", "qos_text"]

FOREVER = 9_223_372_036_854_775_807  # ns


@dataclass(frozen=True)
class Qos:
    """One publisher's offered quality of service, with rmw's names of the policies.

    Attributes:
        history: keep_last, keep_all, system_default or unknown (what discovery tells).
        depth: of keep_last.
        reliability: reliable or best_effort.
        durability: volatile or transient_local.
        deadline: ns.
        lifespan: ns.
        liveliness: automatic or manual_by_topic.
        lease: lease duration of the liveliness, ns.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: int = FOREVER
    lifespan: int = FOREVER
    liveliness: str = "automatic"
    lease: int = FOREVER

    @property
    def latched(self) -> bool:
        """Whether late subscribers get what was published before."""
        return self.durability == "transient_local"

    def record(self) -> dict[str, Any]:
        """The keys of rosbag2's version 9, in its order."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _time(self.deadline),
            "lifespan": _time(self.lifespan),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _time(self.lease),
            "avoid_ros_namespace_conventions": False,
        }


RELIABLE = Qos()
LATCHED = Qos(depth=1, durability="transient_local")


def _time(nanoseconds: int) -> dict[str, int]:
    sec, nsec = divmod(max(0, nanoseconds), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def qos_records(profiles: Sequence[Qos]) -> list[dict[str, Any]]:
    """The list that stands in `metadata.yaml`."""
    return [profile.record() for profile in profiles]


def qos_text(profiles: Sequence[Qos]) -> str:
    """The YAML text that stands in a channel's metadata."""
    return yaml.safe_dump(qos_records(profiles), sort_keys=False, default_flow_style=False).rstrip("\n")


_CODES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "", "manual_by_topic", "unknown"),
}


def parse_qos(value: Any) -> tuple[Qos, ...]:
    """Profiles from what a bag says; what cannot be understood is left at its default.

    Args:
        value: the list of mappings (numbers before version 9 of rosbag2, names since).
    """
    if not isinstance(value, Sequence) or isinstance(value, str):
        return ()
    return tuple(_profile(entry) for entry in value[:1000] if isinstance(entry, Mapping))


def _profile(entry: Mapping[str, Any]) -> Qos:
    depth = entry.get("depth")
    return Qos(
        history=_policy("history", entry, "keep_last"),
        depth=depth if isinstance(depth, int) and depth >= 0 else 10,
        reliability=_policy("reliability", entry, "reliable"),
        durability=_policy("durability", entry, "volatile"),
        liveliness=_policy("liveliness", entry, "automatic"),
    )


def _policy(name: str, entry: Mapping[str, Any], default: str) -> str:
    value, names = entry.get(name), _CODES[name]
    if isinstance(value, bool):
        return default
    if isinstance(value, int):
        return names[value] if 0 <= value < len(names) else default
    return value if isinstance(value, str) and value in names else default
