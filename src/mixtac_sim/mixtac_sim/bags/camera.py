# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver's messages of a simulated trial, transfer by transfer, and the clocks of the trial.

The camera sends its data every millisecond, as the driver requests; the host receives the data a
little later. Events are cut by the driver's own packetizer, the clock is mapped by the driver's own
clock map, and inertial samples are rounded to the camera's sixteen bits.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own. Messages are in the order in which a recorder would
have received them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.clock_map import ClockMap
from mixtac_core.events.packets import PacketWriter
from mixtac_core.events.readings import NO_SAMPLES, Frame, InertialSamples, inertial_samples
from mixtac_core.events.windows import Packetizer
from mixtac_core.node.topics import CAMERA_FRAME, IMU, IMU_FRAME
from mixtac_core.recordings import messages
from mixtac_core.recordings.bag import blank_message, typestore
from mixtac_sim.grids import HEIGHT, WIDTH, stream
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.stream import Oscillator
from mixtac_sim.usb.words import ImuReading, ImuSettings, raw_values
from mixtac_sim.world.instruments import ReferenceSensor
from mixtac_sim.world.trial import Stretch

FIRST_DAY_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01 00:00 UTC: simulated trials lie from here on, an hour apart by their seeds."""
HOUR_NS: Final = 3_600_000_000_000
HOURS: Final = 100_000
LARGEST_SKEW_PPM: Final = 50.0
"""Usual tolerance of a crystal oscillator."""
LEAST_DELAY_US: Final = 150.0
"""Least time from the end of a USB transfer to the host's stamp [us] (estimate)."""
MORE_DELAY_US: Final = 100.0
"""Mean of the further delay, which is exponential [us] (estimate)."""


class TrialClocks:
    """Converts the times of one trial.

    Args:
        trial_seed: Fixes the camera's skew, the delays and the day.

    Attributes:
        skew_ppm: Rate of the camera's clock over the host's, less one [1e-6].
        epoch_ns: Host time at true time 0 [ns since the Unix epoch].
        origin_us: Host time at which the camera's clock read zero [us since the Unix epoch].
    """

    def __init__(self, trial_seed: int) -> None:
        self.skew_ppm = float(
            stream(trial_seed, 'camera clock').uniform(-LARGEST_SKEW_PPM, LARGEST_SKEW_PPM)
        )
        self.epoch_ns = FIRST_DAY_NS + HOUR_NS * (trial_seed % HOURS)
        self.origin_us = self.epoch_ns // 1000
        self._oscillator = Oscillator(self.skew_ppm)
        self._delays = stream(trial_seed, 'usb delay')

    def to_camera_us(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.to_camera(true_us)

    def camera_us(self, true_us: int) -> int:
        """Convert one true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.now(true_us)

    def to_host_ns(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the host's [ns since the Unix epoch]."""
        return np.asarray(self.epoch_ns + 1000 * true_us, np.int64)

    def arrivals_ns(self, end_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return when the host has transfers that end at true times [us]; draws new delays.

        The delays are at least `LEAST_DELAY_US`; arrivals are in order.
        """
        delays_us = LEAST_DELAY_US + self._delays.exponential(MORE_DELAY_US, len(end_us))
        arrivals = self.to_host_ns(end_us) + np.round(1000 * delays_us).astype(np.int64)
        return np.asarray(np.maximum.accumulate(arrivals), np.int64)

    def reference_rate(self, reference: ReferenceSensor) -> float:
        """Return the true rate of the reference sensor's clock over the camera's."""
        return (1.0 + 1e-6 * reference.drift_ppm) / (1.0 + 1e-6 * self.skew_ppm)


NS = 1_000_000_000
_STAMP_AT = 4
"""After CDR's four bytes that name the byte order."""


def serialised(message: Any) -> bytes:  # noqa: ANN401
    """Return a message of `mixtac_core.recordings.bag.blank_message` in CDR."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


class StampedRows:
    """Serialises messages that begin with a header and end with doubles.

    Args:
        example: One such message of `blank_message`; all other fields are taken from it.
        numbers: Number of doubles at its end.
    """

    def __init__(self, example: Any, numbers: int) -> None:  # noqa: ANN401
        self._example = example = serialised(example)
        self._layout = np.dtype(
            {
                'names': ['sec', 'nanosec', 'numbers'],
                'formats': ['<i4', '<u4', ('<f8', numbers)],
                'offsets': [_STAMP_AT, _STAMP_AT + 4, len(example) - 8 * numbers],
                'itemsize': len(example),
            }
        )

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Return the doubles of the example."""
        row = np.frombuffer(self._example, self._layout)[0]
        return np.array(row['numbers'], np.float64)

    def make(self, stamp_ns: NDArray[np.int64], numbers: NDArray[np.float64]) -> list[bytes]:
        """Return one message per row.

        Args:
            stamp_ns: Stamps [n] [ns].
            numbers: The doubles [n, numbers].
        """
        octets = bytearray(self._example * len(stamp_ns))
        rows = np.frombuffer(octets, self._layout)
        rows['sec'], rows['nanosec'] = stamp_ns // NS, stamp_ns % NS
        rows['numbers'] = numbers
        size = len(self._example)
        return [bytes(octets[i : i + size]) for i in range(0, len(octets), size)]


class BagMessage(NamedTuple):
    """One message of a bag.

    Attributes:
        received_ns: Reception by a recorder [ns since the Unix epoch].
        topic: Name relative to the namespace, or absolute.
        data: Serialised message.
    """

    received_ns: int
    topic: str
    data: bytes


class MessageSink:
    """Sorts messages by the time of their reception; those of one time keep their order."""

    def __init__(self) -> None:
        self._waiting: list[BagMessage] = []

    def put(self, received_ns: int, topic: str, message: Any) -> None:  # noqa: ANN401
        """Add a message of `blank_message`."""
        self._waiting.append(BagMessage(received_ns, topic, serialised(message)))

    def put_rows(self, received_ns: Iterable[int], topic: str, rows: Iterable[bytes]) -> None:
        """Add messages of one topic.

        Args:
            received_ns: Time of reception of each [ns].
            topic: Their topic.
            rows: The messages, serialised.
        """
        pairs = zip(received_ns, rows, strict=True)
        self._waiting.extend(BagMessage(when, topic, row) for when, row in pairs)

    def take(self, until_ns: int) -> list[BagMessage]:
        """Return and forget the messages received before a time [ns], in order."""
        due = [message for message in self._waiting if message.received_ns < until_ns]
        self._waiting = [message for message in self._waiting if message.received_ns >= until_ns]
        due.sort(key=lambda message: message.received_ns)
        return due


MPU9250: Final = 2
SIZE: Final = (WIDTH, HEIGHT)
_ANGULAR: Final = slice(13, 16)
"""Places of the angular velocity in the doubles of `sensor_msgs/msg/Imu`."""
_LINEAR: Final = slice(25, 28)
"""Places of the linear acceleration there."""


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
        self._packetizer = Packetizer()
        self._clocks, self._sink, self._serial = clocks, sink, serial
        self._map = ClockMap()
        self._clock_due_ns = 0
        self._temperature_due_us = 0
        self._packets, self._sequence = PacketWriter(CAMERA_FRAME, SIZE), 0
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
                data = self._packets.write(packet.encode(), self._sequence, packet.arrival_ns)
                self._sink.put_rows([arrival_ns + PUBLISH_NS], 'events', [data])
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
