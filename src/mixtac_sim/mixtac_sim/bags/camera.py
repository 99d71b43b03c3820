# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver's messages of a simulated trial, transfer by transfer.

The camera sends its data every millisecond, as the driver requests; the host receives them
a little later. Events are cut by the driver's own packetizer, the clock is mapped by the driver's
own clock map, and inertial samples are rounded to the camera's sixteen bits.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.clock_map import ClockMap
from mixtac_events.packetizer import ENCODING, PACKET_BYTES, PACKET_PERIOD_US, Packetizer
from mixtac_events.readings import NO_SAMPLES, Frame, InertialSamples, inertial_samples
from mixtac_node.topics import CAMERA_FRAME, IMU, IMU_FRAME
from mixtac_recordings import messages
from mixtac_recordings.bag import blank_message
from mixtac_sim.bags.messages import MessageSink, StampedRows, TrialClocks
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.words import ImuReading, ImuSettings, raw_values
from mixtac_sim.world.trial import Stretch

MPU9250: Final = 2
SIZE: Final = (WIDTH, HEIGHT)
_ANGULAR, _LINEAR = slice(13, 16), slice(25, 28)
"""Places of the two vectors in the doubles of `sensor_msgs/msg/Imu`."""


def decoded_samples(readings: list[ImuReading], camera_us: NDArray[np.int64]) -> InertialSamples:
    """Return what the driver decodes from the camera's words, with its default settings.

    Args:
        readings: Measurements of the unit.
        camera_us: Times of the readings [n] [us, camera clock].
    """
    if not readings:
        return NO_SAMPLES
    settings = ImuSettings()
    raw = np.empty((len(readings), 15), np.uint8)
    values = [raw_values(reading, settings) for reading in readings]
    raw[:, :14] = np.array(values, '>i2').view(np.uint8)
    raw[:, 14] = settings.info
    return inertial_samples(camera_us, raw, (False, False, False), MPU9250)


TRANSFER_US: Final = 1_000
"""Period after which the camera sends what it has [us]: the default of the driver."""
WRAP_US: Final = 1 << 15
"""Period of the wrap words of the 15-bit camera time, which are sent without events, too [us]."""
PUBLISH_NS: Final = 200_000
"""From the arrival of data to their reception by a recorder [ns] (estimate)."""
CLOCK_PERIOD_NS: Final = 1_000_000_000
TEMPERATURE_PERIOD_US: Final = 100_000


class CameraMessages:
    """Makes the driver's messages of a trial.

    Args:
        clocks: Clocks of the trial.
        sink: Takes the messages.
        serial: Serial number of the camera.
    """

    def __init__(self, clocks: TrialClocks, sink: MessageSink, serial: str) -> None:
        self._packetizer = Packetizer(ENCODING, PACKET_PERIOD_US, PACKET_BYTES)
        self._clocks, self._sink, self._serial = clocks, sink, serial
        self._map = ClockMap()
        self._clock_due_ns = 0
        self._temperature_due_us = 0
        self._sequence = 0
        zero = np.zeros((1, 3))
        still = InertialSamples(np.zeros(1, np.int64), zero, zero, np.zeros(1))
        sample = messages.imu(still, 0, 0, IMU_FRAME, blank_message)
        self._imu_rows = StampedRows(sample, 37)
        self._reached_us = 0

    def add(self, stretch: Stretch) -> None:
        """Make the messages of the next stretch."""
        ends = np.arange(stretch.start_us, stretch.end_us, TRANSFER_US) + TRANSFER_US
        arrivals = self._clocks.arrivals_ns(ends)
        self._add_events(stretch, ends, arrivals)
        for frame in stretch.sensor.frames:
            transfer = int(np.searchsorted(ends, frame.frame_end_us, side='right'))
            self._add_frame(frame, int(arrivals[transfer]))
        if stretch.readings:
            self._add_samples(stretch, ends, arrivals)

    def _add_events(
        self, stretch: Stretch, ends: NDArray[np.int64], arrivals: NDArray[np.int64]
    ) -> None:
        events, origin_us = stretch.sensor.events, self._clocks.origin_us
        cuts = np.searchsorted(events.t, ends).tolist()
        camera_us = self._clocks.to_camera_us(events.t)
        published = Events(camera_us + origin_us, events.x, events.y, events.polarity)
        reached = self._reached(stretch, ends, camera_us, cuts).tolist()
        first = 0
        for last, time_us, arrival_ns in zip(cuts, reached, arrivals.tolist(), strict=True):
            packets = self._packetizer.push(published[first:last], time_us + origin_us, arrival_ns)
            for packet in packets:
                message = messages.event_packet(
                    packet, self._sequence, SIZE, CAMERA_FRAME, blank_message
                )
                self._sink.put(arrival_ns + PUBLISH_NS, 'events', message)
                self._sequence += 1
            self._add_clock(time_us, arrival_ns)
            first = last

    def _reached(
        self,
        stretch: Stretch,
        ends: NDArray[np.int64],
        camera_us: NDArray[np.int64],
        cuts: list[int],
    ) -> NDArray[np.int64]:
        """Return the latest camera time [us] that each transfer states."""
        wraps = self._clocks.to_camera_us(ends - 1) // WRAP_US * WRAP_US
        times = np.concatenate([[self._reached_us], camera_us])
        latest = np.maximum(wraps, times[np.array(cuts)])
        if stretch.readings:
            read = np.array([reading.t_us for reading in stretch.readings], np.int64)
            known = np.concatenate([[self._reached_us], self._clocks.to_camera_us(read)])
            latest = np.maximum(latest, known[np.searchsorted(read, ends)])
        latest = np.maximum(np.maximum.accumulate(latest), self._reached_us)
        self._reached_us = int(latest[-1])
        return latest

    def _add_clock(self, time_us: int, arrival_ns: int) -> None:
        self._map.add(time_us, arrival_ns)
        if arrival_ns < self._clock_due_ns:
            return
        self._clock_due_ns = arrival_ns + CLOCK_PERIOD_NS
        camera_us = self._map.to_camera_us(arrival_ns) + self._clocks.origin_us
        message = messages.camera_clock(arrival_ns, camera_us, self._serial, blank_message)
        self._sink.put(arrival_ns + PUBLISH_NS, 'camera_clock', message)

    def _add_frame(self, frame: ApsFrame, arrival_ns: int) -> None:
        decoded, origin_us = self._decoded(frame), self._clocks.origin_us
        image = messages.image(decoded, origin_us, 0, CAMERA_FRAME, blank_message)
        info = messages.camera_info(decoded, SIZE, image, blank_message)
        exposure = messages.frame_exposure(decoded, origin_us, image, blank_message)
        named = (('image_raw', image), ('camera_info', info), ('image_exposure', exposure))
        for name, message in named:
            self._sink.put(arrival_ns + PUBLISH_NS, name, message)

    def _decoded(self, frame: ApsFrame) -> Frame:
        """Return the frame as the driver's decoder has it."""
        camera_us = self._clocks.camera_us
        return Frame(
            image=frame.intensity,
            x=0,
            y=0,
            frame_start_us=camera_us(frame.frame_start_us),
            exposure_start_us=camera_us(frame.exposure_start_us),
            exposure_end_us=camera_us(frame.exposure_end_us),
            frame_end_us=camera_us(frame.frame_end_us),
            exposure_cycles=0,
            global_shutter=True,
        )

    def _add_samples(
        self, stretch: Stretch, ends: NDArray[np.int64], arrivals: NDArray[np.int64]
    ) -> None:
        true_us = np.array([reading.t_us for reading in stretch.readings], np.int64)
        samples = decoded_samples(stretch.readings, self._clocks.to_camera_us(true_us))
        received = arrivals[np.searchsorted(ends, true_us, side='right')] + PUBLISH_NS
        rows = self._imu_rows
        stamps_ns = 1000 * (samples.t + self._clocks.origin_us)
        numbers = np.tile(rows.numbers, (len(samples.t), 1))
        numbers[:, _ANGULAR], numbers[:, _LINEAR] = samples.angular_velocity, samples.acceleration
        data = rows.make(stamps_ns, numbers)
        self._sink.put_rows(received.tolist(), IMU.name, data)
        self._add_temperatures(samples, received)

    def _add_temperatures(self, samples: InertialSamples, received: NDArray[np.int64]) -> None:
        for index in range(len(samples.t)):
            time_us = int(samples.t[index]) + self._clocks.origin_us
            if time_us >= self._temperature_due_us:
                self._temperature_due_us = time_us + TEMPERATURE_PERIOD_US
                message = messages.temperature(
                    float(samples.temperature[index]), time_us, IMU_FRAME, blank_message
                )
                self._sink.put(int(received[index]), 'temperature', message)
