# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""rosbag2 recordings (folder, .mcap or .db3), opened for reading message by message."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosbags.rosbag2 import Reader

from mixtac_driver.errors import DamagedRecordingError, RecordingError
from mixtac_driver.recordings.bag_types import typestore

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from pathlib import Path

SUFFIXES = ('.mcap', '.db3')


class BagFile:
    """A bag, open for reading.

    Args:
        path: Folder or file.

    Attributes:
        duration_ns: From the first to the last message [ns, host clock of the recorder].
        start_ns: When the first message was received [ns, host clock of the recorder].

    Raises:
        RecordingError: It is none, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._types = typestore()
        if path.is_dir() and not (path / 'metadata.yaml').exists():
            raise RecordingError(
                f'{path} holds no metadata.yaml: give the folder of a bag, name the .mcap or .db3 '
                'file in it, or run `ros2 bag reindex` on it'
            )
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # the format's parsers raise whatever damage leads them to
            raise self._damaged(error) from error
        self.duration_ns = self._reader.duration
        self.start_ns = self._reader.start_time

    def close(self) -> None:
        """Give the files back."""
        if self._reader.is_open:
            self._reader.close()

    def topics(self, kind: str) -> list[str]:
        """Return the topics of a message type that hold any messages."""
        found = {c.topic for c in self._reader.connections if c.msgtype == kind and c.msgcount}
        return sorted(found)

    def messages(
        self, topics: Sequence[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Generator[tuple[str, int, Any], None, None]:
        """Yield (topic, time received [ns], message) in the order recorded.

        Args:
            topics: Topics to read.
            start_ns: Begin with what was received at this time; None for the first.
            stop_ns: End before what was received at this time; None for the last.

        Raises:
            DamagedRecordingError: As said.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        messages = self._reader.messages(chosen, start_ns, stop_ns)
        while True:
            try:
                connection, received_ns, data = next(messages)
                message = self._types.deserialize_cdr(data, connection.msgtype)
            except StopIteration:
                return
            except Exception as error:  # as above
                raise self._damaged(error) from error
            yield connection.topic, received_ns, message

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        text = ' '.join(str(error).split()) or type(error).__name__
        return DamagedRecordingError(
            f'{self._path} is not a whole bag ({text}): it was cut off while recording or copying; '
            'record it again, or repair it with `ros2 bag reindex`'
        )
