# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads a DAVIS346 with a driver, ours or somebody else's, and saves what it saw.

Run by an interpreter that has the driver::

    python umockdev_clients.py ours|libcaer OUT.npz READY DONE

It touches READY when the camera streams and ends when DONE exists and nothing more arrives.
Edges are saved under the codes of the wire; a reset of the camera's clock, where the driver reports
one, as code 1.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

PATIENCE_S = 40.0
QUIET_S = 2.0
RESET, FALLING, RISING, PULSE, GENERATOR_FALLING, GENERATOR_RISING = 1, 2, 3, 4, 16, 17
LIBCAER_EDGES = {1: RESET, 2: RISING, 3: FALLING, 4: PULSE, 12: GENERATOR_RISING}
LIBCAER_EDGES[13] = GENERATOR_FALLING


class Seen:
    """Collects what a driver delivers, and knows when that is all."""

    def __init__(self, ready, done):
        self.ready, self.done = ready, done
        self.events, self.frames, self.imu, self.edges = [], [], [], []
        self.heard = time.monotonic()
        self.deadline = self.heard + PATIENCE_S

    def add_events(self, t, x, y, polarity):
        columns = [np.asarray(c).astype(np.int64).ravel() for c in (t, x, y, polarity)]
        if len(columns[0]):
            self.events.append(np.stack(columns, axis=1))
            self.heard = time.monotonic()

    def add_frame(self, pixels, times, corner=(0, 0)):
        """Times are frame start, exposure start, exposure end, frame end."""
        self.frames.append((np.array(pixels).squeeze(), times, corner))
        self.heard = time.monotonic()

    def add_imu(self, t, acceleration, rate, temperature):
        self.imu.append((t, *acceleration, *rate, temperature))
        self.heard = time.monotonic()

    def add_edge(self, t, kind):
        self.edges.append((t, kind))
        self.heard = time.monotonic()

    def finished(self):
        now = time.monotonic()
        return now > self.deadline or (self.done.exists() and now > self.heard + QUIET_S)

    def save(self, path):
        images = {f'frame_{k}': image for k, (image, _, _) in enumerate(self.frames)}
        np.savez(
            path,
            events=np.concatenate(self.events) if self.events else np.zeros((0, 4), np.int64),
            imu=np.array(self.imu, float).reshape(-1, 8),
            edges=np.array(self.edges, np.int64).reshape(-1, 2),
            frame_times=np.array([times for _, times, _ in self.frames]).reshape(-1, 4),
            corners=np.array([corner for _, _, corner in self.frames]).reshape(-1, 2),
            **images,
        )


def ours(seen):
    """Acceleration in m/s^2, turn rate in rad/s; the clock restarts after a reset."""
    from mixtac_driver.camera import Davis346
    from mixtac_driver.parameters import DriverParameters

    every_edge = DriverParameters(external_input_rising=True, external_input_falling=True)
    with Davis346(every_edge) as camera:
        camera.start()
        resets = None
        for batch in until_finished(camera, seen):
            decoded = batch.decoded
            if resets is not None and decoded.resets != resets:
                seen.add_edge(0, RESET)
            resets = decoded.resets
            e = decoded.events
            seen.add_events(e.t, e.x, e.y, e.polarity)
            imu = decoded.imu
            for row in zip(
                imu.t, imu.acceleration, imu.angular_velocity, imu.temperature, strict=True
            ):
                seen.add_imu(*row)
            for t, kind in zip(decoded.edges.t, decoded.edges.kind, strict=True):
                seen.add_edge(t, kind)
            for f in decoded.frames:
                times = (f.frame_start_us, f.exposure_start_us, f.exposure_end_us, f.frame_end_us)
                seen.add_frame(f.image, times, (f.x, f.y))


def until_finished(camera, seen):
    """Yield the camera's batches; without data its iterator waits, so a thread ends it."""
    import threading

    def watch():
        while not seen.finished():
            time.sleep(0.02)
        camera.request_stop()

    threading.Thread(target=watch, daemon=True).start()
    for batch in camera.batches():
        seen.ready.touch()
        yield batch


def libcaer(seen):
    """Acceleration in g, turn rate in deg/s."""
    from umockdev_libcaer import Libcaer

    camera = Libcaer()
    camera.start()
    seen.ready.touch()
    while not seen.finished():
        for packet in camera.packets():
            if packet.kind == 'polarity':
                seen.add_events(*packet.events())
            elif packet.kind == 'frame':
                for frame in packet.frames():
                    seen.add_frame(*frame)
            elif packet.kind == 'imu':
                for t, acceleration, rate, temperature in packet.samples():
                    seen.add_imu(t, acceleration, rate, temperature)
            else:
                for t, kind in packet.specials():
                    if kind in LIBCAER_EDGES:
                        seen.add_edge(t, LIBCAER_EDGES[kind])
    camera.close()


def main():
    client, out, ready, done = sys.argv[1:]
    seen = Seen(Path(ready), Path(done))
    {'ours': ours, 'libcaer': libcaer}[client](seen)
    seen.save(out)


if __name__ == '__main__':
    main()
