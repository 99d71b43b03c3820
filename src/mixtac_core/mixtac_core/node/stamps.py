# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Times in microseconds or nanoseconds as ROS stamps, and back; reading one needs no ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time


def us_to_stamp(t_us: int) -> Time:
    """Return a time [us since the epoch of its clock] as a ROS stamp."""
    return ns_to_stamp(1000 * int(t_us))


def stamp_to_us(stamp: Time) -> int:
    """Return a ROS stamp as whole microseconds (rounded down) of its clock."""
    return stamp_to_ns(stamp) // 1000


def ns_to_stamp(t_ns: int) -> Time:
    """Return a time [ns since the epoch of its clock] as a ROS stamp."""
    from builtin_interfaces.msg import Time

    seconds, nanoseconds = divmod(int(t_ns), 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_to_ns(stamp: Time) -> int:
    """Return a ROS stamp in nanoseconds of its clock."""
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)
