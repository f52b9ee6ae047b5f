# SPDX-License-Identifier: Apache-2.0
"""A valid bag from what a killed recorder left, or from a damaged file."""

import contextlib
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from machine_tool_calibration.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording import mcap_reader
from machine_tool_calibration.recording.mcap_reader import RawMessage, RawRecord, messages_in, records, topic_of, unpack
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.text import begins_with

_LARGEST_CUT = 64 << 20  # bytes


@dataclass(frozen=True)
class Recovered:
    """What was saved."""

    folder: Path  # the new bag
    files: tuple[Path, ...]  # files that were read
    messages: int  # messages that were saved
    topics: int  # number of topics
    first: int  # time of the first message, ns
    last: int  # time of the last message, ns
    lost_bytes: int  # bytes at the files' ends, and of damaged chunks, that could not be read
    problems: tuple[str, ...]  # one line for each place that was damaged


def recover(path: Path, output: Path, report: Callable[[float], object] = lambda share: None) -> Recovered:
    """Write a new bag with all that is whole in an unfinished or damaged one; the old one is only read.

    The new folder must not exist; `report` is told the share of the bytes that is read. A RecordingError if nothing can
    be saved, or the new bag cannot be written.
    """
    files = _files(path)
    if not any(begins_with(file, MAGIC) for file in files):
        raise RecordingError(f"{path}: nothing can be saved: no file begins as an MCAP file does")
    problems, lost = list[str](), 0
    sizes = [file.stat().st_size for file in files]
    with BagWriter(output) as bag:
        for number, file in enumerate(files):
            before = sum(sizes[:number])

            def read(end: int, before: int = before) -> None:
                report((before + end) / sum(sizes))

            salvage = _Salvage(file, read)
            for channel, schema, message in salvage.messages():
                if not bag.has(channel.topic):
                    form, definition = (schema.encoding, schema.data) if schema else ("", b"")
                    bag.register(topic_of(channel, schema), form, definition)
                bag.write(channel.topic, message.data, message.log_time, message.publish_time, message.sequence)
            read(sizes[number])
            problems += salvage.problems
            lost += salvage.lost
        bag.flush()
        saved, topics = [summary for summary in bag.summaries if summary.messages], len(bag.topics)
    if not saved:
        shutil.rmtree(output)
        reason = f": {problems[0]}" if problems else ""
        raise RecordingError(f"{path}: no message could be saved{reason}")
    return Recovered(
        folder=output,
        files=tuple(files),
        messages=sum(summary.messages for summary in saved),
        topics=topics,
        first=min(summary.first for summary in saved),
        last=max(summary.last for summary in saved),
        lost_bytes=lost,
        problems=tuple(problems),
    )


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder")
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f"{path}: is not a file")
    files = sorted((file for file in path.glob("*.mcap") if file.is_file()), key=_number)
    if not files:
        raise RecordingError(f"{path}: no .mcap file is in this folder")
    return files


def _number(path: Path) -> tuple[int, str]:
    """Files of a split recording in the order of their numbers."""
    match = re.search(r"_(\d{1,9})$", path.stem)
    return (int(match.group(1)) if match else -1, path.name)


class _Salvage:
    """Reads what is whole in one file; a damaged chunk costs itself, a damaged length what has no index behind it."""

    def __init__(self, path: Path, read: Callable[[int], object]) -> None:
        self.path = path
        self._read = read
        self.problems: list[str] = []
        self.lost = 0
        self._known = mcap_reader.Summary(path)

    def messages(self) -> Iterator[tuple[Channel, Schema | None, RawMessage]]:
        if not begins_with(self.path, MAGIC):
            self._problem("does not begin as an MCAP file does", self.path.stat().st_size)
            return
        for entry in self._entries():
            if isinstance(entry, RawRecord):
                self._known.take(entry)
                continue
            if (channel := self._known.channels.get(entry.channel)) is None:
                self._problem(mcap_reader.UNREGISTERED.format(entry.channel), len(entry.data))
                continue
            yield channel, self._known.schemas.get(channel.schema_id), entry

    def _entries(self) -> Iterator[RawMessage | RawRecord]:
        start: int | None = len(MAGIC)
        while start is not None:
            end, start = start, None
            try:
                with self.path.open("rb") as stream:
                    for record in records(self.path, stream, start=end):
                        try:
                            yield from list(messages_in(self.path, record.offset, unpack(self.path, record)))
                        except RecordingError as error:
                            self._problem(_reason(error, self.path), record.length)
                        end = record.offset + 9 + record.length
                        self._read(end)
                        if record.opcode == Opcode.DATA_END:
                            return
            except RecordingError as error:
                start = self._next_chunk(end)
                if start is not None or not isinstance(error, UnfinishedError):
                    self._problem(_reason(error, self.path), (start or self.path.stat().st_size) - end)
                    continue
                saved = 0
                for saved, entry in enumerate(self._cut(end), 1):  # noqa: B007 (the last one counts)
                    yield entry
                self._problem("the end is missing", 0 if saved else self.path.stat().st_size - end)
            except OSError as error:
                self._problem(f"cannot be read: {error.strerror}", 0)

    def _next_chunk(self, after: int) -> int | None:
        """Where the next chunk begins, by the index at the file's end; None where there is none."""
        if (summary := self._summary) is None:
            return None
        self._known = summary  # with the channels of the chunks that are lost
        return min((offset for offset in summary.chunk_channels if offset > after), default=None)

    @cached_property
    def _summary(self) -> mcap_reader.Summary | None:
        """The file's own; None where it has none that is whole."""
        with contextlib.suppress(RecordingError, OSError):
            return mcap_reader.McapReader(self.path).summary
        return None

    def _cut(self, start: int) -> Iterator[RawMessage | RawRecord]:
        """The whole messages in a chunk whose end is missing."""
        with self.path.open("rb") as stream:
            stream.seek(start)
            if stream.read(9)[:1] == bytes([Opcode.CHUNK]):
                content = stream.read(_LARGEST_CUT)
                with contextlib.suppress(RecordingError):  # where the whole ones end
                    whole = unpack(self.path, RawRecord(Opcode.CHUNK, start, len(content), content), cut=True)
                    yield from messages_in(self.path, start, whole)

    def _problem(self, what: str, lost: int) -> None:
        self.lost += lost
        if len(self.problems) < 100:
            self.problems.append(f"{self.path.name}: {what}")


def _reason(error: RecordingError, path: Path) -> str:
    return str(error).removeprefix(f"{path}: ").split(";")[0]
