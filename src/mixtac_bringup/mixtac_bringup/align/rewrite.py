# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag on one clock: the reference force with camera stamps, everything else as it was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

from mixtac_alignment.fit_message import to_fields
from mixtac_bringup.bag_types import typestore
from mixtac_bringup.bag_writer import offered_qos
from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from mixtac_alignment.clock_fit import ClockFit

_NS: Final = 1_000_000_000


def rewrite(bag: Path, fit: ClockFit, out: Path, reference: str, namespace: str) -> int:
    """Copy a bag with the reference force stamped on the camera clock; return its samples.

    The fit itself becomes the first message of `clock_fit`.

    Args:
        bag: Folder of the bag.
        fit: Its clock map.
        out: Folder of the new bag; must not exist.
        reference: Topic whose stamps change.
        namespace: Namespace of the camera's topics.

    Raises:
        BagError: The new bag exists already or cannot be written.
    """
    types, changed = typestore(), 0
    try:
        with (
            Reader(bag) as reader,
            Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
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
            message = _message(types, fit, reader.start_time)
            writer.write(fit_handle, reader.start_time, message)
            for connection, received_ns, data in reader.messages():
                if connection.id not in handles:
                    continue
                copied: Any = data
                if connection.topic == reference:
                    copied, changed = _moved(types, data, connection.msgtype, fit), changed + 1
                writer.write(handles[connection.id], received_ns, copied)
    except (WriterError, OSError) as error:
        raise BagError(f'cannot write {out}: {error}; choose a folder that is new') from error
    return changed


def _moved(types: Any, data: Any, kind: str, fit: ClockFit) -> Any:  # noqa: ANN401
    message = types.deserialize_cdr(data, kind)
    stamp = message.header.stamp
    seconds = stamp.sec - fit.reference_epoch_s + stamp.nanosec * 1e-9
    moved_ns = 1000 * fit.camera_epoch_us + round((seconds - fit.b) / fit.a * 1e9)
    stamp.sec, stamp.nanosec = divmod(moved_ns, _NS)
    return types.serialize_cdr(message, kind)


def _message(types: Any, fit: ClockFit, now_ns: int) -> Any:  # noqa: ANN401
    import numpy as np

    fields: dict[str, Any] = {
        name: np.array(value) if isinstance(value, list) else value
        for name, value in to_fields(fit).items()
    }
    time = types.types['builtin_interfaces/msg/Time'](*divmod(now_ns, _NS))
    header = types.types['std_msgs/msg/Header'](stamp=time, frame_id='')
    kind = 'mixtac_msgs/msg/ClockFit'
    return types.serialize_cdr(types.types[kind](header=header, **fields), kind)
