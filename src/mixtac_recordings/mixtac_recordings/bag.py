# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags (a folder, .mcap or .db3) and the message types in them, without rclpy.

A bag that was not closed, because its recorder was killed or the disk was full, is read as far as
its files are whole (`mixtac_recordings.recovery`).
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, Nodetype
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mixtac_node import topics
from mixtac_node.files import FileError, read_data
from mixtac_node.share import share
from mixtac_node.stamps import stamp_to_ns
from mixtac_recordings.recording import (
    BAG_SUFFIXES,
    DamagedRecordingError,
    RecordingError,
    expand,
)
from mixtac_recordings.recovery import (
    PACKED_SUFFIX,
    recovered,
    shortened,
    temporary_folder,
    unfinished,
    unpack,
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


_RENAMED = {'event_array_msgs/msg/EventArray': topics.EVENTS.type_name}
"""Former names of message types whose fields are the same."""
_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
"""First bytes of a message that is compressed by itself; those of CDR are 0, 0 or 0, 1."""


class BagFile:
    """A bag, open for reading.

    Args:
        path: Folder, .mcap or .db3 file.
        whole: Read all of every file, without its index, and leave out what is damaged.

    Attributes:
        path: As given.
        start_ns: When the first message was received [ns, host clock of the recorder].
        duration_ns: From the first to the last message [ns].
        counts: Messages by topic.
        types: Type name by topic; with the encoding of the messages where that is not CDR.
        damage: What is missing because the bag is incomplete; empty for a sound one.

    Raises:
        RecordingError: There is no bag.
        DamagedRecordingError: Nothing of it can be read.
    """

    def __init__(self, path: Path, *, whole: bool = False) -> None:
        self.path = path
        self.damage = ''
        self._unpacked: TemporaryDirectory[str] | None = None
        if not path.exists():
            raise RecordingError(f'no bag at {path}', remedy='give its folder, .mcap or .db3 file')
        self._types = typestore()
        self._readers: list[Reader] = []
        try:
            self._open(whole=whole)
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
            form = connection.ext.serialization_format  # type: ignore[union-attr]
            kind = _RENAMED.get(connection.msgtype, connection.msgtype)
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
            if reader.is_open:
                reader.close()
        if self._unpacked is not None:
            self._unpacked.cleanup()

    @property
    def connections(self) -> list[Connection]:
        """Return the connections of all files of the bag, with type and QoS of each topic."""
        return [connection for reader in self._readers for connection in reader.connections]

    def topics(self, type_name: str) -> list[str]:
        """Return the topics of a message type that hold any messages, sorted."""
        return sorted(t for t, kind in self.types.items() if kind == type_name and self.counts[t])

    def messages(
        self,
        *wanted: str,
        start_ns: int | None = None,
        raw: Collection[str] = (),
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time received [ns, host clock], message) in recording order.

        Args:
            wanted: Absolute topic names.
            start_ns: Begin with messages received at this time; None for the first.
            raw: Topics among `wanted` whose messages stay serialised: `bytes` in CDR.

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
            messages = reader.messages(chosen, start_ns) if chosen else iter(())
            while True:
                try:
                    connection, received_ns, data = next(messages)
                    if data[:4] == _ZSTD_MAGIC:
                        data = expand('zstd', data)
                    message = (
                        data
                        if connection.topic in raw
                        else self._types.deserialize_cdr(
                            data, _RENAMED.get(connection.msgtype, connection.msgtype)
                        )
                    )
                except StopIteration:
                    break
                except Exception as error:  # as above
                    raise self._damaged(error) from error
                yield connection.topic, received_ns, message

    def wrenches(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the stamps [n] [ns, the topic's own clock] and forces x, y, z [n, 3] [N]."""
        stamps, forces = [], []
        for _, _, message in self.messages(topic):
            stamps.append(stamp_to_ns(message.header.stamp))
            forces.append((*topics.sideways_force(message), topics.normal_force(message)))
        return np.array(stamps, np.int64), np.array(forces, np.float64).reshape(-1, 3)

    def _open(self, *, whole: bool) -> None:
        """Open the bag by its index or, where that fails, its files one by one."""
        folder = self.path.is_dir()
        files = _storage_files(self.path)
        cause: Exception | None = None
        if not (whole or any(map(_needs_more, files))):
            try:
                self._readers = [_opened(self.path)]
            except Exception as error:  # noqa: BLE001  (parsers raise whatever damage leads them to)
                cause = error
            else:
                return
        notes = [f'{path.name} was not closed' for path in files if unfinished(path)]
        if folder and not (self.path / 'metadata.yaml').exists():
            notes.append('metadata.yaml is missing')
        for path in files:
            try:
                notes += self._open_alone(path, whole=whole)
            except Exception as error:  # noqa: BLE001  (as above)
                cause = error
                notes.append(f'{path.name} cannot be read: {_text(error)}')
        read = sum(reader.message_count for reader in self._readers)
        if not read and (cause or notes):
            why = cause or RecordingError('; '.join(notes))
            raise self._damaged(why) from cause
        if cause and not notes:
            notes.append(f'metadata.yaml cannot be used: {_text(cause)}')
        if notes:
            self.damage = f'the bag is incomplete ({"; ".join(notes)}): {read} messages can be read'

    def _open_alone(self, path: Path, *, whole: bool) -> list[str]:
        """Open one file; return what is missing."""
        note = ''
        if path.suffix == PACKED_SUFFIX:
            self._unpacked = self._unpacked or temporary_folder()
            path = unpack(path, self._unpacked.name)
        if not (whole or _needs_more(path)):
            try:
                self._readers.append(_opened(path))
            except Exception as error:  # noqa: BLE001  (as above)
                note = f'the index of {path.name} cannot be used: {_text(error)}'
            else:
                return []
        reader, damage = recovered(path)
        self._readers.append(reader)
        return [text for text in (damage or note,) if text]

    def _damaged(self, error: Exception) -> DamagedRecordingError:
        return DamagedRecordingError(
            f'{self.path} is damaged or not a bag ({_text(error)})',
            remedy='copy it again, or try `mixtac repair`',
        )


def _storage_files(path: Path) -> list[Path]:
    """Return the files of a bag in the order of their numbers, which have no leading zeros."""
    found = path.glob('*') if path.is_dir() else [path]
    files = [each for each in found if each.suffix in {*BAG_SUFFIXES, PACKED_SUFFIX}]
    if not files:
        raise RecordingError(
            f'{path} is no bag: there is no .mcap or .db3 file',
            remedy='give its folder, .mcap or .db3 file; `mixtac import` makes a bag of others',
        )
    return sorted(files, key=lambda each: (len(each.name), each.name))


def _needs_more(path: Path) -> bool:
    """Return whether the library would overlook changes or a cut, or expand a file of any size."""
    return path.suffix == PACKED_SUFFIX or unfinished(path) or shortened(path)


def _text(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def custom_data(bag: Path) -> dict[str, str]:
    """Return what metadata.yaml says of a bag by keys of its writer; empty if it cannot be read."""
    try:
        content = read_data(bag / 'metadata.yaml')['rosbag2_bagfile_information']['custom_data']
        return {str(key): str(value) for key, value in content.items()}
    except (FileError, KeyError, TypeError, AttributeError):
        return {}


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
    return (folder / 'metadata.yaml').exists() or any(
        next(folder.glob(f'*{suffix}'), None) for suffix in BAG_SUFFIXES
    )


def _opened(path: Path) -> Reader:
    # The library would expand aliases, and below messages, to any size.
    if path.is_dir():
        read_data(path / 'metadata.yaml')
    reader = Reader(path)
    reader.open()
    # `BagFile.messages` expands them.
    found = reader.storage.metadata
    reader.storage.metadata = found._replace(compression_mode=None)
    return reader
