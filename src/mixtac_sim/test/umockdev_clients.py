# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads a DAVIS346 with other people's drivers and saves what they saw.

Run by an interpreter that has the driver::

    python umockdev_clients.py neuromorphic|dv|libcaer OUT.npz READY EVENTS FRAMES SAMPLES

It touches READY when the camera streams and ends when it has seen that many events, frames and
inertial samples, or has waited long enough for the tester to see what is missing.
"""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from pathlib import Path

import numpy as np

PATIENCE_S = 20.0


class Seen:
    """Collects what a driver delivers."""

    def __init__(self, ready, wanted):
        self.ready = ready
        self.wanted = wanted
        self.events = []
        self.frames = []
        self.frame_times = []
        self.imu = []
        self.deadline = time.monotonic() + PATIENCE_S

    def done(self):
        self.ready.touch()
        counts = (sum(len(part) for part in self.events), len(self.frames), len(self.imu))
        enough = all(count >= wanted for count, wanted in zip(counts, self.wanted, strict=True))
        return enough or time.monotonic() > self.deadline

    def save(self, path):
        events = np.concatenate(self.events) if self.events else np.zeros((0, 4), np.int64)
        np.savez(
            path,
            events=events,
            frames=np.array(self.frames),
            frame_times=np.array(self.frame_times),
            imu=np.array(self.imu),
        )


def columns(t, x, y, polarity):
    return np.stack([np.asarray(c).astype(np.int64).ravel() for c in (t, x, y, polarity)], axis=1)


def neuromorphic(seen):
    """Acceleration in m/s^2, turn rate in rad/s."""
    import neuromorphic_drivers as nd

    with nd.open(iterator_timeout=0.1) as device:
        for _, packet in device:
            if packet is not None:
                if packet.polarity_events is not None:
                    e = packet.polarity_events
                    seen.events.append(columns(e['t'], e['x'], e['y'], e['on']))
                if packet.imu_events is not None:
                    seen.imu += [tuple(float(value) for value in row) for row in packet.imu_events]
                for frame in packet.frames:
                    seen.frames.append(frame.pixels)
                    times = (frame.start_t, frame.exposure_start_t, frame.exposure_end_t, frame.t)
                    seen.frame_times.append(times)
            if seen.done():
                return


def dv(seen):
    """Times count from the host's epoch; acceleration in g, turn rate in deg/s."""
    import dv_processing

    camera = dv_processing.io.camera.DAVIS()
    # It takes the exposure from the register words of the frame, and changes it by itself.
    camera.setAutoExposure(False)
    camera.setExposureDuration(timedelta(milliseconds=4))
    offset = camera.getTimestampOffset()
    offset_us = (offset.days * 86_400 + offset.seconds) * 1_000_000 + offset.microseconds
    while not seen.done():
        events = camera.getNextEventBatch()
        if events is not None:
            e = events.numpy()
            seen.events.append(columns(e['timestamp'] - offset_us, e['x'], e['y'], e['polarity']))
        frame = camera.getNextFrame()
        if frame is not None:
            start = frame.timestamp - offset_us
            seen.frames.append(np.array(frame.image))
            exposure_us = round(frame.exposure.total_seconds() * 1e6)
            seen.frame_times.append((-1, start, start + exposure_us, -1))
        for sample in camera.getNextImuBatch() or ():
            acceleration = (sample.accelerometerX, sample.accelerometerY, sample.accelerometerZ)
            rate = (sample.gyroscopeX, sample.gyroscopeY, sample.gyroscopeZ)
            time_us = sample.timestamp - offset_us
            seen.imu.append((time_us, *acceleration, *rate, sample.temperature))
        if events is None and frame is None:
            time.sleep(0.002)


def libcaer(seen):
    """Events only: the Python wrapper hands nothing else on."""
    import event_camera_drivers

    camera = event_camera_drivers.InivationCamera()
    # Its iterator blocks until there are events, so the tester must not wait for the first.
    seen.ready.touch()
    for e in camera:
        if len(e):
            seen.events.append(columns(e['t'], e['x'], e['y'], e['on']))
        if seen.done():
            return


def main():
    client, out, ready, *wanted = sys.argv[1:]
    seen = Seen(Path(ready), [int(count) for count in wanted])
    {'neuromorphic': neuromorphic, 'dv': dv, 'libcaer': libcaer}[client](seen)
    seen.save(out)


if __name__ == '__main__':
    main()
