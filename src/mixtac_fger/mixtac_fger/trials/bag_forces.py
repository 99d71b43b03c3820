# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The forces of a bag: the true one of a simulated bag, and the reference sensor's."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger.errors import DatasetError
from mixtac_fger.trials.bag_labels import (
    ClockMap,
    WrenchStamps,
    clock_map_beside,
    host_to_camera_us,
    label_on_camera_clock,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_fger.dataset import ForceLabel

CLOCK_FIT = 'mixtac_msgs/msg/ClockFit'
_TRUE_FORCE = '/truth/wrench'
_TRUE_FIT = '/truth/clock_fit'
_CAMERA_CLOCK = '/camera_clock'
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class BagForces:
    """Forces of a bag on the camera clock.

    Attributes:
        truth: True normal force, None where the bag has none.
        reference: Measured normal force, None where the bag has none or no clock map to place it.
    """

    truth: ForceLabel | None
    reference: ForceLabel | None


@dataclass(slots=True)
class _Found:
    truth: WrenchStamps = field(default_factory=lambda: WrenchStamps([], []))
    reference: WrenchStamps = field(default_factory=lambda: WrenchStamps([], []))
    pairs: list[tuple[int, int]] = field(default_factory=list)
    fit: ClockMap | None = None
    true_fit: ClockMap | None = None

    def add(self, topic: str, message: Any, reference: str) -> None:  # noqa: ANN401
        if topic == reference:
            self.reference.add(message)
        elif topic.endswith(_TRUE_FORCE):
            self.truth.add(message)
        elif topic.endswith(_CAMERA_CLOCK):
            self.pairs.append((_ns(message.header.stamp), _ns(message.time_ref)))
        else:
            fields = {name: getattr(message, name) for name in _FIELDS}
            if topic.endswith(_TRUE_FIT):
                self.true_fit = ClockMap.from_fields(fields)
            else:
                self.fit = ClockMap.from_fields(fields)


_FIELDS = ('a', 'b', 'camera_epoch', 'reference_epoch')


def read_forces(path: Path, reference: str) -> BagForces:
    """Return the forces of a bag.

    A fit beside the bag is preferred to one inside, and a made one to a simulated bag's true one.

    Args:
        path: The bag.
        reference: Topic of the reference force.

    Raises:
        RecordingError: The bag is damaged.
        DatasetError: It has neither a true force nor a reference that can be aligned.
    """
    found = _read(path, reference)
    fit = clock_map_beside(path) or found.fit or found.true_fit
    truth = measured = None
    if found.truth.force:
        stamps = np.array(found.truth.stamps_ns, np.int64)
        t_us = host_to_camera_us(stamps, found.pairs)
        truth = label_on_camera_clock(t_us, found.truth.force, f'{path} topic ...{_TRUE_FORCE}')
    if found.reference.force and fit is not None:
        t_us = fit.to_camera_us(np.array(found.reference.stamps_ns, np.int64))
        measured = label_on_camera_clock(t_us, found.reference.force, f'{path} topic {reference}')
    if truth is None and measured is None:
        raise DatasetError(_nothing(path, reference, recorded=bool(found.reference.force)))
    return BagForces(truth, measured)


def _nothing(path: Path, reference: str, *, recorded: bool) -> str:
    if recorded:
        return f'{path} has no clock fit to place {reference} by: run `mixtac align {path}`'
    return f'{path} has no force: record the reference sensor ({reference}) beside the camera'


def _read(path: Path, reference: str) -> _Found:
    from rosbags.rosbag2 import Reader

    from mixtac_driver.errors import DamagedRecordingError
    from mixtac_driver.recordings.bag_types import typestore

    found, store = _Found(), typestore()
    _register_clock_fit(store)
    try:
        with Reader(path) as reader:
            chosen = [
                each
                for each in reader.connections
                if each.topic == reference
                or each.topic.endswith((_TRUE_FORCE, _CAMERA_CLOCK))
                or each.msgtype == CLOCK_FIT
            ]
            for connection, _, data in reader.messages(chosen) if chosen else ():
                message = store.deserialize_cdr(data, connection.msgtype)
                found.add(connection.topic, message, reference)
    except DatasetError:
        raise
    except Exception as error:  # the format's parsers raise whatever damage leads them to
        text = ' '.join(str(error).split()) or type(error).__name__
        raise DamagedRecordingError(
            f'{path} is not a whole bag ({text}): record it again, or repair it with'
            ' `ros2 bag reindex`'
        ) from error
    return found


def _register_clock_fit(store: Any) -> None:  # noqa: ANN401 - a class of rosbags
    from pathlib import Path as FilePath

    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
    from rosbags.typesys import get_types_from_msg

    try:
        share = FilePath(get_package_share_directory('mixtac_msgs'))
    except PackageNotFoundError:
        return
    text = (share / 'msg' / 'ClockFit.msg').read_text(encoding='utf-8')
    store.register(get_types_from_msg(text, CLOCK_FIT))


def _ns(stamp: Any) -> int:  # noqa: ANN401
    return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)
