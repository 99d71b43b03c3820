# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Public recordings of real cameras as captures: what a DAVIS346 would have sent over USB.

The recordings are `shared/data` beside the checkout, or in the folder that MIXTAC_TEST_DATA names;
docs/virtual_sensor.md says where they are public. Requests are those of the shipped capture.
"""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from mixtac_driver.usb.capture import Arrival, Capture, read_capture
from mixtac_events.arrays import Events
from mixtac_recordings.camera_stream import open_recording
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.words import (
    TIMESTAMP_RESET_WORD,
    Blocks,
    ImuReading,
    ImuSettings,
    ReadoutSettings,
    WordEncoder,
    frame_blocks,
    imu_blocks,
)

DATA = Path(os.environ.get('MIXTAC_TEST_DATA', Path(__file__).parents[5] / 'shared' / 'data'))
SHIPPED = Path(__file__).parents[3] / 'mixtac_driver/test/usb/virtual.zip'
TRANSFER = 4096
LEAD_US = 20_000
ADC_MHZ = 30.24
RESET_LEVEL = 1023
START_NS = 500_000_000
WRAP_WORD, WRAP_NS, TAIL_WRAPS = 0x7001, 32_768_000, 30


def recordings(*names):
    """Return the paths of recordings, or skip the test."""
    paths = [DATA / name for name in names]
    missing = [path for path in paths if not path.exists()]
    if missing:
        pytest.skip(f'{missing[0]} is not here')
    return paths


def real_data(path):
    """Return events, frames and samples of a recording; times from its beginning [us]."""
    parts, frames, samples = [], [], []
    with closing(open_recording(path)) as recording:
        for piece in recording.pieces(0):
            parts.append(piece.events.copy())
            frames += piece.frames
            samples += zip(
                *(piece.imu.t, piece.imu.acceleration / 9.80665),
                *(np.degrees(piece.imu.angular_velocity), piece.imu.temperature),
                strict=True,
            )
    events = Events.concatenate(parts)
    starts = [int(events.t[0]), *(f.exposure_start_us - 6000 for f in frames)]
    starts += [int(t) for t, *_ in samples[:1]]
    origin = min(starts) - LEAD_US
    return events.shifted(-origin), frames, samples, origin


def real_words(path):
    """Return the stream words of a recording, after a reset of the clock."""
    events, frames, samples, origin = real_data(path)
    parts = []
    for f in frames:
        start, end = f.exposure_start_us - origin, f.exposure_end_us - origin
        reset = np.full(f.image.shape, RESET_LEVEL, np.uint16)
        frame = ApsFrame(start - 6000, start, end, end + 6000, reset, RESET_LEVEL - f.image)
        settings = ReadoutSettings((0, 0, 345, 259), round((end - start) * ADC_MHZ), True, 4)
        parts.append(frame_blocks(frame, settings))
    parts += [
        imu_blocks(ImuReading(int(t) - origin, tuple(a), tuple(r), float(c)), ImuSettings())
        for t, a, r, c in samples
    ]
    until_us = max(int(events.t[-1]), 0) + LEAD_US
    words = WordEncoder(inverted=True).encode(events, Blocks.merge(parts), until_us)
    return np.concatenate([[TIMESTAMP_RESET_WORD], words]).astype('<u2'), until_us


def real_capture(path):
    """Return a recording as a capture whose data come evenly over its time."""
    words, until_us = real_words(path)
    data = words.tobytes()
    cuts = range(2, len(data), TRANSFER)
    step_ns = until_us * 1000 // len(cuts)
    # The reset comes first, alone: clients that have just started look for it.
    arrivals = [Arrival(0, data[:2])]
    arrivals += [
        Arrival(START_NS + k * step_ns, data[at : at + TRANSFER]) for k, at in enumerate(cuts)
    ]
    # Time that passes lets every client hand on what it holds back.
    wrap = np.array([WRAP_WORD], '<u2').tobytes()
    last_ns = arrivals[-1].time_ns
    arrivals += [Arrival(last_ns + k * WRAP_NS, wrap) for k in range(1, TAIL_WRAPS)]
    return Capture(read_capture(SHIPPED).requests, tuple(arrivals))
