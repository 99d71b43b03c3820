# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial samples: start word, info byte, up to 14 bytes of payload, end word.

The info byte tells which groups follow: acceleration (bytes 0 .. 5), temperature (6, 7) and
rotation (8 .. 13). Groups that are not sent are skipped in the payload and stay zero.
"""

from __future__ import annotations

from typing import Any

from numba import njit

from mixtac_driver.decode.state import IMU_AWAITS_INFO, IMU_BYTES, IMU_OUTSIDE

HAS_ACCELERATION, HAS_ROTATION, HAS_TEMPERATURE = 0x80, 0x40, 0x20
Record = Any


@njit(nogil=True)
def imu_drop(s: Record, c: Record) -> None:
    """Drop the sample in progress, if any."""
    if s.imu_index != IMU_OUTSIDE:
        c.imu_dropped += 1
        s.imu_index = IMU_OUTSIDE


@njit(nogil=True)
def imu_start(s: Record, c: Record) -> None:
    """Start a sample."""
    imu_drop(s, c)
    s.imu_index = IMU_AWAITS_INFO


@njit(nogil=True)
def _next_byte(index: int, info: int) -> int:
    """Return the index of the next byte that is sent, at or after this one."""
    if index == 0 and not info & HAS_ACCELERATION:
        index = 6
    if index == 6 and not info & HAS_TEMPERATURE:
        index = 8
    if index == 8 and not info & HAS_ROTATION:
        index = IMU_BYTES
    return index


@njit(nogil=True)
def imu_info(data: int, s: Record, c: Record, r: Record) -> None:
    """Take the info byte."""
    if s.imu_index != IMU_AWAITS_INFO:
        c.imu_unexpected += 1
        imu_drop(s, c)
        return
    s.imu_info = data
    s.imu_index = _next_byte(0, data)
    if s.imu_index == IMU_BYTES:
        imu_drop(s, c)
        return
    for k in range(IMU_BYTES):
        r.imu_raw[r.imu_count, k] = 0
    r.imu_raw[r.imu_count, IMU_BYTES] = data


@njit(nogil=True)
def imu_byte(data: int, s: Record, c: Record, r: Record) -> None:
    """Take one byte of the payload."""
    if s.imu_index < 0 or s.imu_index >= IMU_BYTES:
        c.imu_unexpected += 1
        return
    r.imu_raw[r.imu_count, s.imu_index] = data
    s.imu_index = _next_byte(s.imu_index + 1, s.imu_info)


@njit(nogil=True)
def imu_end(s: Record, c: Record, r: Record) -> None:
    """Finish the sample; its time is that of the end word."""
    if s.imu_index == IMU_OUTSIDE:
        c.imu_unexpected += 1
        return
    if s.imu_index != IMU_BYTES:
        imu_drop(s, c)
        return
    r.imu_t[r.imu_count] = s.time
    r.imu_count += 1
    s.imu_index = IMU_OUTSIDE
    c.imu += 1
