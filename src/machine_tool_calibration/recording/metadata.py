"""`metadata.yaml` of a rosbag2 folder, version 9."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from machine_tool_calibration.recording.qos import Qos, qos_records

__all__ = ["FileSummary", "TopicSummary", "bag_information", "bag_information_text", "metadata_text"]

VERSION = 9
NEVER = 9_223_372_036_854_775_807  # ns: start of a recording without messages, as rosbag2 has it


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a bag and how many messages it has."""

    name: str
    type: str
    type_hash: str
    qos: tuple[Qos, ...]
    messages: int
    encoding: str = "cdr"


@dataclass
class FileSummary:
    """What one file of a bag holds; times in ns, `first` is `NEVER` without messages."""

    path: str
    first: int = NEVER
    last: int = 0
    messages: int = 0
    by_topic: dict[str, int] = field(default_factory=dict)

    @property
    def duration(self) -> int:
        """From the first to the last message, ns."""
        return max(0, self.last - self.first) if self.messages else 0


def bag_information(
    files: Sequence[FileSummary], topics: Sequence[TopicSummary], distro: str, custom: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Content of `rosbag2_bagfile_information`."""
    first = min((entry.first for entry in files), default=NEVER)
    last = max((entry.last for entry in files if entry.messages), default=first)
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
                    "offered_qos_profiles": qos_records(topic.qos),
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
                "duration": {"nanoseconds": entry.duration},
                "message_count": entry.messages,
            }
            for entry in files
        ],
        "custom_data": dict(custom) if custom else None,
        "ros_distro": distro,
    }


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def bag_information_text(information: Mapping[str, Any]) -> str:
    """YAML text of the information, as it stands in a file's `rosbag2` record."""
    return yaml.dump(dict(information), Dumper=_Dumper, sort_keys=False, default_flow_style=False, width=10_000)


def metadata_text(information: Mapping[str, Any]) -> str:
    """Content of `metadata.yaml`."""
    return bag_information_text({"rosbag2_bagfile_information": dict(information)})
