# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled part of the decoder for inertial samples: start, info byte, up to 14 bytes, end."""

from __future__ import annotations

from typing import Any

from numba import njit

from mixtac_driver.decode.state import (
    C_IMU,
    C_IMU_DROPPED,
    C_IMU_UNEXPECTED,
    IMU_AWAITS_INFO,
    IMU_BYTES,
    IMU_INDEX,
    IMU_INFO,
    IMU_OUTSIDE,
    IMU_SAMPLES,
    TIME,
)

Int = Any
Array = Any
SLOT = IMU_BYTES + 1
"""Bytes of a sample and its info byte."""
HAS_ACCELERATION, HAS_ROTATION, HAS_TEMPERATURE = 0x80, 0x40, 0x20


@njit(nogil=True, forceinline=True)
def imu_drop(state: Array, counters: Array) -> None:
    """Drop the sample in progress, if any."""
    if state[IMU_INDEX] != IMU_OUTSIDE:
        counters[C_IMU_DROPPED] += 1
        state[IMU_INDEX] = IMU_OUTSIDE


@njit(nogil=True, forceinline=True)
def imu_start(state: Array, counters: Array) -> None:
    """Begin a sample."""
    imu_drop(state, counters)
    state[IMU_INDEX] = IMU_AWAITS_INFO


@njit(nogil=True, forceinline=True)
def _next_group(index: Int, info: Int) -> Int:
    """Return the index of the next byte that is sent, skipping groups that are not."""
    if index == 0 and not info & HAS_ACCELERATION:
        index = 6
    if index == 6 and not info & HAS_TEMPERATURE:
        index = 8
    if index == 8 and not info & HAS_ROTATION:
        index = IMU_BYTES
    return index


@njit(nogil=True, forceinline=True)
def imu_info(data: Int, state: Array, counters: Array, raw: Array) -> None:
    """Take the byte that says which groups follow and on which scales."""
    if state[IMU_INDEX] != IMU_AWAITS_INFO:
        counters[C_IMU_UNEXPECTED] += 1
        imu_drop(state, counters)
        return
    state[IMU_INFO] = data
    state[IMU_INDEX] = _next_group(0, data)
    if state[IMU_INDEX] == IMU_BYTES:
        imu_drop(state, counters)
        return
    slot = state[IMU_SAMPLES] * SLOT
    for k in range(IMU_BYTES):
        raw[slot + k] = 0
    raw[slot + IMU_BYTES] = data


@njit(nogil=True, forceinline=True)
def imu_byte(data: Int, state: Array, counters: Array, raw: Array) -> None:
    """Take one byte of the sample."""
    index = state[IMU_INDEX]
    if index < 0 or index >= IMU_BYTES:
        counters[C_IMU_UNEXPECTED] += 1
        return
    raw[state[IMU_SAMPLES] * SLOT + index] = data
    state[IMU_INDEX] = _next_group(index + 1, state[IMU_INFO])


@njit(nogil=True, forceinline=True)
def imu_end(state: Array, counters: Array, t_out: Array) -> None:
    """Finish the sample; its time is that of its end."""
    if state[IMU_INDEX] == IMU_OUTSIDE:
        counters[C_IMU_UNEXPECTED] += 1
        return
    if state[IMU_INDEX] != IMU_BYTES:
        imu_drop(state, counters)
        return
    t_out[state[IMU_SAMPLES]] = state[TIME]
    state[IMU_SAMPLES] += 1
    state[IMU_INDEX] = IMU_OUTSIDE
    counters[C_IMU] += 1
