# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading a Mixtac recording, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.rosbag2 import Reader

from mixtac_bringup.bag_types import typestore
from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

_NS = 1_000_000_000


class BagFile:
    """One rosbag2 recording (MCAP or sqlite3), opened for reading.

    Args:
        path: Folder of the bag.

    Attributes:
        duration_s: From the first to the last message [s].
        counts: Messages by topic.
        types: Type name by topic.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise BagError(f'no bag at {path}: give the folder that holds metadata.yaml')
        self._types = typestore()
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # the format's parsers raise whatever damage leads them to
            raise self._damaged(error) from error
        self.duration_s = self._reader.duration / 1e9
        self.counts = {c.topic: c.msgcount for c in self._reader.connections}
        self.types = {c.topic: c.msgtype for c in self._reader.connections}

    def __enter__(self) -> BagFile:
        """Return the open bag."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self._reader.close()

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (host time received [ns], message) of a topic in recording order.

        Raises:
            BagError: The topic was not recorded, or the data are damaged.
        """
        for _, received_ns, message in self.messages_of(topic):
            yield received_ns, message

    def messages_of(
        self, *topics: str, raw: tuple[str, ...] = ()
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, host time received [ns], message) of several topics in one pass.

        Args:
            topics: Absolute topic names.
            raw: Those of them whose messages stay serialised: ``bytes`` in CDR.

        Raises:
            BagError: A topic was not recorded, or the data are damaged.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        missing = set(topics) - {c.topic for c in chosen}
        if missing:
            raise BagError(
                f'{self._path} has no topic {min(missing)}; it has {", ".join(self.counts)}'
            )
        try:
            for connection, received_ns, data in self._reader.messages(chosen):
                if connection.topic in raw:
                    yield connection.topic, received_ns, data
                    continue
                message = self._types.deserialize_cdr(data, connection.msgtype)
                yield connection.topic, received_ns, message
        except (GeneratorExit, BagError):
            raise
        except Exception as error:  # see above
            raise self._damaged(error) from error

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the stamps [ns, the topic's own clock] and normal forces [N] of a topic."""
        stamps, forces = [], []
        for _, message in self.messages(topic):
            stamps.append(message.header.stamp.sec * _NS + message.header.stamp.nanosec)
            forces.append(message.wrench.force.z)
        return np.array(stamps, np.int64), np.array(forces, np.float64)

    def _damaged(self, error: Exception) -> BagError:
        text = ' '.join(str(error).split()) or type(error).__name__
        return BagError(
            f'{self._path} is not a whole bag ({text}): it was cut off while recording or copying; '
            'record it again, or repair it with `ros2 bag reindex`'
        )
