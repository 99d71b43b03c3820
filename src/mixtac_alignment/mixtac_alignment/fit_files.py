# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock maps on disk: a JSON file beside the bag, and bags rewritten onto one clock."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import WriterError

from mixtac_alignment.clock_fit import from_fields, to_fields
from mixtac_recordings.bag import typestore
from mixtac_recordings.bag_writer import McapBag, offered_qos
from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_alignment.clock_fit import ClockFit


SCHEMA = 1


def fit_path(bag: Path) -> Path:
    """Return where the fit of a bag lies."""
    return bag.with_name(f'{bag.name}.clock_fit.json')


def write_fit(fit: ClockFit, bag: Path) -> Path:
    """Write a fit beside its bag and return the file: the fields of `mixtac_msgs/ClockFit`."""
    path = fit_path(bag)
    content = {'schema': SCHEMA, 'bag': bag.name, **to_fields(fit)}
    path.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    return path


def read_fit(bag: Path) -> ClockFit:
    """Return the fit beside a bag.

    Raises:
        RecordingError: No such file, or another schema.
        AlignmentError: The file describes no map.
    """
    path = fit_path(bag)
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise RecordingError(
            f'no clock fit in {path} ({error}): run `mixtac align {bag}`'
        ) from error
    if content.get('schema') != SCHEMA:
        raise RecordingError(
            f'{path} has schema {content.get("schema")}, not {SCHEMA}: align again'
        )
    return from_fields(content)


_NS: Final = 1_000_000_000


def rewrite_bag(bag: Path, fit: ClockFit, out: Path, reference: str, namespace: str) -> int:
    """Copy a bag with the reference force stamped on the camera clock; return its samples.

    The fit itself becomes the first message of `clock_fit`.

    Args:
        bag: Folder of the bag.
        fit: Its clock map.
        out: Folder of the new bag; must not exist.
        reference: Topic whose stamps change.
        namespace: Namespace of the camera's topics.

    Raises:
        RecordingError: The new bag exists already or cannot be written.
    """
    types, changed = typestore(), 0
    try:
        with (
            Reader(bag) as reader,
            McapBag(out) as writer,
        ):
            fit_topic = f'{namespace}/clock_fit'
            handles = {
                c.id: writer.add_connection(
                    c.topic,
                    c.msgtype,
                    typestore=types,
                    offered_qos_profiles=c.ext.offered_qos_profiles,  # type: ignore[union-attr]
                )
                for c in reader.connections
                if c.topic != fit_topic
            }
            fit_handle = writer.add_connection(
                fit_topic,
                'mixtac_msgs/msg/ClockFit',
                typestore=types,
                offered_qos_profiles=(offered_qos(reliable=True, latched=True),),
            )
            message = _fit_message(types, fit, reader.start_time)
            writer.write(fit_handle, reader.start_time, message)
            for connection, received_ns, data in reader.messages():
                if connection.id not in handles:
                    continue
                copied: Any = data
                if connection.topic == reference:
                    copied, changed = (
                        _on_camera_clock(types, data, connection.msgtype, fit),
                        changed + 1,
                    )
                writer.write(handles[connection.id], received_ns, copied)
    except (WriterError, OSError) as error:
        raise RecordingError(f'cannot write {out}: {error}; choose a folder that is new') from error
    return changed


def _on_camera_clock(types: Any, data: Any, kind: str, fit: ClockFit) -> Any:  # noqa: ANN401
    message = types.deserialize_cdr(data, kind)
    stamp = message.header.stamp
    seconds = stamp.sec - fit.reference_epoch_s + stamp.nanosec * 1e-9
    moved_ns = 1000 * fit.camera_epoch_us + round((seconds - fit.b) / fit.a * 1e9)
    stamp.sec, stamp.nanosec = divmod(moved_ns, _NS)
    return types.serialize_cdr(message, kind)


def _fit_message(types: Any, fit: ClockFit, now_ns: int) -> Any:  # noqa: ANN401
    import numpy as np

    fields: dict[str, Any] = {
        name: np.array(value) if isinstance(value, list) else value
        for name, value in to_fields(fit).items()
    }
    time = types.types['builtin_interfaces/msg/Time'](*divmod(now_ns, _NS))
    header = types.types['std_msgs/msg/Header'](stamp=time, frame_id='')
    kind = 'mixtac_msgs/msg/ClockFit'
    return types.serialize_cdr(types.types[kind](header=header, **fields), kind)
