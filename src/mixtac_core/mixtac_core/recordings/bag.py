# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read bags of ROS 2 (folder, .mcap, .db3) and ROS 1 (.bag) and their types, without rclpy.

The intact part of a truncated or damaged MCAP file is read (`mixtac_core.recordings.mcap_file`).
"""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, Nodetype
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mixtac_core.node import topics
from mixtac_core.node.files import FileError, read_data, share
from mixtac_core.node.topics import stamp_to_ns
from mixtac_core.recordings.mcap_file import McapFile
from mixtac_core.recordings.recording import (
    BAG_SUFFIXES,
    ROS1_SUFFIX,
    DamagedRecordingError,
    RecordingError,
    not_a_recording,
    reason,
)

_OWN_TYPES = sorted(
    {
        topic.type_name
        for topic in topics.TOPICS
        if topic.type_name.startswith(('event_camera_msgs/', 'mixtac_msgs/'))
    }
)
"""Message types of this workspace, which rosbags does not know."""


@functools.cache
def typestore() -> Typestore:
    """Return Jazzy's standard types and those of the workspace, from their installed definitions.

    Raises:
        ShareError: The packages that define them are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OWN_TYPES:
        package, _, message = name.split('/')
        text = (share(package) / 'msg' / f'{message}.msg').read_text()
        store.register(get_types_from_msg(text, name))
    return store


def blank_message(type_name: str) -> Any:  # noqa: ANN401
    """Return a message of rosbags with all fields zero or empty, as rclpy's constructors do.

    Args:
        type_name: For example `sensor_msgs/msg/Imu`.
    """
    _, fields = typestore().fielddefs[type_name]
    blank = {name: _blank_value(*description) for name, description in fields}
    return typestore().types[type_name](**blank)


def _blank_value(node: Nodetype, content: Any) -> Any:  # noqa: ANN401
    if node == Nodetype.NAME:
        return blank_message(content)
    if node == Nodetype.BASE:
        kind = content[0]
        return {'string': '', 'bool': False}.get(kind, 0.0 if kind.startswith('float') else 0)
    (element, inner), count = content
    if element == Nodetype.NAME or inner[0] == 'string':
        return [_blank_value(element, inner) for _ in range(count)]
    kind = {'octet': 'uint8', 'byte': 'uint8', 'char': 'uint8'}.get(inner[0], inner[0])
    return np.zeros(count, kind)


class BagFile:
    """A bag, open for reading.

    Args:
        path: Folder, .mcap, .db3 or .bag file.

    Attributes:
        path: As given.
        is_ros1: Whether messages are serialised as ROS 1 does, instead of in CDR.
        start_ns: When the first message was received [ns, host clock of the recorder].
        duration_ns: From the first to the last message [ns].
        counts: Messages by topic.
        types: Type name by topic; with the encoding of the messages where that is not CDR.

    Raises:
        RecordingError: There is no bag.
        DamagedRecordingError: Nothing of it can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_ros1 = path.suffix.lower() == ROS1_SUFFIX and path.is_file()
        if not path.exists():
            raise RecordingError(f'no bag at {path}', remedy='give its folder, .mcap or .db3 file')
        self._types = typestore()
        self._readers: list[Any] = []
        self._held = contextlib.ExitStack()
        self._missing = ''
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        filled = [each for each in self._readers if each.message_count]
        self.start_ns = min((each.start_time for each in filled), default=0)
        self.duration_ns = max((each.end_time for each in filled), default=0) - self.start_ns
        self.counts: dict[str, int] = {}
        self.types: dict[str, str] = {}
        for connection in self.connections:
            topic = connection.topic
            self.counts[topic] = self.counts.get(topic, 0) + connection.msgcount
            form = getattr(connection.ext, 'serialization_format', 'cdr')
            kind = connection.msgtype
            self.types[topic] = kind if form == 'cdr' else f'{kind} in {form}'.strip()

    def __enter__(self) -> BagFile:
        """Return the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        for reader in self._readers:
            reader.close()
        self._readers = []
        self._held.close()

    @property
    def damage(self) -> str:
        """What is missing because the bag is incomplete, as far as it has been read; else empty."""
        scans = [each for each in self._readers if isinstance(each, McapFile)]
        notes = [note for scan in scans for _, note in sorted(scan.notes.items())]
        text = '; '.join(filter(None, (self._missing, *notes)))
        return f'the bag is incomplete: {text}' if text else ''

    @property
    def connections(self) -> list[Connection]:
        """Return the connections of all files of the bag, with type and QoS of each topic."""
        return [connection for reader in self._readers for connection in reader.connections]

    def topics(self, *type_names: str) -> list[str]:
        """Return the topics of some message types that hold any messages, sorted."""
        return sorted(t for t, kind in self.types.items() if kind in type_names and self.counts[t])

    def messages(
        self,
        *wanted: str,
        raw: Collection[str] = (),
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time received [ns, host clock], message) in recording order.

        Args:
            wanted: Absolute topic names.
            raw: Topics among `wanted` whose messages stay serialised: `bytes`, see `is_ros1`.

        Raises:
            RecordingError: A topic was not recorded.
            DamagedRecordingError: The data are damaged.
        """
        missing = set(wanted) - set(self.types)
        if missing:
            listed = ', '.join(self.types) or 'no topics'
            raise RecordingError(f'{self.path} has no topic {min(missing)}; it has {listed}')
        for reader in self._readers:
            chosen = [each for each in reader.connections if each.topic in wanted]
            messages = reader.messages(chosen) if chosen else iter(())
            while True:
                try:
                    connection, received_ns, data = next(messages)
                    message = (
                        data if connection.topic in raw else self._deserialised(connection, data)
                    )
                except StopIteration:
                    break
                except Exception as error:  # the parsers raise whatever damage leads them to
                    raise self._damaged(error) from error
                yield connection.topic, received_ns, message

    def _deserialised(self, connection: Connection, data: bytes) -> Any:  # noqa: ANN401
        if self.is_ros1:
            return self._readers[0].deserialize(data, connection.msgtype)
        return self._types.deserialize_cdr(data, connection.msgtype)

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the stamps [n] [ns, the topic's own clock] and forces x, y, z [n, 3] [N]."""
        stamps, forces = [], []
        for _, _, message in self.messages(topic):
            stamps.append(stamp_to_ns(message.header.stamp))
            forces.append((*topics.sideways_force(message), topics.normal_force(message)))
        return np.array(stamps, np.int64), np.array(forces, np.float64).reshape(-1, 3)

    def _open(self) -> None:
        """Open the files of the bag, in the order of their first messages."""
        folder = self.path if self.path.is_dir() else None
        files = sorted(filter(is_storage, folder.iterdir())) if folder else [self.path]
        facts = _facts(folder) if folder else {}
        if not files or not (self.is_ros1 or is_storage(files[0])):
            raise not_a_recording(self.path)
        named = [Path(str(each)).name for each in facts.get('relative_file_paths') or []]
        lost = sorted(set(named) - {each.name for each in files})
        self._missing = f'missing files: {", ".join(lost)}' if lost else ''
        cause: Exception | None = None
        # The library expands what is compressed by message, as metadata.yaml says.
        by_message = str(facts.get('compression_mode')).upper() == 'MESSAGE'
        for path in [folder] if folder and by_message else files:
            try:
                self._readers.append(_opened(self._expanded(path)))
            except Exception as error:  # noqa: BLE001  (as in `messages`)
                cause = error
                self._missing += f'; {path.name} cannot be read: {reason(error)}'
        self._missing = self._missing.removeprefix('; ')
        if cause is not None and not any(each.message_count for each in self._readers):
            raise self._damaged(cause) from cause
        self._readers.sort(key=lambda each: each.start_time)

    def _expanded(self, path: Path) -> Path:
        """Return a file that is not compressed as a whole: the same, or a temporary one."""
        if path.suffix != '.zstd':
            return path
        folder = self._held.enter_context(tempfile.TemporaryDirectory(prefix='mixtac_'))
        expanded = Path(folder) / path.stem
        with path.open('rb') as source, expanded.open('wb') as file:
            zstandard.ZstdDecompressor().copy_stream(source, file)
        return expanded

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        remedy = 'copy it again, or try `mixtac repair`'
        if isinstance(error, RecordingError) and error.remedy:
            return DamagedRecordingError(f'{self.path}: {error.message}', remedy=error.remedy)
        if self.is_ros1:
            remedy = 'copy it again, or run `rosbag reindex` of ROS 1'
        elif sqlite := next(
            iter([self.path] if self.path.suffix == '.db3' else self.path.glob('*.db3')), None
        ):
            remedy = f"copy it again, or run: sqlite3 '{sqlite}' .recover | sqlite3 recovered.db3"
        return DamagedRecordingError(
            f'{self.path} is damaged or not a bag ({reason(error)})', remedy=remedy
        )


def is_storage(path: Path) -> bool:
    """Return whether a file is one of a ROS 2 bag by its name, compressed as a whole or not."""
    name = Path(path.stem) if path.suffix == '.zstd' else path
    return name.suffix in BAG_SUFFIXES


def _opened(path: Path) -> Any:  # noqa: ANN401  (a reader of rosbags, or one like it)
    """Open a file of a bag, or the folder of a compressed one."""
    if path.suffix == '.mcap':
        return McapFile(path)
    log = path.with_name(f'{path.name}-wal')
    if log.exists() and log.stat().st_size:
        raise RecordingError(
            f'{path.name} was not closed: its last messages are in {log.name}',
            remedy=f"run: sqlite3 '{path}' 'PRAGMA wal_checkpoint(TRUNCATE)'",
        )
    reader = AnyReader([path]) if path.suffix.lower() == ROS1_SUFFIX else Reader(path)
    reader.open()
    return reader


def _facts(bag: Path) -> dict[str, Any]:
    """Return the content of metadata.yaml; empty if it cannot be read."""
    try:
        return dict(read_data(bag / 'metadata.yaml')['rosbag2_bagfile_information'])
    except (FileError, KeyError, TypeError, ValueError):
        return {}


def custom_data(bag: Path) -> dict[str, str]:
    """Return what metadata.yaml says of a bag by keys of its writer; empty if it cannot be read."""
    content = _facts(bag).get('custom_data')
    return {str(key): str(value) for key, value in content.items()} if content else {}


def fit_path(bag: Path) -> Path:
    """Return where the clock fit of a bag lies."""
    return bag.with_name(f'{bag.name}.clock_fit.json')


def check_new(bag: Path) -> None:
    """Check that a bag can be made: a clock fit of an earlier one would count for it.

    Raises:
        RecordingError: The bag or a fit of its name exists.
    """
    if bag.exists():
        raise RecordingError(f'{bag} exists', remedy='name a new folder')
    if fit_path(bag).exists():
        raise RecordingError(
            f'{fit_path(bag)} is the clock fit of an earlier bag',
            remedy='remove it, or name a new folder',
        )


def find_bags(path: Path, depth: int = 3) -> list[Path]:
    """Return a bag itself, or the bags in a folder and its folders in the order of their names.

    A bag that was cut off has its data but no metadata.yaml; hidden folders are left out. Bags have
    names: those of `.` and `..` are looked up.

    Args:
        path: Bag, or folder.
        depth: Levels of folders to look into; 0 takes only a bag itself.
    """
    if path.is_file() or _holds_bag(path):
        return [path.resolve() if path.name in {'', '..'} else path]
    inside = sorted(path.iterdir()) if path.is_dir() and depth else ()
    folders = (each for each in inside if each.is_dir() and each.name[0] != '.')
    return [bag for each in folders for bag in find_bags(each, depth - 1)]


def distinct_names(bags: Iterable[Path]) -> dict[Path, str]:
    """Return a name of each bag: its own, with the folders above where several share it."""
    parts = {bag: bag.absolute().parts for bag in bags}
    names = {bag: each[-1] for bag, each in parts.items()}
    for depth in range(2, max(map(len, parts.values()), default=0)):
        counts = Counter(names.values())
        names = {
            bag: '_'.join(parts[bag][-depth:]) if counts[name] > 1 else name
            for bag, name in names.items()
        }
    return names


def _holds_bag(folder: Path) -> bool:
    return (folder / 'metadata.yaml').exists() or (
        folder.is_dir() and any(map(is_storage, folder.iterdir()))
    )
