# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The messages of a simulated trial, transfer by transfer, and the clocks of the trial.

The camera sends its data every millisecond, as the driver requests; the host receives the data a
little later. Events are cut by the driver's own packetizer, the clock is mapped by the driver's own
clock map, and inertial samples are rounded to the camera's sixteen bits.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own. Messages are in the order in which a recorder would
have received them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.clock_map import ClockMap
from mixtac_core.events.readings import Frame, InertialSamples, inertial_samples
from mixtac_core.node import topics
from mixtac_core.node.topics import Topic
from mixtac_core.recordings import messages
from mixtac_core.recordings.bag import blank_message
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.importing import StreamWriter, serialised
from mixtac_sim.grids import HEIGHT, WIDTH, stream
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.usb.stream import Oscillator
from mixtac_sim.usb.words import ImuReading, ImuSettings, raw_values
from mixtac_sim.world.sensor import truth_wrench
from mixtac_sim.world.trial import Stretch, TrialStream

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
        camera: The camera's clock since its reset.
        epoch_ns: Host time at true time 0 [ns since the Unix epoch].
        origin_us: Host time at which the camera's clock read zero [us since the Unix epoch].
    """

    def __init__(self, trial_seed: int) -> None:
        self.skew_ppm = float(
            stream(trial_seed, 'camera clock').uniform(-LARGEST_SKEW_PPM, LARGEST_SKEW_PPM)
        )
        self.epoch_ns = FIRST_DAY_NS + HOUR_NS * (trial_seed % HOURS)
        self.origin_us = self.epoch_ns // 1000
        self.camera = Oscillator(self.skew_ppm)
        self._delays = stream(trial_seed, 'usb delay')
        self._latest_ns = 0

    def to_host_ns(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the host's [ns since the Unix epoch]."""
        return np.asarray(self.epoch_ns + 1000 * true_us, np.int64)

    def arrivals_ns(self, end_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return when the host has transfers that end at true times [us]; draws new delays.

        The delays are at least `LEAST_DELAY_US`; arrivals are in order, also from call to call.
        """
        delays_us = LEAST_DELAY_US + self._delays.exponential(MORE_DELAY_US, len(end_us))
        arrivals = self.to_host_ns(end_us) + np.round(1000 * delays_us).astype(np.int64)
        arrivals = np.maximum.accumulate(np.maximum(arrivals, self._latest_ns))
        self._latest_ns = int(arrivals.max(initial=self._latest_ns))
        return np.asarray(arrivals, np.int64)


MPU9250: Final = 2
SIZE: Final = (WIDTH, HEIGHT)


def decoded_samples(readings: list[ImuReading], camera_us: NDArray[np.int64]) -> InertialSamples:
    """Return what the driver decodes from the camera's words, with its default settings.

    Args:
        readings: Measurements of the inertial unit.
        camera_us: Times of the readings [n] [us, camera clock].
    """
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


BATCH_NS: Final = 4_000_000
"""The virtual sensor publishes truth and reference every 4 ms."""


class TrialWriter(StreamWriter):
    """Writes a trial to a bag in order of reception.

    Args:
        bag: A bag that is open.
        trial: Runs once.
    """

    def __init__(self, bag: McapBag, trial: TrialStream) -> None:
        super().__init__(bag, SIZE)
        self._trial, self._clocks = trial, TrialClocks(trial.spec.trial_seed)
        self._waiting: list[tuple[int, Topic, Any]] = []
        self._map = ClockMap()
        self._clock_due_ns = self._temperature_due_us = self._reached_us = 0
        zero = np.zeros((1, 3))
        still = InertialSamples(np.zeros(1, np.int64), zero, zero, np.zeros(1))
        self._imu = messages.imu(still, 0, 0, topics.IMU_FRAME, blank_message)
        self._point = blank_message(topics.TRUTH_CONTACT.type_name)
        self._wrench = topics.WrenchWriter(topics.CONTACT_FRAME)
        self._reference = topics.WrenchWriter(topics.REFERENCE_FRAME)

    def write(self) -> None:
        """Write the whole trial."""
        self._put_clock_fit()
        for stretch in self._trial.stretches():
            self._put_camera(stretch)
            self._put_truth(stretch)
            self._put_reference(stretch)
            self._write_before(self._clocks.epoch_ns + 1000 * stretch.end_us)
        self._write_before(1 << 63)

    def put(self, topic: Topic, received_ns: int, message: Any) -> None:  # noqa: ANN401
        """Keep a message until everything that is received earlier is known."""
        self._waiting.append((received_ns, topic, serialised(topic, message)))

    def _write_before(self, until_ns: int) -> None:
        # A stable sort: messages that are received at one time keep the order of their making.
        self._waiting.sort(key=lambda waiting: waiting[0])
        due = sum(received_ns < until_ns for received_ns, _, _ in self._waiting)
        for received_ns, topic, data in self._waiting[:due]:
            super().put(topic, received_ns, data)
        del self._waiting[:due]

    def _put_clock_fit(self) -> None:
        """Put the true relation of the clocks, which is published once."""
        clocks, reference = self._clocks, self._trial.reference
        message = blank_message(topics.TRUTH_CLOCK_FIT.type_name)
        messages.set_header(message, clocks.epoch_ns, '')
        message.a = (1.0 + 1e-6 * reference.drift_ppm) / (1.0 + 1e-6 * clocks.skew_ppm)
        message.b = reference.offset_s
        message.camera_epoch = message.reference_epoch = 1e-9 * clocks.epoch_ns
        message.method, message.message = 'simulation', 'true relation of the clocks'
        self.put(topics.TRUTH_CLOCK_FIT, clocks.epoch_ns, message)

    def _put_truth(self, stretch: Stretch) -> None:
        truth = stretch.sensor.truth
        stamps_ns = self._clocks.to_host_ns(truth['t_us'].astype(np.int64)).tolist()
        for stamp_ns, wrench in zip(stamps_ns, truth_wrench(truth).tolist(), strict=True):
            data = self._wrench.serialised(stamp_ns, wrench)
            self.put(topics.TRUTH_WRENCH, _batch_end(stamp_ns), data)
        right, down = self._trial.sensor.contact_mm
        place, message = self._point.point, self._point
        place.x, place.y = 1e-3 * right, -1e-3 * down
        for stamp_ns, depth_m in zip(stamps_ns, (1e-3 * truth['depth_mm']).tolist(), strict=True):
            messages.set_header(message, stamp_ns, topics.CONTACT_FRAME)
            place.z = depth_m
            self.put(topics.TRUTH_CONTACT, _batch_end(stamp_ns), message)

    def _put_reference(self, stretch: Stretch) -> None:
        samples, sensor, epoch_ns = stretch.reference, self._trial.reference, self._clocks.epoch_ns
        true_ns = (samples.t_ns - 1e9 * sensor.offset_s) / (1.0 + 1e-6 * sensor.drift_ppm)
        latest_ns = epoch_ns + 1000 * stretch.end_us
        rows = zip(
            (epoch_ns + true_ns.astype(np.int64)).tolist(),
            (epoch_ns + samples.t_ns).tolist(),
            samples.wrench.tolist(),
            strict=True,
        )
        for measured_ns, stamp_ns, wrench in rows:
            received_ns = min(_batch_end(measured_ns), latest_ns)
            data = self._reference.serialised(stamp_ns, wrench)
            self.put(topics.REFERENCE_WRENCH, received_ns, data)

    def _put_camera(self, stretch: Stretch) -> None:
        ends = np.arange(stretch.start_us, stretch.end_us, TRANSFER_US) + TRANSFER_US
        arrivals = self._clocks.arrivals_ns(ends)
        self._put_events(stretch, ends, arrivals)
        for frame in stretch.sensor.frames:
            transfer = int(np.searchsorted(ends, frame.frame_end_us, side='right'))
            received_ns = int(arrivals[transfer]) + PUBLISH_NS
            self.frame(self._decoded(frame), self._clocks.origin_us, received_ns)
        if stretch.readings:
            self._put_samples(stretch, ends, arrivals)

    def _put_events(
        self, stretch: Stretch, ends: NDArray[np.int64], arrivals: NDArray[np.int64]
    ) -> None:
        events, origin_us = stretch.sensor.events, self._clocks.origin_us
        cuts = np.searchsorted(events.t, ends).tolist()
        camera_us = self._clocks.camera.to_camera(events.t)
        published = Events(camera_us + origin_us, events.x, events.y, events.polarity)
        reached = self._reached(stretch, ends, camera_us, cuts).tolist()
        first = 0
        for last, time_us, arrival_ns in zip(cuts, reached, arrivals.tolist(), strict=True):
            due, until_us = published[first:last], time_us + origin_us
            self.events(due, until_us, arrival_ns, delay_ns=PUBLISH_NS)
            self._put_clock(time_us, arrival_ns)
            first = last

    def _reached(
        self,
        stretch: Stretch,
        ends: NDArray[np.int64],
        camera_us: NDArray[np.int64],
        cuts: list[int],
    ) -> NDArray[np.int64]:
        """Return the latest camera time [us] that each transfer states."""
        wraps = self._clocks.camera.to_camera(ends - 1) // WRAP_US * WRAP_US
        times = np.concatenate([[self._reached_us], camera_us])
        latest = np.maximum(wraps, times[np.array(cuts)])
        if stretch.readings:
            read = np.array([reading.t_us for reading in stretch.readings], np.int64)
            known = np.concatenate([[self._reached_us], self._clocks.camera.to_camera(read)])
            latest = np.maximum(latest, known[np.searchsorted(read, ends)])
        latest = np.maximum(np.maximum.accumulate(latest), self._reached_us)
        self._reached_us = int(latest[-1])
        return latest

    def _put_clock(self, time_us: int, arrival_ns: int) -> None:
        self._map.add(time_us, arrival_ns)
        if arrival_ns < self._clock_due_ns:
            return
        self._clock_due_ns = arrival_ns + CLOCK_PERIOD_NS
        camera_us = self._map.to_camera_us(arrival_ns) + self._clocks.origin_us
        serial = serial_number(self._trial.spec.device_seed)
        message = messages.camera_clock(arrival_ns, camera_us, serial, blank_message)
        self.put(topics.CAMERA_CLOCK, arrival_ns + PUBLISH_NS, message)

    def _decoded(self, frame: ApsFrame) -> Frame:
        """Return the frame as the driver's decoder has it."""
        camera_us = self._clocks.camera.now
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

    def _put_samples(
        self, stretch: Stretch, ends: NDArray[np.int64], arrivals: NDArray[np.int64]
    ) -> None:
        true_us = np.array([reading.t_us for reading in stretch.readings], np.int64)
        samples = decoded_samples(stretch.readings, self._clocks.camera.to_camera(true_us))
        received = (arrivals[np.searchsorted(ends, true_us, side='right')] + PUBLISH_NS).tolist()
        times_us = (samples.t + self._clocks.origin_us).tolist()
        message, warm = self._imu, samples.temperature.tolist()
        linear, angular = message.linear_acceleration, message.angular_velocity
        vectors = zip(samples.acceleration.tolist(), samples.angular_velocity.tolist(), strict=True)
        for received_ns, time_us, (force, rate) in zip(received, times_us, vectors, strict=True):
            messages.set_header(message, 1000 * time_us, topics.IMU_FRAME)
            linear.x, linear.y, linear.z = force
            angular.x, angular.y, angular.z = rate
            self.put(topics.IMU, received_ns, message)
        for received_ns, time_us, celsius in zip(received, times_us, warm, strict=True):
            if time_us >= self._temperature_due_us:
                self._temperature_due_us = time_us + TEMPERATURE_PERIOD_US
                message = messages.temperature(celsius, time_us, topics.IMU_FRAME, blank_message)
                self.put(topics.TEMPERATURE, received_ns, message)


def _batch_end(measured_ns: int) -> int:
    return -(-measured_ns // BATCH_NS) * BATCH_NS
