# SPDX-License-Identifier: Apache-2.0
"""`metadata.yaml` of a rosbag2 folder, version 9, with quality of service as rosbag2 writes it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import yaml

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.text import PlainDumper, load_yaml

_MOST_QOS = 1 << 17  # characters: hundreds of publishers
FOREVER = 9_223_372_036_854_775_807  # ns; also the start of a recording without messages, as rosbag2 has it


@dataclass(frozen=True)
class Qos:
    """One publisher's offered quality of service, with rmw's names of the policies."""

    history: str = "keep_last"  # keep_last, keep_all, system_default or unknown (what discovery tells)
    depth: int = 10  # of keep_last
    reliability: str = "reliable"  # reliable or best_effort
    durability: str = "volatile"  # volatile or transient_local
    deadline: int = FOREVER  # ns
    lifespan: int = FOREVER  # ns
    liveliness: str = "automatic"  # automatic or manual_by_topic
    lease: int = FOREVER  # lease duration of the liveliness, ns

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


LATCHED = Qos(depth=1, durability="transient_local")


def _time(nanoseconds: int) -> dict[str, int]:
    sec, nsec = divmod(max(0, nanoseconds), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def qos_text(profiles: Sequence[Qos]) -> str:
    """The YAML text that stands in a channel's metadata."""
    records = [profile.record() for profile in profiles]
    return yaml.safe_dump(records, sort_keys=False, default_flow_style=False).rstrip("\n")


_CODES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "", "manual_by_topic", "unknown"),
}


@lru_cache(maxsize=64)
def offered_qos(text: str) -> tuple[Qos, ...]:
    """What a channel's `offered_qos_profiles` say; none where they cannot be understood.

    It is only for people, and for late subscribers when the bag is played: a bag is readable without it.
    """
    try:
        entries = load_yaml(text, "offered_qos_profiles").value if len(text) < _MOST_QOS else ()
    except SessionError:
        entries = ()
    return tuple(_profile(entry) for entry in entries if isinstance(entry, dict)) if isinstance(entries, list) else ()


def _profile(entry: Mapping[str, Any]) -> Qos:
    """One profile; what cannot be understood is left at its default."""
    told: dict[str, Any] = {}
    for name, names in _CODES.items():
        value = entry.get(name)  # a number before version 9 of rosbag2, a name since
        if isinstance(value, int) and 0 <= value < len(names):
            value = names[value]
        if isinstance(value, str) and value in names:
            told[name] = value
    if isinstance(depth := entry.get("depth"), int) and depth >= 0:
        told["depth"] = depth
    return Qos(**told)


VERSION = 9
_DISTRO = "jazzy"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str  # absolute name
    type: str  # such as `sensor_msgs/msg/JointState`; empty if the bag does not say
    type_hash: str  # `RIHS01_…`; empty if the bag does not say
    qos: tuple[Qos, ...]  # what the publishers offered
    messages: int  # how many there are
    encoding: str = "cdr"  # of its messages


@dataclass
class FileSummary:
    """What one file of a bag holds; times in ns, `first` is `FOREVER` without messages."""

    path: str
    first: int = FOREVER
    last: int = 0
    messages: int = 0
    by_topic: dict[str, int] = field(default_factory=dict)


def bag_information(files: Sequence[FileSummary], topics: Sequence[Topic]) -> dict[str, Any]:
    """Content of `rosbag2_bagfile_information`."""
    first = min((entry.first for entry in files), default=FOREVER)
    last = max((entry.last for entry in files), default=0)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max(0, last - first)},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": sum(entry.messages for entry in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": [profile.record() for profile in topic.qos],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.messages,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [entry.path for entry in files],
        "files": [
            {
                "path": entry.path,
                "starting_time": {"nanoseconds_since_epoch": entry.first},
                "duration": {"nanoseconds": max(0, entry.last - entry.first)},
                "message_count": entry.messages,
            }
            for entry in files
        ],
        "custom_data": None,
        "ros_distro": _DISTRO,
    }


def bag_information_text(information: Mapping[str, Any]) -> str:
    """YAML text of the information, as it stands in a file's `rosbag2` record and in `metadata.yaml`."""
    return yaml.dump(dict(information), Dumper=PlainDumper, sort_keys=False, default_flow_style=False, width=10_000)
