# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read MCAP files chunk by chunk, so that damage affects only the chunks that it hit.

A chunk with a wrong checksum is skipped. A truncated file is read up to the cut. Messages of a
chunk are in order of their reception. The index gives the number of messages; without an index, the
messages are counted once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.metadata import parse_qos

from mixtac_core.recordings.recording import DamagedRecordingError, reason

_FORMATS = {
    'ros2msg': MessageDefinitionFormat.MSG,
    'ros2idl': MessageDefinitionFormat.IDL,
}
_NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, '')


class McapFile:
    """An MCAP file, with the attributes and methods of a reader of rosbags.

    Args:
        path: The file.

    Attributes:
        connections: Its topics, with their numbers of messages.
        message_count: Number of messages.
        start_time: When the first one was received [ns, host clock of the recorder].
        end_time: When the last one was received, and 1 ns.
        notes: What is missing, by place; grows while messages are read.

    Raises:
        DamagedRecordingError: Nothing can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._counts: Counter[int] = Counter()
        self.start_time = self.end_time = 0
        if not self._read_index():
            self._count()
        self.message_count = sum(self._counts[number] for number in self._channels)
        self.connections = [self._connection(each) for each in self._channels.values()]

    def close(self) -> None:
        """Do nothing: the file is open only while it is read."""

    def messages(
        self, connections: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield topic, time received [ns] and CDR of the messages of some topics."""
        wanted = {each.id: each for each in connections}
        for record in self._records():
            if isinstance(record, Message) and record.channel_id in wanted:
                yield wanted[record.channel_id], record.log_time, record.data

    def _read_index(self) -> bool:
        """Read the index at the end of the file; return whether there is one."""
        try:
            with self.path.open('rb') as file:
                summary = SeekingReader(file).get_summary()
        except Exception:  # noqa: BLE001  (the parser raises whatever damage leads it to)
            return False
        if summary is None or summary.statistics is None:
            return False
        self._channels, self._schemas = dict(summary.channels), dict(summary.schemas)
        self._counts.update(summary.statistics.channel_message_counts)
        if summary.statistics.message_count:
            self.start_time = summary.statistics.message_start_time
            self.end_time = summary.statistics.message_end_time + 1
        return True

    def _count(self) -> None:
        """Read the whole file for what its index would say.

        Raises:
            DamagedRecordingError: Nothing can be read.
        """
        times = []
        for record in self._records():
            if isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self._channels.setdefault(record.id, record)
            elif isinstance(record, Message):
                self._counts[record.channel_id] += 1
                times.append(record.log_time)
        orphans = sum(self._counts[number] for number in self._counts.keys() - self._channels)
        if orphans:
            self.notes[-1] = f'{orphans} messages of {self.path.name} belong to no topic'
        if not self._channels:
            why = '; '.join(self.notes.values()) or 'it holds no topics'
            raise DamagedRecordingError(why)
        self.notes.setdefault(0, f'{self.path.name} was not closed')
        self.start_time, self.end_time = min(times, default=0), max(times, default=-1) + 1

    def _records(self) -> Iterator[Any]:
        """Yield schemas, channels and messages; note what is damaged."""
        name, size = self.path.name, self.path.stat().st_size
        with self.path.open('rb') as file:
            records = StreamReader(file, emit_chunks=True, record_size_limit=size).records
            while True:
                at = file.tell()
                try:
                    record = next(records)
                except StopIteration:
                    return
                except Exception as error:  # noqa: BLE001  (as above)
                    self.notes[at] = f'{name} ends or is damaged at byte {at} ({reason(error)})'
                    return
                if isinstance(record, DataEnd):
                    return
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except Exception as error:  # noqa: BLE001  (as above)
                    self.notes[at] = f'{name} lacks a chunk at byte {at} ({reason(error)})'
                else:
                    # Schemas and channels first, which have no time.
                    yield from sorted(inside, key=lambda each: getattr(each, 'log_time', -1))

    def _connection(self, channel: Channel) -> Connection:
        schema = self._schemas.get(channel.schema_id)
        form = _FORMATS.get(schema.encoding) if schema else None
        definition = _NO_DEFINITION
        if schema and form:
            definition = MessageDefinition(form, schema.data.decode(errors='replace'))
        try:
            profiles = parse_qos(channel.metadata.get('offered_qos_profiles', ''))
        except Exception:  # noqa: BLE001  (as above)
            profiles = []
        return Connection(
            channel.id,
            channel.topic,
            schema.name if schema else '',
            definition,
            channel.metadata.get('topic_type_hash', ''),
            self._counts[channel.id],
            ConnectionExtRosbag2(channel.message_encoding, profiles),
            self,
        )
