# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Forces in a bag, brought to the camera clock."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger.dataset import ForceLabel
from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

_US_PER_S = 1_000_000
_NS_PER_S = 1_000_000_000


@dataclass(slots=True)
class WrenchStamps:
    """Stamps and normal forces of a topic, while they are read."""

    stamps_ns: list[int]
    force: list[float]

    def add(self, message: Any) -> None:  # noqa: ANN401 - a class made by rosbags
        """Add a `WrenchStamped`."""
        stamp = message.header.stamp
        self.stamps_ns.append(int(stamp.sec) * _NS_PER_S + int(stamp.nanosec))
        self.force.append(float(message.wrench.force.z))


@dataclass(frozen=True, slots=True)
class ClockMap:
    """The map t_reference - reference_epoch = a (t_camera - camera_epoch) + b.

    Attributes:
        a: Rate of the reference clock per camera clock.
        b: Offset at the epochs [s].
        camera_epoch_us: Camera clock [us].
        reference_epoch_ns: Reference clock [ns].
    """

    a: float
    b: float
    camera_epoch_us: int
    reference_epoch_ns: int

    @staticmethod
    def from_fields(fields: Mapping[str, Any]) -> ClockMap:
        """Return the map of the fields of a `mixtac_msgs/ClockFit`.

        Raises:
            DatasetError: The fields describe no map.
        """
        try:
            a, b = float(fields['a']), float(fields['b'])
            camera, reference = float(fields['camera_epoch']), float(fields['reference_epoch'])
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(f'clock fit without {error}: run `mixtac align` again') from error
        if not (np.isfinite([a, b, camera, reference]).all() and a > 0.0):
            raise DatasetError(
                f'clock fit with a = {a}, b = {b} is no map of clocks: run `mixtac align` again'
            )
        return ClockMap(a, b, round(camera * _US_PER_S), round(reference) * _NS_PER_S)

    def to_camera_us(self, reference_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return reference times [ns] on the camera clock [us], exact for epoch-sized times."""
        seconds = (reference_ns - self.reference_epoch_ns) / _NS_PER_S
        return np.asarray(self.camera_epoch_us + (seconds - self.b) / self.a * _US_PER_S)


def clock_map_beside(bag: Path) -> ClockMap | None:
    """Return the fit in `<bag>.clock_fit.json`, None where there is no such file.

    Raises:
        DatasetError: The file cannot be read.
    """
    path = bag.with_name(f'{bag.name}.clock_fit.json')
    if not path.exists():
        return None
    try:
        return ClockMap.from_fields(json.loads(path.read_text(encoding='utf-8')))
    except (OSError, ValueError) as error:
        raise DatasetError(f'{path} cannot be read ({error}): run `mixtac align` again') from error


def label_on_camera_clock(t_us: NDArray[np.float64], force: list[float], what: str) -> ForceLabel:
    """Return a force curve in the order of time.

    Args:
        t_us: Camera clock [us].
        force: Normal force [N].
        what: Name of the curve, for messages.

    Raises:
        DatasetError: There are too few samples, or one is not finite.
    """
    values = np.array(force, np.float64)
    if len(values) < 2:
        raise DatasetError(f'{what} holds {len(values)} samples: record the force sensor as well')
    if not np.isfinite(values).all():
        raise DatasetError(f'{what} holds values that are no numbers: check the force sensor')
    order = np.argsort(t_us, kind='stable')
    return ForceLabel(np.asarray(t_us, np.float64)[order], values[order])


def host_to_camera_us(
    host_ns: NDArray[np.int64], pairs: list[tuple[int, int]]
) -> NDArray[np.float64]:
    """Return host times on the camera clock [us] by the pairs that the driver published.

    Args:
        host_ns: Host clock [ns].
        pairs: Host time [ns] and camera time [ns], in the order of time.

    Raises:
        DatasetError: There are no pairs.
    """
    if not pairs:
        raise DatasetError('no camera_clock in the bag, on which a host time could be placed')
    table = np.array(pairs, np.int64)
    since = (host_ns - table[0, 0]) / 1000.0
    host, ahead = (table[:, 0] - table[0, 0]) / 1000.0, (table[:, 1] - table[:, 0]) / 1000.0
    if len(table) == 1:
        offset = np.full(len(since), ahead[0])
    else:
        # A line: single pairs carry the jitter of USB transfers.
        slope, start = np.polyfit(host, ahead, 1)
        offset = start + slope * since
    return np.asarray(table[0, 0] / 1000.0 + since + offset, np.float64)
