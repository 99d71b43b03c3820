# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames and inertial samples of the virtual camera, read back by a decoder of the test's own."""

from __future__ import annotations

import struct

import numpy as np
from usb_oracle import APS, IMU, camera, decode, drain, events_of, some_frame, write

from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.words import ImuReading


def test_frame_words_times_and_region():
    device = camera()
    write(device, (APS, 8, 10), (APS, 9, 20), (APS, 10, 300), (APS, 11, 219), (APS, 12, 120_960))
    frame = some_frame()
    # Events must come between the words of the frame, each at its own time.
    rows = [(t, 3, 4, True) for t in range(0, 20_000, 7)]
    device.submit(events_of(rows), [frame])
    for t in range(0, 20_001, 250):
        device.advance(t)
    decoded = decode(drain(device))
    assert decoded.events == rows
    marks = {code: t for code, t in decoded.specials if code in {8, 14, 15, 10}}
    assert marks == {8: 1000, 14: 6000, 15: 10_000, 10: 15_000}
    assert decoded.regions == [[0, 10, 0, 20, 300 >> 8, 300 & 255, 0, 219]]
    low, middle, high = decoded.exposures[0]
    assert low | middle << 10 | high << 20 == 120_960
    resets = np.array([c for kind, c in decoded.columns if kind == 11])
    np.testing.assert_array_equal(resets, frame.reset[20:220, 10:301])
    order = [code for code, _ in decoded.specials if code in {11, 12, 14, 15}]
    assert order == [11] * 200 + [14, 15] + [12] * 200


def test_rolling_shutter_takes_reset_and_signal_columns_in_turns():
    device = camera()
    write(device, (APS, 7, 0))
    picture = some_frame()
    frame = ApsFrame(1000, 1100, 3000, 8000, picture.reset, picture.signal)
    device.submit(frames=[frame])
    for t in range(0, 40_001, 250):
        device.advance(t)
    decoded = decode(drain(device))
    order = [code for code, _ in decoded.specials]
    assert order[0] == 9
    assert order[-1] == 10
    columns = [code for code in order if code in {11, 12, 13}]
    # A column ends before the next begins.
    assert columns[1::2] == [13] * 520
    starts = columns[::2]
    assert starts[200:210] == [11, 12] * 5 or starts[200:210] == [12, 11] * 5
    for kind, pixels in ((11, frame.reset), (12, frame.signal)):
        read = np.array([column for code, column in decoded.columns if code == kind])
        np.testing.assert_array_equal(read, pixels)


def test_imu_sample_bytes_and_info():
    device = camera()
    write(device, (IMU, 7, 1), (IMU, 10, 2))
    reading = ImuReading(123, (0.5, -1.0, 99.0), (100.0, -250.0, 0.0), 31.0)
    device.submit(readings=[reading])
    device.advance(200)
    ((info, *data, end),) = decode(drain(device)).imu
    assert info == 0b111_0_01_10
    assert end == 123
    values = struct.unpack('>7h', bytes(data))
    # 4 g and 1000 deg/s full scale; 99 g saturates; 333.87 per kelvin above 21.
    assert values == (4096, -8192, 32767, 3339, 3277, -8192, 0)
    write(device, (IMU, 2, 0), (IMU, 4, 0))
    device.submit(readings=[ImuReading(300, (0, 0, 1), (1, 2, 3), 30.0)])
    device.advance(400)
    ((info, *data, end),) = decode(drain(device)).imu
    assert (info, len(data)) == (0b010_0_01_10, 6)


def test_snapshot_gives_one_frame():
    device = camera()
    write(device, (APS, 4, 0))
    device.submit(frames=[some_frame(1000)])
    device.advance(30_000)
    before = [code for code, _ in decode(drain(device)).specials].count(10)
    write(device, (APS, 4, 1), (APS, 4, 0))
    device.submit(frames=[some_frame(41_000), some_frame(81_000)])
    device.advance(120_000)
    after = [code for code, _ in decode(drain(device)).specials].count(10)
    # The camera was on before the first frame was due, so that one is still owed.
    assert (before, after) == (1, 1)
